//! Models that are installed while the robot drives: the network is swapped between two ticks,
//! monitored during its trial, and rolled back automatically if it fails.
//!
//! The model before it stays in memory until the trial is over, so a rollback needs no disk.

use hal::{Clock, Pose2};
use monotonic_clock::MonotonicClock;
use runtime::event::{Event, SafetyEvent};
use runtime::model_gate::{
    LidarView, LostObstacles, Trial, TrialCounts, TrialLimits, TrialState, TrialTick, lidar_score,
};
use runtime::perception::{DepthNetwork, NoDepth};
use runtime::robot::Robot;
use runtime::tick::{Command, Decision, TickInput};

use std::path::Path;
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};

use anyhow::{Context, Result};
use signed_model::TrustedKeys;

use super::counts::{Counted, SavedCounts};
use super::error::StoreErrorKind;
use super::store::{State, Store};
use crate::config::Config;
use crate::setup;

/// Interval between two checks for a new model, nanoseconds.
const POLL_INTERVAL_NS: u64 = 1_000_000_000;
/// The counts of the resident model are halved after this number of ticks, so that they follow
/// changes of the home and its light.
const REMEMBERED_TICKS: u64 = 6000;

/// Number of ticks with a frame after which the counts are written to the disk: 10 s at 10 Hz.
const SAVED_EVERY_TICKS: u64 = 100;

/// A change of the current model.
pub enum Swap {
    /// Use this network, which is loaded and warmed up.
    To { network: Box<DepthNetwork>, on_trial: bool },
    /// Use no network.
    ToNone,
}

/// Request of the control loop to the [`Keeper`]: how a trial goes and how it ended.
enum Request {
    Keep {
        digest: String,
        why: String,
    },
    /// `drives` is the digest of the network that the robot uses instead.
    RollBack {
        digest: String,
        why: String,
        drives: Option<String>,
    },
    /// The model on trial has run for long enough not to be the cause of crashes.
    Survived {
        digest: String,
    },
    Save(SavedCounts),
}

/// Watches one store: loads newly installed models, and writes the results of trials into it.
pub struct Keeper {
    store: Store,
    config: Config,
    /// Digest of the model that the loop uses, as far as the keeper knows.
    seen: Option<String>,
}

impl Keeper {
    /// Opens the store and loads the network that the robot starts with and, if that one is on
    /// trial, the one to go back to. `first` is put into a store that never had a model.
    ///
    /// A current model that cannot be loaded is rolled back. A model whose signature is not trusted
    /// any more is not used, and stays in the store: the robot starts with the one before it, or
    /// without a network. If the store's own file is damaged, the store is rolled back to a model
    /// that has passed its trial.
    ///
    /// # Errors
    /// If the store cannot be used, or `first` is needed and cannot be read.
    pub fn start(dir: &Path, first: Option<&Path>, config: &Config) -> Result<(Self, Start)> {
        let mut keeper = Self { store: Store::open(dir)?, config: config.clone(), seen: None };
        if let Some(path) = first {
            keeper.adopt(path)?;
        }
        let mut state = keeper.begin()?;
        let mut network = None;
        while let Some(digest) = state.current().map(str::to_owned) {
            match keeper.load(&digest) {
                Ok(loaded) => {
                    network = Some(loaded);
                    break;
                }
                Err(NotLoaded::Untrusted(why)) => {
                    tracing::error!("the model {digest} is not used: {why:#}");
                }
                Err(NotLoaded::Broken(error)) => {
                    keeper
                        .give_up(&digest, &format!("rolled back: it cannot be loaded: {error:#}"));
                }
            }
            // Also go on in memory, in case the store cannot be written.
            state.models.remove(0);
            state.trial_starts = None;
        }
        let on_trial = state.current().filter(|_| state.trial_starts.is_some()).map(str::to_owned);
        let resident = state
            .previous()
            .filter(|_| on_trial.is_some())
            .and_then(|digest| keeper.load(digest).ok());
        keeper.seen =
            keeper.store.state().ok().and_then(|state| state.current().map(str::to_owned));
        let used = if on_trial.is_some() { resident.as_ref() } else { network.as_ref() };
        let compared_with = used.map(|network| network.digest().to_owned());
        let counts = keeper.store.counts();
        Ok((keeper, Start { network, on_trial, resident, compared_with, counts }))
    }

