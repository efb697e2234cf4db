//! A simulated run: the session over simulated devices in virtual time, and its outputs.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::Result;
use drivers::fault::Faults;
use hal::{DepthMap, Pose2};
use runtime::event::ExploreEnd;
use runtime::lidar_agreement::LidarAgreement;
use runtime::recording::{RecordedTick, RunDigest};
use runtime::robot::{Robot, Stage as RobotStage, StageTimer};
use runtime::session::{Observer, Session};
use runtime::task::Task;
use runtime::tick::{Decision, TickInput};
use simulator::SimulatedRobot;
use simulator::robot::Truth as World;

use super::devices::{SimulatedDevices, simulated_devices};
use super::hand_over::{HandOver, Round};
use super::map_plot::reachable_cells;
use super::narration::Narrator;
use super::shots::Shots;
use super::watched::{Watched, attend};
use super::{map_accuracy, map_plot};
use crate::cli::ExploreArgs;
use crate::config::{Config, RecordingSection};
use crate::control_panel::ControlPanel;
use crate::dump::{Depths, Dump, Shot};
use crate::evaluation::{Evaluation, NEAR_EDGE_M, Truth};
use crate::map::KeptMap;
use crate::model::LiveModels;
use crate::record::{RecordError, Recorder, recorded_views, snapshot};
use crate::report::coverage::Coverage;
use crate::report::depth_sample::{FrameDepths, SheetRow, SheetSampler};
use crate::report::depth_scale::DepthScale;
use crate::report::depth_sheet::DepthSheet;
use crate::report::latency::Stage;
use crate::report::progress::{Progress, Status};
use crate::report::summary::{CameraLatency, LidarLine, Summary, peak_resident_mib};
use crate::report::table;
use crate::stopwatch::Stopwatch;

/// A simulated run in progress.
pub(super) struct Exploration {
    out: PathBuf,
    frames: u64,
    until_done: bool,
    quiet: bool,
    session: Session<SimulatedDevices>,
    /// The source of better networks, if there is one.
    pub hand_over: Option<HandOver>,
    /// The outputs of the run.
    pub log: RunLog,
    done: u64,
    interrupted: Arc<AtomicBool>,
}

/// The outputs of a simulated run: recording, evaluation against ground truth, latencies and plots.
pub(super) struct RunLog {
    recording: RecordingSection,
    /// The recording, if the run is recorded.
    pub recorder: Option<Recorder>,
    /// The dump of coarse depth for training, if there is one.
    pub dump: Option<Dump>,
    /// The map that the run began with and leaves behind.
    pub map: Option<KeptMap>,
    /// Signed models that arrive during the run.
    pub models: Option<LiveModels>,
    /// The live view, if there is one.
    pub watched: Option<Watched>,
    /// Agreement of the depth with the LiDAR.
    pub line: LidarAgreement,
    world: World,
    /// Ground-truth depth of the newest frame.
    true_depth: DepthMap,
    pub evaluation: Evaluation,
    digest: RunDigest,
    pub stopwatch: Stopwatch,
    sheet: SheetSampler,
    began: Instant,
    started: Instant,
    snapshot: Option<Vec<u8>>,
    /// The images of the animation so far, if there is one.
    animation: Option<Shots>,
    #[cfg(feature = "rerun")]
    stream: Option<crate::rerun_stream::RerunStream>,
}

/// Why a run ends early.
pub(super) enum Failure {
    /// The recording cannot be written. The run ends with a report.
    Recording(RecordError),
    /// A defect, or output that cannot be written.
    Other(anyhow::Error),
}

impl<E: Into<anyhow::Error>> From<E> for Failure {
    fn from(error: E) -> Self {
        Self::Other(error.into())
    }
}

