//! What the inertial measurement unit adds to the input of a tick.

mod history;

pub use history::ImuHistory;

/// Rotation and tilt of the robot as its inertial measurement unit measured them, with everything that is wrong with them: a
/// gyroscope's bias is in the angles.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuInput {
    /// Counts the interruptions of the samples. Angles before and after one cannot be compared.
    pub gaps: u32,
    /// Angle by which the robot has rotated since the last interruption, counter-clockwise, at the time of the wheel feedback. It is
    /// not wrapped.
    pub yaw_rad: f64,
    /// The same angle at the middle of the scan; that of the wheel feedback where there is no scan.
    pub yaw_at_scan_rad: f64,
    /// Angle between the robot's vertical axis and the mean specific force of the last half second; `None` for a gyroscope alone.
    pub tilt_rad: Option<f64>,
}

impl ImuInput {
    /// Whether all angles are finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        let tilt_rad = self.tilt_rad.unwrap_or_default();
        [self.yaw_rad, self.yaw_at_scan_rad, tilt_rad].iter().all(|angle| angle.is_finite())
    }
}
