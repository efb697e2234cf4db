//! Models that come while the robot drives: swapped between two turns, watched on trial, and taken back by itself.
//!
//! The model that drove before stays in memory until the trial is over, so going back needs no disk.

use hal::{Clock, Pose2};
use monotonic_clock::MonotonicClock;
use runtime::event::{Event, SafetyEvent};
use runtime::model_gate::{
    LidarView, Trial, TrialCounts, TrialLimits, TrialState, TrialTurn, line_score,
};
use runtime::perception::{DepthNetwork, NoDepth};
use runtime::robot::Robot;
use runtime::tick::{Decision, TickInput};

use std::path::Path;
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};

use anyhow::{Context, Result};

use super::error::StoreErrorKind;
use super::store::{State, Store};
use crate::config::Config;
use crate::setup;

/// Between two looks for another model.
const LOOK_EVERY_NS: u64 = 1_000_000_000;
/// What a model did longer ago than this many turns counts half: homes and light change.
const REMEMBERED_TURNS: u64 = 6000;

/// Another model is current.
pub enum Swap {
    /// This one, loaded and warmed up.
    To {
        /// The network.
        network: Box<DepthNetwork>,
        /// Whether it is on trial.
        on_trial: bool,
    },
    /// None: coarse depth.
    ToNone,
}

/// What becomes of a model, to be written into the store.
enum Ask {
    Keep {
        digest: String,
        why: String,
    },
    /// With what drives instead.
    RollBack {
        digest: String,
        why: String,
        drives: Option<String>,
    },
}

/// Looks after one store: loads what is new in it, and writes into it what became of models.
pub struct Keeper {
    store: Store,
    config: Config,
    /// What drives, as far as this side knows.
    seen: Option<String>,
}

