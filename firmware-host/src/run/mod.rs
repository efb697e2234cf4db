//! `firmware-host run`: the real robot.
//!
//! The program has four main threads. The safety loop ([`safety_thread`]) owns scanner and base and runs at 100 Hz; the
//! exploration loop
//! ([`runtime::session`]) runs at 10 Hz in the main thread; the operator's thread ([`operator`]) passes signals on to the safety
//! loop; the recorder writes when the disk allows. Drivers have threads of their own. No loop waits for a device.

mod device_log;
pub(crate) mod devices;
mod exploration;
mod images;
pub(crate) mod instance_lock;
mod last_stop;
mod live_devices;
mod operator;
mod pose_socket;
pub mod safety_thread;
pub(crate) mod state_words;
pub mod status;
#[cfg(test)]
mod stops_reference;
mod supervision;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;

use anyhow::{Context, Result};
use drivers::fault::{Faults, FaultyClock};
use monotonic_clock::MonotonicClock;
use monotonic_clock::monotonic_ns;
use runtime::event::ExploreEnd;
use runtime::latency::LatencyHistogram;
use runtime::recording::{RunHeader, RunIdentity};
use runtime::robot::Robot;
use segment_store::signature::RobotKey;

use crate::areas;
use crate::cli::RunArgs;
use crate::config::Config;
use crate::model::{Keeper, LiveModels};

use crate::check::{self, Speed};
use crate::identity;
use crate::live::{self, Live};
use crate::map::KeptMap;
use crate::record::{FaultyDisk, FileSystem, Quota, Recorder, RecorderOptions};
use crate::report::atomic::prepare_private_dir;
use crate::report::latency::Stage;
use crate::report::summary::{CameraLatency, LidarLine, Summary, peak_resident_mib};
use crate::setup::{self, Mission};
use crate::task::TaskFile;
#[cfg(test)]
pub(crate) use exploration::log_agreement;
use exploration::{Exploration, RunLog};
use instance_lock::InstanceLock;
use last_stop::StopFile;
use live_devices::LiveDevices;
use operator::Operator;
use pose_socket::PoseSocket;
use safety_thread::{Pace, SafetyThread};
use supervision::Supervision;

/// The injected random faults of a run without an end are spread over this time, seconds.
const RANDOM_FAULTS_S: f64 = 600.0;

/// When the robot may drive.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arming {
    /// When it is armed: by SIGUSR1, or at the start if the configuration says so.
    Configured,
    /// At the start, because a person beside the robot has just said so.
    Confirmed,
}

