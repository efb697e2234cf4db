//! A pose that another program sends: visual-inertial odometry, ORB-SLAM3, a motion capture.

use hal::Pose2;
use serde::{Deserialize, Serialize};

/// Where another program believes the robot to be. In JSON, one object as
/// `{"time_ns": 81250000000, "x_m": 1.25, "y_m": -0.4, "yaw_rad": 1.57}`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(from = "Flat", into = "Flat")]
pub struct OutsidePose {
    /// When the robot was there, by this computer's monotonic clock.
    pub time_ns: u64,
    /// Pose of `base_link` in a frame of the other program, which may be anywhere but does not move.
    pub pose: Pose2,
}

/// An outside pose, with what the wheels say about the same moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OutsideInput {
    pub outside: OutsidePose,
    /// Wheel odometry at the time of the pose.
    pub wheel_odom: Pose2,
}

/// The fields without nested objects, so that a sender is easy to write.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Flat {
    time_ns: u64,
    x_m: f64,
    y_m: f64,
    yaw_rad: f64,
}

impl From<Flat> for OutsidePose {
    fn from(Flat { time_ns, x_m, y_m, yaw_rad }: Flat) -> Self {
        Self { time_ns, pose: Pose2 { x_m, y_m, yaw_rad } }
    }
}

impl From<OutsidePose> for Flat {
    fn from(OutsidePose { time_ns, pose }: OutsidePose) -> Self {
        Self { time_ns, x_m: pose.x_m, y_m: pose.y_m, yaw_rad: pose.yaw_rad }
    }
}
