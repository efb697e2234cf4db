//! The section `[simulator]`.

use simulator::laser::LaserModel;
use simulator::nuisance::Nuisances;
use simulator::odometry::OdometryNoise;
use simulator::robot::{CAMERA_LATENCY_S, FLOOR_TILT_DEG};

use super::odometry::Odometry;

hal::settings! {
    /// The simulated robot.
    pub struct SimulatorSection {
        /// Whether the robot slides along an obstacle that it touches (the default of Habitat) or stops there.
        sliding: bool = false;
        /// Whether wheel odometry has the errors below, or none, as no real robot does. `explore --odometry` overrides it.
        odometry: Odometry;
        /// Standard deviation of the measured distance after one metre, as a fraction of it.
        odometry_distance_noise: f64 = OdometryNoise::ORDINARY.translation, in 0.0..=0.2;
        /// Standard deviation of a measured rotation of one radian, as a fraction of it.
        odometry_turn_noise: f64 = OdometryNoise::ORDINARY.rotation, in 0.0..=0.2;
        /// Standard deviation of the measured heading after one metre, in radians. It grows with the square root of the distance.
        odometry_heading_drift: f64 = OdometryNoise::ORDINARY.heading_drift_rad, in 0.0..=0.2;
        /// Standard deviation of a heading error in radians for each metre that stays the same during a run.
        odometry_heading_bias: f64 = OdometryNoise::ORDINARY.heading_bias_rad_per_m, in 0.0..=0.5,
            source "Intel Research Lab -0.065, Freiburg 079 -0.019";
        /// Largest relative error of the configured wheel radius, drawn by the seed.
        odometry_radius_error: f64 = OdometryNoise::ORDINARY.radius, in 0.0..=0.2;
        /// Largest relative error of the configured distance between the wheels, drawn by the seed.
        odometry_track_error: f64 = OdometryNoise::ORDINARY.track, in 0.0..=0.2;
        /// Mean number of slips on 100 m. A slip is a distance of 0.2 m on which one wheel reports too much.
        odometry_slips_per_100m: f64 = OdometryNoise::ORDINARY.slips_per_100m, in 0.0..=1000.0;
        /// Largest distance that a wheel reports too much in one slip; the smallest is a quarter.
        odometry_slip_m: f64 = OdometryNoise::ORDINARY.slip_m, in 0.0..=0.2, unit "m";
        /// Mean time from the exposure of a frame to its time stamp; the seed draws half of it to one and a half times it. None
        /// with perfect odometry, where every frame comes with its true pose.
        camera_latency_s: f64 = CAMERA_LATENCY_S, in 0.0..=0.3, unit "s", source "a USB camera at 30 Hz";
        /// Time from the first row of a frame to its last, for a rolling shutter; 0 for a global one.
        rolling_shutter_s: f64 = 0.0, in 0.0..=0.3, unit "s";
        /// Root mean square of the floor's slope, which tilts the robot.
        floor_tilt_deg: f64 = FLOOR_TILT_DEG, in 0.0..=5.0, unit "degrees", source "DIN 18202: 4 mm on 1 m";
        /// Standard deviation of a LiDAR range up to 10 m; three times this beyond.
        lidar_noise_m: f64 = LaserModel::UTM_30LX.noise_near_m, in 0.0..=0.2, unit "m", source "UTM-30LX";
        /// Fraction of the LiDAR beams that hit something and return nothing.
        lidar_dropout: f64 = LaserModel::UTM_30LX.dropout, in 0.0..=0.5;
        /// Whether the LiDAR misses glass and black lacquer, as real ones do. The camera sees both.
        lidar_misses_materials: bool = LaserModel::UTM_30LX.misses_materials;
        nuisances: Nuisances;
    }
}

impl SimulatorSection {
    /// The errors of the simulated wheels.
    #[must_use]
    pub fn odometry_noise(&self) -> OdometryNoise {
        match self.odometry {
            Odometry::Perfect => OdometryNoise::NONE,
            Odometry::Realistic => OdometryNoise {
                translation: self.odometry_distance_noise,
                rotation: self.odometry_turn_noise,
                heading_drift_rad: self.odometry_heading_drift,
                heading_bias_rad_per_m: self.odometry_heading_bias,
                radius: self.odometry_radius_error,
                track: self.odometry_track_error,
                slips_per_100m: self.odometry_slips_per_100m,
                slip_m: self.odometry_slip_m,
            },
        }
    }

    /// Mean time from the exposure of a frame to its time stamp. It makes the pose of a frame wrong, so perfect odometry has none.
    #[must_use]
    pub fn latency_s(&self) -> f64 {
        match self.odometry {
            Odometry::Perfect => 0.0,
            Odometry::Realistic => self.camera_latency_s,
        }
    }

    /// The simulated scanner: a UTM-30LX with the configured noise.
    #[must_use]
    pub fn laser_model(&self) -> LaserModel {
        LaserModel {
            noise_near_m: self.lidar_noise_m,
            noise_far_m: 3.0 * self.lidar_noise_m,
            dropout: self.lidar_dropout,
            misses_materials: self.lidar_misses_materials,
            ..LaserModel::UTM_30LX
        }
    }
}
