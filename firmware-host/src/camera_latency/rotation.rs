//! Measures the rotation of the robot between two frames from the optical flow.

use anyhow::Result;
use hal::{CameraModel, ImageView, Pose3};
use nalgebra::{Matrix2, Matrix2x3, Rotation3, Unit, Vector2, Vector3};
use runtime::perception::flow::{DenseFlow, FlowField, FlowPreset};

/// Flow is sampled at every fourth pixel, at this distance from the edges, pixels.
const EVERY: usize = 4;
const MARGIN: f64 = 8.0;
/// Required change of brightness over four pixels, of 255. Without texture the flow is only
/// interpolated.
const LEAST_CONTRAST: i16 = 8;
/// Minimum number of matches, weighted by their agreement.
const LEAST_PIXELS: f64 = 50.0;
/// Robust scale of each iteration, pixels. It shrinks, so that outliers are rejected step by step.
const SCALES_PX: [f64; 7] = [32.0, 16.0, 8.0, 4.0, 2.0, 1.0, 1.0];

/// Compares each frame with the one before it.
pub(super) struct RotationMeter {
    flow: DenseFlow,
    camera: CameraModel,
    /// The robot's vertical axis and driving direction in the frame of the camera.
    up: Unit<Vector3<f64>>,
    forward: Vector3<f64>,
    /// Time of the previous frame in seconds, and its RGB8 data.
    before: Option<(f64, Vec<u8>)>,
}

/// The rotation between two frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct FrameRotation {
    /// Times of the frames, seconds.
    pub from_s: f64,
    pub to_s: f64,
    /// Positive to the left, radians.
    pub yaw_rad: f64,
}

impl RotationMeter {
    /// A meter for frames of `camera`, which is mounted at `t_base_camera`.
    pub fn new(camera: CameraModel, t_base_camera: &Pose3) -> Result<Self> {
        let to_camera = t_base_camera.rotation.inverse();
        Ok(Self {
            flow: DenseFlow::new(FlowPreset::Fast, camera.width, camera.height)?,
            camera,
            up: to_camera * Vector3::z_axis(),
            forward: to_camera * Vector3::x(),
            before: None,
        })
    }

    /// Measures the rotation of the robot since the previous frame. `None` for the first frame, for
    /// frames without enough texture, and for a frame that is identical to the previous one,
    /// because the camera then delivered the same capture twice.
    pub fn measure(&mut self, to_s: f64, rgb: &[u8]) -> Result<Option<FrameRotation>> {
        if self.before.as_ref().is_some_and(|(_, before)| before == rgb) {
            return Ok(None);
        }
        let Some((from_s, before)) = self.before.replace((to_s, rgb.to_vec())) else {
            return Ok(None);
        };
        let width = self.camera.width;
        let height = self.camera.height;
        let image = ImageView::rgb8(width, height, rgb)?;
        let image_before = ImageView::rgb8(width, height, &before)?;
        let flow = self.flow.flow(image, image_before)?;
        let yaw_rad = estimate_yaw(
            &matches(flow, [rgb, &before], &self.camera),
            &self.camera,
            &self.up,
            &self.forward,
        );
        Ok(yaw_rad.map(|yaw_rad| FrameRotation { from_s, to_s, yaw_rad }))
    }
}

/// Matches between two frames: the ray (z = 1) of a textured pixel now, and the pixel coordinates
/// of the same point in the previous frame.
fn matches(
    flow: &FlowField,
    [rgb, before]: [&[u8]; 2],
    camera: &CameraModel,
) -> Vec<(Vector3<f64>, Vector2<f64>)> {
    samples(camera.height)
        .flat_map(|row| samples(camera.width).map(move |column| (column, row)))
        .filter(|(column, row)| has_texture(rgb, camera.width, *column, *row))
        .filter_map(|(column, row)| {
            let [du, dv] = flow.values()[row * camera.width + column].map(f64::from);
            let u = column as f64 + du;
            let v = row as f64 + dv;
            let visible = is_inside(u, camera.width)
                && is_inside(v, camera.height)
                && has_texture(before, camera.width, u.round() as usize, v.round() as usize);
            visible.then(|| (camera.ray(column as f64, row as f64), Vector2::new(u, v)))
        })
        .collect()
}

/// Coordinates of the sampled pixels along one axis.
fn samples(size: usize) -> impl Iterator<Item = usize> {
    let margin = MARGIN as usize;
    (margin..size.saturating_sub(margin)).step_by(EVERY)
}

fn is_inside(at: f64, size: usize) -> bool {
    at >= MARGIN && at < size as f64 - MARGIN
}

/// The yaw that explains most of the matches, radians. It is estimated together with a forward
/// motion in a scene of constant distance, by robust least squares (Geman-McClure).
fn estimate_yaw(
    matches: &[(Vector3<f64>, Vector2<f64>)],
    camera: &CameraModel,
    up: &Unit<Vector3<f64>>,
    forward: &Vector3<f64>,
) -> Option<f64> {
    // Yaw, and the forward motion as a share of the distance.
    let mut unknowns = Vector2::<f64>::zeros();
    let mut total_weight = 0.0;
    for scale_px in SCALES_PX {
        let mut normal = Matrix2::zeros();
        let mut right = Vector2::zeros();
        total_weight = 0.0;
        let rotation = Rotation3::from_axis_angle(up, unknowns.x);
        for (ray, observed) in matches {
            let rotated = rotation * ray;
            let point = rotated + forward * unknowns.y;
            let Some((u, v)) = camera.project(&point.into()) else { continue };
            let residual = observed - Vector2::new(u, v);
            let x = point.x / point.z;
            let y = point.y / point.z;
            let z = point.z;
            let slope =
                Matrix2x3::new(camera.fx, 0.0, -camera.fx * x, 0.0, camera.fy, -camera.fy * y) / z;
            let slopes = Matrix2::from_columns(&[slope * up.cross(&rotated), slope * forward]);
            let weight = (1.0 + residual.norm_squared() / (scale_px * scale_px)).powi(-2);
            normal += slopes.transpose() * slopes * weight;
            right += slopes.transpose() * residual * weight;
            total_weight += weight;
        }
        // Damping: without any evidence of a forward motion it stays 0.
        unknowns += (normal + Matrix2::identity() * 1e-3).cholesky()?.solve(&right);
    }
    (total_weight >= LEAST_PIXELS && unknowns.x.is_finite()).then_some(unknowns.x)
}

