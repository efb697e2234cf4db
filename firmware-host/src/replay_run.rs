//! `firmware-host replay`: the loop of a recorded run, built again from the run's header.

use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use runtime::event::Event;
use runtime::exploration::PolicyKind;
use runtime::perception::DepthNetwork;
use runtime::recording::RunHeader;
use runtime::robot::{DepthSource, Robot};
use runtime::tick::{Decision, TickInput};

use crate::cli::ReplayArgs;
use crate::config::Config;
use crate::explore::model_path;
use crate::model::Store;
use crate::replay::{Replayable, Run, replay};
use crate::setup::{self, Mission};

struct Loop {
    robot: Robot,
    /// Networks that are handed over before a turn, last first; none: the one that was there was taken away.
    networks: Vec<(u64, Option<DepthNetwork>)>,
}

impl Replayable for Loop {
    fn step(&mut self, input: &TickInput<'_>) -> Decision {
        if self.networks.last().is_some_and(|(tick, _)| *tick == input.tick)
            && let Some((_, network)) = self.networks.pop()
        {
            match network {
                Some(network) => drop(self.robot.take_network(network)),
                None => self.robot.leave_network(),
            }
        }
        self.robot.tick(input, &mut ())
    }
}

/// Replays a run; the exit code says whether every decision is the same.
///
/// # Errors
/// When there is nothing to replay, or the run needs a model that was not given.
pub fn run(args: &ReplayArgs) -> Result<ExitCode> {
    let build = |header: &RunHeader| -> Result<Box<dyn Replayable>> {
        let config: Config =
            serde_json::from_value(header.config.clone()).context("the recording's configuration cannot be read")?;
        let mission = Mission {
            policy: policy(&header.policy)?,
            depth_source: depth_source(&header.depth_source)?,
            seed: header.seed,
        };
        let robot = Robot::new(config.robot(&mission), network(args, header, &config)?)?;
        let networks =
            if header.model_store { from_store(args, header, &config)? } else { handed_over(args, header, &config)? };
        Ok(Box::new(Loop { robot, networks }))
    };
    let report = replay(&args.run, build, &mut std::io::stdout().lock())?;
    Ok(if report.is_exact() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// The very network that the run was made with.
fn network(args: &ReplayArgs, header: &RunHeader, config: &Config) -> Result<Option<DepthNetwork>> {
    if let (Some(digest), true) = (&header.model_digest, header.model_store) {
        return stored(&model_store(args)?, digest, header, config).map(Some);
    }
    match (&header.model_digest, &args.model) {
        (None, None) => Ok(None),
        (None, Some(path)) => bail!("the run was made without a model; leave out --model {}", path.display()),
        (Some(digest), None) => bail!("the run was made with the model {digest}; give it with --model FILE"),
        (Some(digest), Some(path)) => {
            let network = setup::load_network(path, &header.camera, config)?;
            if network.digest() != digest {
                bail!("the run was made with the model {digest}, but {} is {}", path.display(), network.digest());
            }
            Ok(Some(network))
        }
    }
}

/// The networks that the run was handed, as far as there are any: the run may have ended before the next.
fn handed_over(args: &ReplayArgs, header: &RunHeader, config: &Config) -> Result<Vec<(u64, Option<DepthNetwork>)>> {
    let (schedule, dir) = match (&header.hand_over, &args.hand_over) {
        (None, None) => return Ok(Vec::new()),
        (None, Some(dir)) => bail!("the run was handed no networks; leave out --hand-over {}", dir.display()),
        (Some(_), None) => bail!("the run was handed networks on its way; give their folder with --hand-over DIR"),
        (Some(schedule), Some(dir)) => (schedule, dir),
    };
    let paths = (0..).map(|round| model_path(dir, round)).take_while(|path| path.exists());
    let mut networks = Vec::new();
    for (round, path) in paths.enumerate() {
        let tick = schedule.first + round as u64 * schedule.every;
        networks.push((tick, Some(setup::load_network(&path, &header.camera, config)?)));
    }
    networks.reverse();
    Ok(networks)
}

/// The networks that the run took out of its store, at the turns that say so.
fn from_store(args: &ReplayArgs, header: &RunHeader, config: &Config) -> Result<Vec<(u64, Option<DepthNetwork>)>> {
    let store = model_store(args)?;
    let mut networks = Vec::new();
    // What cannot be read ends the replay itself, with its reason.
    for tick in Run::open(&args.run)?.map_while(Result::ok) {
        for event in tick.decision.into_iter().flat_map(|decision| decision.events) {
            match event {
                Event::NetworkTaken { digest } => {
                    networks.push((tick.tick, Some(stored(&store, &digest, header, config)?)));
                }
                Event::NetworkLeft => networks.push((tick.tick, None)),
                _ => {}
            }
        }
    }
    networks.reverse();
    Ok(networks)
}

fn model_store(args: &ReplayArgs) -> Result<Store> {
    let dir = args.model_store.as_deref();
    let dir = dir.context("the run drove with signed models; give their folder with --model-store DIR")?;
    Ok(Store::open(dir)?)
}

fn stored(store: &Store, digest: &str, header: &RunHeader, config: &Config) -> Result<DepthNetwork> {
    let model = store.read_model(digest).with_context(|| {
        format!("the run drove with the model {digest}, which {} no longer holds", store.dir().display())
    })?;
    setup::network_of(&model, &header.camera, config)
}

fn policy(name: &str) -> Result<PolicyKind> {
    let known = PolicyKind::ALL.into_iter().find(|policy| policy.name() == name);
    known.with_context(|| format!("the recording's policy `{name}` is not known to this version"))
}

fn depth_source(name: &str) -> Result<DepthSource> {
    let known = DepthSource::ALL.into_iter().find(|source| source.name() == name);
    known.with_context(|| format!("the recording's depth source `{name}` is not known to this version"))
}
