//! The section `[simulator]`.

use simulator::{laser::LaserModel, nuisance::Nuisances};

hal::settings! {
    /// The simulated robot.
    pub struct SimulatorSection {
        /// Whether the robot slides along an obstacle that it touches (the default of Habitat) or stops there.
        sliding: bool = false;
        /// Standard deviation of the measured distance, as a fraction of the distance. A good base has 0.01.
        odometry_distance_noise: f64 = 0.0, in 0.0..=0.2;
        /// Standard deviation of the measured rotation, as a fraction of the rotation. A good base has 0.02.
        odometry_turn_noise: f64 = 0.0, in 0.0..=0.2;
        /// Standard deviation of a LiDAR range up to 10 m; three times this beyond.
        lidar_noise_m: f64 = LaserModel::UTM_30LX.noise_near_m, in 0.0..=0.2, unit "m", source "UTM-30LX";
        /// Fraction of the LiDAR beams that hit something and return nothing.
        lidar_dropout: f64 = LaserModel::UTM_30LX.dropout, in 0.0..=0.5;
        nuisances: Nuisances;
    }
}

impl SimulatorSection {
    /// The simulated scanner: a UTM-30LX with the configured noise.
    #[must_use]
    pub fn laser_model(&self) -> LaserModel {
        LaserModel {
            noise_near_m: self.lidar_noise_m,
            noise_far_m: 3.0 * self.lidar_noise_m,
            dropout: self.lidar_dropout,
            ..LaserModel::UTM_30LX
        }
    }
}