    /// The state of the store at the start. The robot must also start with a full disk or a damaged
    /// file.
    fn begin(&mut self) -> Result<State> {
        let error = match self.store.start() {
            Ok(state) => return Ok(state),
            Err(error) => error,
        };
        tracing::error!("{error}");
        if error.kind() == StoreErrorKind::Damaged {
            return Ok(self.store.roll_back(&format!("rolled back automatically: {error}"))?);
        }
        let mut state = self.store.state()?;
        if let Some(digest) = state.current().filter(|_| state.trial_starts.is_some()) {
            // Without a count of the starts, a model that crashes the program would do so forever.
            tracing::error!(
                "cannot count the starts with the model {digest}; using the model before it"
            );
            state.models.remove(0);
            state.trial_starts = None;
        }
        Ok(state)
    }

    fn adopt(&mut self, path: &Path) -> Result<()> {
        if self.store.is_new() {
            let model = std::fs::read(path)
                .with_context(|| format!("cannot read the model {}", path.display()))?;
            let name = path.file_stem().unwrap_or_default().to_string_lossy();
            self.store.adopt(&model, &name)?;
        }
        Ok(())
    }

    fn load(&self, digest: &str) -> Result<DepthNetwork, NotLoaded> {
        let bytes =
            self.store.read_model(digest).map_err(|error| NotLoaded::Broken(error.into()))?;
        self.check_signature(digest, &bytes).map_err(NotLoaded::Untrusted)?;
        setup::network_of(&bytes, &self.config.camera.model(), &self.config)
            .map_err(NotLoaded::Broken)
    }

    /// Checks a model's signature against the keys that the configuration trusts now, whichever keys
    /// it was installed with.
    fn check_signature(&self, digest: &str, model: &[u8]) -> Result<()> {
        if let Some(signature) = self.store.signature(digest)? {
            let keys = TrustedKeys::read(Path::new(&self.config.models.trusted_keys))?;
            signed_model::verify(model, &signature, &keys)?;
        }
        Ok(())
    }

    /// Loads the current model of the store if it has changed. A model that cannot be loaded is
    /// rolled back; one that is not trusted is not used.
    pub fn poll(&mut self) -> Option<Swap> {
        let state = self.store.state().inspect_err(|error| tracing::error!("{error}")).ok()?;
        if state.current() == self.seen.as_deref() {
            return None;
        }
        let Some(digest) = state.current() else {
            self.seen = None;
            return Some(Swap::ToNone);
        };
        match self.load(digest) {
            Ok(network) => {
                self.seen = Some(digest.to_owned());
                Some(Swap::To {
                    network: Box::new(network),
                    on_trial: state.trial_starts.is_some(),
                })
            }
            Err(NotLoaded::Untrusted(why)) => {
                tracing::error!("the model {digest} is not used: {why:#}");
                self.seen = Some(digest.to_owned());
                None
            }
            Err(NotLoaded::Broken(error)) => {
                // The model that is current now may differ from the one in use: the next poll sees
                // it.
                if !self.give_up(digest, &format!("rolled back: it cannot be loaded: {error:#}")) {
                    self.seen = Some(digest.to_owned());
                }
                None
            }
        }
    }

    fn handle(&mut self, request: Request) {
        match request {
            Request::Keep { digest, why } => {
                if let Err(error) = self.store.keep(&digest, &why) {
                    tracing::error!("the model {digest} stays on trial: {error}");
                }
            }
            Request::RollBack { digest, why, drives } => {
                // `seen` stays if the store could not be changed, so that the bad model is not
                // loaded again, and if another model is already on its way to the loop.
                if self.give_up(&digest, &why) && self.seen == Some(digest) {
                    self.seen = drives;
                }
            }
            Request::Survived { digest } => {
                if let Err(error) = self.store.survived(&digest) {
                    tracing::warn!("the starts of the model {digest} are not forgotten: {error}");
                }
            }
            Request::Save(counts) => {
                if let Err(error) = self.store.save_counts(&counts) {
                    tracing::warn!("the counts of the trial are not saved: {error}");
                }
            }
        }
    }

    /// Rolls back the model `digest` unless another process already did. Returns whether the store
    /// was changed or already names another model.
    fn give_up(&mut self, digest: &str, why: &str) -> bool {
        tracing::error!("giving up the model {digest}: {why}");
        self.store
            .give_up(digest, why)
            .inspect_err(|error| {
                tracing::error!("the store still names the model {digest}: {error}");
            })
            .is_ok()
    }
}

/// Why a model is not used.
enum NotLoaded {
    /// No key that is trusted now has signed it.
    Untrusted(anyhow::Error),
    /// It is damaged, or not a network for this robot.
    Broken(anyhow::Error),
}

/// The networks that the robot starts with.
pub struct Start {
    /// The network in use, if there is one.
    pub network: Option<DepthNetwork>,
    /// Digest of `network` if it is on trial.
    pub on_trial: Option<String>,
    /// The network before it, if `network` is on trial.
    pub resident: Option<DepthNetwork>,
    /// Digest of the model that a candidate is compared with: of `resident` during a trial, else of
    /// `network`; `None` without one.
    pub compared_with: Option<String>,
    /// What was counted before the start.
    pub counts: SavedCounts,
}

