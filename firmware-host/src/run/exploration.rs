//! The exploration plane of a real robot: pictures, wheels and scans in, plans out, ten times a second.
//!
//! Turns have no clock of their own: what the runtime decides follows from the recorded inputs, and `replay` recomputes it.

use anyhow::{Context, Result};
use drivers::DeviceStatus;
use drivers::fault::FaultyCamera;
use drivers::v4l2::V4l2Camera;
use hal::{Camera, Frame, ImageView, Pose2, WheelFeedback};
use monotonic_clock::monotonic_ns;
use runtime::event::{Event, SafetyEvent};
use runtime::imaging::{FrontEnd, YuvRange};
use runtime::latency::Percentiles;
use runtime::line_monitor::LineMonitor;
use runtime::mapping::CellState;
use runtime::perception::NoDepth;
use runtime::recording::{RecordedTick, Views, sentence};
use runtime::robot::Robot;
use runtime::safety::Plan;
use runtime::tick::{Decision, SafetyReport, TickInput};

use super::odometry::WheelHistory;
use super::safety_thread::{News, SafetyThread};
use super::status::ExplorationStatus;
use crate::config::{Config, RecordingSection};
use crate::model::LiveModels;
use crate::record::{Recorder, snapshot};
use crate::report::events::EventCounts;
use crate::report::latency::Stage;
use crate::report::map_view::map_view;
use crate::report::summary::LidarLine;
use crate::setup;
use crate::stopwatch::Stopwatch;

/// Poses for the picture of the map: three hours of driving.
const MOST_REMEMBERED: usize = 100_000;
/// Stops are logged at most this often.
const LOG_EVERY_NS: u64 = 1_000_000_000;
/// How right the depth is, is logged so often: as long as the monitor remembers.
const LOG_LINE_EVERY_NS: u64 = 60_000_000_000;

/// The exploration plane, turn by turn.
pub struct Exploration {
    camera: FaultyCamera<V4l2Camera>,
    front_end: FrontEnd,
    robot: Robot,
    recorder: Option<Recorder>,
    /// How right the depth is, as far as the LiDAR can tell.
    line: LineMonitor,
    /// Signed models that come while it drives.
    pub models: Option<LiveModels>,
    period_ns: u64,
    recording: RecordingSection,
    frame: Frame,
    picture: Vec<u8>,
    wheels: WheelHistory,
    report: SafetyReport,
    stopwatch: Stopwatch,
    counts: EventCounts,
    tick: u64,
    pictures: u64,
    path_m: f64,
    trajectory: Vec<Pose2>,
    trips_m: Vec<[f64; 2]>,
    last_wheel: Option<WheelFeedback>,
    no_depth: Option<NoDepth>,
    camera_problem: Option<String>,
    /// What happens again and again is in the recording; the log need not repeat it.
    quiet_until_ns: u64,
    /// When it is told again how right the depth is.
    line_told_ns: Option<u64>,
}

impl Exploration {
    /// A robot that has seen nothing yet.
    ///
    /// # Errors
    /// When the camera's pictures cannot become those that perception works on.
    pub fn new(
        config: &Config,
        camera: FaultyCamera<V4l2Camera>,
        robot: Robot,
        recorder: Option<Recorder>,
    ) -> Result<Self> {
        let (source, target) = (*camera.model(), config.camera.model());
        let format = config.devices.camera.format.pixels();
        let front_end = FrontEnd::new(source, target, format, YuvRange::Limited).context(
            "[devices.lens] and [camera]: the camera's pictures cannot become those that perception works on",
        )?;
        Ok(Self {
            camera,
            front_end,
            robot,
            recorder,
            line: setup::line_monitor(config),
            models: None,
            period_ns: config.base.tick_ns(),
            recording: config.recording.clone(),
            frame: Frame::empty(),
            picture: vec![0; 3 * target.width * target.height],
            wheels: WheelHistory::default(),
            report: SafetyReport::default(),
            stopwatch: Stopwatch::default(),
            counts: EventCounts::driving(),
            tick: 0,
            pictures: 0,
            path_m: 0.0,
            trajectory: Vec::new(),
            trips_m: Vec::new(),
            last_wheel: None,
            no_depth: None,
            camera_problem: None,
            quiet_until_ns: 0,
            line_told_ns: None,
        })
    }

