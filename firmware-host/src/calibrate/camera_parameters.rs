//! The parameters of the camera.

use hal::{CameraMount, Pose3};
use nalgebra::DVector;

/// Number of parameters, in this order: roll, pitch down, yaw (rad), x, y (m), scale of the focal length, latency (s).
pub(super) const PARAMETERS: usize = 7;
/// Indices of some of them.
pub(super) const ROLL: usize = 0;
pub(super) const PITCH: usize = 1;
pub(super) const FORWARD: usize = 3;
pub(super) const LEFT: usize = 4;
pub(super) const FOCAL: usize = 5;
pub(super) const LATENCY: usize = 6;

/// The camera's parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct CameraParameters {
    pub roll_rad: f64,
    pub pitch_down_rad: f64,
    pub yaw_rad: f64,
    pub x_m: f64,
    pub y_m: f64,
    /// True focal length by the configured one.
    pub focal: f64,
    /// Time from the exposure of a frame to its stamp, on the wheels' clock, seconds.
    pub latency_s: f64,
}

impl CameraParameters {
    /// The configured mount; latency and focal length as stamped and configured.
    pub fn configured(t_base_camera: &Pose3) -> Self {
        let mount = CameraMount::of(t_base_camera);
        Self {
            roll_rad: mount.roll_deg.to_radians(),
            pitch_down_rad: mount.pitch_down_deg.to_radians(),
            yaw_rad: mount.yaw_deg.to_radians(),
            x_m: mount.forward_m,
            y_m: mount.left_m,
            focal: 1.0,
            latency_s: 0.0,
        }
    }

    pub fn to_vector(self) -> DVector<f64> {
        let Self { roll_rad, pitch_down_rad, yaw_rad, x_m, y_m, focal, latency_s } = self;
        DVector::from_vec(vec![roll_rad, pitch_down_rad, yaw_rad, x_m, y_m, focal, latency_s])
    }

    pub fn from_vector(vector: &DVector<f64>) -> Self {
        Self {
            roll_rad: vector[0],
            pitch_down_rad: vector[1],
            yaw_rad: vector[2],
            x_m: vector[3],
            y_m: vector[4],
            focal: vector[5],
            latency_s: vector[6],
        }
    }

    /// `t_base_camera` of a camera at this height.
    pub fn mount(&self, height_m: f64) -> Pose3 {
        let mount = CameraMount {
            height_m,
            forward_m: self.x_m,
            left_m: self.y_m,
            pitch_down_deg: self.pitch_down_rad.to_degrees(),
            roll_deg: self.roll_rad.to_degrees(),
            yaw_deg: self.yaw_rad.to_degrees(),
        };
        mount.t_base_camera()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mount_comes_back_from_its_pose() {
        let parameters = CameraParameters {
            roll_rad: 0.03,
            pitch_down_rad: -0.04,
            yaw_rad: 0.05,
            x_m: 0.02,
            y_m: -0.03,
            focal: 1.0,
            latency_s: 0.0,
        };
        let back = CameraParameters::configured(&parameters.mount(0.8));
        assert!((back.to_vector() - parameters.to_vector()).amax() < 1e-12);
    }
}