/// How the control loop receives new models.
enum Source {
    /// From the loop's own thread. In virtual time, loading takes no time.
    Direct(Box<Keeper>),
    /// From a thread of its own, so that loading does not block the loop.
    Thread { swaps: Receiver<Swap>, requests: SyncSender<Request> },
}

/// The control loop's side. Call [`before`](Self::before) and [`after`](Self::after) in every tick.
pub struct LiveModels {
    source: Source,
    lidar: LidarView,
    trial: Option<OnTrial>,
    limits: TrialLimits,
    /// Counts of the model that is in use without a trial, for comparison.
    resident: Counted,
    next_poll_ns: u64,
    last: Option<Pose2>,
    lost: LostObstacles,
    /// Number of ticks with a frame since the counts were saved.
    unsaved: u64,
    /// Number of ticks with a frame since the model on trial was started.
    ran: u64,
}

struct OnTrial {
    trial: Trial,
    digest: String,
    resident: Option<DepthNetwork>,
}

impl LiveModels {
    /// For virtual time: the store is polled between two ticks.
    #[must_use]
    pub fn direct(keeper: Keeper, start: Start, config: &Config) -> Self {
        Self::new(Source::Direct(Box::new(keeper)), start, config)
    }

    /// For real time: a thread polls the store once per second, and loads and warms up new models.
    ///
    /// # Errors
    /// If the thread cannot be started.
    pub fn threaded(keeper: Keeper, start: Start, config: &Config) -> Result<Self> {
        let (swap_sender, swaps) = sync_channel(1);
        let (requests, request_receiver) = sync_channel(8);
        std::thread::Builder::new()
            .name("models".to_owned())
            .spawn(move || run_keeper(keeper, &request_receiver, &swap_sender))?;
        Ok(Self::new(Source::Thread { swaps, requests }, start, config))
    }

    fn new(source: Source, start: Start, config: &Config) -> Self {
        let limits = config.models.trial_limits();
        let Start { on_trial, resident, compared_with: digest, counts, .. } = start;
        let resident_counts = counts.of_resident(digest.as_deref());
        Self {
            source,
            lidar: setup::lidar_view(config),
            trial: on_trial.map(|digest| OnTrial {
                trial: Trial::new(limits, resident_counts, counts.of_trial(&digest)),
                digest,
                resident,
            }),
            limits,
            resident: Counted { digest, counts: resident_counts },
            next_poll_ns: 0,
            last: None,
            lost: LostObstacles::new(&config.camera.model(), config.map.min_confidence),
            unsaved: 0,
            ran: 0,
        }
    }

    /// To be called before a tick: switches to another model if there is one.
    pub fn before(&mut self, robot: &mut Robot, now_ns: u64) {
        let swap = match &mut self.source {
            Source::Direct(keeper) if now_ns >= self.next_poll_ns => {
                self.next_poll_ns = now_ns + POLL_INTERVAL_NS;
                keeper.poll()
            }
            Source::Direct(_) => None,
            Source::Thread { swaps, .. } => swaps.try_recv().ok(),
        };
        match swap {
            Some(Swap::To { network, on_trial }) => {
                let digest = network.digest().to_owned();
                tracing::warn!(
                    "now using the model {digest}{}",
                    if on_trial { ", on trial" } else { "" }
                );
                let old = robot.set_network(*network);
                // If the old model was on trial, the one before it stays the one to go back to.
                let resident = self.trial.take().map_or(old, |trial| trial.resident);
                self.ran = 0;
                if on_trial {
                    let resident_counts = self.resident.counts;
                    let trial = Trial::new(self.limits, resident_counts, TrialCounts::default());
                    self.trial = Some(OnTrial { trial, digest, resident });
                } else {
                    self.uses_without_trial(Some(digest));
                }
            }
            Some(Swap::ToNone) => {
                self.trial = None;
                robot.remove_network();
                self.uses_without_trial(None);
            }
            None => {}
        }
    }

    /// Begins to count for a model that needs no trial, unless that was done already.
    fn uses_without_trial(&mut self, digest: Option<String>) {
        if self.resident.digest != digest {
            self.resident = Counted { digest, counts: TrialCounts::default() };
        }
    }

