//! What `run` adds to the exploration loop: recording, reports, new models, `health`.

use std::time::Instant;

use anyhow::Result;
use drivers::DeviceStatus;
use hal::{Clock, Pose2, WheelFeedback};
use runtime::event::{Event, SafetyEvent};
use runtime::latency::Percentiles;
use runtime::lidar_agreement::LidarAgreement;
use runtime::mapping::CellState;
use runtime::perception::NoDepth;
use runtime::recording::{RecordedTick, lost_reason, sentence};
use runtime::robot::{Robot, Stage as RobotStage, StageTimer};
use runtime::session::{Observer, SafetyPort, Session};
use runtime::tick::{Decision, TickInput};

use super::live_devices::LiveDevices;
use super::status::{CalibrationChange, CalibrationStatus, ExplorationStatus, unix_s};
use crate::config::Config;
use crate::live::Live;
use crate::map::KeptMap;
use crate::model::LiveModels;
use crate::record::{Recorder, recorded_views, snapshot};
use crate::report::depth_sample::{FrameDepths, SheetRow, SheetSampler};
use crate::report::events::EventCounts;
use crate::report::goal_log::GoalLog;
use crate::report::latency::Stage;
use crate::report::summary::LidarLine;
use crate::setup;
use crate::stopwatch::Stopwatch;

/// Number of poses that are kept for the plot of the map: three hours of driving.
const MOST_REMEMBERED: usize = 100_000;
/// Stops are logged at most this often.
const LOG_EVERY_NS: u64 = 1_000_000_000;
/// The LiDAR's agreement with the depth is logged at this interval, which is also the memory of the monitor.
const LOG_LINE_EVERY_NS: u64 = 60_000_000_000;
/// Odometry that moves by more than this between two ticks was restarted, metres.
const ODOMETRY_JUMP_M: f64 = 0.5;

/// The exploration loop on a real robot.
pub struct Exploration {
    /// The session, which runs the loop.
    pub session: Session<LiveDevices>,
    /// The outputs of the run.
    pub log: RunLog,
}

impl Exploration {
    /// An exploration loop before its first tick.
    pub fn new(
        config: &Config,
        devices: LiveDevices,
        robot: Robot,
        port: SafetyPort,
        recorder: Option<Recorder>,
        models: Option<LiveModels>,
    ) -> Self {
        let session = Session::new(devices, robot, port, config.base.tick_ns());
        Self { session, log: RunLog::new(config, recorder, models) }
    }

    /// Takes the orders that came over the live view.
    pub fn take_orders(&mut self) {
        let RunLog { live, map, .. } = &mut self.log;
        if let Some(live) = live {
            live.serve(&mut self.session, map.as_mut());
        }
    }

    /// Runs one tick.
    ///
    /// # Errors
    /// A frame that cannot be recorded, which is a defect.
    pub fn tick(&mut self) -> Result<()> {
        self.session.tick(&mut self.log).map(drop)
    }

    /// The current status, for `health`.
    #[must_use]
    pub fn status(&self) -> ExplorationStatus {
        let robot = self.session.robot();
        let total = self.log.percentiles();
        let map = robot.map();
        let free =
            map.known_cells().filter(|(cell, _)| map.state(*cell) == CellState::Free).count();
        ExplorationStatus {
            ticks: self.session.ticks(),
            skipped: self.session.skipped(),
            policy: robot.explorer().policy().name().to_owned(),
            goal: robot.explorer().goal().map(|goal| {
                let [x_m, y_m] = goal.target_m;
                format!("{} at ({x_m:.2}, {y_m:.2}) m", goal.why.name())
            }),
            lost: robot.whereabouts().lost().map(|why| lost_reason(why).to_owned()),
            no_depth: self.log.no_depth.map(|why| sentence(&Event::NoDepth { why }).1),
            tick_p50_ms: total.map_or(0.0, |total| total.p50),
            tick_p99_ms: total.map_or(0.0, |total| total.p99),
            line: self.log.line.overall(),
            line_by_distance: self.log.line.by_distance(),
            calibration: calibration(robot, self.session.devices().now_ns()),
            gyroscope: robot.gyroscope().filter(|_| self.session.devices().has_imu()),
            model: robot.network_digest(),
            on_trial: self.log.models.as_ref().and_then(LiveModels::on_trial).map(str::to_owned),
            mapped_m2: free as f64 * map.cell_m() * map.cell_m(),
        }
    }