impl Exploration {
    pub fn new(
        args: &ExploreArgs,
        config: &Config,
        simulated: &SimulatedRobot,
        faults: &Faults,
        robot: Robot,
        panel: &ControlPanel,
    ) -> Self {
        let world = simulated.devices().truth;
        let plan = world.floor_plan();
        let grid = plan.grid();
        let reachable = reachable_cells(&plan);
        let coverage = Coverage::new(reachable, grid.width, grid.origin_m, grid.resolution_m);
        let camera = config.camera.model();
        let maps_truth = robot.maps_truth();
        let (devices, port) =
            simulated_devices(config, simulated, faults, maps_truth, args.real_time, panel);
        let log = RunLog {
            recording: config.recording.clone(),
            recorder: None,
            dump: None,
            map: None,
            models: None,
            watched: None,
            line: crate::setup::lidar_agreement(config),
            world,
            true_depth: DepthMap::none(camera.width, camera.height),
            evaluation: Evaluation::new(coverage),
            digest: RunDigest::new(),
            stopwatch: Stopwatch::default(),
            sheet: SheetSampler::default(),
            began: Instant::now(),
            started: Instant::now(),
            snapshot: None,
            animation: args.animation.then(|| Shots::of(args.frames)),
            #[cfg(feature = "rerun")]
            stream: None,
        };
        Self {
            out: args.out.clone(),
            frames: args.frames,
            until_done: args.until_done,
            quiet: args.quiet,
            session: Session::new(devices, robot, port, config.base.tick_ns()),
            hand_over: None,
            log,
            done: 0,
            interrupted: stop_on_interrupt(),
        }
    }

    /// Also shows the run in Rerun.
    #[cfg(feature = "rerun")]
    pub fn show_in(&mut self, stream: crate::rerun_stream::RerunStream) {
        self.log.stream = Some(stream);
    }

    /// Runs the loop to its end.
    pub fn explore(&mut self) -> Result<ExploreEnd> {
        let mut progress =
            if self.quiet { Progress::hidden() } else { Progress::start(self.frames) };
        let mut narrator = Narrator::default();
        let mut end = ExploreEnd::FrameBudget;
        for tick in 0..self.frames {
            if !self.take_network(tick)? || self.interrupted.load(Ordering::Relaxed) {
                end = ExploreEnd::Interrupted;
                break;
            }
            attend(&mut self.log, &mut self.session);
            self.log.stopwatch.start();
            self.session.wait();
            match self.session.tick(&mut self.log) {
                Ok(decision) => {
                    self.done = tick + 1;
                    let wall_s = self.log.began.elapsed().as_secs_f64();
                    let line = decision.and_then(|decision| narrator.line(&decision, wall_s));
                    if let Some(line) = line {
                        progress.say(&line);
                    }
                }
                Err(Failure::Recording(error)) => {
                    tracing::error!(%error, "the recording has failed; the run ends");
                    end = ExploreEnd::OutputFailed;
                    break;
                }
                Err(Failure::Other(error)) => return Err(error),
            }
            let goal = self.session.robot().explorer().goal();
            let doing = goal.map_or("", |goal| goal.why.name());
            let coverage = self.log.evaluation.coverage().map(Coverage::share);
            progress.frame(self.done, &Status { coverage, doing });
            if self.until_done && self.session.robot().explorer().is_done() {
                end = ExploreEnd::Explored;
                break;
            }
            if self.log.world.fell() {
                let Pose2 { x_m, y_m, .. } = self.log.world.pose();
                tracing::error!(x_m, y_m, "the robot fell over an edge of the floor; the run ends");
                end = ExploreEnd::Fell;
                break;
            }
        }
        progress.finish();
        Ok(end)
    }

    /// Gives the robot a task before its next tick.
    pub fn give(&mut self, task: Task) -> Result<()> {
        Ok(self.session.give(task)?)
    }

    /// Closes the areas that were drawn on the map in earlier runs.
    pub fn close_areas(&mut self, map: Option<&KeptMap>) -> Result<()> {
        for change in map.into_iter().flat_map(KeptMap::area_changes) {
            self.session.change_areas(change)?;
        }
        Ok(())
    }

    /// Saves the map, if the run keeps one.
    pub fn save_map(&mut self) -> Result<()> {
        self.log.map.as_mut().map_or(Ok(()), |map| map.save(self.session.robot()))
    }

