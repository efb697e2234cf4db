//! A robot that is not the same any more after some distance: a sensor is hit, a wheel is exchanged.

use hal::Pose3;

use super::State;
use crate::odometry::WheelErrors;

/// How the robot is after it has driven some distance.
#[derive(Debug, Clone, PartialEq)]
pub struct Change {
    /// The distance, metres.
    pub after_m: f64,
    /// Pose of the camera in the base frame.
    pub t_base_camera: Pose3,
    /// Pose of the laser scanner in the base frame; must be level.
    pub t_base_laser: Pose3,
    pub wheels: WheelErrors,
    /// Replaces `RobotOptions::camera_late_s`.
    pub camera_late_s: f64,
    /// Replaces `RobotOptions::lidar_late_s`.
    pub lidar_late_s: f64,
    /// Replaces `RobotOptions::focal_scale`.
    pub focal_scale: f64,
}

impl State {
    /// Counts the driven distance, and changes the robot when it is reached.
    pub(super) fn change_after(&mut self, step_m: f64) {
        self.driven_m += step_m;
        let due = self.options.change.take_if(|change| self.driven_m >= change.after_m);
        let Some(change) = due else { return };
        self.latency_s += change.camera_late_s - self.options.camera_late_s;
        self.odometer.set_wheels(change.wheels);
        self.options.t_base_camera = change.t_base_camera;
        self.options.t_base_laser = change.t_base_laser;
        self.options.camera_late_s = change.camera_late_s;
        self.options.lidar_late_s = change.lidar_late_s;
        self.options.focal_scale = change.focal_scale;
    }
}
