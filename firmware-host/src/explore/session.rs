//! One run: the loop over the simulated devices, and what is kept of it.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::Result;
use drivers::fault::{Faults, FaultyBase, FaultyCamera, FaultyClock, FaultyLidar};
use hal::{
    Base, Camera, Clock, DepthMap, DriveCommand, Error, ErrorKind, Frame, LaserScan, Lidar,
    WheelFeedback,
};
use runtime::event::ExploreEnd;
use runtime::line_monitor::LineMonitor;
use runtime::mapping::{CellState, OccupancyGrid};
use runtime::recording::{RecordedTick, RunDigest, Views, quantise_mm};
use runtime::robot::{DepthSource, Robot};
use runtime::tick::{Decision, TickInput};
use simulator::SimulatedRobot;
use simulator::floor::FloorPlan;
use simulator::robot::{SimBase, SimCamera, SimClock, SimLidar, Truth as World};

use crate::cli::ExploreArgs;
use crate::config::{Config, RecordingSection};
use crate::dump::{Dump, Shot};
use crate::evaluation::{Evaluation, Truth};
use crate::model::LiveModels;
use crate::record::{Recorder, snapshot};
use crate::report::coverage::Coverage;
use crate::report::depth_sample::{SheetRow, SheetSampler};
use crate::report::depth_sheet::DepthSheet;
use crate::report::latency::Stage;
use crate::report::map_picture::{self, Cells, MapPicture};
use crate::report::map_view::map_view;
use crate::report::progress::{Progress, Status};
use crate::report::summary::{LidarLine, Summary, peak_resident_mib};
use crate::report::table;
use crate::stopwatch::Stopwatch;

use super::hand_over::{HandOver, Round};

pub(super) struct Session {
    out: PathBuf,
    frames: u64,
    tick_ns: u64,
    recording: RecordingSection,
    devices: Devices,
    robot: Robot,
    recorder: Option<Recorder>,
    /// Where coarse depth is written for training.
    pub dump: Option<Dump>,
    /// Where better networks come from.
    pub hand_over: Option<HandOver>,
    /// Or, signed ones.
    pub models: Option<LiveModels>,
    /// How right the depth is, as far as the robot can tell.
    line: LineMonitor,
    evaluation: Evaluation,
    digest: RunDigest,
    stopwatch: Stopwatch,
    sheet: SheetSampler,
    began: Instant,
    done: u64,
    interrupted: Arc<AtomicBool>,
    #[cfg(feature = "rerun")]
    stream: Option<crate::rerun_stream::RerunStream>,
}

/// The simulated devices, and what is wrong with them.
struct Devices {
    camera: FaultyCamera<SimCamera>,
    lidar: FaultyLidar<SimLidar>,
    base: FaultyBase<SimBase>,
    clock: FaultyClock<SimClock>,
    truth: World,
}

impl Devices {
    fn new(devices: simulator::Devices, faults: &Faults) -> Self {
        Self {
            camera: FaultyCamera::new(devices.camera, faults),
            lidar: FaultyLidar::new(devices.lidar, faults),
            base: FaultyBase::new(devices.base, faults),
            clock: FaultyClock::new(devices.clock, faults),
            truth: devices.truth,
        }
    }
}

/// Memory for one turn's inputs, reused.
struct Senses {
    frame: Frame,
    scan: LaserScan,
    truth: DepthMap,
    mapped_truth: DepthMap,
    wheel: WheelFeedback,
}

impl Session {
    pub fn new(
        args: &ExploreArgs,
        config: &Config,
        simulated: &SimulatedRobot,
        faults: &Faults,
        robot: Robot,
        recorder: Option<Recorder>,
    ) -> Self {
        let devices = Devices::new(simulated.devices(), faults);
        let plan = devices.truth.floor_plan();
        let grid = plan.grid();
        let reachable = reachable_cells(&plan);
        let coverage = Coverage::new(reachable, grid.width, grid.origin_m, grid.resolution_m);
        Self {
            out: args.out.clone(),
            frames: args.frames,
            tick_ns: config.base.tick_ns(),
            recording: config.recording.clone(),
            devices,
            robot,
            recorder,
            dump: None,
            hand_over: None,
            models: None,
            line: crate::setup::line_monitor(config),
            evaluation: Evaluation::new(coverage),
            digest: RunDigest::new(),
            stopwatch: Stopwatch::default(),
            sheet: SheetSampler::default(),
            began: Instant::now(),
            done: 0,
            interrupted: stop_on_interrupt(),
            #[cfg(feature = "rerun")]
            stream: None,
        }
    }