    /// At the ticks of the schedule, hands over the recording and takes the next network. `false` if the run was
    /// interrupted.
    fn take_network(&mut self, tick: u64) -> Result<bool> {
        let Some(hand_over) = &self.hand_over else { return Ok(true) };
        let Some(round) = hand_over.round(tick) else { return Ok(true) };
        let began = Instant::now();
        if let Some(dump) = &self.log.dump {
            dump.write_index()?;
        }
        let segments = self.log.recorder.as_mut().map_or(Ok(0), Recorder::cut)?;
        let round = Round { round, frames: tick, segments, digest: self.log.digest.decisions() };
        let network = hand_over.exchange(&round, &self.interrupted)?;
        // Waiting for the trainer is not part of the run.
        self.log.began += began.elapsed();
        let came = network.is_some();
        if let Some(network) = network {
            self.session.robot_mut().set_network(network);
        }
        Ok(came)
    }

    /// Writes summary and plots, and prints the summary. Returns why the run ended.
    pub fn report(self, end: ExploreEnd, mut summary: Summary) -> Result<ExploreEnd> {
        let Self { out, session, log, done, .. } = self;
        let (devices, robot) = session.into_parts();
        devices.into_clock().into_inner().shut_down();
        let wall_s = log.began.elapsed().as_secs_f64();
        #[cfg(feature = "rerun")]
        if let Some(counts) = log.stream.map(crate::rerun_stream::RerunStream::finish) {
            println!("Rerun: {} ticks shown, {} dropped.", counts.sent, counts.dropped);
        }
        if let Some(dump) = &log.dump {
            dump.write_index()?;
        }
        let recording = log.recorder.map(Recorder::finish);
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
        summary.frames = done;
        summary.end_reason = Some(end);
        summary.wall_s = Some(wall_s);
        summary.frames_per_s = Some(done as f64 / wall_s);
        summary.latency_ms = log.stopwatch.latencies().percentiles();
        summary.digest = Some(log.digest.decisions());
        summary.resident_mib = peak_resident_mib();
        summary.lidar_line = LidarLine::of(&log.line);
        summary.camera_latency = CameraLatency::of(&robot);
        log.evaluation.summarise(&mut summary);
        map_accuracy::summarise(
            &log.evaluation,
            robot.map(),
            &log.world.floor_plan(),
            &mut summary,
        );
        // The summary is written before the images, because it still fits on a disk that is nearly full.
        summary.write(&out)?;
        println!("{}", table::render(&summary));
        let title = map_plot::title(&summary);
        let rows = log.sheet.into_rows();
        let scale = DepthScale::of(rows.iter());
        DepthSheet { title: &title, rows: &rows, scale }.write(&out)?;
        if let Some(shots) = &log.animation {
            shots.write(
                &title,
                scale,
                robot.map().cell_m(),
                &log.evaluation,
                &log.world.floor_plan(),
                &out,
            )?;
        }
        map_plot::write(&summary, robot.map(), &log.evaluation, &log.world.floor_plan(), &out)?;
        println!(
            "See {0}/map.png and {0}/depth.png; numbers are in {0}/summary.json.",
            out.display()
        );
        if log.animation.is_some() {
            println!("{}/animation.png shows how the map grew; a browser plays it.", out.display());
        }
        if summary.recording_mib.is_some() {
            println!(
                "For Foxglove and Rerun: firmware-host buffer export {} --as viewer --out run.mcap",
                out.display()
            );
        }
        Ok(end)
    }
}

impl StageTimer for RunLog {
    fn ended(&mut self, stage: RobotStage) {
        self.stopwatch.ended(stage);
    }
}

impl Observer for RunLog {
    type Error = Failure;

    fn before(&mut self, robot: &mut Robot, input: &TickInput<'_>) -> Result<(), Failure> {
        self.stopwatch.lap(Stage::Simulator);
        if let (Some(map), Some(scan)) = (&self.map, input.scan) {
            map.check(&scan.geometry)?;
        }
        if let Some(models) = &mut self.models {
            models.before(robot, input.time_ns);
        }
        self.snapshot = snapshot(self.recorder.as_mut(), robot, input.time_ns);
        self.started = Instant::now();
        self.stopwatch.start();
        Ok(())
    }

