//! The exploration plane's decisions: perceive, map, choose a goal, plan, for one tick's input.

mod camera_time;
mod config;
mod depth_source;
#[cfg(test)]
mod layout_tests;
mod location;
mod lost;
mod map_correction;
mod outside_odometry;
#[cfg(test)]
mod refusal_tests;
mod saved_map;
#[cfg(test)]
mod saved_map_tests;
mod separate_maps;
#[cfg(test)]
mod separate_maps_tests;
#[cfg(test)]
mod sweep_tests;
#[cfg(test)]
pub(crate) mod test_robot;
mod tilt;
mod wheel_frame;

use std::collections::VecDeque;

use hal::{DepthMap, LaserScan, Pose2, Pose3, Twist2};
use nalgebra::Vector3;
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use crate::calibration_watch::{CalibrationWatch, MatchedScan, Report};
use crate::event::{Event, RefusedInput};
use crate::exploration::{Explorer, Observations};
use crate::localization::{Gyroscope, LocalizationError, Whereabouts};
use crate::mapping::{MapError, OccupancyGrid, SingleFrameMap, Surfaces, Sweep};
use crate::perception::{
    CoarseDepth, DenseDepth, DepthEstimate, DepthNetwork, GivenDepth, Moment, NoDepth,
    PerceptionError, map_depth,
};
use crate::planning::{ConfigError, Primitive};
use crate::recording::input_digest;
use crate::safety::SentCommand;
use crate::snapshot::{
    SNAPSHOT_VERSION, SNAPSHOT_WITHOUT_IMU, SNAPSHOT_WITHOUT_SCANNER_TIME,
    SNAPSHOT_WITHOUT_SEPARATE_MAPS, SnapshotError, State, remembers,
};
use crate::tick::{Decision, SafetyReport, TickInput};
use camera_time::CameraTime;
use location::Location;
use lost::LostMotion;
use map_correction::MapCorrection;
use outside_odometry::OutsideOdometry;
use separate_maps::SeparateMaps;
use tilt::Tilt;
use wheel_frame::WheelFrame;

pub use config::{FRAME_TIMEOUT_S, RobotConfig, SAFETY_HZ, ticks_of_silence};
pub use depth_source::DepthSource;
pub use location::TickPoses;
pub use saved_map::{MAP_STATE_VERSION, MapStateError, SavedMap};