impl Keeper {
    /// What the robot starts with: the network that drives and, while that is on trial, the one to go back to. `first` goes into a
    /// store that never had a model.
    ///
    /// # Errors
    /// A store that cannot be used, or no `first` where it is needed. A current model that cannot be loaded is rolled back instead,
    /// and so is one that nobody knows because the store's own file is damaged.
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
                Err(error) => {
                    keeper
                        .give_up(&digest, &format!("rolled back: it cannot be loaded: {error:#}"));
                    // The same again where the disk takes nothing.
                    state.models.remove(0);
                    state.trial_starts = None;
                }
            }
        }
        let on_trial = state.current().filter(|_| state.trial_starts.is_some()).map(str::to_owned);
        let resident = state
            .previous()
            .filter(|_| on_trial.is_some())
            .and_then(|digest| keeper.load(digest).ok());
        keeper.seen =
            keeper.store.state().ok().and_then(|state| state.current().map(str::to_owned));
        Ok((keeper, Start { network, on_trial, resident }))
    }

    /// What the store says drives. A full disk or a damaged file keeps no robot from driving.
    fn begin(&mut self) -> Result<State> {
        let error = match self.store.start() {
            Ok(state) => return Ok(state),
            Err(error) => error,
        };
        tracing::error!("{error}");
        if error.kind() == StoreErrorKind::Damaged {
            return Ok(self
                .store
                .roll_back(&format!("rolled back by the robot itself: {error}"))?);
        }
        let mut state = self.store.state()?;
        if let Some(digest) = state.current().filter(|_| state.trial_starts.is_some()) {
            // A model that ends the program would do so for ever.
            tracing::error!(
                "nobody could count the starts with {digest}: the model before it drives"
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

    fn load(&self, digest: &str) -> Result<DepthNetwork> {
        let bytes = self.store.read_model(digest)?;
        setup::network_of(&bytes, &self.config.camera.model(), &self.config)
    }

    /// Whether another model is current than before. One that cannot be loaded is rolled back.
    pub fn look(&mut self) -> Option<Swap> {
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
            Err(error) => {
                // What is current then need not be what drives: the next look sees to it.
                if !self.give_up(digest, &format!("rolled back: it cannot be loaded: {error:#}")) {
                    self.seen = Some(digest.to_owned());
                }
                None
            }
        }
    }

    fn done(&mut self, ask: Ask) {
        match ask {
            Ask::Keep { digest, why } => {
                if let Err(error) = self.store.keep(&digest, &why) {
                    tracing::error!("the model {digest} stays on trial: {error}");
                }
            }
            Ask::RollBack { digest, why, drives } => {
                // Where the store still names it, it must not come back; nor where another one is on its way to the loop.
                if self.give_up(&digest, &why) && self.seen == Some(digest) {
                    self.seen = drives;
                }
            }
        }
    }

    /// Whether the store names another one now. A model that somebody else has rolled back meanwhile needs no more of that.
    fn give_up(&mut self, digest: &str, why: &str) -> bool {
        tracing::error!("the model {digest} is given up: {why}");
        self.store
            .give_up(digest, why)
            .inspect_err(|error| tracing::error!("the store still names it: {error}"))
            .is_ok()
    }
}

/// What the robot starts with.
pub struct Start {
    /// What drives.
    pub network: Option<DepthNetwork>,
    /// Its digest while it is on trial.
    pub on_trial: Option<String>,
    /// While it is: what drove before.
    pub resident: Option<DepthNetwork>,
}

/// How the loop hears of models.
enum Source {
    /// In the loop's own thread, whose time stands still meanwhile: virtual time.
    Direct(Box<Keeper>),
    /// By a thread that may take its time.
    Thread { swaps: Receiver<Swap>, asks: SyncSender<Ask> },
}

/// The loop's side: call [`before`](Self::before) and [`after`](Self::after) every turn.
pub struct LiveModels {
    source: Source,
    lidar: LidarView,
    trial: Option<OnTrial>,
    limits: TrialLimits,
    /// What the model that drives without a trial did.
    resident: TrialCounts,
    next_look_ns: u64,
    last: Option<Pose2>,
}

struct OnTrial {
    trial: Trial,
    digest: String,
    resident: Option<DepthNetwork>,
}

impl LiveModels {
    /// In virtual time: the store is looked at between two turns.
    #[must_use]
    pub fn direct(keeper: Keeper, start: Start, config: &Config) -> Self {
        Self::new(Source::Direct(Box::new(keeper)), start, config)
    }

    /// In real time: a thread looks once a second, loads and warms up.
    ///
    /// # Errors
    /// When the thread cannot be started.
    pub fn threaded(keeper: Keeper, start: Start, config: &Config) -> Result<Self> {
        let (swap_sender, swaps) = sync_channel(1);
        let (asks, ask_receiver) = sync_channel(8);
        std::thread::Builder::new()
            .name("models".to_owned())
            .spawn(move || keep(keeper, &ask_receiver, &swap_sender))?;
        Ok(Self::new(Source::Thread { swaps, asks }, start, config))
    }

    fn new(source: Source, start: Start, config: &Config) -> Self {
        let limits = config.models.trial_limits();
        let Start { on_trial, resident, .. } = start;
        let new_trial = |digest| OnTrial {
            trial: Trial::new(limits, TrialCounts::default()),
            digest,
            resident,
        };
        Self {
            source,
            lidar: setup::lidar_view(config),
            trial: on_trial.map(new_trial),
            limits,
            resident: TrialCounts::default(),
            next_look_ns: 0,
            last: None,
        }
    }

    /// Before a turn: another model, if there is one.
    pub fn before(&mut self, robot: &mut Robot, now_ns: u64) {
        let swap = match &mut self.source {
            Source::Direct(keeper) if now_ns >= self.next_look_ns => {
                self.next_look_ns = now_ns + LOOK_EVERY_NS;
                keeper.look()
            }
            Source::Direct(_) => None,
            Source::Thread { swaps, .. } => swaps.try_recv().ok(),
        };
        match swap {
            Some(Swap::To { network, on_trial }) => {
                let digest = network.digest().to_owned();
                tracing::warn!(
                    "the model {digest} drives from now on{}",
                    if on_trial { ", on trial" } else { "" }
                );
                let old = robot.take_network(*network);
                // What is on trial is not what is gone back to.
                let resident = self.trial.take().map_or(old, |trial| trial.resident);
                let trial = Trial::new(self.limits, self.resident);
                self.trial = on_trial.then_some(OnTrial { trial, digest, resident });
            }
            Some(Swap::ToNone) => {
                self.trial = None;
                robot.leave_network();
            }
            None => {}
        }
    }

    /// After a turn: counts it, and ends a trial that is decided. `late`: the turn took longer than it may.
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
        let odom = input.wheel.odom;
        // A jump is odometry that began anew.
        let moved_m = self.last.replace(odom).map_or(0.0, |last| last.distance_m(&odom));
        let moved_m = if moved_m < 0.5 { moved_m } else { 0.0 };
        let said = |wanted: &dyn Fn(&Event) -> bool| {
            decision.events.iter().filter(|event| wanted(event)).count()
        };
        let turn = TrialTurn {
            overrun: late,
            bad_output: said(&|event| {
                matches!(event, Event::NoDepth { why: NoDepth::NetworkOutput })
            }) > 0,
            trips: said(&|event| {
                matches!(event, Event::Safety { what: SafetyEvent::Tripped { .. } })
            }) as u64,
            moved_m,
            delta1: robot
                .mapped_depth()
                .and_then(|estimate| line_score(estimate, &self.lidar.of_turn(input)))
                .map(|score| score.delta1),
        };
        match &mut self.trial {
            None => self.resident.remember(&turn, REMEMBERED_TURNS),
            Some(on_trial) => {
                if let TrialState::Ended(verdict) = on_trial.trial.observe(&turn) {
                    self.end_trial(robot, verdict.keeps(), &verdict.to_string());
                }
            }
        }
    }

    fn end_trial(&mut self, robot: &mut Robot, keeps: bool, why: &str) {
        let Some(OnTrial { trial, digest, resident }) = self.trial.take() else { return };
        tracing::warn!("the model {digest}: {why}");
        if keeps {
            self.resident = *trial.counts();
            return self.ask(Ask::Keep { digest, why: why.to_owned() });
        }
        let drives = resident.as_ref().map(|resident| resident.digest().to_owned());
        match resident {
            Some(resident) => drop(robot.take_network(resident)),
            None => robot.leave_network(),
        }
        self.ask(Ask::RollBack { digest, why: why.to_owned(), drives });
    }

    fn ask(&mut self, ask: Ask) {
        match &mut self.source {
            Source::Direct(keeper) => keeper.done(ask),
            Source::Thread { asks, .. } => {
                if asks.try_send(ask).is_err() {
                    tracing::error!(
                        "the store does not answer; at the next start the model is on trial again"
                    );
                }
            }
        }
    }

    /// What the current model did so far.
    #[must_use]
    pub fn counts(&self) -> &TrialCounts {
        self.trial.as_ref().map_or(&self.resident, |on_trial| on_trial.trial.counts())
    }

    /// The model that is on trial.
    #[must_use]
    pub fn on_trial(&self) -> Option<&str> {
        self.trial.as_ref().map(|on_trial| on_trial.digest.as_str())
    }
}

/// The thread beside the loop. Ends when the loop does.
fn keep(mut keeper: Keeper, asks: &Receiver<Ask>, swaps: &SyncSender<Swap>) {
    let mut clock = MonotonicClock;
    loop {
        match asks.try_recv() {
            Ok(ask) => keeper.done(ask),
            Err(TryRecvError::Disconnected) => return,
            Err(TryRecvError::Empty) => {
                if let Some(swap) = keeper.look()
                    && swaps.send(swap).is_err()
                {
                    return;
                }
                clock.sleep_until_ns(clock.now_ns() + LOOK_EVERY_NS);
            }
        }
    }
}