/// Drives until a signal ends the run, then brakes, releases the motors and reports. Returns why the run ended.
///
/// # Errors
/// A configuration, model or folder that cannot be used. An absent device is no error: its driver waits for it.
pub fn run(args: &RunArgs, arming: Arming) -> Result<ExploreEnd> {
    let mut config = Config::load(&args.config)?;
    args.areas.add_to(args.policy.into(), &mut config)?;
    config.check_devices(&args.config)?;
    check::require(&config, &args.config)?;
    // The lock is taken before anything is opened or written, so that a running instance is not disturbed.
    let _lock = InstanceLock::on(&config.devices.base.bus)?;
    let camera = config.camera.model();
    let configured = Some(&config.models.store).filter(|dir| !dir.is_empty());
    let store = args.model_store.clone().or_else(|| configured.map(PathBuf::from));
    let first = args.model.as_deref();
    let mut start = store.as_deref().map(|dir| Keeper::start(dir, first, &config)).transpose()?;
    let network = match &mut start {
        Some((_, start)) => start.network.take(),
        None => first.map(|path| setup::load_network(path, &camera, &config)).transpose()?,
    };
    let depth_source = setup::depth_source(None, network.is_some(), &config.dense)?;
    let mission = Mission { policy: args.policy.into(), depth_source, seed: args.seed };
    let model = network.as_ref().map(|network| network.digest().to_owned());
    let mut robot = Robot::new(config.robot(&mission), network)?;
    let map =
        args.map.as_deref().map(|path| KeptMap::open(path, &mut robot, &config)).transpose()?;
    if map.as_ref().and_then(KeptMap::loaded).is_none() {
        areas::allow_the_start(&config)?;
    }
    let poses = PoseSocket::open(&config.run.pose_socket)?;
    let key = identity::robot_key(&config)?;
    let identity = identity::of_run(&config, key.as_ref())?;
    let out = &args.out.clone().unwrap_or_else(|| folder(args, &config, &identity));
    prepare_private_dir(out)?;
    let plan = args
        .faults
        .plan(args.frames.map_or(RANDOM_FAULTS_S, |frames| frames as f64 * config.base.tick_s()));
    if plan.seed().is_some() {
        tracing::warn!("devices are broken on purpose: {}", plan.texts().join(", "));
    }
    let model_store = start.is_some();
    let loaded_map = map.as_ref().and_then(KeptMap::loaded).map(ToOwned::to_owned);
    let header = setup::run_header(&config, &mission, model.as_deref(), &plan)?;
    let header = RunHeader { model_store, loaded_map, identity: Some(identity), ..header };
    let start_ns = monotonic_ns();
    let faults = plan.clone().at(Arc::new(move || monotonic_ns().saturating_sub(start_ns)));
    let recorder =
        if args.no_recording { None } else { Some(recorder(out, &config, header, key, &faults)?) };
    let camera = devices::open_camera(&config, &faults)?;
    let imu = devices::open_imu(&config, &faults)?;
    let imu_monitor = imu.as_ref().map(|imu| imu.inner().monitor());
    let pace =
        Pace { period_ns: config.safety_period_ns(), priority: config.run.realtime_priority };
    let wiring = config.clone();
    let wiring_faults = faults.clone();
    let (mut safety, port, monitors) =
        SafetyThread::start(pace, move || devices::open_for_safety(&wiring, &wiring_faults))?;
    let clock = FaultyClock::new(MonotonicClock, &faults);
    let devices = LiveDevices::new(&config, clock, camera, imu)?;
    let models =
        start.map(|(keeper, start)| LiveModels::threaded(keeper, start, &config)).transpose()?;
    let mut exploration = Exploration::new(&config, devices, robot, port, recorder, models);
    let can = live::abilities(map.as_ref(), mission.policy, &config)?;
    let view = live::socket_of(args.live.as_deref(), &config)
        .map(|socket| Live::start(&socket, &config, safety.panel.clone(), can))
        .transpose()?;
    for change in map.iter().flat_map(KeptMap::area_changes) {
        exploration.session.change_areas(change)?;
    }
    exploration.log.map = map;
    exploration.log.live = view;
    let stop_file = StopFile::open(config.run.stop_file.as_ref());
    let operator = Operator::start(safety.panel.clone(), stop_file)?;
    let mut supervision = Supervision::new(args, out, &config, monitors, imu_monitor, &operator);
    match (&operator.last_stop, arming) {
        (_, Arming::Confirmed) => safety.panel.arm(),
        (None, Arming::Configured) if config.run.arm_at_start => safety.panel.arm(),
        (Some(stop), Arming::Configured) if config.run.arm_at_start => tracing::warn!(
            "the robot does not arm on its own after its last stop ({}): fix the cause, then send SIGUSR1",
            stop.why
        ),
        _ => {}
    }
    tracing::info!("{}", Speed::new(&config).sentence());
    supervision.announce(&safety);
    let mut inputs = Inputs { tasks: TaskFile::open(config.run.task_file.as_ref()), poses };
    let end =
        explore(args, &operator, &mut inputs, &mut safety, &mut exploration, &mut supervision)?;
    let late = safety.shut_down();
    supervision.good_bye();
    let summary = Summary {
        model,
        end_reason: Some(end),
        skipped_ticks: Some(exploration.session.skipped()),
        faults: plan.texts(),
        fault_seed: plan.seed(),
        ..Summary::default()
    };
    let (robot, mut log) = exploration.finish();
    // The report comes also if the map cannot be saved.
    let saved = log.map.take().map_or(Ok(()), |mut map| map.save(&robot));
    report(out, &mission, summary, &robot, log, late)?;
    saved?;
    Ok(end)
}

/// What other programs give the exploration loop.
struct Inputs {
    tasks: TaskFile,
    poses: Option<PoseSocket>,
}

/// Runs the exploration loop until something ends it.
fn explore(
    args: &RunArgs,
    operator: &Operator,
    inputs: &mut Inputs,
    safety: &mut SafetyThread,
    exploration: &mut Exploration,
    supervision: &mut Supervision,
) -> Result<ExploreEnd> {
    loop {
        exploration.session.wait();
        if let Some(task) = inputs.tasks.take() {
            exploration.session.give(task)?;
        }
        if let Some(pose) = inputs.poses.as_mut().and_then(PoseSocket::take) {
            exploration.session.give_pose(pose);
        }
        let interrupted = operator.ends.load(Ordering::Relaxed);
        let has_frames = args.frames.is_some_and(|frames| exploration.log.frames >= frames);
        if let Some(end) = end_of_run(interrupted, has_frames, safety.is_alive()) {
            return Ok(end);
        }
        exploration.take_orders();
        exploration.tick()?;
        supervision.update(safety, exploration);
    }
}

