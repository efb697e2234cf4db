//! What a robot is like.

use hal::{CameraModel, Pose2, Pose3, camera_mount};

use crate::error::SceneError;
use crate::laser::LaserModel;
use crate::nuisance::Nuisances;
use crate::odometry::OdometryNoise;

/// A robot and where it starts. The footprint is the world's: [`OpenOptions::footprint`](crate::world::OpenOptions::footprint).
#[derive(Debug, Clone, PartialEq)]
pub struct RobotOptions {
    /// Intrinsics; a pinhole. Default: 640 x 192, 90 degrees wide.
    pub camera: CameraModel,
    /// The camera's place on the robot. Default: level, 0.8 m high, above the axle.
    pub t_base_camera: Pose3,
    /// Height of the scanner's plane, metres. Default 0.18.
    pub laser_height_m: f64,
    /// How the scanner measures.
    pub laser: LaserModel,
    /// Whether the robot slides along what it meets. Default: it stops.
    pub sliding: bool,
    /// What is wrong with the wheels.
    pub odometry: OdometryNoise,
    /// What is wrong with the pictures, and who walks about.
    pub nuisances: Nuisances,
    /// The base stops by itself this long after the last new command. Default 200 ms.
    pub watchdog_ns: u64,
    /// Chooses the start, and all noise.
    pub seed: u64,
    /// Where the robot starts in the world; `None`: at an open place.
    pub start: Option<Pose2>,
}

impl Default for RobotOptions {
    fn default() -> Self {
        Self {
            camera: CameraModel::pinhole(640, 192, std::f64::consts::FRAC_PI_2),
            t_base_camera: camera_mount(0.0, 0.8, 0.0),
            laser_height_m: 0.18,
            laser: LaserModel::UTM_30LX,
            sliding: false,
            odometry: OdometryNoise::default(),
            nuisances: Nuisances::default(),
            watchdog_ns: 200_000_000,
            seed: 0,
            start: None,
        }
    }
}

impl RobotOptions {
    /// Checks every field.
    ///
    /// # Errors
    /// For the first that is outside its range.
    pub fn check(&self) -> Result<(), SceneError> {
        let refuse = |option, value: String, allowed| Err(SceneError::Option { option, value, allowed });
        if !self.camera.is_sound() || self.camera.distortion != hal::Distortion::None {
            return refuse(
                "camera model",
                format!("{:?}", self.camera),
                "a pinhole with positive size and focal lengths",
            );
        }
        let mount = self.t_base_camera;
        if !mount.translation.vector.iter().chain(mount.rotation.coords.iter()).all(|c| c.is_finite()) {
            return refuse("camera mount", format!("{mount:?}"), "finite");
        }
        if !(0.02..=2.0).contains(&self.laser_height_m) {
            return refuse("laser height", self.laser_height_m.to_string(), "from 0.02 to 2 m");
        }
        let beams = &self.laser.geometry;
        if beams.beams == 0 || beams.beams > 100_000 || beams.angle_increment_rad.is_nan() {
            return refuse("laser beams", beams.beams.to_string(), "from 1 to 100000");
        }
        if !(1_000_000..=10_000_000_000).contains(&self.watchdog_ns) {
            return refuse("watchdog", format!("{} ns", self.watchdog_ns), "from 1 ms to 10 s");
        }
        if let Some(start) = self.start.filter(|start| !start.is_finite()) {
            return refuse("start pose", format!("{start:?}"), "finite");
        }
        self.odometry.check()?;
        self.nuisances.check()?;
        Ok(())
    }
}
