//! How far the robot turned from one picture to the next, as the pictures say.

use anyhow::Result;
use hal::{CameraModel, ImageView, Pose3};
use nalgebra::{Matrix2, Matrix2x3, Rotation3, Unit, Vector2, Vector3};
use runtime::perception::flow::{DenseFlow, FlowField, FlowPreset};

/// Every so many pixels one counts, this far from the edge, pixels.
const EVERY: usize = 4;
const MARGIN: f64 = 8.0;
/// Brightness that must change over four pixels, of 255: without texture, flow is what the neighbours do.
const LEAST_CONTRAST: i16 = 8;
/// Fewer pixels than this say nothing.
const LEAST_PIXELS: f64 = 50.0;
/// Robust scale from one iteration to the next, pixels: far outliers first.
const SCALES_PX: [f64; 7] = [32.0, 16.0, 8.0, 4.0, 2.0, 1.0, 1.0];

/// Compares each picture with the one before it.
pub(super) struct TurnMeter {
    flow: DenseFlow,
    camera: CameraModel,
    /// The robot's vertical axis and its direction of driving, in the camera's axes.
    up: Unit<Vector3<f64>>,
    forward: Vector3<f64>,
    /// The picture before, and its time, seconds.
    before: Option<(f64, Vec<u8>)>,
}

/// What two pictures showed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Turned {
    /// Their times, seconds.
    pub from_s: f64,
    pub to_s: f64,
    /// To the left positive, radians.
    pub yaw_rad: f64,
}

impl TurnMeter {
    /// For pictures of `camera`, mounted at `t_base_camera`.
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

    /// How far the robot has turned from the picture before this one. `None` for the first picture, where flow does not tell, and
    /// for a picture that is the same: it shows what was at the time of the one before.
    pub fn turned(&mut self, to_s: f64, rgb: &[u8]) -> Result<Option<Turned>> {
        if self.before.as_ref().is_some_and(|(_, before)| before == rgb) {
            return Ok(None);
        }
        let Some((from_s, before)) = self.before.replace((to_s, rgb.to_vec())) else {
            return Ok(None);
        };
        let (width, height) = (self.camera.width, self.camera.height);
        let view = |rgb| ImageView::rgb8(width, height, rgb);
        let flow = self.flow.flow(view(rgb)?, view(&before)?, None)?;
        let yaw_rad = turn_of(
            &matches(flow, [rgb, &before], &self.camera),
            &self.camera,
            &self.up,
            &self.forward,
        );
        Ok(yaw_rad.map(|yaw_rad| Turned { from_s, to_s, yaw_rad }))
    }
}

/// Where something with texture is seen now, as a ray of length 1 forward, and where it was in the picture before, pixels.
fn matches(
    flow: &FlowField,
    [rgb, before]: [&[u8]; 2],
    camera: &CameraModel,
) -> Vec<(Vector3<f64>, Vector2<f64>)> {
    let margin = MARGIN as usize;
    let along = |size: usize| (margin..size.saturating_sub(margin)).step_by(EVERY);
    let inside = |at: f64, size: usize| at >= MARGIN && at < size as f64 - MARGIN;
    let places =
        along(camera.height).flat_map(|row| along(camera.width).map(move |column| (column, row)));
    places
        .filter(|(column, row)| has_texture(rgb, camera.width, *column, *row))
        .filter_map(|(column, row)| {
            let [du, dv] = flow.values()[row * camera.width + column].map(f64::from);
            let (u, v) = (column as f64 + du, row as f64 + dv);
            let shown = inside(u, camera.width)
                && inside(v, camera.height)
                && has_texture(before, camera.width, u.round() as usize, v.round() as usize);
            shown.then(|| (camera.ray(column as f64, row as f64), Vector2::new(u, v)))
        })
        .collect()
}

/// The turn that explains most of the matches, together with a way forward in a scene that is equally far everywhere: robust
/// least squares (Geman-McClure).
fn turn_of(
    matches: &[(Vector3<f64>, Vector2<f64>)],
    camera: &CameraModel,
    up: &Unit<Vector3<f64>>,
    forward: &Vector3<f64>,
) -> Option<f64> {
    // The turn, and the way forward as a share of the distance.
    let mut unknowns = Vector2::<f64>::zeros();
    let mut trusted = 0.0;
    for scale_px in SCALES_PX {
        let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
        trusted = 0.0;
        let turn = Rotation3::from_axis_angle(up, unknowns.x);
        for (ray, there) in matches {
            let turned = turn * ray;
            let point = turned + forward * unknowns.y;
            let Some((u, v)) = camera.project(&point.into()) else { continue };
            let off = there - Vector2::new(u, v);
            let (x, y, z) = (point.x / point.z, point.y / point.z, point.z);
            let slope =
                Matrix2x3::new(camera.fx, 0.0, -camera.fx * x, 0.0, camera.fy, -camera.fy * y) / z;
            let slopes = Matrix2::from_columns(&[slope * up.cross(&turned), slope * forward]);
            let weight = (1.0 + off.norm_squared() / (scale_px * scale_px)).powi(-2);
            normal += slopes.transpose() * slopes * weight;
            right += slopes.transpose() * off * weight;
            trusted += weight;
        }
        // A little more: where nothing shows the way forward, there is none.
        unknowns += (normal + Matrix2::identity() * 1e-3).cholesky()?.solve(&right);
    }
    (trusted >= LEAST_PIXELS && unknowns.x.is_finite()).then_some(unknowns.x)
}