    /// Also shows the run in Rerun.
    #[cfg(feature = "rerun")]
    pub fn show_in(&mut self, stream: crate::rerun_stream::RerunStream) {
        self.stream = Some(stream);
    }

    /// Runs the loop to its end.
    pub fn explore(&mut self) -> Result<ExploreEnd> {
        let model = *self.devices.camera.model();
        let mut senses = Senses {
            frame: Frame::empty(),
            scan: LaserScan::empty(self.devices.lidar.geometry()),
            truth: DepthMap::none(model.width, model.height),
            mapped_truth: DepthMap::none(model.width, model.height),
            wheel: WheelFeedback::default(),
        };
        let mut progress = Progress::start(self.frames);
        let mut end = ExploreEnd::FrameBudget;
        for tick in 0..self.frames {
            if !self.take_network(tick)? || self.interrupted.load(Ordering::Relaxed) {
                end = ExploreEnd::Interrupted;
                break;
            }
            if let Err(error) = self.turn(tick, &mut senses)? {
                tracing::error!(%error, "the recording has failed; the run ends");
                end = ExploreEnd::OutputFailed;
                break;
            }
            self.done = tick + 1;
            let doing = self
                .robot
                .explorer()
                .goal()
                .map_or_else(String::new, |goal| format!("{:?}", goal.why));
            let doing = doing.to_lowercase();
            progress
                .frame(self.done, &Status { coverage: self.evaluation.coverage(), doing: &doing });
        }
        let _ = self.devices.base.stop();
        progress.finish();
        Ok(end)
    }

    /// Where the schedule says so, hands over what was recorded and takes the next network. `false`: interrupted.
    fn take_network(&mut self, tick: u64) -> Result<bool> {
        let Some(hand_over) = &self.hand_over else { return Ok(true) };
        let Some(round) = hand_over.round(tick) else { return Ok(true) };
        let began = Instant::now();
        if let Some(dump) = &self.dump {
            dump.write_index()?;
        }
        let segments = self.recorder.as_mut().map_or(Ok(0), Recorder::cut)?;
        let round = Round { round, frames: tick, segments, digest: self.digest.decisions() };
        let network = hand_over.exchange(&round, &self.interrupted)?;
        // Waiting is no part of the run.
        self.began += began.elapsed();
        let came = network.is_some();
        if let Some(network) = network {
            self.robot.take_network(network);
        }
        Ok(came)
    }

    /// One turn. The inner error: the recording failed, and the run must end.
    fn turn(
        &mut self,
        tick: u64,
        senses: &mut Senses,
    ) -> Result<Result<(), crate::record::RecordError>> {
        self.stopwatch.start();
        self.devices.clock.sleep_until_ns(tick * self.tick_ns);
        let time_ns = self.devices.clock.now_ns();
        let (has_frame, has_scan) = self.sense(senses);
        self.stopwatch.lap(Stage::Simulator);
        let maps_truth = self.robot.config().depth_source == DepthSource::Truth;
        if maps_truth {
            senses.mapped_truth.clone_from(&senses.truth);
            quantise_mm(&mut senses.mapped_truth);
        }
        let input = TickInput {
            tick,
            time_ns,
            wheel: senses.wheel,
            scan: has_scan.then_some(&senses.scan),
            frame: if has_frame { Some(senses.frame.view()?) } else { None },
            truth: maps_truth.then_some(&senses.mapped_truth),
            safety: None,
        };
        if let Some(models) = &mut self.models {
            models.before(&mut self.robot, time_ns);
        }
        let snapshot = snapshot(self.recorder.as_mut(), &self.robot, time_ns);
        let began = Instant::now();
        self.stopwatch.start();
        let decision = self.robot.tick(&input, &mut self.stopwatch);
        self.stopwatch.since(began, Stage::Total);
        let command =
            DriveCommand { twist: decision.command.into(), counter: tick as u32, plan_age_ns: 0 };
        self.drive(&command)?;
        self.digest.add_input(&input);
        self.digest.add_decision(&decision);
        self.evaluate(&input, &senses.truth, &decision)?;
        self.dump(&input)?;
        self.line.look(&input, self.robot.mapped_depth());
        if let Some(models) = &mut self.models {
            // Virtual time waits: no turn is late.
            models.after(&mut self.robot, &input, &decision, false);
        }
        self.stopwatch.start();
        let recorded = self.record(&input, decision, snapshot)?;
        self.stopwatch.lap(Stage::Record);
        Ok(recorded)
    }

