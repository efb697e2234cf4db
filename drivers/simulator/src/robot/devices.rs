//! Devices that implement the hal traits, and the ground-truth handle for evaluation.

use std::convert::Infallible;
use std::fmt;
use std::sync::{Arc, Mutex};

use hal::{
    Base, Camera, CameraModel, Clock, DepthMap, DriveCommand, ErrorKind, ErrorType, Frame,
    LaserScan, Lidar, Pose2, Range, ScanGeometry, Twist2, WheelFeedback,
};
use rand_pcg::Pcg64Mcg;

use super::{State, lock};
use crate::floor::FloorPlan;
use crate::laser::LaserModel;

type Shared = Arc<Mutex<State>>;

/// Error of a drive command that is not finite. The base stops.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DriveRefused {
    pub twist: Twist2,
}

impl fmt::Display for DriveRefused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Twist2 { linear_mps, angular_radps } = self.twist;
        write!(f, "refused to drive {linear_mps} m/s, {angular_radps} rad/s: both must be finite")
    }
}

impl std::error::Error for DriveRefused {}

impl hal::Error for DriveRefused {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Rejected
    }
}

/// The camera: renders a frame when it is polled at a new time.
pub struct SimCamera {
    shared: Shared,
    model: CameraModel,
}

impl SimCamera {
    pub(super) fn new(shared: Shared, model: CameraModel) -> Self {
        Self { shared, model }
    }
}

impl ErrorType for SimCamera {
    type Error = Infallible;
}

impl Camera for SimCamera {
    fn model(&self) -> &CameraModel {
        &self.model
    }

    fn poll_frame(&mut self, frame: &mut Frame) -> Result<bool, Infallible> {
        let mut state = lock(&self.shared);
        let now_ns = state.now_ns;
        if state.frame_ns.replace(now_ns) == Some(now_ns) {
            return Ok(false);
        }
        state.take_frame(frame);
        Ok(true)
    }
}

/// The laser scanner. It rotates all the time; a poll casts the beams of the last complete scan, while the robot's other
/// devices continue.
pub struct SimLidar {
    shared: Shared,
    model: LaserModel,
    rng: Pcg64Mcg,
    /// Number of the last scan that was returned.
    returned: Option<u64>,
}

impl SimLidar {
    pub(super) fn new(shared: Shared, model: LaserModel, rng: Pcg64Mcg) -> Self {
        Self { shared, model, rng, returned: None }
    }

    /// Takes the scan of the revolution that began at `begin_ns`, within the last second. A scanner that is simulated with its
    /// wire protocol has revolutions of its own. People and animals stand still during it.
    pub fn scan_from(&mut self, begin_ns: u64, scan: &mut LaserScan) {
        let period_ns = self.model.geometry.period_ns;
        let motion = lock(&self.shared).motion_of_scan(begin_ns + period_ns, period_ns);
        motion.scan(&self.model, &mut self.rng, scan);
    }

    /// Measures one beam at its true time `time_ns`, within the last second, in a direction counter-clockwise from the x axis of
    /// the `laser` frame, radians.
    pub fn beam(&mut self, time_ns: u64, angle_rad: f64) -> Range {
        let view = lock(&self.shared).view_of_beam(time_ns);
        view.measure(angle_rad, &self.model, &mut self.rng)
    }
}

impl ErrorType for SimLidar {
    type Error = Infallible;
}

impl Lidar for SimLidar {
    fn geometry(&self) -> ScanGeometry {
        self.model.geometry
    }

    fn poll_scan(&mut self, scan: &mut LaserScan) -> Result<bool, Infallible> {
        let period_ns = self.model.geometry.period_ns.max(1);
        let motion = {
            let state = lock(&self.shared);
            let newest = state.now_ns / period_ns;
            if self.returned.replace(newest) == Some(newest) {
                return Ok(false);
            }
            state.motion_of_scan(newest * period_ns, period_ns)
        };
        // Not under the lock: the motors must not wait for the beams.
        motion.scan(&self.model, &mut self.rng, scan);
        Ok(true)
    }
}

