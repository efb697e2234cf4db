//! A robot in a simulated home: implements the hal traits with rendered frames, ray-cast scans and
//! simulated wheels, in virtual time.

mod change;
mod devices;
mod drive;
mod imu;
mod inhabitants;
#[cfg(test)]
mod tests;
mod trail;
mod unevenness;

use std::f64::consts::FRAC_PI_4;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use hal::{
    CameraModel, DepthMap, Distortion, Frame, LaserScan, Pose2, Pose3, Range, RobotDescription,
    ScanGeometry, Twist2, WheelFeedback, wrap_angle,
};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use crate::body::Capsule;
use crate::error::SceneError;
use crate::floor::FloorPlan;
use crate::laser::{self, LaserModel};
use crate::nuisance::Nuisances;
use crate::odometry::{Odometer, OdometryNoise};
use crate::world::World;
use inhabitants::Inhabitants;
use trail::Trail;
use unevenness::Unevenness;

pub use change::Change;
pub use devices::{DriveRefused, SimBase, SimCamera, SimClock, SimLidar, Truth};
pub use imu::{ImuNoise, SimImu};

/// Random streams of a run. They are separate so that changing one option does not change the
/// numbers drawn for another.
const LASER_STREAM: u64 = 0x6c61_7365;
const IMU_STREAM: u64 = 0x0069_6d75;
const CAMERA_STREAM: u64 = 0x6361_6d65;
const WHEEL_STREAM: u64 = 0x7768_6565;
const PEOPLE_STREAM: u64 = 0x7065_6f70;
const PETS_STREAM: u64 = 0x7065_7473;
const LATENCY_STREAM: u64 = 0x6c61_7465;
/// Mean latency of a USB camera that stamps frames when their transfer begins: exposure and readout
/// of a frame at 30 Hz, on average.
pub const CAMERA_LATENCY_S: f64 = 0.02;
/// Root mean square slope of a finished floor, degrees. DIN 18202, table 3, line 3 allows 4 mm under
/// a straight edge of 1 m.
pub const FLOOR_TILT_DEG: f64 = 0.2;
/// Largest latency of camera and scanner, and largest readout of a camera, seconds.
const LATEST_S: f64 = 0.3;
/// The same in words, for time stamps that may be early as well.
const LATE_ALLOWED: &str = "from -0.3 to 0.3 s";
/// Largest slope of a floor, radians.
const STEEPEST_FLOOR_RAD: f64 = 0.1;
/// Directions of the cliff sensors from the centre of the base, at the edge of its footprint, radians.
const CLIFF_SENSORS_RAD: [f64; 3] = [-FRAC_PI_4, 0.0, FRAC_PI_4];
/// Number of rendered images that are averaged into one motion-blurred frame.
const BLUR_IMAGES: usize = 4;

/// Options of the simulated robot. The defaults are those of "Embodied Depth Prediction", section
/// IV: a 640x192 camera of 90 degrees, 0.8 m high.
#[derive(Debug, Clone, PartialEq)]
pub struct RobotOptions {
    pub camera: CameraModel,
    /// Pose of the camera in the base frame.
    pub t_base_camera: Pose3,
    /// Pose of the laser scanner in the base frame; must be level.
    pub t_base_laser: Pose3,
    /// Whether the robot slides along obstacles (as Habitat does by default) or stops at them.
    pub sliding: bool,
    pub odometry: OdometryNoise,
    pub laser: LaserModel,
    pub imu: ImuNoise,
    /// Disturbances of the camera image, people and pets.
    pub nuisances: Nuisances,
    /// Mean time from the exposure of a frame to its time stamp, seconds. The latency of one robot is
    /// drawn by the seed, from half of this to one and a half times this, and stays so.
    pub camera_latency_s: f64,
    /// What the camera's latency is more than the drawn one, seconds. With a negative sum, time stamps are early.
    pub camera_late_s: f64,
    /// Time by which the time stamps of scans are late, seconds; a negative one if they are early.
    pub lidar_late_s: f64,
    /// A change of the robot during the run, if there is one.
    pub change: Option<Change>,
    /// True focal length over that of `camera`.
    pub focal_scale: f64,
    /// Time from the first row of a frame to its last, seconds; 0 for a global shutter.
    pub rolling_shutter_s: f64,
    /// Root mean square of the floor's slope, which tilts the robot, radians; 0 for a flat floor.
    pub floor_tilt_rad: f64,
    /// Whether the base has cliff sensors at its front edge.
    pub cliff_sensors: bool,
    pub seed: u64,
    /// Start pose; `None` selects a free pose by the seed.
    pub start: Option<Pose2>,
    /// The base stops when no new command arrives for this time.
    pub watchdog_ns: u64,
}