    fn after(
        &mut self,
        robot: &mut Robot,
        input: &TickInput<'_>,
        decision: &Decision,
    ) -> Result<(), Failure> {
        if let Some(watched) = &mut self.watched {
            self.stopwatch.start();
            watched.live.offer(robot, input, decision, self.started.elapsed());
            self.stopwatch.lap(Stage::Live);
        }
        self.stopwatch.since(self.started, Stage::Total);
        self.digest.add_input(input);
        self.digest.add_decision(decision);
        self.world.depth(&mut self.true_depth);
        self.evaluate(robot, input, decision)?;
        self.dump(robot, input)?;
        self.line.observe(input, robot.compared_depth());
        if let Some(models) = &mut self.models {
            // In virtual time no tick is late.
            models.after(robot, input, decision, false);
        }
        self.stopwatch.start();
        self.record(robot, input, decision)?;
        self.stopwatch.lap(Stage::Record);
        Ok(())
    }
}

impl RunLog {
    fn evaluate(
        &mut self,
        robot: &Robot,
        input: &TickInput<'_>,
        decision: &Decision,
    ) -> Result<()> {
        let truth = Truth {
            pose: self.world.pose(),
            depth: Some(&self.true_depth),
            contact: self.world.take_contact(),
            near_edge: self.world.drop_distance_m(NEAR_EDGE_M).is_some(),
            fell: self.world.fell(),
        };
        self.evaluation.frame(&truth, robot, decision)?;
        if let Some(shots) = &mut self.animation {
            shots.offer(input, robot, &self.evaluation, &self.world.floor_plan());
        }
        if let Some(frame) = &input.frame {
            let depths = FrameDepths { truth: Some(&self.true_depth), ..FrameDepths::of(robot) };
            self.sheet.offer(input.tick, depths.count(), || {
                SheetRow::capture(input.tick, frame, &depths)
            });
        }
        Ok(())
    }

    /// Writes a frame's coarse and dense depth, with the believed pose.
    fn dump(&mut self, robot: &Robot, input: &TickInput<'_>) -> Result<()> {
        let (Some(dump), Some(_)) = (&mut self.dump, &input.frame) else { return Ok(()) };
        let t_map_base = robot.poses().t_map_base_at_frame();
        let t_world_camera = t_map_base.to_pose3() * robot.config().t_base_camera;
        let shot =
            Shot { time_ns: input.time_ns, t_world_camera, rgb: None, truth: None, view: None };
        dump.add(&shot, &Depths { coarse: robot.coarse_depth(), dense: robot.dense_depth() })
    }

    fn record(
        &mut self,
        robot: &Robot,
        input: &TickInput<'_>,
        decision: &Decision,
    ) -> Result<(), Failure> {
        #[cfg(feature = "rerun")]
        self.show(robot, input, decision);
        let Some(recorder) = &mut self.recorder else { return Ok(()) };
        let tick = RecordedTick::capture(input, Some(decision.clone()))?;
        let tick = RecordedTick { snapshot: self.snapshot.take(), ..tick };
        let views = recorded_views(robot, input.tick, &self.recording);
        recorder.record(tick, views).map_err(Failure::Recording)
    }

    #[cfg(feature = "rerun")]
    fn show(&mut self, robot: &Robot, input: &TickInput<'_>, decision: &Decision) {
        let Some(stream) = &mut self.stream else { return };
        let mut numbers = vec![("desired_mps", decision.desired.linear_mps)];
        numbers.extend(decision.sent.map(|sent| ("sent_mps", sent.linear_mps)));
        numbers.extend(self.evaluation.coverage().map(|coverage| ("coverage", coverage.share())));
        numbers.extend(self.line.overall().map(|line| ("line_delta1", line.delta1)));
        numbers.extend(self.line.overall().map(|line| ("line_scale", line.scale)));
        stream.offer(crate::rerun_stream::Moment {
            tick: input.tick,
            time_ns: input.time_ns,
            t_map_base: robot.poses().t_map_base(),
            goal_m: decision.goal_m,
            image: input.frame.map(|view| (view.width(), view.height(), view.data().to_vec())),
            views: recorded_views(robot, input.tick, &self.recording),
            numbers,
        });
    }
}

/// Makes Ctrl-C, SIGTERM and SIGHUP end the run after the current tick, with a report.
fn stop_on_interrupt() -> Arc<AtomicBool> {
    let interrupted = Arc::new(AtomicBool::new(false));
    let flag = interrupted.clone();
    // A second session in one process keeps the first handler; only tests do that.
    let _ = ctrlc::set_handler(move || flag.store(true, Ordering::Relaxed));
    interrupted
}