/// The differential-drive base of the simulated robot.
pub struct SimBase {
    shared: Shared,
}

impl SimBase {
    pub(super) fn new(shared: Shared) -> Self {
        Self { shared }
    }
}

impl ErrorType for SimBase {
    type Error = DriveRefused;
}

impl Base for SimBase {
    fn drive(&mut self, command: &DriveCommand) -> Result<(), DriveRefused> {
        let mut state = lock(&self.shared);
        // A repeated command counter must not reset the watchdog: the sender may have stopped.
        let is_new = state.last_counter.replace(command.counter) != Some(command.counter);
        if !command.twist.is_finite() {
            state.command = Twist2::ZERO;
            return Err(DriveRefused { twist: command.twist });
        }
        if is_new {
            state.command = command.twist;
            state.commanded_ns = state.now_ns;
        }
        Ok(())
    }

    fn stop(&mut self) -> Result<(), DriveRefused> {
        lock(&self.shared).command = Twist2::ZERO;
        Ok(())
    }

    fn poll_feedback(&mut self) -> Result<Option<WheelFeedback>, DriveRefused> {
        let mut state = lock(&self.shared);
        let now_ns = state.now_ns;
        let fresh = state.feedback_ns.replace(now_ns) != Some(now_ns);
        Ok(fresh.then(|| state.feedback()))
    }
}

/// The virtual clock. The robot drives while the clock sleeps.
pub struct SimClock {
    shared: Shared,
}

impl SimClock {
    pub(super) fn new(shared: Shared) -> Self {
        Self { shared }
    }
}

impl Clock for SimClock {
    fn now_ns(&self) -> u64 {
        lock(&self.shared).now_ns
    }

    fn sleep_until_ns(&mut self, deadline_ns: u64) {
        lock(&self.shared).run_until(deadline_ns);
    }
}

/// Ground truth for evaluation. It is not reachable through the hal traits.
pub struct Truth {
    shared: Shared,
}

impl Truth {
    pub(super) fn new(shared: Shared) -> Self {
        Self { shared }
    }

    /// True pose of the base, `t_world_base`.
    #[must_use]
    pub fn pose(&self) -> Pose2 {
        lock(&self.shared).pose
    }

    /// True pose of the base at a time of the last second.
    #[must_use]
    pub fn pose_at(&self, time_ns: u64) -> Pose2 {
        lock(&self.shared).trail.at(time_ns as i64)
    }

    /// Pose of the odometry frame in the world at the current time. It moves as odometry drifts;
    /// without noise it is the start pose.
    #[must_use]
    pub fn t_world_odom(&self) -> Pose2 {
        let state = lock(&self.shared);
        state.pose.compose(&state.odometer.pose().inverse())
    }

    /// Free space around the robot.
    #[must_use]
    pub fn floor_plan(&self) -> Arc<FloorPlan> {
        lock(&self.shared).plan.clone()
    }

    /// Whether the last step ended at an obstacle.
    #[must_use]
    pub fn contact(&self) -> bool {
        lock(&self.shared).contact
    }

    /// Whether a motion was blocked since the last call.
    pub fn take_contact(&self) -> bool {
        std::mem::take(&mut lock(&self.shared).touched_in_truth)
    }

    /// Whether a wheel left the floor, at an edge or a stairwell. The robot does not move any more.
    #[must_use]
    pub fn fell(&self) -> bool {
        lock(&self.shared).fell
    }

    /// Distance from the robot's footprint to the nearest edge over which it can fall, if that is
    /// less than `limit_m`; metres.
    #[must_use]
    pub fn drop_distance_m(&self, limit_m: f64) -> Option<f64> {
        let state = lock(&self.shared);
        let radius_m = state.plan.footprint().radius_m;
        let pose = state.pose;
        let from_center_m = state.plan.drop_distance_m(pose.x_m, pose.y_m, limit_m + radius_m)?;
        Some((from_center_m - radius_m).max(0.0))
    }

    /// Copies the z-depth of the last frame.
    pub fn depth(&self, into: &mut DepthMap) {
        into.clone_from(&lock(&self.shared).depth);
    }
}