impl Default for RobotOptions {
    fn default() -> Self {
        let robot = RobotDescription::default();
        Self {
            camera: CameraModel::pinhole(640, 192, std::f64::consts::FRAC_PI_2),
            t_base_camera: robot.camera.t_base_camera(),
            t_base_laser: robot.lidar.t_base_laser_3d(),
            sliding: false,
            odometry: OdometryNoise::default(),
            laser: LaserModel::UTM_30LX,
            imu: ImuNoise::BMI160,
            nuisances: Nuisances::default(),
            camera_latency_s: CAMERA_LATENCY_S,
            camera_late_s: 0.0,
            lidar_late_s: 0.0,
            change: None,
            focal_scale: 1.0,
            rolling_shutter_s: 0.0,
            floor_tilt_rad: FLOOR_TILT_DEG.to_radians(),
            cliff_sensors: false,
            seed: 0,
            start: None,
            watchdog_ns: 200_000_000,
        }
    }
}

impl RobotOptions {
    fn check(&self) -> Result<(), SceneError> {
        self.nuisances.check()?;
        self.odometry.check()?;
        self.imu.check()?;
        if !self.camera.is_sound() || self.camera.distortion != Distortion::None {
            let allowed = "a pinhole without distortion, of positive size and focal length";
            return refuse("camera model", format!("{:?}", self.camera), allowed);
        }
        let mounts = [("camera mount", &self.t_base_camera), ("laser mount", &self.t_base_laser)];
        for (option, mount) in mounts {
            if !mount
                .translation
                .vector
                .iter()
                .chain(mount.rotation.coords.iter())
                .all(|c| c.is_finite())
            {
                return refuse(option, mount.to_string(), "finite");
            }
        }
        let limits = [
            ("camera latency", self.camera_latency_s, LATEST_S, "from 0 to 0.3 s"),
            ("lateness of the camera", self.camera_late_s.abs(), LATEST_S, LATE_ALLOWED),
            ("lateness of the scanner", self.lidar_late_s.abs(), LATEST_S, LATE_ALLOWED),
            ("focal length", (self.focal_scale - 1.0).abs(), 0.5, "from 0.5 to 1.5 of the model's"),
            ("rolling shutter", self.rolling_shutter_s, LATEST_S, "from 0 to 0.3 s"),
            ("floor tilt", self.floor_tilt_rad, STEEPEST_FLOOR_RAD, "from 0 to 0.1 rad"),
        ];
        for (option, value, max, allowed) in limits {
            if !(0.0..=max).contains(&value) {
                return refuse(option, value.to_string(), allowed);
            }
        }
        if self.watchdog_ns == 0 {
            return refuse("watchdog", "0 ns".into(), "longer than the time between two commands");
        }
        match self.start.filter(|start| !start.is_finite()) {
            Some(start) => refuse("start pose", format!("{start:?}"), "finite"),
            None => Ok(()),
        }
    }
}

fn refuse(option: &'static str, value: String, allowed: &'static str) -> Result<(), SceneError> {
    Err(SceneError::Option { option, value, allowed })
}

/// A robot in a simulated home. Pass its [`devices`](Self::devices) to the software under test; the
/// robot moves while the clock sleeps.
#[derive(Clone)]
pub struct SimulatedRobot {
    shared: Arc<Mutex<State>>,
}