/// Which part of the configuration cannot be used, and why.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RobotError {
    /// The map refuses its configuration.
    #[error("map: {0}")]
    Map(#[from] MapError),
    /// Localization refuses its configuration.
    #[error("localization: {0}")]
    Localization(#[from] LocalizationError),
    /// Perception refuses its configuration.
    #[error("perception: {0}")]
    Perception(#[from] PerceptionError),
    /// Planning refuses its configuration.
    #[error("planning: {0}")]
    Planning(#[from] ConfigError),
    /// The depth source is `network`, and there is no network.
    #[error("depth source `network` needs a model: give one, or take `dense` or `coarse`")]
    NoModel,
    /// The depth source is `dense`, and dense depth is not computed.
    #[error("depth source `dense` needs `dense.enabled = true`: set it, or take `coarse`")]
    NoDense,
}

/// Stages of one tick, for latency reports.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    Coarse,
    /// From coarse depth to dense depth.
    Dense,
    Network,
    /// Depth and scan enter the map.
    Map,
    /// Policy and planning.
    Plan,
}

/// Measures how long the stages of a tick take. The program that drives the session implements it with a clock of its own;
/// the runtime has none.
pub trait StageTimer {
    /// The robot calls this at the end of `stage`.
    fn ended(&mut self, stage: Stage);
}

/// A timer that measures nothing.
impl StageTimer for () {
    fn ended(&mut self, _stage: Stage) {}
}

/// The exploration plane: perception, map and policy, with everything that they remember from earlier ticks.
pub struct Robot {
    config: RobotConfig,
    coarse: CoarseDepth,
    dense: DenseDepth,
    network: Option<DepthNetwork>,
    /// What the map believes of dense depth, or of a network's depth that was joined with it, if it uses one of them.
    believed: DepthEstimate,
    /// The network's depth, joined with dense depth if the network was given that.
    joined: DepthEstimate,
    truth: DepthEstimate,
    has_depth: HasDepth,
    location: Location,
    camera_time: CameraTime,
    watch: CalibrationWatch,
    outside: OutsideOdometry,
    wheel_frame: WheelFrame,
    poses: TickPoses,
    whereabouts: Whereabouts,
    lost_motion: LostMotion,
    tilt: Tilt,
    map_correction: MapCorrection,
    map: OccupancyGrid,
    separate_maps: SeparateMaps,
    /// The surfaces of the newest scan.
    surfaces: Surfaces,
    /// Maps of the newest single frames, oldest first, from which the policy finds inconsistencies.
    frame_maps: VecDeque<SingleFrameMap>,
    explorer: Explorer,
    bumped: bool,
    collision_at: Option<[f64; 2]>,
    unseen_at: Option<[f64; 2]>,
    last_time_ns: Option<u64>,
    /// Ticks since the last frame.
    ticks_without_frame: u64,
    /// A network that was loaded or removed since the last tick.
    new_network: Option<Event>,
}

/// Which depth sources delivered depth in this tick.
#[derive(Debug, Clone, Copy, Default)]
struct HasDepth {
    coarse: bool,
    dense: bool,
    network: bool,
    truth: bool,
}

impl Robot {
    /// A robot with an empty map.
    ///
    /// # Errors
    /// When a part of the configuration is out of range, or the robot does not have the depth source.
    pub fn new(config: RobotConfig, network: Option<DepthNetwork>) -> Result<Self, RobotError> {
        if config.depth_source == DepthSource::Network && network.is_none() {
            return Err(RobotError::NoModel);
        }
        if config.depth_source == DepthSource::Dense && !config.dense.enabled {
            return Err(RobotError::NoDense);
        }
        let rng = Pcg64Mcg::seed_from_u64(config.seed);
        let coarse = CoarseDepth::new(config.coarse.clone(), config.camera)?.with_floor(true);
        let mount = Some(&config.t_base_camera);
        let dense = DenseDepth::new(config.dense.clone(), &config.camera, &coarse, mount);
        Ok(Self {
            coarse,
            dense,
            network,
            believed: DepthEstimate::none(config.camera.width, config.camera.height),
            joined: DepthEstimate::none(config.camera.width, config.camera.height),
            truth: DepthEstimate::none(config.camera.width, config.camera.height),
            has_depth: HasDepth::default(),
            location: Location::new(config.localization.clone(), config.t_base_laser)?,
            camera_time: CameraTime::default(),
            watch: CalibrationWatch::default(),
            outside: OutsideOdometry::default(),
            wheel_frame: WheelFrame::default(),
            poses: TickPoses::START,
            whereabouts: Whereabouts::Localized,
            lost_motion: LostMotion::default(),
            tilt: Tilt::default(),
            map_correction: MapCorrection::default(),
            map: OccupancyGrid::new(&config.map)?,
            separate_maps: SeparateMaps::default(),
            surfaces: Surfaces::default(),
            frame_maps: VecDeque::new(),
            explorer: Explorer::new(
                config.policy,
                config.exploration,
                &config.plan,
                &config.follower,
                rng,
            )?,
            bumped: false,
            collision_at: None,
            unseen_at: None,
            last_time_ns: None,
            ticks_without_frame: 0,
            new_network: None,
            config,
        })
    }

    /// Replaces the depth network between two ticks and makes it the map's depth source. Returns the previous network.
    pub fn set_network(&mut self, network: DepthNetwork) -> Option<DepthNetwork> {
        self.new_network = Some(Event::NetworkTaken { digest: network.digest().to_owned() });
        self.config.depth_source = DepthSource::Network;
        self.network.replace(network)
    }

    /// Removes the depth network between two ticks. The map then uses dense depth, or coarse depth if dense depth is off.
    pub fn remove_network(&mut self) {
        if self.network.take().is_some() {
            self.new_network = Some(Event::NetworkLeft);
            self.config.depth_source = DepthSource::without_network(&self.config.dense);
        }
    }

    /// Everything that the robot remembers between two ticks, as bytes.
    #[must_use]
    pub fn snapshot(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        SNAPSHOT_VERSION.to_le_bytes().iter().for_each(|byte| byte.write(&mut bytes));
        self.network_digest().write(&mut bytes);
        self.config.depth_source.write(&mut bytes);
        State::write(self, &mut bytes);
        if let Some(network) = &self.network {
            network.write(&mut bytes);
        }
        self.location.write_gyro(&mut bytes);
        self.tilt.write(&mut bytes);
        self.watch.write_layout_13(&mut bytes);
        self.location.write_layout_14(&mut bytes);
        self.separate_maps.write(&mut bytes);
        bytes
    }

    /// Restores the memory that [`snapshot`](Self::snapshot) wrote. This robot must have the same configuration, seed and
    /// network as the one that wrote it.
    ///
    /// # Errors
    /// When the bytes are of another version or of another robot, or damaged. The robot must not be used after an error.
    pub fn restore(&mut self, snapshot: &[u8]) -> Result<(), SnapshotError> {
        let (version, network, mut from) = begin_snapshot(snapshot)?;
        let here = self.network_digest();
        if network != here {
            return Err(SnapshotError::OtherRobot {
                what: "the model",
                found: network.unwrap_or_else(|| "none".to_owned()),
                here: here.unwrap_or_else(|| "none".to_owned()),
            });
        }
        self.config.depth_source.read(&mut from)?;
        State::read(self, &mut from)?;
        if let Some(network) = &mut self.network {
            network.read(&mut from)?;
        }
        if version > SNAPSHOT_WITHOUT_IMU {
            self.location.read_gyro(&mut from)?;
            self.tilt.read(&mut from)?;
        } else {
            self.tilt = Tilt::default();
        }
        if version > SNAPSHOT_WITHOUT_SCANNER_TIME {
            self.watch.read_layout_13(&mut from)?;
        } else {
            self.watch.forget_layout_13();
        }
        if version > SNAPSHOT_WITHOUT_SEPARATE_MAPS {
            self.location.read_layout_14(&mut from)?;
            self.separate_maps = SeparateMaps::read(&self.config.map, &mut from)?;
            self.separate_maps.check(&self.location)?;
        } else {
            self.separate_maps = SeparateMaps::default();
        }
        match from.len() {
            0 => Ok(()),
            more => Err(SnapshotError::Damaged(format!("{more} bytes are left over"))),
        }
    }

    /// Digest of the model that a robot must have to restore `snapshot`; `None` when it must have none.
    ///
    /// # Errors
    /// When the bytes are of another version, or damaged.
    pub fn network_of_snapshot(snapshot: &[u8]) -> Result<Option<String>, SnapshotError> {
        begin_snapshot(snapshot).map(|(_, network, _)| network)
    }

    /// BLAKE3 digest of the depth network's file, in hex.
    #[must_use]
    pub fn network_digest(&self) -> Option<String> {
        self.network.as_ref().map(|network| network.digest().to_owned())
    }

    /// One tick: a pure function of this input and all inputs before it. Only [`Session`](crate::session::Session) calls it.
    pub(crate) fn tick(&mut self, input: &TickInput<'_>, timer: &mut impl StageTimer) -> Decision {
        let mut events = Vec::new();
        events.extend(self.new_network.take());
        events.extend(input.orders.iter().map(|order| Event::Operator { order: order.clone() }));
        for change in input.areas {
            self.explorer.change_areas(*change);
        }
        if let Some(task) = input.task {
            self.explorer.begin(task, input.tick, input.time_ns, &mut events);
        }
        if let Some(why) = self.refusal(input) {
            events.push(Event::InputRefused { why });
            return self.stop(input, events);
        }
        self.last_time_ns = Some(input.time_ns);
        let scan = input.scan.filter(|scan| {
            let sound = scan.ranges.len() == scan.geometry.beams && input.scan_odom.is_finite();
            if !sound {
                events.push(Event::InputRefused { why: RefusedInput::ScanShape });
            }
            sound
        });
        events.extend(input.safety.events.iter().map(|what| Event::Safety { what: *what }));
        let tilt_rad = input.imu.and_then(|imu| imu.tilt_rad).filter(|tilt| tilt.is_finite());
        let most_deg = self.config.localization.most_tilt_deg;
        self.tilt.observe(tilt_rad, input.time_ns, most_deg, &mut events);
        // The scan of a tilted robot shows floor and ceiling as walls.
        let scan = scan.filter(|_| !self.tilt.is_tilted());
        let twist = self.localize(input, scan, &mut events);
        self.note_blocked(input);
        let t_odom_camera = self.poses.t_odom_base_at_frame.to_pose3() * self.config.t_base_camera;
        if let Some(scan) = scan {
            self.dense
                .see(scan, &self.poses.t_odom_base_at_scan.compose(&self.config.t_base_laser));
        }
        self.estimate_depth(input, &t_odom_camera, &mut events, timer);
        self.find_camera_time(input);
        self.watch_calibration(input, &mut events);
        let depth_digest = self.mapped_depth().map_or(0, digest_of);
        let is_mapped = self.is_mapping();
        if is_mapped {
            self.update_map(scan, &twist);
        }
        timer.ended(Stage::Map);
        let desired = self.desired(input, &mut events);
        timer.ended(Stage::Plan);
        Decision {
            tick: input.tick,
            time_ns: input.time_ns,
            desired: desired.into(),
            sent: input.safety.sent.last().map(SentCommand::command),
            goal_m: self.explorer.goal().map(|goal| goal.target_m),
            t_odom_base: self.poses.t_odom_base,
            t_odom_base_at_frame: self.poses.t_odom_base_at_frame,
            t_map_odom: self.poses.t_map_odom,
            lost: self.whereabouts.lost(),
            events,
            input_digest: input_digest(input),
            depth_digest,
            map_digest: if is_mapped { self.map.changes_digest() } else { 0 },
        }
    }

    /// Why this input cannot be used. The robot then stops for the tick.
    fn refusal(&self, input: &TickInput<'_>) -> Option<RefusedInput> {
        if !input.wheel.odom.is_finite() {
            return Some(RefusedInput::OdometryNotFinite);
        }
        self.last_time_ns.filter(|last| input.time_ns < *last).map(|_| RefusedInput::TimeWentBack)
    }

    fn stop(&self, input: &TickInput<'_>, events: Vec<Event>) -> Decision {
        Decision {
            tick: input.tick,
            time_ns: input.time_ns,
            desired: Twist2::ZERO.into(),
            sent: input.safety.sent.last().map(SentCommand::command),
            goal_m: None,
            t_odom_base: self.poses.t_odom_base,
            t_odom_base_at_frame: self.poses.t_odom_base_at_frame,
            t_map_odom: self.poses.t_map_odom,
            lost: self.whereabouts.lost(),
            events,
            input_digest: input_digest(input),
            depth_digest: 0,
            map_digest: 0,
        }
    }

    fn estimate_depth(
        &mut self,
        input: &TickInput<'_>,
        t_odom_camera: &Pose3,
        events: &mut Vec<Event>,
        timer: &mut impl StageTimer,
    ) {
        self.has_depth = HasDepth::default();
        if let Some(truth) = input.truth {
            self.has_depth.truth = self.copy_truth(truth);
        }
        if self.whereabouts.lost().is_some() {
            events.push(Event::NoDepth { why: NoDepth::Lost });
            return;
        }
        let Some(frame) = input.frame else {
            events.push(Event::NoDepth { why: NoDepth::NoFrame });
            self.ticks_without_frame += 1;
            if self.config.stop_without_frames == Some(self.ticks_without_frame) {
                events.push(Event::StandsWithoutFrames);
            }
            return;
        };
        self.ticks_without_frame = 0;
        let coarse = self.coarse.estimate(frame, t_odom_camera).map(|_| ());
        timer.ended(Stage::Coarse);
        self.has_depth.coarse = coarse.is_ok();
        self.has_depth.dense = self.complete(input.wheel.time_ns, coarse);
        timer.ended(Stage::Dense);
        if let Some(network) = &mut self.network {
            let given = match network.spec().given {
                GivenDepth::Coarse => self.has_depth.coarse.then(|| self.coarse.last()),
                GivenDepth::Dense => self.has_depth.dense.then(|| self.dense.last()),
            };
            let result = network.estimate(frame, t_odom_camera, given).map(|_| ());
            if network.spec().given == GivenDepth::Dense && result.is_ok() {
                let seen = self.has_depth.coarse.then(|| self.coarse.last());
                self.joined.copy_from(network.last());
                if let Some(dense) = given {
                    self.joined.join(dense);
                }
                if self.config.depth_source == DepthSource::Network {
                    let dense = given.map_or(&self.joined, |_| self.dense.before_choice());
                    map_depth(&mut self.believed, dense, &self.joined, seen);
                }
                network.doubt_unseen(seen);
            }
            timer.ended(Stage::Network);
            self.has_depth.network = result.is_ok();
            if let Err(why) = result {
                events.push(Event::NoDepth { why });
            }
        } else if let Err(why) = coarse {
            events.push(Event::NoDepth { why });
        }
    }

    /// Whether what the robot sees enters its map and its memory.
    fn is_mapping(&self) -> bool {
        self.whereabouts == Whereabouts::Localized && !self.tilt.is_tilted()
    }

    /// Completes this frame's coarse depth, or its lack of parallax. Whether there is dense depth.
    fn complete(&mut self, time_ns: u64, coarse: Result<(), NoDepth>) -> bool {
        let has_image = coarse.map_or_else(NoDepth::has_image, |()| true);
        let completes = has_image && self.config.dense.enabled;
        if completes {
            let is_sure = self.is_mapping();
            let moment = Moment {
                time_ns,
                t_odom_base: self.poses.t_odom_base_at_frame,
                t_map_odom: self.poses.t_map_odom,
                section: is_sure.then(|| self.map.section()),
            };
            self.dense.complete(&self.coarse, &moment);
            if self.config.depth_source == DepthSource::Dense {
                let coarse = coarse.is_ok().then(|| self.coarse.last());
                map_depth(
                    &mut self.believed,
                    self.dense.before_choice(),
                    self.dense.last(),
                    coarse,
                );
            }
        }
        completes
    }

    fn find_camera_time(&mut self, input: &TickInput<'_>) {
        if input.frame.is_some() {
            let up = self.config.t_base_camera.rotation.inverse() * Vector3::z();
            if let Some(mount) = self.coarse.mount() {
                self.watch.see_camera(&mount);
            }
            let yaw_error = self.coarse.take_yaw_error(&up);
            let motion = self.motion_now(input);
            let said = self.camera_time.observe(input.wheel.time_ns, &motion, yaw_error);
            // Without the correction of frames, image motion shows another error than is assumed.
            if let Some(said) = said.filter(|_| self.config.localization.estimate_camera_latency) {
                self.watch.see_latency(&said);
            }
        }
    }

    /// The motion at the time of the wheel feedback, by the gyroscope as long as it does not contradict the scans.
    fn motion_now(&self, input: &TickInput<'_>) -> Twist2 {
        let is_refused = self.gyroscope().is_some_and(|gyroscope| gyroscope.is_refused);
        if is_refused { input.wheel.twist } else { camera_time::motion_now(input) }
    }

    fn watch_calibration(&mut self, input: &TickInput<'_>, events: &mut Vec<Event>) {
        let found = self.watch.advance(&input.wheel.odom, input.wheel.time_ns);
        events.extend(found.map(|report| match report {
            Report::Changed(change) => Event::CalibrationChanged { change },
            Report::Withdrawn(withdrawal) => Event::CalibrationChangeWithdrawn { withdrawal },
        }));
    }

    /// What the robot finds of its own calibration while it drives.
    #[must_use]
    pub fn calibration(&self) -> &CalibrationWatch {
        &self.watch
    }

    /// Time from the exposure of a frame to its stamp as found so far, and its standard deviation, seconds.
    #[must_use]
    pub fn camera_latency_s(&self) -> (f64, f64) {
        (self.camera_time.latency_s(), self.camera_time.error_s())
    }

    /// Whether `truth` has the camera's size.
    fn copy_truth(&mut self, truth: &DepthMap) -> bool {
        if (truth.width(), truth.height()) != (self.config.camera.width, self.config.camera.height)
        {
            return false;
        }
        self.truth.depth.values_mut().copy_from_slice(truth.values());
        for (confidence, depth) in self.truth.confidence.iter_mut().zip(truth.values()) {
            *confidence = f32::from(u8::from(*depth > 0.0));
        }
        true
    }

    /// The depth of this tick that the map uses.
    #[must_use]
    pub fn mapped_depth(&self) -> Option<&DepthEstimate> {
        match self.config.depth_source {
            DepthSource::Coarse => self.coarse_depth(),
            DepthSource::Dense => self.has_depth.dense.then_some(&self.believed),
            DepthSource::Network if self.is_joined() => {
                self.has_depth.network.then_some(&self.believed)
            }
            DepthSource::Network => self.network_depth(),
            DepthSource::Truth => self.has_depth.truth.then_some(&self.truth),
        }
    }

    /// The depth of this tick that can be compared with the LiDAR: dense depth cannot, because it was made with the scan, and no depth
    /// that was joined with it.
    #[must_use]
    pub fn compared_depth(&self) -> Option<&DepthEstimate> {
        match self.config.depth_source {
            DepthSource::Dense => self.coarse_depth(),
            DepthSource::Network => {
                self.network.as_ref().filter(|_| self.has_depth.network).map(DepthNetwork::last)
            }
            DepthSource::Coarse | DepthSource::Truth => self.mapped_depth(),
        }
    }

    /// Whether the network's depth is joined with dense depth, which it was given.
    fn is_joined(&self) -> bool {
        self.network.as_ref().is_some_and(|network| network.spec().given == GivenDepth::Dense)
    }

    /// Coarse depth of this tick.
    #[must_use]
    pub fn coarse_depth(&self) -> Option<&DepthEstimate> {
        self.has_depth.coarse.then(|| self.coarse.last())
    }

    /// Dense depth of this tick.
    #[must_use]
    pub fn dense_depth(&self) -> Option<&DepthEstimate> {
        self.has_depth.dense.then(|| self.dense.last())
    }

    /// Whether this tick has depth to show.
    #[must_use]
    pub fn can_show_depth(&self) -> bool {
        self.has_depth.dense || self.mapped_depth().is_some()
    }

    /// The depth of this tick to show to a person: dense depth that is right with a probability of 50 % or more. With a network
    /// or ground truth in the map, and without dense depth, the depth that the map uses.
    #[must_use]
    pub fn shown_depth(&self) -> Option<DepthMap> {
        let shows_dense =
            matches!(self.config.depth_source, DepthSource::Coarse | DepthSource::Dense);
        match self.dense_depth().filter(|_| shows_dense) {
            Some(dense) => Some(dense.above(0.5)),
            None => self.mapped_depth().map(|estimate| estimate.depth.clone()),
        }
    }

    /// The network's depth of this tick; that of a network which is given dense depth is joined with it
    /// ([`DepthEstimate::join`]).
    #[must_use]
    pub fn network_depth(&self) -> Option<&DepthEstimate> {
        let network = self.network.as_ref().filter(|_| self.has_depth.network)?;
        Some(if self.is_joined() { &self.joined } else { network.last() })
    }

    fn update_map(&mut self, scan: Option<&LaserScan>, twist: &Twist2) {
        let t_map_base = self.poses.t_map_base();
        let t_map_camera = self.poses.t_map_base_at_frame().to_pose3() * self.config.t_base_camera;
        // Poses were checked in `refusal`, shapes in `tick`: an error here means that the map stays as it was in this tick.
        if self.map.begin_update(&t_map_base).is_err() {
            return;
        }
        let t_map_scan = self.poses.t_map_odom.compose(&self.poses.t_odom_base_at_scan);
        let t_map_laser = t_map_scan.compose(&self.config.t_base_laser);
        match scan {
            Some(scan) => self.surfaces.measure(scan, &t_map_laser, &self.poses.t_map_odom),
            None => self.surfaces.follow(&t_map_laser, &self.poses.t_map_odom),
        }
        let turned_deg = self.watch.camera_turned_rad().to_degrees();
        let trusts_camera = turned_deg <= self.config.map.camera_trust_deg;
        // The body of `mapped_depth`, repeated so that the borrow checker sees that `self.map` is not borrowed.
        let depth = match self.config.depth_source {
            DepthSource::Coarse => self.has_depth.coarse.then(|| self.coarse.last()),
            DepthSource::Dense => self.has_depth.dense.then_some(&self.believed),
            DepthSource::Network if self.is_joined() => {
                self.has_depth.network.then_some(&self.believed)
            }
            DepthSource::Network => {
                self.network.as_ref().filter(|_| self.has_depth.network).map(DepthNetwork::last)
            }
            DepthSource::Truth => self.has_depth.truth.then_some(&self.truth),
        };
        if let Some(depth) = depth.filter(|_| trusts_camera)
            && let Ok(newest) =
                self.map.integrate_depth(depth, &self.config.camera, &t_map_camera, &self.surfaces)
        {
            let gap = self.config.exploration.inconsistency_gap;
            remember_frame_map(&mut self.frame_maps, newest, gap);
        }
        if let Some(scan) = scan {
            let sweep = Sweep::new(&t_map_scan, &self.config.t_base_laser, twist);
            let _ = self.map.integrate_scan(scan, &sweep);
        }
        if let Some(place_m) = self.unseen_at.take() {
            let (facing, ahead_m) = facing(&t_map_base, place_m);
            let _ = self.map.mark_unseen(&facing, ahead_m);
        }
        if let Some(place_m) = self.collision_at.take() {
            let (facing, ahead_m) = facing(&t_map_base, place_m);
            let _ = self.map.mark_collision(&facing, ahead_m);
        }
        let _ = self.map.mark_standing(&t_map_base, self.config.footprint_radius_m);
        self.map.finish_update();
    }

    fn desired(&mut self, input: &TickInput<'_>, events: &mut Vec<Event>) -> Twist2 {
        let frames_missing =
            self.config.stop_without_frames.is_some_and(|ticks| self.ticks_without_frame >= ticks);
        if input.safety.in_charge || frames_missing {
            return Twist2::ZERO;
        }
        let [forward, yaw_rate] = self.speeds();
        if let Some(by_hand) = self.explorer.hand_velocity(input.time_ns) {
            return by_hand.within(forward, yaw_rate);
        }
        if self.tilt.is_tilted() {
            return Twist2::ZERO;
        }
        if self.whereabouts.lost().is_some() {
            // A person who has paused the robot may stand beside it.
            if self.explorer.stands() {
                return Twist2::ZERO;
            }
            let may_begin_map = self.may_begin_map();
            let motion = &mut self.lost_motion;
            let desired =
                motion.desired(&input.wheel, input.time_ns, yaw_rate, may_begin_map, events);
            if may_begin_map && self.lost_motion.is_over() && !self.location.is_doubtful() {
                self.begin_map(events);
            }
            return desired;
        }
        let newest_and_earlier = self.frame_maps.back().zip(self.frame_maps.front());
        let observations = Observations {
            tick: input.tick,
            time_ns: input.time_ns,
            pose: self.pose_when_the_command_acts(input),
            map: &self.map,
            frame_maps: newest_and_earlier.filter(|_| self.frame_maps.len() > 1),
            bumped: std::mem::take(&mut self.bumped),
        };
        match self.explorer.step(&observations, events) {
            Primitive::Forward => Twist2 { linear_mps: forward, angular_radps: 0.0 },
            Primitive::TurnLeft => Twist2 { linear_mps: 0.0, angular_radps: yaw_rate },
            Primitive::TurnRight => Twist2 { linear_mps: 0.0, angular_radps: -yaw_rate },
            Primitive::ArcLeft => Twist2 { linear_mps: forward / 2.0, angular_radps: yaw_rate },
            Primitive::ArcRight => Twist2 { linear_mps: forward / 2.0, angular_radps: -yaw_rate },
            Primitive::Stay => Twist2::ZERO,
        }
    }

    /// Standard deviations of the position, metres, and of the yaw, radians, against the scans of the last metres; the drift of the
    /// map over longer distances is not in them. `None` before the first scan.
    #[must_use]
    pub fn pose_std(&self) -> Option<[f64; 2]> {
        self.location.pose_std()
    }

    /// What was learnt of the gyroscope, if the robot has one; `None` before the first scan.
    #[must_use]
    pub fn gyroscope(&self) -> Option<Gyroscope> {
        self.location.gyroscope()
    }

    /// The highest speed, m/s, and the highest yaw rate, rad/s, that the robot desires.
    #[must_use]
    pub fn speeds(&self) -> [f64; 2] {
        [self.config.forward_step_m, self.config.rotation_step_rad]
            .map(|step| step / self.config.tick_s)
    }

    /// Returns the velocity, for the motion during the scan.
    fn localize(
        &mut self,
        input: &TickInput<'_>,
        scan: Option<&LaserScan>,
        events: &mut Vec<Event>,
    ) -> Twist2 {
        let before = self.poses.t_map_base();
        let corrected = self.outside.apply(input, events);
        // Areas are closed in the map in which the robot is, and mean nothing in another.
        self.location.stay_in_map(!self.explorer.keep_out().is_empty());
        let located = self.location.update(&self.wheel_frame.apply(&corrected), scan);
        self.poses = located.poses;
        // What another program's poses have corrected is not what the wheels say.
        let is_raw = corrected.wheel.odom == input.wheel.odom;
        if let Some(leg) = located.leg.filter(|_| is_raw) {
            self.watch.see_leg(&leg, &self.config.localization);
        }
        if let Some(scan) = scan {
            let matched = located.matched_scan.filter(|_| is_raw).map(|by_scans| MatchedScan {
                time_ns: scan.middle_ns(),
                by_wheels: input.scan_odom,
                by_scans,
                yaw_rate_radps: located.twist.angular_radps,
            });
            self.watch.see_scan(matched, &self.config.localization);
        }
        if self.config.localization.estimate_camera_latency {
            self.poses.t_odom_base_at_frame =
                self.camera_time.at_exposure(&self.poses.t_odom_base, &self.motion_now(input));
        }
        events.extend(located.wheel_error.map(|how| Event::WheelsContradicted { how }));
        events.extend(located.gyro_refused.then_some(Event::GyroscopeRefused));
        let was_lost = std::mem::replace(&mut self.whereabouts, located.whereabouts).lost();
        match (was_lost, located.whereabouts.lost()) {
            (None, Some(why)) => self.note_lost(why, events),
            (Some(_), None) => self.note_found(&before, events),
            _ => {}
        }
        if let Some(joined) = located.joined {
            self.join_maps(&joined, events);
        }
        if let Some(moved) = self.map_correction.update(&self.location, &mut self.map) {
            let before = self.poses.t_map_base();
            events.push(Event::MapCorrected { shift_m: moved.shift_m(&before) });
            let map = &self.map;
            self.explorer.move_places(|place_m| moved.place(map, place_m));
            for place_m in [&mut self.collision_at, &mut self.unseen_at].into_iter().flatten() {
                *place_m = moved.place(map, *place_m);
            }
            self.frame_maps.clear();
            self.dense.correct(moved.corrections());
        }
        self.poses.t_map_odom = self.map_correction.t_map_odom();
        located.twist
    }

    /// Until a new command acts, the robot goes on as it does now.
    fn pose_when_the_command_acts(&self, input: &TickInput<'_>) -> Pose2 {
        let age_s = input.time_ns.saturating_sub(input.wheel.time_ns) as f64 * 1e-9;
        let motion = input.wheel.twist.integrate(age_s + self.config.command_delay_s);
        let pose = self.poses.t_map_base().compose(&motion);
        if pose.is_finite() { pose } else { self.poses.t_map_base() }
    }

    /// The safety plane reports places in the frame of wheel odometry.
    fn note_blocked(&mut self, input: &TickInput<'_>) {
        let SafetyReport { blocked_m, unseen_m, .. } = input.safety;
        if (blocked_m.is_none() && unseen_m.is_none()) || self.whereabouts.lost().is_some() {
            return;
        }
        let t_map_wheels = self.poses.t_map_base().compose(&input.wheel.odom.inverse());
        let [blocked_at, unseen_at] = [blocked_m, unseen_m]
            .map(|place_m| place_m.map(|[x_m, y_m]| t_map_wheels.transform(x_m, y_m).into()));
        self.collision_at = blocked_at.or(self.collision_at);
        self.unseen_at = unseen_at.or(self.unseen_at);
        self.bumped = true;
    }

    /// The poses of the last tick.
    #[must_use]
    pub fn poses(&self) -> &TickPoses {
        &self.poses
    }

    /// The current map.
    #[must_use]
    pub fn map(&self) -> &OccupancyGrid {
        &self.map
    }

    /// The policy in its current state.
    #[must_use]
    pub fn explorer(&self) -> &Explorer {
        &self.explorer
    }

    /// Whether ground truth goes into the map ([`DepthSource::Truth`]).
    #[must_use]
    pub fn maps_truth(&self) -> bool {
        self.config.depth_source == DepthSource::Truth
    }

    /// The robot's configuration.
    #[must_use]
    pub fn config(&self) -> &RobotConfig {
        &self.config
    }
}

/// Checks the version. Returns it with the digest of the model and the bytes behind it.
fn begin_snapshot(snapshot: &[u8]) -> Result<(u32, Option<String>, &[u8]), SnapshotError> {
    let mut from = snapshot;
    let mut version = [0_u8; 4];
    version.iter_mut().try_for_each(|byte| byte.read(&mut from))?;
    let found = u32::from_le_bytes(version);
    if !(SNAPSHOT_WITHOUT_IMU..=SNAPSHOT_VERSION).contains(&found) {
        return Err(SnapshotError::Version { found });
    }
    let mut network = None;
    network.read(&mut from)?;
    Ok((found, network, from))
}

remembers!(
    Robot: coarse, dense, location, camera_time, watch, outside, wheel_frame, poses, whereabouts, lost_motion, map_correction, map, surfaces, frame_maps, explorer, bumped, collision_at, unseen_at, last_time_ns, ticks_without_frame, new_network
);

/// The pose at the robot's place that faces `place_m`, and the distance to it, metres.
fn facing(t_map_base: &Pose2, [x_m, y_m]: [f64; 2]) -> (Pose2, f64) {
    let yaw_rad = (y_m - t_map_base.y_m).atan2(x_m - t_map_base.x_m);
    let ahead_m = (x_m - t_map_base.x_m).hypot(y_m - t_map_base.y_m);
    (Pose2 { yaw_rad, ..*t_map_base }, ahead_m)
}

/// Keeps the newest map and those of the `gap` frames before it.
fn remember_frame_map(
    frame_maps: &mut VecDeque<SingleFrameMap>,
    newest: &SingleFrameMap,
    gap: usize,
) {
    let mut slot = if frame_maps.len() > gap {
        frame_maps.pop_front().unwrap_or_default()
    } else {
        SingleFrameMap::default()
    };
    slot.clone_from(newest);
    frame_maps.push_back(slot);
}

/// First 8 bytes of the BLAKE3 digest of depth and confidence, little-endian.
fn digest_of(estimate: &DepthEstimate) -> u64 {
    let mut hasher = blake3::Hasher::new();
    hasher.update(bytemuck::cast_slice(estimate.depth.values()));
    hasher.update(bytemuck::cast_slice(&estimate.confidence));
    let mut first = [0; 8];
    first.copy_from_slice(&hasher.finalize().as_bytes()[..8]);
    u64::from_le_bytes(first)
}
