//! The parameters of wheels and scanner that a calibration finds.

use hal::Pose2;
use nalgebra::DVector;

use super::drive::Configured;
use super::wheels::WheelGeometry;

/// Wheels, and where and when the scanner measures.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LaserParameters {
    pub wheels: WheelGeometry,
    pub t_base_laser: Pose2,
    /// Time from the middle of a scan to its stamp, on the clock of the wheels' reports, seconds.
    pub latency_s: f64,
}

impl LaserParameters {
    /// What the robot was taken for.
    pub fn configured(configured: &Configured) -> Self {
        let wheels = WheelGeometry { scale: [1.0, 1.0], track_m: configured.track_m };
        Self { wheels, t_base_laser: configured.t_base_laser, latency_s: 0.0 }
    }

    pub fn to_vector(self) -> DVector<f64> {
        let Self { wheels, t_base_laser, latency_s } = self;
        let Pose2 { x_m, y_m, yaw_rad } = t_base_laser;
        let [left, right] = wheels.scale;
        DVector::from_vec(vec![left, right, wheels.track_m, x_m, y_m, yaw_rad, latency_s])
    }

    pub fn from_vector(vector: &DVector<f64>) -> Self {
        Self {
            wheels: WheelGeometry { scale: [vector[0], vector[1]], track_m: vector[2] },
            t_base_laser: Pose2::new(vector[3], vector[4], vector[5]),
            latency_s: vector[6],
        }
    }
}
