//! A short stretch of the drive as the wheels and as the scans report it.

use hal::Pose2;
use serde::{Deserialize, Serialize};

/// How uncertain a pose is by its scan alone; infinite where the scan says nothing, as along a corridor.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ScanVariances {
    /// Of the yaw, rad^2.
    pub yaw_rad2: f64,
    /// Of the position along the robot's heading, m^2.
    pub forward_m2: f64,
    /// Of the position across the robot's heading, m^2.
    pub left_m2: f64,
}

impl ScanVariances {
    pub(super) fn plus(&self, other: &Self) -> Self {
        Self {
            yaw_rad2: self.yaw_rad2 + other.yaw_rad2,
            forward_m2: self.forward_m2 + other.forward_m2,
            left_m2: self.left_m2 + other.left_m2,
        }
    }
}

/// A stretch of 0.3 m or 0.3 rad. Both motions are the end in the frame of the beginning.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DrivenLeg {
    /// Sum of the reported increments, metres; negative backwards.
    pub distance_m: f64,
    /// Sum of the reported rotations, radians.
    pub yaw_rad: f64,
    /// The motion that the wheels reported.
    pub by_wheels: Pose2,
    /// The motion by the matched scans, with the scanner where it is configured.
    pub by_scans: Pose2,
    /// Variances of `by_scans`.
    pub variances: ScanVariances,
}