    /// The camera, for `health`.
    #[must_use]
    pub fn camera(&self) -> (DeviceStatus, Option<&String>) {
        self.session.devices().camera()
    }

    /// Ends the loop, and returns the robot and the outputs.
    #[must_use]
    pub fn finish(self) -> (Robot, RunLog) {
        let (_, robot) = self.session.into_parts();
        (robot, self.log)
    }
}

/// The outputs of a run: the recording, counts, and the data of the report.
pub struct RunLog {
    /// The recording, which the caller finishes.
    pub recorder: Option<Recorder>,
    /// The map that the run began with and leaves behind.
    pub map: Option<KeptMap>,
    /// The live view, if there is one.
    pub live: Option<Live>,
    /// Signed models that arrive while the robot drives.
    models: Option<LiveModels>,
    /// Agreement of the depth with the LiDAR.
    pub line: LidarAgreement,
    /// Time of each stage.
    pub stopwatch: Stopwatch,
    /// Number of events of each kind.
    pub counts: EventCounts,
    /// Number of ticks with a frame.
    pub frames: u64,
    /// Distance by wheel odometry, metres.
    pub path_m: f64,
    /// Poses of the robot in `map`, one for each tick in which it moved.
    pub trajectory: Vec<Pose2>,
    /// Places in `map` where the safety plane stopped for an obstacle, metres.
    pub trips_m: Vec<[f64; 2]>,
    /// Goals and what became of them.
    pub goals: GoalLog,
    /// Frames with their depth for the report; `None` if no image of the home may be stored.
    pub sheet: Option<SheetSampler>,
    config: crate::config::RecordingSection,
    period_ns: u64,
    started: Instant,
    snapshot: Option<Vec<u8>>,
    last_wheel: Option<WheelFeedback>,
    no_depth: Option<NoDepth>,
    /// Time before which the log does not repeat a stop; the recording contains every stop.
    quiet_until_ns: u64,
    /// Time at which the LiDAR's agreement was last logged.
    line_logged_ns: Option<u64>,
}

impl RunLog {
    /// The outputs of a run that has not begun.
    pub fn new(config: &Config, recorder: Option<Recorder>, models: Option<LiveModels>) -> Self {
        let stores_images = recorder.is_some() && config.recording.images;
        let sheet = stores_images.then(SheetSampler::default);
        Self {
            recorder,
            map: None,
            live: None,
            models,
            line: setup::lidar_agreement(config),
            stopwatch: Stopwatch::default(),
            counts: EventCounts::driving(),
            frames: 0,
            path_m: 0.0,
            trajectory: Vec::new(),
            trips_m: Vec::new(),
            goals: GoalLog::default(),
            sheet,
            config: config.recording.clone(),
            period_ns: config.base.tick_ns(),
            started: Instant::now(),
            snapshot: None,
            last_wheel: None,
            no_depth: None,
            quiet_until_ns: 0,
            line_logged_ns: None,
        }
    }

    fn percentiles(&self) -> Option<Percentiles> {
        self.stopwatch.latencies().percentiles().get(&Stage::Total).copied()
    }

    fn note(&mut self, decision: &Decision, wheel: &WheelFeedback) {
        self.no_depth = decision.events.iter().find_map(|event| match event {
            Event::NoDepth { why } => Some(*why),
            _ => None,
        });
        for event in &decision.events {
            self.counts.add(event);
            self.goals.note(event);
            if let Event::Safety { what: SafetyEvent::Tripped { x_m, y_m, .. } } = event {
                self.trips_m.push(decision.t_map_base().transform(*x_m, *y_m).into());
            }
            if matches!(event, Event::MapBegun | Event::MapChanged | Event::MapsJoined) {
                self.trips_m.clear();
            }
            if matches!(
                event,
                Event::Lost { .. }
                    | Event::Found { .. }
                    | Event::StandsLost
                    | Event::MapBegun
                    | Event::MapChanged
                    | Event::MapsJoined
                    | Event::StandsTilted { .. }
                    | Event::LevelAgain
                    | Event::GyroscopeRefused
                    | Event::WheelsContradicted { .. }
                    | Event::CalibrationChanged { .. }
                    | Event::CalibrationChangeWithdrawn { .. }
            ) {
                tracing::warn!("{}", sentence(event).1);
            }
            if let Event::Safety { what: SafetyEvent::Faulted { .. } | SafetyEvent::Tripped { .. } } =
                event
                && decision.time_ns >= self.quiet_until_ns
            {
                tracing::warn!("{}", sentence(event).1);
                self.quiet_until_ns = decision.time_ns + LOG_EVERY_NS;
            }
        }
        if !wheel.odom.is_finite() {
            return;
        }
        let last = self.last_wheel.replace(*wheel);
        let step_m = last.map_or(0.0, |last| last.odom.distance_m(&wheel.odom));
        self.path_m += step_m.min(ODOMETRY_JUMP_M);
        if step_m > 0.0 && self.trajectory.len() < MOST_REMEMBERED {
            self.trajectory.push(decision.t_map_base());
        }
    }