fn has_texture(rgb: &[u8], width: usize, column: usize, row: usize) -> bool {
    let green = |column: usize, row: usize| i16::from(rgb[3 * (row * width + column) + 1]);
    let across = (green(column + 2, row) - green(column - 2, row)).abs();
    let down = (green(column, row + 2) - green(column, row - 2)).abs();
    across.max(down) >= LEAST_CONTRAST
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::camera_mount;
    use proptest::prelude::*;

    /// A picture of a far cylinder with blotches, and how the robot has turned, radians.
    fn picture(camera: &CameraModel, mount: &Pose3, yaw_rad: f64) -> Vec<u8> {
        let look = Rotation3::from_axis_angle(&Vector3::z_axis(), yaw_rad);
        let mut rgb = Vec::with_capacity(3 * camera.width * camera.height);
        for row in 0..camera.height {
            for column in 0..camera.width {
                let ray = look * (mount.rotation * camera.ray(column as f64, row as f64));
                let (bearing, rise) = (ray.y.atan2(ray.x), ray.z / ray.x.hypot(ray.y));
                // Nothing repeats, at any scale of a pyramid.
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
        fn a_turn_on_the_spot_is_measured_to_a_milliradian(yaw_rad in -0.1..0.1, pitch_rad in -0.2..0.3) {
            let camera = CameraModel::pinhole(320, 96, std::f64::consts::FRAC_PI_2);
            let mount = camera_mount(0.1, 0.3, pitch_rad);
            let mut meter = TurnMeter::new(camera, &mount).unwrap();
            let first = meter.turned(1.0, &picture(&camera, &mount, 0.4)).unwrap();
            prop_assert_eq!(first, None, "nothing is before the first picture");
            let Turned { from_s, to_s, yaw_rad: found } =
                meter.turned(1.1, &picture(&camera, &mount, 0.4 + yaw_rad)).unwrap().unwrap();
            prop_assert_eq!((from_s, to_s), (1.0, 1.1));
            prop_assert!(f64::abs(found - yaw_rad) < 1e-3, "{} instead of {}", found, yaw_rad);
        }
    }

    #[test]
    fn the_way_forward_is_no_turn() {
        let camera = CameraModel::pinhole(320, 96, std::f64::consts::FRAC_PI_2);
        let mount = camera_mount(0.1, 0.3, 0.0);
        let mut meter = TurnMeter::new(camera, &mount).unwrap();
        let far = picture(&camera, &mount, 0.2);
        // 4 % nearer: what was at u is at 1.04 u from the middle now.
        let mut near = far.clone();
        for (at, pixel) in near.chunks_exact_mut(3).enumerate() {
            let from =
                |at: usize, middle: f64| ((at as f64 - middle) / 1.04 + middle).round() as usize;
            let (column, row) = (from(at % 320, camera.cx), from(at / 320, camera.cy));
            pixel.copy_from_slice(&far[3 * (row * 320 + column)..][..3]);
        }
        meter.turned(0.0, &far).unwrap();
        let turned = meter.turned(0.1, &near).unwrap().unwrap();
        assert!(turned.yaw_rad.abs() < 1e-3, "{turned:?}");
    }

    #[test]
    fn a_bare_wall_says_nothing_and_the_same_picture_again_is_of_the_same_time() {
        let camera = CameraModel::pinhole(320, 96, std::f64::consts::FRAC_PI_2);
        let mount = camera_mount(0.1, 0.3, 0.0);
        let mut meter = TurnMeter::new(camera, &mount).unwrap();
        let (grey, seen) = (vec![128; 3 * 320 * 96], picture(&camera, &mount, 0.0));
        for (index, rgb) in
            [&grey, &vec![129; 3 * 320 * 96], &grey, &seen, &seen].into_iter().enumerate()
        {
            assert_eq!(meter.turned(index as f64, rgb).unwrap(), None);
        }
        let turned = meter.turned(5.0, &picture(&camera, &mount, 0.05)).unwrap().unwrap();
        assert_eq!(turned.from_s, 3.0, "when it was seen first");
    }
}
