//! `firmware-host replay`: builds the loop of a recorded run from the run's header.

use std::path::Path;
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use hal::CameraModel;
use runtime::event::Event;
use runtime::exploration::PolicyKind;
use runtime::perception::DepthNetwork;
use runtime::recording::{RecordedTick, RunHeader};
use runtime::robot::{DepthSource, Robot};
use runtime::session::recompute;
use runtime::tick::Decision;

use crate::cli::{ReplayArgs, RunModels};
use crate::config::Config;
use crate::model::Store;
use crate::output::Output;
use crate::replay::{Moment, Replayable, Run, Span, replay};
use crate::setup::{self, Mission};

struct Loop {
    robot: Robot,
    /// The networks that the run used from a tick on, last first; `None`: from that tick on it used none.
    networks: Vec<(u64, Option<DepthNetwork>)>,
    /// The model store of a run that used one.
    stored: Option<Stored>,
}

struct Stored {
    store: Store,
    camera: CameraModel,
    config: Config,
}

impl Stored {
    fn open(args: &RunModels, header: &RunHeader, config: &Config) -> Result<Self> {
        let dir = args.model_store.as_deref();
        let dir = dir.context(
            "the run drove with signed models; give their folder with --model-store DIR",
        )?;
        Ok(Self { store: Store::open(dir)?, camera: header.camera, config: config.clone() })
    }

    /// The changes of network in the run's events, last first.
    fn taken(&self, run: &Path) -> Result<Vec<(u64, Option<DepthNetwork>)>> {
        let mut networks = Vec::new();
        // An error of the recording is reported by the replay itself.
        for tick in Run::open(run)?.map_while(Result::ok) {
            for event in tick.decision.into_iter().flat_map(|decision| decision.events) {
                match event {
                    Event::NetworkTaken { digest } => {
                        networks.push((tick.tick, Some(self.load(&digest)?)));
                    }
                    Event::NetworkLeft => networks.push((tick.tick, None)),
                    _ => {}
                }
            }
        }
        networks.reverse();
        Ok(networks)
    }

    fn load(&self, digest: &str) -> Result<DepthNetwork> {
        let model = self.store.read_model(digest).with_context(|| {
            format!(
                "the run drove with the model {digest}, which {} no longer holds",
                self.store.dir().display()
            )
        })?;
        setup::network_of(&model, &self.camera, &self.config)
    }
}

impl Replayable for Loop {
    fn hand_over(&mut self, tick: u64) {
        while let Some((_, network)) = self.networks.pop_if(|(from, _)| *from <= tick) {
            match network {
                Some(network) => drop(self.robot.set_network(network)),
                None => self.robot.remove_network(),
            }
        }
    }

    fn restore(&mut self, snapshot: &[u8]) -> Result<()> {
        if let Some(stored) = &self.stored {
            let wanted = Robot::network_of_snapshot(snapshot)?;
            if wanted != self.robot.network_digest() {
                match wanted {
                    Some(digest) => drop(self.robot.set_network(stored.load(&digest)?)),
                    None => self.robot.remove_network(),
                }
            }
        }
        Ok(self.robot.restore(snapshot)?)
    }

    fn snapshot(&self) -> Vec<u8> {
        self.robot.snapshot()
    }

    fn step(&mut self, tick: &RecordedTick) -> Result<Decision> {
        Ok(recompute(&mut self.robot, tick)?)
    }
}

