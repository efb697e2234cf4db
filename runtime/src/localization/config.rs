//! Configuration of localization.

use hal::settings::OutOfRange;
use serde::{Deserialize, Serialize};

use super::LocalizationError;

/// What the pose is made from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PoseSource {
    /// Wheel odometry as the base reports it: for tests, and to measure what localization gains.
    Wheels,
    /// Wheels and scans.
    #[default]
    Scans,
}

hal::choices!(PoseSource: "wheels", "scans");

hal::settings! {
    /// Localization: where the robot is, from wheels and LiDAR.
    pub struct LocalizationConfig {
        /// What the pose is made from: the wheels alone, or wheels and scans.
        source: PoseSource = PoseSource::default();
        /// Find the time from the exposure of a frame to its stamp while driving, in addition to `devices.camera.latency_ms`.
        estimate_camera_latency: bool = true;
        /// Earlier scans that a new scan is matched against.
        keyframes: usize = 20, in 2..=60, unit "scans";
        /// A scan becomes a keyframe after the robot has driven this far since the last keyframe.
        keyframe_distance_m: f64 = 0.25, in 0.05..=2.0, unit "m";
        /// A scan becomes a keyframe after the robot has rotated this far since the last keyframe.
        keyframe_yaw_deg: f64 = 12.0, in 2.0..=45.0, unit "deg";
        /// Standard deviation of the wheels' distance after one metre, in metres; it grows with the square root of the distance.
        wheel_distance_noise: f64 = 0.02, in 0.0001..=0.5, source "1 % for a good base, doubled for carpets and sills";
        /// Standard deviation of the wheels' yaw in one increment of a radian, in radians. A radian in small increments has a third of it.
        wheel_yaw_noise: f64 = 0.04, in 0.0001..=0.5, source "2 % for a good base, doubled for carpets and sills";
        /// Standard deviation of the wheels' yaw in one increment of a metre (bumps, unequal wheels). A metre in small increments has a third of it.
        wheel_drift_rad_per_m: f64 = 0.02, in 0.0001..=0.5, unit "rad/m";
        /// Standard deviation of the angle that a gyroscope has measured after one second, beside its bias and scale, which are learnt.
        gyro_noise: f64 = 0.0005, in 0.000001..=0.1, unit "rad", source "four times a BMI160's 0.007 deg/s per root hertz, for vibrations";
        /// A robot that is lost, and has rotated twice without recognizing the place, begins another map and explores on; when it comes to
        /// a place of the map before, both become one. If not, it stands. It stands as well if a person has sent it to a place, when it
        /// returns to its start, and with areas to keep in or out of: these are places of the map before. It has four maps at most.
        new_map_when_lost: bool = true;
        /// A robot whose inertial unit measures a larger tilt stands and maps nothing until it is 3 degrees below it: it is on a ramp or
        /// an obstacle, or was lifted.
        most_tilt_deg: f64 = 10.0, in 8.0..=60.0, unit "deg", source "a wheelchair ramp has 5; thresholds tilt a small robot by less";
        /// Standard deviation of one range. The scanner's own figure is usually lower; walls and furniture are not quite flat.
        range_noise_m: f64 = 0.02, in 0.001..=0.2, unit "m", source "UTM-30LX data sheet: 10 to 30 mm";
        /// Ranges beyond this are not used: the gaps between their beams are too wide to know a surface by.
        range_limit_m: f64 = 25.0, in 2.0..=25.0, unit "m";
    }
}

impl LocalizationConfig {
    /// Checks every value.
    ///
    /// # Errors
    /// The first value that is not allowed.
    pub fn validate(&self) -> Result<(), LocalizationError> {
        Ok(self.check_ranges()?)
    }
}

impl From<OutOfRange> for LocalizationError {
    fn from(OutOfRange { key, value, allowed }: OutOfRange) -> Self {
        Self::Config { key, value, allowed }
    }
}