    /// Reads the devices. An error is no reading, and never a reason to keep the last one.
    fn sense(&mut self, senses: &mut Senses) -> (bool, bool) {
        let has_frame = self.devices.camera.poll_frame(&mut senses.frame).unwrap_or(false);
        let has_scan = self.devices.lidar.poll_scan(&mut senses.scan).unwrap_or(false);
        if let Ok(Some(wheel)) = self.devices.base.poll_feedback() {
            senses.wheel = wheel;
        }
        self.devices.truth.depth(&mut senses.truth);
        (has_frame, has_scan)
    }

    /// A base that cannot be reached stops by its own watchdog; one that refuses was asked for nonsense, and the run ends.
    fn drive(&mut self, command: &DriveCommand) -> Result<()> {
        match self.devices.base.drive(command) {
            Err(error) if error.kind() == ErrorKind::Rejected => Err(error.into()),
            _ => Ok(()),
        }
    }

    fn evaluate(
        &mut self,
        input: &TickInput<'_>,
        depth: &DepthMap,
        decision: &Decision,
    ) -> Result<()> {
        let truth = Truth {
            pose: self.devices.truth.pose(),
            odom: input.wheel.odom,
            depth: Some(depth),
            contact: self.devices.truth.contact(),
        };
        self.evaluation.frame(&truth, &self.robot, decision)?;
        if let Some(frame) = &input.frame {
            let (coarse, network) = (self.robot.coarse_depth(), self.robot.network_depth());
            let depths = usize::from(coarse.is_some()) + usize::from(network.is_some());
            self.sheet.offer(input.tick, depths, || {
                SheetRow::capture(input.tick, frame, coarse, network, Some(depth))
            });
        }
        Ok(())
    }

    /// A picture's coarse depth, with the pose that the robot believes in.
    fn dump(&mut self, input: &TickInput<'_>) -> Result<()> {
        let (Some(dump), Some(_)) = (&mut self.dump, &input.frame) else { return Ok(()) };
        let t_world_camera = input.wheel.odom.to_pose3() * self.robot.config().t_base_camera;
        let shot =
            Shot { time_ns: input.time_ns, t_world_camera, rgb: None, truth: None, view: None };
        dump.add(&shot, self.robot.coarse_depth())
    }

    fn record(
        &mut self,
        input: &TickInput<'_>,
        decision: Decision,
        snapshot: Option<Vec<u8>>,
    ) -> Result<Result<(), crate::record::RecordError>> {
        let path_m = self.robot.explorer().path_m();
        let shows = |every: u64| input.tick.is_multiple_of(every);
        let views = Views {
            map: shows(self.recording.map_every_ticks)
                .then(|| map_view(self.robot.map()))
                .flatten(),
            path_m: shows(self.recording.depth_every_ticks).then(|| path_m.to_vec()),
            depth: if shows(self.recording.depth_every_ticks) {
                self.robot.mapped_depth().map(|estimate| estimate.depth.clone())
            } else {
                None
            },
        };
        #[cfg(feature = "rerun")]
        self.show(input, &decision, &views);
        let Some(recorder) = &mut self.recorder else { return Ok(Ok(())) };
        Ok(recorder.record(
            RecordedTick { snapshot, ..RecordedTick::capture(input, Some(decision))? },
            views,
        ))
    }

    #[cfg(feature = "rerun")]
    fn show(&mut self, input: &TickInput<'_>, decision: &Decision, views: &Views) {
        let Some(stream) = &mut self.stream else { return };
        let mut numbers = vec![("linear_mps", decision.command.linear_mps)];
        numbers.extend(self.evaluation.coverage().map(|share| ("coverage", share)));
        numbers.extend(self.line.overall().map(|line| ("line_delta1", line.delta1)));
        numbers.extend(self.line.overall().map(|line| ("line_scale", line.scale)));
        stream.offer(crate::rerun_stream::Moment {
            tick: input.tick,
            time_ns: input.time_ns,
            odom: input.wheel.odom,
            goal_m: decision.goal_m,
            picture: input.frame.map(|view| (view.width(), view.height(), view.data().to_vec())),
            views: views.clone(),
            numbers,
        });
    }

