//! Flow that is known before looking: from the motion of the camera and a guess of the depth.

use hal::{CameraModel, DepthMap, Pose3};
use nalgebra::{Point3, Vector3};

use super::{FlowError, FlowField};

/// What is known of the depth of the first picture.
#[derive(Debug, Clone, Copy)]
pub enum DepthGuess<'a> {
    /// Nothing, or very far: only the rotation moves anything.
    Infinite,
    /// One z-depth for every pixel, metres.
    Constant(f64),
    /// A z-depth for each pixel; pixels without depth count as very far.
    Map(&'a DepthMap),
}

impl DepthGuess<'_> {
    /// 1 / m; 0 where nothing is known.
    fn inverse_m(&self, index: usize) -> f64 {
        let depth_m = match self {
            Self::Infinite => return 0.0,
            Self::Constant(depth_m) => *depth_m,
            Self::Map(map) => f64::from(map.values()[index]),
        };
        if depth_m > 0.0 { 1.0 / depth_m } else { 0.0 }
    }
}

/// Fills `out` with the flow from a picture of `camera` to another, where `t_to_from` maps points of the first camera into the
/// second. NaN where a point is not in front of the second camera. Ignores distortion, as [`CameraModel::project`] does.
///
/// # Errors
/// A depth map or a field of another size than the camera.
pub fn predicted_flow(
    camera: &CameraModel,
    t_to_from: &Pose3,
    depth: DepthGuess<'_>,
    out: &mut FlowField,
) -> Result<(), FlowError> {
    let want = (camera.width, camera.height);
    FlowError::check_size("the field for the prediction", (out.width(), out.height()), want)?;
    if let DepthGuess::Map(map) = depth {
        FlowError::check_size("the depth map", (map.width(), map.height()), want)?;
    }
    let rotation = t_to_from.rotation.to_rotation_matrix();
    let translation = t_to_from.translation.vector;
    for (index, flow) in out.values_mut().iter_mut().enumerate() {
        let (u, v) = ((index % camera.width) as f64, (index / camera.width) as f64);
        // The point divided by its depth, so that a depth without end is no exception.
        let point = rotation * camera.ray(u, v) + translation * depth.inverse_m(index);
        *flow = displacement(camera, (u, v), point);
    }
    Ok(())
}

/// From pixel (`u`, `v`) to where `point` is seen; NaN when it is not in front of the camera.
pub fn displacement(camera: &CameraModel, (u, v): (f64, f64), point: Vector3<f64>) -> [f32; 2] {
    camera
        .project(&Point3::from(point))
        .map_or([f32::NAN; 2], |(x, y)| [(x - u) as f32, (y - v) as f32])
}