/// Why the run ends now, if it does. Without its safety thread the robot explores no further: nothing would stop it.
fn end_of_run(interrupted: bool, has_frames: bool, safety_is_alive: bool) -> Option<ExploreEnd> {
    match (interrupted, has_frames, safety_is_alive) {
        (true, _, _) => Some(ExploreEnd::Interrupted),
        (_, true, _) => Some(ExploreEnd::FrameBudget),
        (_, _, false) => Some(ExploreEnd::DeviceFailed),
        _ => None,
    }
}

/// A folder for this run, such as `2026-11-26T12-31-07-3fa9c2d1`: the universal time, and the beginning of the run's identity, so
/// that the runs of two robots whose clocks say the same can be stored together.
fn folder(args: &RunArgs, config: &Config, identity: &RunIdentity) -> PathBuf {
    let runs = args.runs.clone().unwrap_or_else(|| PathBuf::from(&config.models.recordings));
    let time = jiff::Timestamp::now().strftime("%Y-%m-%dT%H-%M-%S");
    runs.join(format!("{time}-{}", identity.run.get(..8).unwrap_or_default()))
}

fn recorder(
    out: &Path,
    config: &Config,
    header: RunHeader,
    key: Option<RobotKey>,
    faults: &Faults,
) -> Result<Recorder> {
    let options = RecorderOptions {
        quota: Some(quota(out, config)?),
        key,
        ..RecorderOptions::robot(out).configured(&config.recording)
    };
    let disk = Box::new(FaultyDisk::new(FileSystem, faults));
    Ok(Recorder::start_on(disk, options, header)?)
}

/// The limits of the folder that holds this run and the earlier ones, which is the robot's buffer.
fn quota(out: &Path, config: &Config) -> Result<Quota> {
    let out = std::path::absolute(out).context("the working directory is gone")?;
    let buffer = out.parent().unwrap_or(&out).to_owned();
    let most = Some(bytes_of(config.recording.quota_gib)).filter(|most| *most > 0);
    let free_bytes = bytes_of(config.recording.free_gib);
    Ok(Quota {
        buffer,
        bytes: most,
        free_bytes,
        kept_percent: config.recording.kept_percent,
        max_age_days: config.recording.max_age_days,
    })
}

fn bytes_of(gib: f64) -> u64 {
    (gib * (1u64 << 30) as f64) as u64
}

fn report(
    out: &Path,
    mission: &Mission,
    summary: Summary,
    robot: &Robot,
    mut log: RunLog,
    late: Option<LatencyHistogram>,
) -> Result<()> {
    let mut summary = Summary {
        frames: log.frames,
        seed: Some(mission.seed),
        policy: Some(mission.policy.name().to_owned()),
        depth_source: Some(mission.depth_source),
        path_m: Some(log.path_m),
        lidar_line: LidarLine::of(&log.line),
        camera_latency: CameraLatency::of(robot),
        events: std::mem::take(&mut log.counts),
        latency_ms: log.stopwatch.latencies().percentiles(),
        resident_mib: peak_resident_mib(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        ..summary
    };
    let late = late.and_then(|late| late.percentiles());
    summary.latency_ms.extend(late.map(|late| (Stage::SafetyLate, late)));
    match log.recorder.take().map(Recorder::finish) {
        Some(Ok(recording)) => {
            summary.recording_mib = Some(recording.bytes as f64 / f64::from(1 << 20));
            summary.recording_digest = Some(recording.inputs_digest);
            summary.digest = Some(recording.decisions_digest);
            if let Some(failure) = recording.failure {
                eprintln!("warning: the end of the run was not recorded: {failure}");
            }
        }
        // Without a complete recording, the summary has neither its size nor its digests.
        Some(Err(error)) => eprintln!("warning: {error}"),
        None => {}
    }
    summary.write(out)?;
    println!("{}", crate::report::table::render(&summary));
    let images = images::write(out, robot, log)?;
    if images.is_empty() {
        println!("The robot has mapped nothing; numbers are in {}/summary.json.", out.display());
        return Ok(());
    }
    for image in images {
        println!("See {}/{image}.", out.display());
    }
    println!("Numbers are in {}/summary.json.", out.display());
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_ends_by_a_signal_with_its_last_frame_or_without_its_safety_thread() {
        assert_eq!(end_of_run(false, false, true), None);
        assert_eq!(end_of_run(true, false, true), Some(ExploreEnd::Interrupted));
        assert_eq!(end_of_run(false, true, true), Some(ExploreEnd::FrameBudget));
        assert_eq!(end_of_run(false, false, false), Some(ExploreEnd::DeviceFailed));
    }
}