    /// Writes summary and pictures, and prints what a person wants to know.
    pub fn report(self, end: ExploreEnd, mut summary: Summary) -> Result<()> {
        let wall_s = self.began.elapsed().as_secs_f64();
        #[cfg(feature = "rerun")]
        if let Some(counts) = self.stream.map(crate::rerun_stream::RerunStream::finish) {
            println!("Rerun: {} turns shown, {} dropped.", counts.sent, counts.dropped);
        }
        if let Some(dump) = &self.dump {
            dump.write_index()?;
        }
        let recording = self.recorder.map(Recorder::finish);
        let mut end = end;
        match recording {
            Some(Ok(recording)) => {
                summary.recording_mib = Some(recording.bytes as f64 / f64::from(1 << 20));
                summary.recording_digest = Some(recording.inputs_digest);
            }
            Some(Err(error)) => {
                eprintln!("warning: {error}");
                end = ExploreEnd::OutputFailed;
            }
            None => {}
        }
        summary.frames = self.done;
        summary.end_reason = Some(end);
        summary.wall_s = Some(wall_s);
        summary.frames_per_s = Some(self.done as f64 / wall_s);
        summary.latency_ms = self.stopwatch.latencies().percentiles();
        summary.digest = Some(self.digest.decisions());
        summary.resident_mib = peak_resident_mib();
        summary.lidar_line = LidarLine::of(&self.line);
        self.evaluation.summarise(&mut summary);
        // Numbers before pictures: they still find room on a disk that is nearly full.
        summary.write(&self.out)?;
        println!("{}", table::render(&summary));
        let title = title(&summary);
        DepthSheet { title: &title, rows: &self.sheet.into_rows() }.write(&self.out)?;
        let t_world_odom = self.evaluation.t_world_odom();
        draw_map(
            &title,
            self.robot.map(),
            &t_world_odom,
            &self.evaluation,
            &self.devices,
            &self.out,
        )?;
        println!(
            "Look at {0}/map.png and {0}/depth.png; numbers are in {0}/summary.json.",
            self.out.display()
        );
        if summary.recording_mib.is_some() {
            println!("Open {}/recording_0000.mcap in Foxglove or Rerun.", self.out.display());
        }
        Ok(())
    }
}

fn title(summary: &Summary) -> String {
    let scene = summary.scene.as_deref().unwrap_or_default();
    let policy = summary.policy.as_deref().unwrap_or_default();
    let coverage = summary
        .coverage
        .map_or_else(String::new, |share| format!(", {:.0} % mapped", 100.0 * share));
    format!("{scene}, {policy}, {} frames{coverage} (simulated)", summary.frames)
}

/// The map in the world's frame, so that the true floor and way lie on it.
fn draw_map(
    title: &str,
    map: &OccupancyGrid,
    t_world_odom: &hal::Pose2,
    evaluation: &Evaluation,
    devices: &Devices,
    out: &std::path::Path,
) -> Result<()> {
    let plan = devices.truth.floor_plan();
    let grid = plan.grid();
    let reachable = reachable_cells(&plan);
    // Resampled into the world at the map's own resolution: without drift the frames differ by the start pose only.
    let cell_m = map.cell_m();
    let (width, height) = (
        (grid.width as f64 * grid.resolution_m / cell_m).ceil() as usize,
        (grid.height as f64 * grid.resolution_m / cell_m).ceil() as usize,
    );
    let t_odom_world = t_world_odom.inverse();
    let state = |index: usize| {
        let x_m = grid.origin_m[0] + (index % width) as f64 * cell_m + cell_m / 2.0;
        let y_m = grid.origin_m[1] + (index / width) as f64 * cell_m + cell_m / 2.0;
        let (x_m, y_m) = t_odom_world.transform(x_m, y_m);
        match map.state_at(x_m, y_m) {
            CellState::Unknown => map_picture::CellState::Unknown,
            CellState::Free => map_picture::CellState::Free,
            CellState::Occupied => map_picture::CellState::Occupied,
        }
    };
    let cells: Vec<map_picture::CellState> = (0..width * height).map(state).collect();
    let picture = MapPicture {
        title,
        map: Cells { width, cells: &cells, resolution_m: cell_m, origin_m: grid.origin_m },
        trajectory: evaluation.trajectory(),
        goals: evaluation.goals_m(),
        trips: evaluation.trips_m(),
        reachable: Some(Cells {
            width: grid.width,
            cells: &reachable,
            resolution_m: grid.resolution_m,
            origin_m: grid.origin_m,
        }),
    };
    Ok(picture.write(out)?)
}

/// Which cells of the plan's grid are reachable floor.
fn reachable_cells(plan: &FloorPlan) -> Vec<bool> {
    let grid = plan.grid();
    let mut cells = vec![false; grid.cells()];
    for index in plan.reachable_floor().filter_map(|[x_m, y_m]| grid.index(x_m, y_m)) {
        cells[index] = true;
    }
    cells
}

/// Ctrl-C ends the run after the current turn, with a report.
fn stop_on_interrupt() -> Arc<AtomicBool> {
    let interrupted = Arc::new(AtomicBool::new(false));
    let flag = interrupted.clone();
    // A second session in one process keeps the first handler; only tests do that.
    let _ = ctrlc::set_handler(move || flag.store(true, Ordering::Relaxed));
    interrupted
}