    /// One turn: newest picture, scan and wheels of its moment. No decision before the wheels have spoken.
    ///
    /// # Errors
    /// A picture that cannot be recorded: a defect.
    pub fn turn(&mut self, safety: &mut SafetyThread) -> Result<()> {
        let began = std::time::Instant::now();
        let picture_ns = self.look();
        while let Ok(wheel) = safety.wheels.pop() {
            self.wheels.push(wheel);
        }
        safety.scans.update();
        self.hear(safety);
        let now_ns = monotonic_ns();
        let wheel = match picture_ns {
            Some(time_ns) => self.wheels.at(time_ns),
            None => self.wheels.newest().copied(),
        };
        let Some(wheel) = wheel else { return Ok(()) };
        let target = *self.front_end.target();
        let frame = picture_ns
            .map(|_| ImageView::rgb8(target.width, target.height, &self.picture))
            .transpose()?;
        let input = TickInput {
            tick: self.tick,
            time_ns: now_ns,
            wheel,
            scan: safety.scans.nearest(wheel.time_ns),
            frame,
            truth: None,
            safety: Some(&self.report),
        };
        if let Some(models) = &mut self.models {
            models.before(&mut self.robot, now_ns);
        }
        let snapshot = snapshot(self.recorder.as_mut(), &self.robot, now_ns);
        self.stopwatch.start();
        let decision = self.robot.tick(&input, &mut self.stopwatch);
        // The plan is as old as what it was decided on, and never of a time to come.
        safety.plan.write(Some(Plan {
            twist: decision.command.into(),
            time_ns: wheel.time_ns.min(now_ns),
        }));
        self.stopwatch.since(began, Stage::Total);
        self.line.look(&input, self.robot.mapped_depth());
        tell_line(&self.line, &mut self.line_told_ns, now_ns);
        if let Some(models) = &mut self.models {
            let late = began.elapsed().as_nanos() > u128::from(self.period_ns);
            models.after(&mut self.robot, &input, &decision, late);
        }
        let recorded = self
            .recorder
            .is_some()
            .then(|| RecordedTick::capture(&input, Some(decision.clone())))
            .transpose()?;
        let recorded = recorded.map(|tick| RecordedTick { snapshot, ..tick });
        self.note(&decision, &wheel);
        self.record(recorded)?;
        self.tick += 1;
        self.pictures += u64::from(picture_ns.is_some());
        Ok(())
    }

    /// Fetches the newest picture and brings it to perception's size; when it was taken.
    fn look(&mut self) -> Option<u64> {
        match self.camera.poll_frame(&mut self.frame) {
            Ok(false) => return None,
            Ok(true) => {}
            Err(error) => {
                self.camera_problem = Some(error.to_string());
                return None;
            }
        }
        let view = self.frame.view().map_err(|error| error.to_string());
        let made = view.and_then(|view| {
            self.front_end.to_rgb(view, &mut self.picture).map_err(|error| error.to_string())
        });
        self.camera_problem = made.err();
        self.camera_problem.is_none().then_some(self.frame.time_ns)
    }

    /// What the safety plane did since the last turn.
    fn hear(&mut self, safety: &mut SafetyThread) {
        self.report.events.clear();
        self.report.blocked_m = None;
        while let Ok(News { event, blocked_m }) = safety.news.pop() {
            self.report.events.extend(event);
            self.report.blocked_m = blocked_m.or(self.report.blocked_m);
        }
        self.report.in_charge = safety.glance.read().state.is_in_charge();
    }

