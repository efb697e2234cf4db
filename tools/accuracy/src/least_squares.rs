//! Depth in closed form from optical flow and known motion ("Embodied Depth Prediction", section on coarse depth).
//!
//! The point on a pixel's ray `b` (z = 1) at depth z lies at `z R b + t` in another view, and flow gives the unit bearing `o`
//! at which that view sees it. The distance of the point to that bearing is `|z s + r|` with `s = o x (R b)`, `r = o x t`.
//! The sum of squares over the views is `A z^2 + 2 B z + C`, so `z = -B / A`, and the residual `C - B^2 / A` measures how
//! well the views agree.

use hal::{CameraModel, DepthMap, Pose3};
use nalgebra::Vector3;

use anyhow::{Result, ensure};
use runtime::perception::flow::FlowField;

/// The flow to another frame, and its pose.
#[derive(Debug, Clone, Copy)]
pub struct FlowView<'a> {
    /// Displacement of the current frame's pixels in the other frame.
    pub flow: &'a FlowField,
    /// Maps points of the current camera to the other camera.
    pub t_view_camera: Pose3,
}

/// Depth, and two measures of its accuracy.
#[derive(Debug, Clone, PartialEq)]
pub struct Triangulation {
    /// z-depth, metres; 0 where no view gives one within the range.
    pub depth: DepthMap,
    /// Root mean square distance of the point to the rays of the views that agreed on the range, metres, row-major.
    /// Large where the match is wrong or the object has moved.
    pub residual_m: Vec<f32>,
    /// Largest angle between the rays of two views, radians, row-major. A bearing error of e radians is a depth error of
    /// about e / parallax of the depth.
    pub parallax_rad: Vec<f32>,
}