/// One device for each hal trait, and one handle for evaluation.
pub struct Devices {
    pub camera: SimCamera,
    pub lidar: SimLidar,
    pub base: SimBase,
    pub imu: SimImu,
    /// Virtual time; advancing it moves the robot.
    pub clock: SimClock,
    /// Ground truth for evaluation only.
    pub truth: Truth,
}

pub(crate) struct State {
    world: Arc<World>,
    /// The world's floor plan, or the component of it around the start pose.
    plan: Arc<FloorPlan>,
    options: RobotOptions,
    now_ns: u64,
    pose: Pose2,
    trail: Trail,
    floor: Unevenness,
    /// Time from the middle of an exposure to the frame's time stamp.
    latency_s: f64,
    odometer: Odometer,
    /// Angle by which the robot was rotated while it was carried, which the gyroscope has not measured yet, radians.
    carried_rad: f64,
    /// Distance that was driven, metres.
    driven_m: f64,
    twist: Twist2,
    command: Twist2,
    commanded_ns: u64,
    /// Whether a wheel left the floor. The robot never moves again.
    fell: bool,
    /// Whether the robot touched an obstacle during the last step.
    contact: bool,
    /// Whether the robot touched an obstacle since the last feedback.
    touched: bool,
    /// Whether the robot touched an obstacle since the evaluation last asked.
    touched_in_truth: bool,
    last_counter: Option<u32>,
    inhabitants: Inhabitants,
    camera_rng: Pcg64Mcg,
    frame_ns: Option<u64>,
    feedback_ns: Option<u64>,
    sequence: u32,
    depth: DepthMap,
}

impl SimulatedRobot {
    /// Places a robot in a home.
    ///
    /// # Errors
    /// Returns [`SceneError::StartBlocked`] when the robot does not fit at the start pose, and an
    /// error when an option or a nuisance is out of range.
    pub fn new(world: Arc<World>, options: RobotOptions) -> Result<Self, SceneError> {
        options.check()?;
        let (start, plan) = place(&world, &options)?;
        let inhabitants = Inhabitants::new(&plan, &options.nuisances, options.seed);
        let state = State {
            now_ns: 0,
            pose: start,
            trail: Trail::new(0, start),
            floor: Unevenness::new(options.floor_tilt_rad),
            latency_s: options.camera_latency_s
                * stream_rng(LATENCY_STREAM, options.seed).random_range(0.5..1.5)
                + options.camera_late_s,
            odometer: Odometer::new(options.odometry, options.seed ^ (WHEEL_STREAM << 16)),
            carried_rad: 0.0,
            driven_m: 0.0,
            twist: Twist2::ZERO,
            command: Twist2::ZERO,
            commanded_ns: 0,
            fell: false,
            contact: false,
            touched: false,
            touched_in_truth: false,
            last_counter: None,
            inhabitants,
            camera_rng: stream_rng(CAMERA_STREAM, options.seed),
            frame_ns: None,
            feedback_ns: None,
            sequence: 0,
            depth: DepthMap::none(options.camera.width, options.camera.height),
            world,
            plan,
            options,
        };
        Ok(Self { shared: Arc::new(Mutex::new(state)) })
    }

    /// Lifts the robot and puts it down at `pose` in the world, whatever stands there. Its wheels do not notice.
    pub fn carry_to(&self, pose: Pose2) {
        let mut state = lock(&self.shared);
        let now_ns = state.now_ns;
        state.carried_rad += wrap_angle(pose.yaw_rad - state.pose.yaw_rad);
        state.pose = pose;
        state.trail = Trail::new(now_ns, pose);
    }

    /// Pushes the robot by `motion` in its own frame, where it still fits; returns whether it did. Its wheels do not notice.
    pub fn push_by(&self, motion: &Pose2) -> bool {
        let mut state = lock(&self.shared);
        let pose = state.pose.compose(motion);
        if !pose.is_finite() || !state.plan.fits(pose.x_m, pose.y_m, &[]) {
            return false;
        }
        state.pose = pose;
        state.trail.move_end(pose);
        true
    }

