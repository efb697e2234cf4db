//! The section `[simulator]`.

use drivers::lidar::LidarConfig;
use hal::{CameraMount, LidarMount};
use simulator::laser::LaserModel;
use simulator::nuisance::Nuisances;
use simulator::odometry::{OdometryNoise, WheelErrors};
use simulator::robot::{CAMERA_LATENCY_S, FLOOR_TILT_DEG};

use super::odometry::Odometry;

hal::settings! {
    /// How the simulated robot differs from what `[camera]`, `[lidar]` and `[devices.base]` say of it: what a wrong calibration costs, and
    /// what `calibrate` finds, can be simulated. By default it is as it is configured.
    pub struct TruthSection {
        /// The robot is as it is configured until it has driven this far, and then differs: a sensor is hit, a wheel is exchanged. 0:
        /// it differs from the beginning.
        changes_after_m: f64 = 0.0, in 0.0..=10000.0, unit "m";
        /// How much farther forward than `camera.forward_m` the camera is.
        camera_forward_m: f64 = 0.0, in -0.2..=0.2, unit "m";
        /// How much farther to the left than `camera.left_m` the camera is.
        camera_left_m: f64 = 0.0, in -0.2..=0.2, unit "m";
        /// How much higher than `camera.height_m` the camera is.
        camera_height_m: f64 = 0.0, in -0.2..=0.2, unit "m";
        /// How much more than `camera.pitch_down_deg` the camera points down.
        camera_pitch_down_deg: f64 = 0.0, in -10.0..=10.0, unit "degrees";
        /// How much more than `camera.roll_deg` the camera is rotated about its axis.
        camera_roll_deg: f64 = 0.0, in -10.0..=10.0, unit "degrees";
        /// How much more than `camera.yaw_deg` the camera points to the left.
        camera_yaw_deg: f64 = 0.0, in -10.0..=10.0, unit "degrees";
        /// How much longer the focal length is than the camera's model says.
        focal_percent: f64 = 0.0, in -10.0..=10.0, unit "%";
        /// How much farther forward than `lidar.forward_m` the scanner is.
        lidar_forward_m: f64 = 0.0, in -0.2..=0.2, unit "m";
        /// How much farther to the left than `lidar.left_m` the scanner is.
        lidar_left_m: f64 = 0.0, in -0.2..=0.2, unit "m";
        /// How much more than `lidar.yaw_deg` the scanner points to the left.
        lidar_yaw_deg: f64 = 0.0, in -20.0..=20.0, unit "degrees";
        /// How much larger the left wheel's radius is than configured.
        left_wheel_percent: f64 = 0.0, in -10.0..=10.0, unit "%";
        /// How much larger the right wheel's radius is than configured.
        right_wheel_percent: f64 = 0.0, in -10.0..=10.0, unit "%";
        /// How much farther apart the wheels are than configured.
        track_percent: f64 = 0.0, in -10.0..=10.0, unit "%";
        /// Time by which frames are stamped late, in addition to `camera_latency_s`; negative if early.
        camera_late_s: f64 = 0.0, in -0.1..=0.2, unit "s";
        /// Time by which scans are stamped late; negative if early.
        lidar_late_s: f64 = 0.0, in -0.1..=0.2, unit "s";
    }
}

impl TruthSection {
    /// Where the camera really is.
    #[must_use]
    pub fn camera(&self, configured: CameraMount) -> CameraMount {
        CameraMount {
            height_m: configured.height_m + self.camera_height_m,
            forward_m: configured.forward_m + self.camera_forward_m,
            left_m: configured.left_m + self.camera_left_m,
            pitch_down_deg: configured.pitch_down_deg + self.camera_pitch_down_deg,
            roll_deg: configured.roll_deg + self.camera_roll_deg,
            yaw_deg: configured.yaw_deg + self.camera_yaw_deg,
        }
    }

    /// Where the scanner really is.
    #[must_use]
    pub fn lidar(&self, configured: LidarMount) -> LidarMount {
        LidarMount {
            height_m: configured.height_m,
            forward_m: configured.forward_m + self.lidar_forward_m,
            left_m: configured.left_m + self.lidar_left_m,
            yaw_deg: configured.yaw_deg + self.lidar_yaw_deg,
        }
    }

    /// How the wheels really are.
    #[must_use]
    pub fn wheels(&self) -> WheelErrors {
        WheelErrors {
            left: self.left_wheel_percent / 100.0,
            right: self.right_wheel_percent / 100.0,
            track: self.track_percent / 100.0,
        }
    }
}

hal::settings! {
    /// The simulated robot. Its scanner is that of `[devices.lidar]`, with the noise that is given here.
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
        /// Whether the base has three cliff sensors at its front edge, ahead and 45 degrees to both sides.
        cliff_sensors: bool = false;
        /// Whether the robot has an inertial measurement unit: a BMI160 at 100 Hz, level in the middle of the robot.
        imu: bool = false;
        /// Standard deviation of a LiDAR range up to 10 m; three times this beyond.
        lidar_noise_m: f64 = LaserModel::UTM_30LX.noise_near_m, in 0.0..=0.2, unit "m", source "UTM-30LX";
        /// Fraction of the LiDAR beams that hit something and return nothing.
        lidar_dropout: f64 = LaserModel::UTM_30LX.dropout, in 0.0..=0.5;
        /// Whether the LiDAR misses glass and black lacquer, as real ones do. The camera sees both.
        lidar_misses_materials: bool = LaserModel::UTM_30LX.misses_materials;
        nuisances: Nuisances;
        truth: TruthSection;
    }
}

impl SimulatorSection {
    /// The errors of the simulated wheels.
    #[must_use]
    pub fn odometry_noise(&self) -> OdometryNoise {
        let wheels = self.truth.wheels();
        match self.odometry {
            Odometry::Perfect => OdometryNoise { wheels, ..OdometryNoise::NONE },
            Odometry::Realistic => OdometryNoise {
                wheels,
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

    /// The simulated scanner: beams, ranges and revolutions of the configured one, with the configured noise.
    #[must_use]
    pub fn laser_model(&self, lidar: &LidarConfig) -> LaserModel {
        LaserModel {
            geometry: lidar.geometry(),
            noise_near_m: self.lidar_noise_m,
            noise_far_m: 3.0 * self.lidar_noise_m,
            dropout: self.lidar_dropout,
            misses_materials: self.lidar_misses_materials,
            ..LaserModel::UTM_30LX
        }
    }
}
