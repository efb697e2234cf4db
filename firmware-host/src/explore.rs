//! `firmware-host explore`: a simulated robot explores a home in virtual time.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::{Context, Result};
use hal::{Base, Camera, Clock, DriveCommand, Frame, LaserScan, Lidar, PixelFormat, Pose3, WheelFeedback};
use runtime::event::{Event, ExploreEnd};
use runtime::recording::{MapView, RecordedTick, RunDigest, RunHeader, Views, quantise_mm};
use runtime::robot::{DepthSource, Robot};
use runtime::tick::{Decision, TickInput};
use simulator::{SimulatedRobot, World};

use crate::cli::ExploreArgs;
use crate::config::Config;
use crate::evaluation::{Evaluation, Truth};
use crate::record::{Recorder, RecorderOptions};
use crate::report::atomic::prepare_dir;
use crate::report::coverage::Coverage;
use crate::report::depth_sheet::{DepthSheet, SheetRow};
use crate::report::latency::Stage;
use crate::report::map_picture::{CellState, Cells, MapPicture};
use crate::report::progress::{Progress, Status};
use crate::report::summary::{Summary, peak_resident_mib};
use crate::report::table;
use crate::setup::{self, Mission};
use crate::stopwatch::Stopwatch;

/// Pictures on the contact sheet.
const SHEET_ROWS: u64 = 8;

/// Explores, then reports.
///
/// # Errors
/// A scene, model, configuration or folder that cannot be used. A disk that fills up ends the run with a report and the
/// reason `output_failed`.
pub fn run(args: &ExploreArgs) -> Result<()> {
    let config = args.config.as_deref().map_or_else(|| Ok(Config::default()), Config::load)?;
    let depth_source = setup::depth_source(args.depth.map(Into::into), args.model.is_some())?;
    let mission = Mission { policy: args.policy.into(), depth_source, seed: args.seed };
    let camera = config.camera.model();
    let network = args.model.as_deref().map(|path| setup::load_network(path, &camera, &config)).transpose()?;
    let model = network.as_ref().map(|network| network.digest().to_owned());
    let scene = scene_spec(args, &config);
    let world = World::open(&scene, &setup::open_options(args))?;
    let simulated = SimulatedRobot::new(Arc::new(world), setup::simulated_robot(args, &config))?;
    prepare_dir(&args.out)?;
    let robot = Robot::new(config.robot(&mission), network)?;
    let header = RunHeader {
        written_by: format!("firmware-host {}", env!("CARGO_PKG_VERSION")),
        seed: args.seed,
        scene: Some(scene.clone()),
        policy: mission.policy.name().to_owned(),
        depth_source: serde_name(&depth_source),
        model_digest: model.clone(),
        camera,
        t_base_camera: config.camera.mount(),
        t_base_laser: Pose3::translation(config.lidar.forward_m, 0.0, config.lidar.height_m),
        config: serde_json::to_value(&config)?,
    };
    let recorder = if args.no_recording {
        None
    } else {
        Some(Recorder::start(setup::recorder_options(RecorderOptions::simulation(&args.out), &config), header)?)
    };
    let summary = Summary {
        seed: Some(args.seed),
        policy: Some(mission.policy.name().to_owned()),
        scene: Some(scene),
        depth_source: Some(depth_source),
        model,
        version: env!("CARGO_PKG_VERSION").to_owned(),
        ..Summary::default()
    };
    Session::new(args, &config, simulated, robot, recorder)?.explore()?.report(summary)
}