/// Replays a run; the exit code says whether every decision is the same.
///
/// # Errors
/// When there is nothing to replay, or the run needs a model that was not given.
pub fn run(args: &ReplayArgs) -> Result<ExitCode> {
    let span = Span { from: args.from, until_mismatch: args.until_mismatch };
    let report =
        replay(&args.run, span, |header| build(&args.run, header, &args.models), &mut Output)?;
    Ok(if report.is_exact() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// The loop of a recorded run in its state before the first tick.
///
/// # Errors
/// When this version does not know the run's configuration, or its models are not those that were given.
pub fn build(run: &Path, header: &RunHeader, models: &RunModels) -> Result<Box<dyn Replayable>> {
    Ok(Box::new(loop_of(run, header, models)?))
}

/// The robot as it was after the last tick of a recorded run, and the run's header. Begins at the newest snapshot.
///
/// # Errors
/// As [`build`], and when no part of the run's end can be recomputed.
pub fn robot_at_end(path: &Path, models: &RunModels) -> Result<(Robot, RunHeader)> {
    let run = Run::open_before(path, Moment::Tick(u64::MAX))?;
    let header = run.header().clone();
    let mut recorded = loop_of(path, &header, models)?;
    let mut memory_known = run.is_at_the_start();
    for tick in run {
        let tick = match tick {
            Ok(tick) => tick,
            Err(error) => {
                tracing::warn!("{error}");
                memory_known &= !error.is_gap();
                continue;
            }
        };
        recorded.hand_over(tick.tick);
        if let (false, Some(snapshot)) = (memory_known, &tick.snapshot) {
            recorded.restore(snapshot)?;
            memory_known = true;
        }
        if memory_known {
            recorded.step(&tick)?;
        }
    }
    if !memory_known {
        bail!("{} has no snapshot before its end, so its last state is unknown", path.display());
    }
    Ok((recorded.robot, header))
}

fn loop_of(run: &Path, header: &RunHeader, models: &RunModels) -> Result<Loop> {
    if !header.images {
        bail!(
            "the run was recorded without images (recording.images = false): nothing can be recomputed"
        );
    }
    let config: Config = serde_json::from_value(header.config.clone()).context(
        "the recording's configuration cannot be read; the version that recorded it replays it",
    )?;
    let mission = Mission {
        policy: policy(&header.policy)?,
        depth_source: depth_source(&header.depth_source)?,
        seed: header.seed,
    };
    let stored = header.model_store.then(|| Stored::open(models, header, &config)).transpose()?;
    let network = match (&stored, &header.model_digest) {
        (Some(stored), digest) => digest.as_ref().map(|digest| stored.load(digest)).transpose()?,
        (None, _) => network(models, header, &config)?,
    };
    let robot = Robot::new(config.robot(&mission), network)?;
    let networks = match &stored {
        Some(stored) => stored.taken(run)?,
        None => handed_over(models, header, &config)?,
    };
    Ok(Loop { robot, networks, stored })
}

/// The network that the run was made with.
fn network(args: &RunModels, header: &RunHeader, config: &Config) -> Result<Option<DepthNetwork>> {
    match (&header.model_digest, &args.model) {
        (None, None) => Ok(None),
        (None, Some(path)) => {
            bail!("the run was made without a model; leave out --model {}", path.display())
        }
        (Some(digest), None) => {
            bail!("the run was made with the model {digest}; give it with --model FILE")
        }
        (Some(digest), Some(path)) => {
            let network = setup::load_network(path, &header.camera, config)?;
            if network.digest() != digest {
                bail!(
                    "the run was made with the model {digest}, but {} is {}",
                    path.display(),
                    network.digest()
                );
            }
            Ok(Some(network))
        }
    }
}

/// The networks of the run's hand-over schedule. The run may have ended before the last of them.
fn handed_over(
    args: &RunModels,
    header: &RunHeader,
    config: &Config,
) -> Result<Vec<(u64, Option<DepthNetwork>)>> {
    let (schedule, dir) = match (&header.hand_over, &args.hand_over) {
        (None, None) => return Ok(Vec::new()),
        (None, Some(dir)) => {
            bail!("the run was handed no networks; leave out --hand-over {}", dir.display())
        }
        (Some(_), None) => {
            bail!(
                "the run received networks while it drove; give their folder with --hand-over DIR"
            )
        }
        (Some(schedule), Some(dir)) => (schedule, dir),
    };
    let paths =
        (0..).map(|round| setup::handed_over_model(dir, round)).take_while(|path| path.exists());
    let mut networks = Vec::new();
    for (round, path) in paths.enumerate() {
        let tick = schedule.first + round as u64 * schedule.every;
        networks.push((tick, Some(setup::load_network(&path, &header.camera, config)?)));
    }
    networks.reverse();
    Ok(networks)
}

fn policy(name: &str) -> Result<PolicyKind> {
    let known = PolicyKind::ALL.into_iter().find(|policy| policy.name() == name);
    known.with_context(|| format!("the recording's policy `{name}` is not known to this version"))
}

fn depth_source(name: &str) -> Result<DepthSource> {
    DepthSource::from_name(name).with_context(|| {
        format!("the recording's depth source `{name}` is not known to this version")
    })
}