/// Triangulates every pixel. A view whose own depth of a pixel is outside `range_m` (ends excluded) is not used for it.
/// Without any translation, no pixel gets a depth.
///
/// # Errors
/// A flow field of another size than the camera.
pub fn triangulate(
    camera: &CameraModel,
    views: &[FlowView<'_>],
    range_m: (f64, f64),
) -> Result<Triangulation> {
    let width = camera.width;
    let height = camera.height;
    for view in views {
        let size = (view.flow.width(), view.flow.height());
        ensure!(
            size == (width, height),
            "the flow is {}x{}, the camera {width}x{height}; resample the flow",
            size.0,
            size.1
        );
    }
    let pixels = width * height;
    let mut out = Triangulation {
        depth: DepthMap::none(width, height),
        residual_m: vec![0.0; pixels],
        parallax_rad: vec![0.0; pixels],
    };
    for (index, depth) in out.depth.values_mut().iter_mut().enumerate() {
        let u = (index % width) as f64;
        let v = (index / width) as f64;
        let mut sum = Normal::default();
        for view in views {
            let [dx, dy] = view.flow.values()[index];
            let bearing = camera.ray(u + f64::from(dx), v + f64::from(dy)).normalize();
            sum.add(&camera.ray(u, v), &bearing, &view.t_view_camera, range_m);
        }
        if let Some((depth_m, residual_m)) = sum.solve() {
            *depth = depth_m as f32;
            out.residual_m[index] = residual_m as f32;
            out.parallax_rad[index] = sum.sin_parallax.min(1.0).asin() as f32;
        }
    }
    Ok(out)
}

/// The coefficients of the sum of squares.
#[derive(Debug, Clone, Copy, Default)]
struct Normal {
    a: f64,
    b: f64,
    c: f64,
    views: u32,
    sin_parallax: f64,
}

impl Normal {
    fn add(
        &mut self,
        ray: &Vector3<f64>,
        bearing: &Vector3<f64>,
        t_view_camera: &Pose3,
        range_m: (f64, f64),
    ) {
        let rotated = t_view_camera.rotation * ray;
        let s = bearing.cross(&rotated);
        let r = bearing.cross(&t_view_camera.translation.vector);
        let a = s.dot(&s);
        let b = s.dot(&r);
        let own_m = -b / a;
        // NaN (no match, or 0 / 0 without parallax) is not in the range.
        if own_m > range_m.0 && own_m < range_m.1 {
            self.a += a;
            self.b += b;
            self.c += r.dot(&r);
            self.views += 1;
            self.sin_parallax = self.sin_parallax.max(s.norm() / ray.norm());
        }
    }

    /// Depth and residual, metres.
    fn solve(&self) -> Option<(f64, f64)> {
        (self.views > 0).then(|| {
            let left = (self.c - self.b * self.b / self.a).max(0.0);
            (-self.b / self.a, (left / f64::from(self.views)).sqrt())
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Translation3, UnitQuaternion};
    use proptest::prelude::*;

    const RANGE: (f64, f64) = (0.1, 40.0);

    fn camera() -> CameraModel {
        CameraModel::pinhole(160, 64, std::f64::consts::FRAC_PI_2)
    }

    fn pose(position_m: [f64; 3], yaw_rad: f64) -> Pose3 {
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), yaw_rad);
        Pose3::from_parts(Translation3::from(position_m), rotation)
    }

    /// Depth of the plane `z = 2.5 + 0.3 x`, metres, seen from the origin.
    fn plane_depth_m(u: f64, v: f64) -> f64 {
        let ray = camera().ray(u, v);
        2.5 / (ray.z - 0.3 * ray.x)
    }

    /// The exact flow of the slanted plane from a camera at the origin to one at `t_world_view`.
    fn exact_flow(t_world_view: &Pose3) -> FlowField {
        let camera = camera();
        let t_view_camera = t_world_view.inverse();
        let flow = (0..camera.width * camera.height).map(|index| {
            let u = (index % camera.width) as f64;
            let v = (index / camera.width) as f64;
            let point = camera.unproject(u, v, plane_depth_m(u, v));
            let (x, y) = camera.project(&(t_view_camera * point)).unwrap();
            [(x - u) as f32, (y - v) as f32]
        });
        FlowField::from_vec(camera.width, camera.height, flow.collect()).unwrap()
    }

    fn view<'a>(flow: &'a FlowField, t_world_view: &Pose3) -> FlowView<'a> {
        FlowView { flow, t_view_camera: t_world_view.inverse() }
    }

    #[test]
    fn the_exact_flow_of_a_plane_returns_the_plane() {
        let camera = camera();
        let p = pose([-0.1, 0.02, 0.05], 0.05);
        let q = pose([0.08, 0.0, -0.12], -0.02);
        let flow_p = exact_flow(&p);
        let flow_q = exact_flow(&q);
        let found = triangulate(&camera, &[view(&flow_p, &p), view(&flow_q, &q)], RANGE).unwrap();
        for (index, depth) in found.depth.values().iter().enumerate() {
            let u = (index % camera.width) as f64;
            let v = (index / camera.width) as f64;
            let truth = plane_depth_m(u, v);
            assert!((f64::from(*depth) / truth - 1.0).abs() < 5e-4, "{u} {v}: {depth} {truth}");
            assert!(found.residual_m[index] < 1e-4 && found.parallax_rad[index] > 0.005);
        }
    }

    #[test]
    fn without_translation_there_is_no_depth() {
        let turned = pose([0.0; 3], 0.1);
        let flow = exact_flow(&turned);
        let found = triangulate(&camera(), &[view(&flow, &turned)], RANGE).unwrap();
        assert!(found.depth.values().iter().all(|depth| *depth == 0.0));
    }

    #[test]
    fn a_missing_match_gives_no_depth_and_does_not_affect_other_views() {
        let camera = camera();
        let p = pose([-0.1, 0.0, 0.0], 0.0);
        let flow = exact_flow(&p);
        let gone = FlowField::from_vec(
            camera.width,
            camera.height,
            vec![[f32::NAN; 2]; camera.width * camera.height],
        );
        let gone = gone.unwrap();
        let both = triangulate(&camera, &[view(&flow, &p), view(&gone, &p)], RANGE).unwrap();
        assert_eq!(both, triangulate(&camera, &[view(&flow, &p)], RANGE).unwrap());
        let none = triangulate(&camera, &[view(&gone, &p)], RANGE).unwrap();
        assert!(none.depth.values().iter().all(|depth| *depth == 0.0));
    }

    #[test]
    fn another_size_is_refused() {
        let flow = FlowField::from_vec(2, 2, vec![[0.0; 2]; 4]).unwrap();
        assert!(triangulate(&camera(), &[view(&flow, &Pose3::identity())], RANGE).is_err());
        assert!(FlowField::from_vec(2, 2, vec![[0.0; 2]; 3]).is_none());
    }

    proptest! {
        #[test]
        fn the_closed_form_is_the_minimum_of_the_distances(
            u in 0.0..159.0f64, v in 0.0..63.0f64, depth in 0.5..8.0f64,
            noise in prop::array::uniform4(-2.0..2.0f64), bx in -0.3..0.3f64, bz in -0.3..0.3f64, yaw in -0.2..0.2f64,
        ) {
            let camera = camera();
            let ray = camera.ray(u, v);
            let poses = [pose([bx, 0.05, bz], yaw).inverse(), pose([-bz, 0.1, bx], -yaw).inverse()];
            let mut sum = Normal::default();
            let mut distances: Vec<(Vector3<f64>, Vector3<f64>)> = Vec::new();
            for (view, noise) in poses.iter().zip(noise.chunks(2)) {
                let Some((x, y)) = camera.project(&(view * camera.unproject(u, v, depth))) else { continue };
                let bearing = camera.ray(x + noise[0], y + noise[1]).normalize();
                sum.add(&ray, &bearing, view, (0.0, f64::INFINITY));
                distances.push((bearing, view.translation.vector));
            }
            prop_assume!(sum.views as usize == distances.len() && sum.views > 0);
            // Distance of a point to a ray, from its definition.
            let cost = |z: f64| -> f64 {
                poses.iter().zip(&distances).map(|(view, (o, _))| {
                    let x = (view * nalgebra::Point3::from(ray * z)).coords;
                    (x - o * o.dot(&x)).norm_squared()
                }).sum()
            };
            let mut low = 0.0;
            let mut high = 1e4;
            for _ in 0..400 {
                let a = low + (high - low) / 3.0;
                let b = high - (high - low) / 3.0;
                if cost(a) < cost(b) { high = b } else { low = a }
            }
            let (z, residual) = sum.solve().unwrap();
            prop_assume!(z < 1e3);
            prop_assert!(cost(z) <= cost(low) + 1e-9);
            prop_assert!((z - low).abs() < 1e-3 * z.max(1.0), "{} {}", z, low);
            prop_assert!((residual * residual * f64::from(sum.views) - cost(z)).abs() < 1e-9);
        }
    }
}