    /// Device handles that share this robot. The noise of each scanner begins with the robot's seed.
    #[must_use]
    pub fn devices(&self) -> Devices {
        let RobotOptions { camera, laser, imu, seed, .. } = lock(&self.shared).options.clone();
        Devices {
            camera: SimCamera::new(self.shared.clone(), camera),
            lidar: SimLidar::new(self.shared.clone(), laser, stream_rng(LASER_STREAM, seed)),
            base: SimBase::new(self.shared.clone()),
            imu: SimImu::new(self.shared.clone(), imu, stream_rng(IMU_STREAM, seed)),
            clock: SimClock::new(self.shared.clone()),
            truth: Truth::new(self.shared.clone()),
        }
    }
}

fn stream_rng(stream: u64, seed: u64) -> Pcg64Mcg {
    Pcg64Mcg::seed_from_u64(seed ^ (stream << 16))
}

/// Locks the state. A poisoned lock is used anyway: a panic in another thread does not invalidate
/// the robot's state.
pub(crate) fn lock(shared: &Mutex<State>) -> MutexGuard<'_, State> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

impl State {
    fn take_frame(&mut self, frame: &mut Frame) {
        let exposed_s = self.now_ns as f64 * 1e-9 - self.latency_s.max(0.0);
        let exposed_ns = (exposed_s.max(0.0) * 1e9) as u64;
        let bodies = self.inhabitants.bodies(exposed_ns);
        let nuisances = &self.options.nuisances;
        let light = nuisances.lighting(exposed_ns);
        let camera = &self.true_camera();
        let readout_s = self.options.rolling_shutter_s;
        let at = |passed: f64, above: f64| {
            let after_s = (passed - 0.5) * nuisances.shutter_s + (above - 0.5) * readout_s;
            let time_ns = ((exposed_s + after_s) * 1e9).round() as i64;
            self.floor.raise(&self.trail.at(time_ns)) * self.options.t_base_camera
        };
        let renderer = self.world.renderer();
        let rgb = &mut frame.data;
        if nuisances.shutter_s > 0.0 && self.trail.moved() {
            renderer.render_blurred(camera, at, BLUR_IMAGES, &bodies, &light, rgb, &mut self.depth);
        } else {
            renderer.render_rows(
                camera,
                |above| at(0.5, above),
                &bodies,
                &light,
                rgb,
                &mut self.depth,
            );
        }
        nuisances.add_sensor_noise(&mut self.camera_rng, rgb);
        frame.time_ns = self.now_ns.saturating_sub(early_ns(self.latency_s));
        frame.sequence = self.sequence;
        frame.width = camera.width;
        frame.height = camera.height;
        frame.format = hal::PixelFormat::Rgb8;
        self.sequence = self.sequence.wrapping_add(1);
    }

    /// The camera with its true focal length.
    fn true_camera(&self) -> CameraModel {
        let camera = self.options.camera;
        let scale = self.options.focal_scale;
        CameraModel { fx: camera.fx * scale, fy: camera.fy * scale, ..camera }
    }

    /// What moved during the scan that ended at `end_ns` by its time stamp, or, if time stamps are early, in truth.
    fn motion_of_scan(&self, end_ns: u64, period_ns: u64) -> ScanMotion {
        let late_s = self.options.lidar_late_s;
        let late_ns = (late_s.max(0.0) * 1e9) as u64;
        ScanMotion {
            late_ns: (late_s * 1e9) as i64,
            world: Arc::clone(&self.world),
            bodies: self.inhabitants.bodies(end_ns.saturating_sub(period_ns / 2 + late_ns)),
            trail: self.trail.clone(),
            floor: self.floor,
            t_base_laser: self.options.t_base_laser,
            start_ns: end_ns as i64 - period_ns as i64 - early_ns(late_s) as i64,
        }
    }