    fn note(&mut self, decision: &Decision, wheel: &WheelFeedback) {
        self.no_depth = decision.events.iter().find_map(|event| match event {
            Event::NoDepth { why } => Some(*why),
            _ => None,
        });
        for event in &decision.events {
            self.counts.add(event);
            if let Event::Safety { what: SafetyEvent::Tripped { x_m, y_m, .. } } = event {
                self.trips_m.push(wheel.odom.transform(*x_m, *y_m).into());
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
        // A jump is odometry that began anew.
        self.path_m += step_m.min(0.5);
        if step_m > 0.0 && self.trajectory.len() < MOST_REMEMBERED {
            self.trajectory.push(wheel.odom);
        }
    }

    fn record(&mut self, tick: Option<RecordedTick>) -> Result<()> {
        let (Some(tick), Some(recorder)) = (tick, &mut self.recorder) else { return Ok(()) };
        let shows = |every: u64| tick.tick.is_multiple_of(every);
        let views = Views {
            map: shows(self.recording.map_every_ticks)
                .then(|| map_view(self.robot.map()))
                .flatten(),
            path_m: shows(self.recording.depth_every_ticks)
                .then(|| self.robot.explorer().path_m().to_vec()),
            depth: if shows(self.recording.depth_every_ticks) {
                self.robot.mapped_depth().map(|estimate| estimate.depth.clone())
            } else {
                None
            },
        };
        Ok(recorder.record(tick, views)?)
    }

    /// Turns with a picture so far.
    #[must_use]
    pub fn pictures(&self) -> u64 {
        self.pictures
    }

    /// For `health`.
    #[must_use]
    pub fn status(&self, skipped: u64) -> ExplorationStatus {
        let total = self.percentiles();
        let ms = |part: fn(&Percentiles) -> f64| total.as_ref().map_or(0.0, part);
        let map = self.robot.map();
        let free =
            map.known_cells().filter(|(cell, _)| map.state(*cell) == CellState::Free).count();
        ExplorationStatus {
            ticks: self.tick,
            skipped,
            policy: self.robot.config().policy.name().to_owned(),
            goal: self.robot.explorer().goal().map(|goal| {
                let [x_m, y_m] = goal.target_m;
                format!("{:?} at ({x_m:.2}, {y_m:.2}) m", goal.why).to_lowercase()
            }),
            no_depth: self.no_depth.map(|why| sentence(&Event::NoDepth { why }).1),
            turn_p50_ms: ms(|total| total.p50),
            turn_p99_ms: ms(|total| total.p99),
            line: self.line.overall(),
            line_by_distance: self.line.by_distance(),
            model: self.robot.network_digest(),
            on_trial: self.models.as_ref().and_then(LiveModels::on_trial).map(str::to_owned),
            mapped_m2: free as f64 * map.cell_m() * map.cell_m(),
        }
    }

    fn percentiles(&self) -> Option<Percentiles> {
        self.stopwatch.latencies().percentiles().get(&Stage::Total).copied()
    }

    /// The camera, for `health`.
    #[must_use]
    pub fn camera(&self) -> (DeviceStatus, Option<&String>) {
        (self.camera.injector().status(self.camera.inner().status()), self.camera_problem.as_ref())
    }

    /// The recorder, for `health`.
    #[must_use]
    pub fn recorder(&self) -> Option<&Recorder> {
        self.recorder.as_ref()
    }

    /// What is left of it when it ends.
    #[must_use]
    pub fn finish(self) -> Finished {
        Finished {
            latencies: self.stopwatch,
            counts: self.counts,
            line: LidarLine::of(&self.line),
            recorder: self.recorder,
            robot: self.robot,
            pictures: self.pictures,
            path_m: self.path_m,
            trajectory: self.trajectory,
            trips_m: self.trips_m,
        }
    }
}

/// What is left of a run.
pub struct Finished {
    /// Time of each stage.
    pub latencies: Stopwatch,
    /// What happened.
    pub counts: EventCounts,
    /// How right the depth was on the LiDAR's line.
    pub line: Option<LidarLine>,
    /// The recording, to be finished.
    pub recorder: Option<Recorder>,
    /// The robot's mind, with its map.
    pub robot: Robot,
    /// Turns with a picture.
    pub pictures: u64,
    /// Way by wheel odometry, metres.
    pub path_m: f64,
    /// Where it was, in `odom`.
    pub trajectory: Vec<Pose2>,
    /// What it stopped for, in `odom`, metres.
    pub trips_m: Vec<[f64; 2]>,
}

/// Logs once a minute how right the depth is.
fn tell_line(monitor: &LineMonitor, told_ns: &mut Option<u64>, now_ns: u64) {
    let last_ns = told_ns.get_or_insert(now_ns);
    if now_ns.saturating_sub(*last_ns) < LOG_LINE_EVERY_NS {
        return;
    }
    *last_ns = now_ns;
    match LidarLine::of(monitor) {
        Some(line) => tracing::info!("the LiDAR agrees: {line}"),
        None => tracing::info!("nothing to compare depth and LiDAR by yet"),
    }
}