fn has_texture(rgb: &[u8], width: usize, column: usize, row: usize) -> bool {
    let pixel = row * width + column;
    let horizontal = (green(rgb, pixel + 2) - green(rgb, pixel - 2)).abs();
    let vertical = (green(rgb, pixel + 2 * width) - green(rgb, pixel - 2 * width)).abs();
    horizontal.max(vertical) >= LEAST_CONTRAST
}

fn green(rgb: &[u8], pixel: usize) -> i16 {
    i16::from(rgb[3 * pixel + 1])
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::camera_mount;
    use proptest::prelude::*;

    /// Renders the texture of a distant cylinder for a robot with the given heading.
    fn rendered(camera: &CameraModel, mount: &Pose3, yaw_rad: f64) -> Vec<u8> {
        let heading = Rotation3::from_axis_angle(&Vector3::z_axis(), yaw_rad);
        let mut rgb = Vec::with_capacity(3 * camera.width * camera.height);
        for row in 0..camera.height {
            for column in 0..camera.width {
                let ray = heading * (mount.rotation * camera.ray(column as f64, row as f64));
                let bearing = ray.y.atan2(ray.x);
                let rise = ray.z / ray.x.hypot(ray.y);
                // The texture does not repeat, at any scale of the flow's pyramid.
                let waves = [(7.0, 11.0), (13.3, -5.0), (23.7, 17.0), (41.1, -31.0), (67.9, 23.0)];
                let tone: f64 =
                    waves.iter().map(|(across, up)| f64::sin(across * bearing + up * rise)).sum();
                rgb.extend([(128.0 + 25.0 * tone) as u8; 3]);
            }
        }
        rgb
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(12))]
        #[test]
        fn a_rotation_on_the_spot_is_measured_to_a_milliradian(yaw_rad in -0.1..0.1, pitch_rad in -0.2..0.3) {
            let camera = CameraModel::pinhole(320, 96, std::f64::consts::FRAC_PI_2);
            let mount = camera_mount(0.1, 0.3, pitch_rad);
            let mut meter = RotationMeter::new(camera, &mount).unwrap();
            let first = meter.measure(1.0, &rendered(&camera, &mount, 0.4)).unwrap();
            prop_assert_eq!(first, None, "the first frame has no previous one");
            let FrameRotation { from_s, to_s, yaw_rad: found } =
                meter.measure(1.1, &rendered(&camera, &mount, 0.4 + yaw_rad)).unwrap().unwrap();
            prop_assert_eq!((from_s, to_s), (1.0, 1.1));
            prop_assert!(f64::abs(found - yaw_rad) < 1e-3, "{} instead of {}", found, yaw_rad);
        }
    }

    #[test]
    fn forward_motion_is_not_a_rotation() {
        let camera = CameraModel::pinhole(320, 96, std::f64::consts::FRAC_PI_2);
        let mount = camera_mount(0.1, 0.3, 0.0);
        let mut meter = RotationMeter::new(camera, &mount).unwrap();
        let far = rendered(&camera, &mount, 0.2);
        // 4 % nearer: a point at distance u from the centre moves to 1.04 u.
        let mut near = far.clone();
        for (at, pixel) in near.chunks_exact_mut(3).enumerate() {
            let column = (((at % 320) as f64 - camera.cx) / 1.04 + camera.cx).round() as usize;
            let row = (((at / 320) as f64 - camera.cy) / 1.04 + camera.cy).round() as usize;
            pixel.copy_from_slice(&far[3 * (row * 320 + column)..][..3]);
        }
        meter.measure(0.0, &far).unwrap();
        let turned = meter.measure(0.1, &near).unwrap().unwrap();
        assert!(turned.yaw_rad.abs() < 1e-3, "{turned:?}");
    }

    #[test]
    fn a_frame_without_texture_and_a_repeated_frame_give_no_rotation() {
        let camera = CameraModel::pinhole(320, 96, std::f64::consts::FRAC_PI_2);
        let mount = camera_mount(0.1, 0.3, 0.0);
        let mut meter = RotationMeter::new(camera, &mount).unwrap();
        let grey = vec![128; 3 * 320 * 96];
        let textured = rendered(&camera, &mount, 0.0);
        for (index, rgb) in
            [&grey, &vec![129; 3 * 320 * 96], &grey, &textured, &textured].into_iter().enumerate()
        {
            assert_eq!(meter.measure(index as f64, rgb).unwrap(), None);
        }
        let turned = meter.measure(5.0, &rendered(&camera, &mount, 0.05)).unwrap().unwrap();
        assert_eq!(turned.from_s, 3.0, "the repeated frame has the time of its first appearance");
    }
}