    fn view_of_beam(&self, time_ns: u64) -> BeamView {
        let t_world_base = self.floor.raise(&self.trail.at(time_ns as i64));
        BeamView {
            world: Arc::clone(&self.world),
            bodies: self.inhabitants.bodies(time_ns),
            t_world_laser: t_world_base * self.options.t_base_laser,
        }
    }

    fn feedback(&mut self) -> WheelFeedback {
        let contact = std::mem::take(&mut self.touched);
        WheelFeedback {
            time_ns: self.now_ns,
            odom: self.odometer.pose(),
            twist: self.twist,
            contact,
            cliff: self.options.cliff_sensors && self.is_before_cliff(),
        }
    }

    /// Whether one of the cliff sensors sees no floor. A wall is none, because nothing can fall there.
    fn is_before_cliff(&self) -> bool {
        let radius_m = self.plan.footprint().radius_m;
        CLIFF_SENSORS_RAD.iter().any(|bearing_rad| {
            let (sin, cos) = bearing_rad.sin_cos();
            let (x_m, y_m) = self.pose.transform(radius_m * cos, radius_m * sin);
            !self.plan.is_supported(x_m, y_m) && !self.plan.is_blocked(x_m, y_m)
        })
    }
}

/// The time by which a time stamp is before what it belongs to.
fn early_ns(late_s: f64) -> u64 {
    ((-late_s).max(0.0) * 1e9) as u64
}

/// The world around the scanner while it measures one beam.
struct BeamView {
    world: Arc<World>,
    bodies: Vec<Capsule>,
    t_world_laser: Pose3,
}

impl BeamView {
    fn measure(&self, angle_rad: f64, model: &LaserModel, rng: &mut Pcg64Mcg) -> Range {
        let renderer = self.world.renderer();
        laser::beam(renderer, &self.t_world_laser, angle_rad, &self.bodies, model, rng)
    }
}

/// The world around the scanner during one scan.
struct ScanMotion {
    world: Arc<World>,
    bodies: Vec<Capsule>,
    trail: Trail,
    floor: Unevenness,
    t_base_laser: Pose3,
    /// Start of the scan by its time stamp. The first one may have begun before time 0.
    start_ns: i64,
    /// Time by which the time stamp is late; negative if it is early.
    late_ns: i64,
}

impl ScanMotion {
    fn scan(&self, model: &LaserModel, rng: &mut Pcg64Mcg, scan: &mut LaserScan) {
        laser::scan(
            self.world.renderer(),
            |beam| self.t_world_laser(beam, &model.geometry),
            &self.bodies,
            model,
            rng,
            // A scan that began before time 0 gets the time 0.
            u64::try_from(self.start_ns).unwrap_or(0),
            scan,
        );
    }

    fn t_world_laser(&self, beam: usize, geometry: &ScanGeometry) -> Pose3 {
        let after_ns = laser::beam_after_ns(geometry, beam) as i64;
        let time_ns = self.start_ns + after_ns - self.late_ns;
        self.floor.raise(&self.trail.at(time_ns)) * self.t_base_laser
    }
}

/// The start pose, and the free space around it.
fn place(world: &World, options: &RobotOptions) -> Result<(Pose2, Arc<FloorPlan>), SceneError> {
    let whole = world.floor_plan();
    let Some(requested) = options.start else {
        return Ok((whole.start_pose(options.seed), whole.clone()));
    };
    let x_m = requested.x_m;
    let y_m = requested.y_m;
    let around = whole.around(x_m, y_m).filter(|plan| plan.fits(x_m, y_m, &[]));
    match around {
        Some(plan) => Ok((requested, Arc::new(plan))),
        None => {
            let [nearest_x_m, nearest_y_m] = whole.nearest_free(x_m, y_m);
            Err(SceneError::StartBlocked { x_m, y_m, nearest_x_m, nearest_y_m })
        }
    }
}