    /// To be called after a tick: updates the counts and ends a trial that is decided. `late`: the
    /// tick took longer than its period.
    pub fn after(
        &mut self,
        robot: &mut Robot,
        input: &TickInput<'_>,
        decision: &Decision,
        late: bool,
    ) {
        if input.frame.is_none() {
            return;
        }
        let tick = self.tick(robot, input, decision, late);
        match &mut self.trial {
            None => self.resident.counts.remember(&tick, REMEMBERED_TICKS),
            Some(on_trial) => {
                if let TrialState::Ended(verdict) = on_trial.trial.observe(&tick) {
                    self.end_trial(robot, verdict.keeps(), &verdict.to_string());
                    self.save();
                }
            }
        }
        self.count_survival();
        self.unsaved += 1;
        if self.unsaved >= SAVED_EVERY_TICKS {
            self.save();
        }
    }

    /// What the trial needs to know about a tick.
    fn tick(
        &mut self,
        robot: &Robot,
        input: &TickInput<'_>,
        decision: &Decision,
        overrun: bool,
    ) -> TrialTick {
        let pose = decision.t_odom_base;
        // A larger step means that odometry was reset.
        let moved_m = self.last.replace(pose).map_or(0.0, |last| last.distance_m(&pose));
        let bad_output = decision
            .events
            .iter()
            .any(|event| matches!(event, Event::NoDepth { why: NoDepth::NetworkOutput }));
        let trips = decision
            .events
            .iter()
            .filter(|event| matches!(event, Event::Safety { what: SafetyEvent::Tripped { .. } }))
            .count() as u64;
        // Dense depth is made with the scan, so that it always agrees with it.
        let compared = robot.compared_depth();
        let depth = robot.mapped_depth();
        let line = self.lidar.of_tick(input);
        TrialTick {
            overrun,
            bad_output,
            trips,
            moving: !input.safety.in_charge && decision.sent.is_some_and(is_motion),
            moved_m: if moved_m < 0.5 { moved_m } else { 0.0 },
            delta1: compared
                .and_then(|estimate| lidar_score(estimate, &line))
                .map(|score| score.delta1),
            lost_near: depth
                .zip(robot.coarse_depth())
                .and_then(|(estimate, coarse)| self.lost.shares(estimate, coarse).near),
        }
    }

    /// After as many ticks as a trial has at least, the program has survived the model.
    fn count_survival(&mut self) {
        self.ran += 1;
        if self.ran == self.limits.ticks
            && let Some(digest) = self.on_trial().map(str::to_owned)
        {
            self.request(Request::Survived { digest });
        }
    }

    fn save(&mut self) {
        self.unsaved = 0;
        let trial = self.trial.as_ref().map(|on_trial| Counted {
            digest: Some(on_trial.digest.clone()),
            counts: *on_trial.trial.counts(),
        });
        self.request(Request::Save(SavedCounts { resident: self.resident.clone(), trial }));
    }

    fn end_trial(&mut self, robot: &mut Robot, keeps: bool, why: &str) {
        let Some(OnTrial { trial, digest, resident }) = self.trial.take() else { return };
        tracing::warn!("the model {digest}: {why}");
        if keeps {
            self.resident = Counted { digest: Some(digest.clone()), counts: *trial.counts() };
            return self.request(Request::Keep { digest, why: why.to_owned() });
        }
        let drives = resident.as_ref().map(|resident| resident.digest().to_owned());
        match resident {
            Some(resident) => drop(robot.set_network(resident)),
            None => robot.remove_network(),
        }
        self.request(Request::RollBack { digest, why: why.to_owned(), drives });
    }

    fn request(&mut self, request: Request) {
        match &mut self.source {
            Source::Direct(keeper) => keeper.handle(request),
            Source::Thread { requests, .. } => {
                if requests.try_send(request).is_err() {
                    tracing::error!(
                        "the thread of the model store does not respond; what the trial has found is not saved"
                    );
                }
            }
        }
    }

    /// Digest of the model that is on trial.
    #[must_use]
    pub fn on_trial(&self) -> Option<&str> {
        self.trial.as_ref().map(|on_trial| on_trial.digest.as_str())
    }
}

impl Drop for LiveModels {
    fn drop(&mut self) {
        if self.unsaved > 0 {
            self.save();
        }
    }
}

/// Whether a command moves the robot.
fn is_motion(command: Command) -> bool {
    command.linear_mps != 0.0 || command.angular_radps != 0.0
}

/// The thread that owns the keeper. It ends when the control loop drops its end of the channels.
fn run_keeper(mut keeper: Keeper, requests: &Receiver<Request>, swaps: &SyncSender<Swap>) {
    let mut clock = MonotonicClock;
    loop {
        match requests.try_recv() {
            Ok(request) => keeper.handle(request),
            Err(TryRecvError::Disconnected) => return,
            Err(TryRecvError::Empty) => {
                if let Some(swap) = keeper.poll()
                    && swaps.send(swap).is_err()
                {
                    return;
                }
                clock.sleep_until_ns(clock.now_ns() + POLL_INTERVAL_NS);
            }
        }
    }
}
