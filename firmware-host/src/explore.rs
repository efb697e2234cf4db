//! `firmware-host explore`: a simulated robot explores a home in virtual time.

mod devices;
mod hand_over;
mod map_accuracy;
mod map_plot;
mod narration;
mod paced_clock;
mod session;
mod shots;
mod watched;

use anyhow::{Context, Result, bail};
use drivers::fault::Faults;
use hal::{Clock, Pose2};
use runtime::event::ExploreEnd;
use runtime::recording::RunHeader;
use runtime::robot::Robot;
use runtime::task::Task;
use simulator::SimulatedRobot;

use crate::areas;
use crate::cli::ExploreArgs;
use crate::config::Config;
use crate::control_panel::ControlPanel;
use crate::dump::Dump;
use crate::faults::FaultPlan;
use crate::live::{self, Live};
use crate::map::KeptMap;
use crate::model::{Keeper, LiveModels};
use crate::record::{FaultyDisk, FileSystem, Recorder, RecorderOptions, refuse_old_recording};
use crate::report::another_run::refuse_file;
use crate::report::atomic::prepare_dir;
use crate::report::summary::{SUMMARY_FILE, Summary};
use crate::setup::{self, Mission};
use crate::simulation;
use hand_over::HandOver;
use session::Exploration;
use watched::Watched;

/// Explores, then reports.
///
/// # Errors
/// A scene, model, configuration or folder that cannot be used. A disk that fills up ends the run with a report, the
/// reason `output_failed`, and an error.
pub fn run(args: &ExploreArgs) -> Result<()> {
    let mut config = args.config.as_deref().map_or_else(|| Ok(Config::default()), Config::load)?;
    args.areas.add_to(args.policy.into(), &mut config)?;
    config.simulator.odometry = args.odometry.unwrap_or(config.simulator.odometry);
    let mut stored = args
        .model_store
        .as_deref()
        .map(|dir| Keeper::start(dir, args.model.as_deref(), &config))
        .transpose()?;
    let network = match &mut stored {
        Some((_, start)) => start.network.take(),
        None => args
            .model
            .as_deref()
            .map(|path| setup::load_network(path, &config.camera.model(), &config))
            .transpose()?,
    };
    let depth_source = setup::depth_source(args.depth, network.is_some(), &config.dense)?;
    let mission = Mission { policy: args.policy.into(), depth_source, seed: args.seed };
    let model = network.as_ref().map(|network| network.digest().to_owned());
    let world = simulation::open(&args.scene, &args.scene_file, &config)?;
    let start = args.start.map(|[x_m, y_m, yaw_deg]| Pose2::new(x_m, y_m, yaw_deg.to_radians()));
    let simulated = SimulatedRobot::new(
        std::sync::Arc::new(world),
        simulation::simulated_robot(&config, args.seed, start),
    )?;
    let mut robot = Robot::new(config.robot(&mission), network)?;
    let map =
        args.map.as_deref().map(|path| KeptMap::open(path, &mut robot, &config)).transpose()?;
    if map.as_ref().and_then(KeptMap::loaded).is_none() {
        areas::allow_the_start(&config)?;
    }
    prepare_dir(&args.out)?;
    // This is checked without a recording, too: the summary of another run would be overwritten.
    refuse_old_recording(&args.out)?;
    refuse_file(&args.out, SUMMARY_FILE)?;
    let plan = args.faults.plan(args.frames as f64 * config.base.tick_s());
    let loaded_map = map.as_ref().and_then(KeptMap::loaded).map(ToOwned::to_owned);
    let header = header(args, &config, &mission, model.as_deref(), &plan)?;
    let header = RunHeader { loaded_map, ..header };
    let (texts, fault_seed) = (plan.texts(), plan.seed());
    let clock = simulated.devices().clock;
    let faults = plan.at(std::sync::Arc::new(move || clock.now_ns()));
    let summary = Summary {
        seed: Some(args.seed),
        policy: Some(mission.policy.name().to_owned()),
        scene: Some(args.scene.clone()),
        depth_source: Some(depth_source),
        odometry: Some(config.simulator.odometry),
        model,
        faults: texts,
        fault_seed,
        version: env!("CARGO_PKG_VERSION").to_owned(),
        ..Summary::default()
    };
    let dump =
        args.dump.as_deref().map(|dir| Dump::create(dir, &config.camera.model())).transpose()?;
    let hand_over = HandOver::new(&args.hand_over, &config)?;
    let panel = ControlPanel::default();
    let can = live::abilities(map.as_ref(), mission.policy, &config)?;
    let watched = live::socket_of(args.live.as_deref(), &config)
        .map(|socket| Live::start(&socket, &config, panel.clone(), can))
        .transpose()?
        .map(|live| Watched::new(live, panel.clone(), Some(args.out.display().to_string())));
    let mut exploration = Exploration::new(args, &config, &simulated, &faults, robot, &panel);
    exploration.log.watched = watched;
    exploration.log.dump = dump;
    exploration.close_areas(map.as_ref())?;
    exploration.log.map = map;
    exploration.hand_over = hand_over;
    exploration.log.models =
        stored.map(|(keeper, start)| LiveModels::direct(keeper, start, &config));
    #[cfg(feature = "rerun")]
    if let Some(targets) = args.rerun.targets(&args.out) {
        let camera = config.camera.model();
        exploration.show_in(crate::rerun_stream::RerunStream::start(
            &targets,
            &camera,
            &config.camera.t_base_camera(),
        )?);
    }
    if let Some([x_m, y_m]) = args.go_to {
        exploration.give(Task::GoTo { x_m, y_m })?;
    }
    // The recording begins last: a start that fails must not leave one that refuses the next try.
    if !args.no_recording {
        exploration.log.recorder = Some(recorder(args, &config, header, &faults)?);
    }
    let end = exploration.explore()?;
    // The report comes also if the map cannot be saved.
    let saved = exploration.save_map();
    let end = exploration
        .report(end, summary)
        .with_context(|| format!("cannot report into {}", args.out.display()))?;
    saved?;
    match end {
        ExploreEnd::OutputFailed => bail!(
            "the run is not recorded to its end: free some space at {}, or use --no-recording",
            args.out.display()
        ),
        _ => Ok(()),
    }
}

fn header(
    args: &ExploreArgs,
    config: &Config,
    mission: &Mission,
    model: Option<&str>,
    plan: &FaultPlan,
) -> Result<RunHeader> {
    Ok(RunHeader {
        scene: Some(args.scene.clone()),
        hand_over: HandOver::schedule(&args.hand_over),
        model_store: args.model_store.is_some(),
        ..setup::run_header(config, mission, model, plan)?
    })
}

fn recorder(
    args: &ExploreArgs,
    config: &Config,
    header: RunHeader,
    faults: &Faults,
) -> Result<Recorder> {
    let options = RecorderOptions::simulation(&args.out).configured(&config.recording);
    let disk = Box::new(FaultyDisk::new(FileSystem, faults));
    Ok(Recorder::start_on(disk, options, header)?)
}