    /// Keeps a frame with its depth if it is one of those that the report shows.
    fn sample(&mut self, robot: &Robot, input: &TickInput<'_>) {
        let (Some(sheet), Some(frame)) = (&mut self.sheet, &input.frame) else { return };
        let depths = FrameDepths::of(robot);
        sheet.offer(input.tick, depths.count(), || SheetRow::capture(input.tick, frame, &depths));
    }

    fn record(&mut self, robot: &Robot, input: &TickInput<'_>, decision: &Decision) -> Result<()> {
        let Some(recorder) = &mut self.recorder else { return Ok(()) };
        let tick = RecordedTick::capture(input, Some(decision.clone()))?;
        let tick = RecordedTick { snapshot: self.snapshot.take(), ..tick };
        let views = recorded_views(robot, input.tick, &self.config);
        Ok(recorder.record(tick, views)?)
    }
}

impl StageTimer for RunLog {
    fn ended(&mut self, stage: RobotStage) {
        self.stopwatch.ended(stage);
    }
}

impl Observer for RunLog {
    type Error = anyhow::Error;

    fn started(&mut self) {
        self.started = Instant::now();
    }

    fn before(&mut self, robot: &mut Robot, input: &TickInput<'_>) -> Result<()> {
        if let (Some(map), Some(scan)) = (&self.map, input.scan) {
            map.check(&scan.geometry)?;
        }
        if let Some(models) = &mut self.models {
            models.before(robot, input.time_ns);
        }
        self.snapshot = snapshot(self.recorder.as_mut(), robot, input.time_ns);
        self.stopwatch.start();
        Ok(())
    }

    fn after(
        &mut self,
        robot: &mut Robot,
        input: &TickInput<'_>,
        decision: &Decision,
    ) -> Result<()> {
        // The copy for clients of the live view must not count against a model on trial.
        let late = self.started.elapsed().as_nanos() > u128::from(self.period_ns);
        if let Some(live) = &mut self.live {
            self.stopwatch.start();
            live.offer(robot, input, decision, self.started.elapsed());
            self.stopwatch.lap(Stage::Live);
        }
        self.stopwatch.since(self.started, Stage::Total);
        self.line.observe(input, robot.compared_depth());
        log_agreement(&self.line, &mut self.line_logged_ns, input.time_ns);
        if let Some(models) = &mut self.models {
            models.after(robot, input, decision, late);
        }
        self.note(decision, &input.wheel);
        self.sample(robot, input);
        self.record(robot, input, decision)?;
        self.frames += u64::from(input.frame.is_some());
        Ok(())
    }
}

fn calibration(robot: &Robot, now_ns: u64) -> CalibrationStatus {
    let watch = robot.calibration();
    CalibrationStatus {
        changes: watch
            .changes()
            .map(|change| {
                let ago_s = now_ns.saturating_sub(change.since_ns) as f64 * 1e-9;
                CalibrationChange { change: *change, since_unix_s: unix_s() - ago_s }
            })
            .collect(),
        measured: watch.measured().collect(),
    }
}

/// Logs once a minute how well the depth agrees with the LiDAR.
pub(crate) fn log_agreement(monitor: &LidarAgreement, logged_ns: &mut Option<u64>, now_ns: u64) {
    let last_ns = logged_ns.get_or_insert(now_ns);
    if now_ns.saturating_sub(*last_ns) < LOG_LINE_EVERY_NS {
        return;
    }
    *last_ns = now_ns;
    match LidarLine::of(monitor) {
        Some(line) => tracing::info!("the LiDAR agrees: {line}"),
        None => tracing::info!("no depth lies on the LiDAR's scan plane yet"),
    }
}
