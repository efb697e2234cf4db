//! The plane of the floor as a rival of votes that are behind it.
//!
//! On tiles, boards and carpets a pattern repeats. A patch of it may match a period too far, and then the floor looks like a drop. The
//! sweep does not show that: it compares every patch as if it faced the camera, and the floor does not. Here the floor is compared as it
//! lies. Where it explains the image as well, the vote is removed: such an image shows neither a drop nor floor.

use hal::{CameraModel, Pose3};

use super::belief::AGREEMENT;
use super::sweep::PatchObservation;

/// The plane of the floor as a camera sees it: inverse depth is linear in the position in the image.
#[derive(Debug, Clone, Copy)]
pub struct FloorPlane {
    /// Inverse depth at position (0, 0), 1/m.
    at_origin: f32,
    /// Change of inverse depth per pixel to the right, 1/m.
    along_u: f32,
    /// Change of inverse depth per pixel down, 1/m.
    along_v: f32,
}

impl FloorPlane {
    /// The plane z = 0 of `odom`, seen by a camera at `t_odom_camera`; `None` unless the camera is above it. Positions are pixels of
    /// `camera`.
    pub fn new(t_odom_camera: &Pose3, camera: &CameraModel) -> Option<Self> {
        let height_m = t_odom_camera.translation.z;
        let inverse_depth =
            |u: f64, v: f64| -(t_odom_camera.rotation * camera.ray(u, v)).z / height_m;
        let at_origin = inverse_depth(0.0, 0.0);
        (height_m > 0.0).then(|| Self {
            at_origin: at_origin as f32,
            along_u: (inverse_depth(1.0, 0.0) - at_origin) as f32,
            along_v: (inverse_depth(0.0, 1.0) - at_origin) as f32,
        })
    }

    /// Inverse depth of the floor at position (u, v), 1/m; 0 or less where the ray does not meet the floor.
    #[inline(always)]
    pub fn inverse_depth(&self, u: f32, v: f32) -> f32 {
        self.at_origin + self.along_u * u + self.along_v * v
    }

    /// Whether the floor at position (u, v) is clearly before a point of this inverse depth.
    #[inline(always)]
    pub fn is_before(&self, u: f32, v: f32, inverse_depth: f32) -> bool {
        inverse_depth < (1.0 - AGREEMENT) * self.inverse_depth(u, v)
    }

    /// The observation of a patch that lies on the floor, from that of a patch which faces the camera at the same place.
    #[inline(always)]
    pub fn lay_down(&self, mut patch: PatchObservation) -> PatchObservation {
        for axis in 0..2 {
            patch.along_u[axis] += patch.motion[axis] * self.along_u;
            patch.along_v[axis] += patch.motion[axis] * self.along_v;
        }
        patch
    }
}

#[cfg(test)]
mod tests;
