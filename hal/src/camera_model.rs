//! Camera intrinsics: projection, lens distortion, and how both change when an image is cropped or
//! resized.

use nalgebra::{ComplexField, Point3, Vector3};

/// A lens distortion model. The models and the order of their coefficients are OpenCV's.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub enum Distortion {
    /// An ideal pinhole without distortion.
    #[default]
    None,
    /// Brown-Conrady: k1 k2 p1 p2 k3.
    PlumbBob([f64; 5]),
    /// Kannala-Brandt: k1 k2 k3 k4.
    Fisheye([f64; 4]),
}

/// Rays further than this from the optical axis, in focal lengths (86 degrees), appear in no
/// pinhole image of practical use.
const WIDEST_RAY: f64 = 16.0;

impl Distortion {
    /// The image position of the ray (`x`, `y`, 1), in focal lengths from the optical axis. The
    /// formulas are those of OpenCV's `projectPoints` and `fisheye::projectPoints` (Brown 1966;
    /// Kannala and Brandt 2006).
    #[must_use]
    pub fn distort(&self, x: f64, y: f64) -> (f64, f64) {
        match self {
            Self::None => (x, y),
            Self::PlumbBob([k1, k2, p1, p2, k3]) => {
                let r2 = x * x + y * y;
                let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
                let dx = 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x);
                let dy = p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y;
                (x * radial + dx, y * radial + dy)
            }
            Self::Fisheye([k1, k2, k3, k4]) => {
                let r = ComplexField::sqrt(x * x + y * y);
                if r < 1e-12 {
                    return (x, y);
                }
                let angle = ComplexField::atan(r);
                let a2 = angle * angle;
                let distorted = angle * (1.0 + a2 * (k1 + a2 * (k2 + a2 * (k3 + a2 * k4))));
                (x * distorted / r, y * distorted / r)
            }
        }
    }

    /// The largest distance of a ray from the optical axis, in focal lengths, for which the model
    /// is valid. Beyond it the radial polynomial decreases, so the model would show the middle of
    /// the image a second time.
    #[must_use]
    pub fn valid_radius(&self) -> f64 {
        let steps = 16_000;
        (1..=steps)
            .map(|step| WIDEST_RAY * f64::from(step) / f64::from(steps))
            .find(|r| self.radial_slope(*r) <= 0.0)
            .unwrap_or(f64::INFINITY)
    }

    /// Derivative of the radial polynomial at the distance `r`, which decides whether the model is
    /// still monotonic there.
    fn radial_slope(&self, r: f64) -> f64 {
        match self {
            Self::None => 1.0,
            Self::PlumbBob([k1, k2, _, _, k3]) => {
                let r2 = r * r;
                1.0 + r2 * (3.0 * k1 + r2 * (5.0 * k2 + r2 * 7.0 * k3))
            }
            Self::Fisheye([k1, k2, k3, k4]) => {
                let a2 = ComplexField::atan(r) * ComplexField::atan(r);
                1.0 + a2 * (3.0 * k1 + a2 * (5.0 * k2 + a2 * (7.0 * k3 + a2 * 9.0 * k4)))
            }
        }
    }

    fn is_finite(&self) -> bool {
        match self {
            Self::None => true,
            Self::PlumbBob(k) => k.iter().copied().all(f64::is_finite),
            Self::Fisheye(k) => k.iter().copied().all(f64::is_finite),
        }
    }
}

/// A camera's intrinsics, in pixels, with pixel centres at integer coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraModel {
    pub width: usize,
    pub height: usize,
    /// Focal length along x, pixels.
    pub fx: f64,
    /// Focal length along y, pixels.
    pub fy: f64,
    /// Column of the optical axis.
    pub cx: f64,
    /// Row of the optical axis.
    pub cy: f64,
    pub distortion: Distortion,
}

impl CameraModel {
    /// A pinhole with square pixels, the optical axis in the middle of the image, and the given
    /// horizontal field of view. For 640x192 at 90 degrees: f = 320, cx = 319.5, cy = 95.5.
    #[must_use]
    pub fn pinhole(width: usize, height: usize, horizontal_fov_rad: f64) -> Self {
        let focal = width as f64 / 2.0 / ComplexField::tan(horizontal_fov_rad / 2.0);
        Self {
            width,
            height,
            fx: focal,
            fy: focal,
            cx: (width as f64 - 1.0) / 2.0,
            cy: (height as f64 - 1.0) / 2.0,
            distortion: Distortion::None,
        }
    }

    /// The point at z-depth `depth_m` behind pixel (`u`, `v`), in `camera_optical`. Ignores
    /// distortion.
    #[must_use]
    pub fn unproject(&self, u: f64, v: f64, depth_m: f64) -> Point3<f64> {
        Point3::from(self.ray(u, v) * depth_m)
    }

    /// The direction behind pixel (`u`, `v`), scaled so that z = 1. Ignores distortion.
    #[must_use]
    pub fn ray(&self, u: f64, v: f64) -> Vector3<f64> {
        Vector3::new((u - self.cx) / self.fx, (v - self.cy) / self.fy, 1.0)
    }

    /// The pixel of a point in `camera_optical`, or `None` when the point is not in front of the
    /// camera. The pixel may lie outside the image. Ignores distortion.
    #[must_use]
    pub fn project(&self, point: &Point3<f64>) -> Option<(f64, f64)> {
        (point.z > 0.0)
            .then(|| (self.fx * point.x / point.z + self.cx, self.fy * point.y / point.z + self.cy))
    }

    /// The pixel of the ray (`x`, `y`, 1) in this camera's raw, distorted images. The pixel may lie
    /// outside the image.
    #[must_use]
    pub fn distorted_pixel(&self, x: f64, y: f64) -> (f64, f64) {
        let (x, y) = self.distortion.distort(x, y);
        (self.fx * x + self.cx, self.fy * y + self.cy)
    }

    /// The model of the image after cropping it to `width` x `height` pixels from column `left`,
    /// row `top`.
    #[must_use]
    pub fn cropped(&self, left: f64, top: f64, width: usize, height: usize) -> Self {
        Self { width, height, cx: self.cx - left, cy: self.cy - top, ..*self }
    }

    /// The model of the image after resampling it to `width` x `height`, with the outer edges of
    /// both images aligned (the half-pixel convention of OpenCV's `resize`).
    #[must_use]
    pub fn resized(&self, width: usize, height: usize) -> Self {
        let sx = width as f64 / self.width as f64;
        let sy = height as f64 / self.height as f64;
        Self {
            width,
            height,
            fx: self.fx * sx,
            fy: self.fy * sy,
            cx: (self.cx + 0.5) * sx - 0.5,
            cy: (self.cy + 0.5) * sy - 0.5,
            distortion: self.distortion,
        }
    }

    /// Whether the intrinsics are usable: a size above zero, positive finite focal lengths, and a
    /// finite centre and distortion.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        let finite = [self.fx, self.fy, self.cx, self.cy].iter().copied().all(f64::is_finite);
        let finite = finite && self.distortion.is_finite();
        finite && self.width > 0 && self.height > 0 && self.fx > 0.0 && self.fy > 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f64::consts::FRAC_PI_2;
    use proptest::prelude::*;

    #[test]
    fn the_papers_camera_has_f_320_and_its_axis_between_the_middle_pixels() {
        let model = CameraModel::pinhole(640, 192, FRAC_PI_2);
        assert!((model.fx - 320.0).abs() < 1e-9 && (model.fy - 320.0).abs() < 1e-9);
        assert_eq!((model.cx, model.cy), (319.5, 95.5));
    }

    #[test]
    fn a_point_behind_the_camera_has_no_pixel() {
        let model = CameraModel::pinhole(640, 192, FRAC_PI_2);
        assert_eq!(model.project(&Point3::new(0.0, 0.0, -1.0)), None);
        assert_eq!(model.project(&Point3::new(0.0, 0.0, 0.0)), None);
    }

    #[test]
    fn nan_intrinsics_are_not_sound() {
        let model = CameraModel::pinhole(640, 192, FRAC_PI_2);
        assert!(model.is_sound());
        assert!(!CameraModel { fx: f64::NAN, ..model }.is_sound());
        assert!(!CameraModel { fy: 0.0, ..model }.is_sound());
    }

    /// cv2.projectPoints and cv2.fisheye.projectPoints of OpenCV 5.0, by
    /// tests/fixtures/make_imaging.py.
    #[test]
    fn rays_land_where_opencv_puts_them() {
        let rays = [(0.0, 0.0), (0.1, -0.2), (-0.5, 0.4), (0.75, 0.3), (-0.05, 0.9), (1.2, -1.1)];
        let plumb_bob = [
            (322.5, 236.25),
            (361.89205, 155.4142975),
            (138.760558, 386.84910244),
            (582.841067859375, 343.8459178223438),
            (304.345974609375, 553.8692684570312),
            (834.7422, -245.85910875000008),
        ];
        let fisheye = [
            (322.5, 236.25),
            (361.94604303921335, 155.38561176961267),
            (142.07408944980887, 384.1992466511567),
            (579.6836842857326, 341.6953105571504),
            (305.87082524475306, 543.0582742343059),
            (633.3743302223878, -55.842339438118586),
        ];
        for (distortion, pixels) in [
            (Distortion::PlumbBob([-0.25, 0.08, 0.002, -0.003, 0.01]), plumb_bob),
            (Distortion::Fisheye([0.05, -0.02, 0.004, -0.001]), fisheye),
        ] {
            let camera = CameraModel {
                width: 640,
                height: 480,
                fx: 400.0,
                fy: 410.0,
                cx: 322.5,
                cy: 236.25,
                distortion,
            };
            for ((x, y), (u, v)) in rays.into_iter().zip(pixels) {
                let (u2, v2) = camera.distorted_pixel(x, y);
                assert!(
                    (u - u2).abs() < 1e-9 && (v - v2).abs() < 1e-9,
                    "{distortion:?} {x} {y}: {u2} {v2}"
                );
            }
        }
    }

    #[test]
    fn a_lens_model_is_valid_up_to_the_radius_where_its_polynomial_decreases() {
        // d/dr (r - 0.3 r^3) = 0 at r = sqrt(1 / 0.9).
        let valid_radius = Distortion::PlumbBob([-0.3, 0.0, 0.0, 0.0, 0.0]).valid_radius();
        assert!((valid_radius - (1.0_f64 / 0.9).sqrt()).abs() < 2e-3);
        // The same for the angle: 1 - 0.9 a^2 = 0.
        let valid_radius = Distortion::Fisheye([-0.3, 0.0, 0.0, 0.0]).valid_radius();
        assert!((ComplexField::atan(valid_radius) - (1.0_f64 / 0.9).sqrt()).abs() < 2e-3);
        assert_eq!(Distortion::None.valid_radius(), f64::INFINITY);
        assert_eq!(Distortion::PlumbBob([0.1, 0.01, 0.0, 0.0, 0.0]).valid_radius(), f64::INFINITY);
    }

    #[test]
    fn nan_distortion_is_not_sound() {
        let model = CameraModel::pinhole(640, 192, FRAC_PI_2);
        assert!(
            !CameraModel { distortion: Distortion::PlumbBob([f64::NAN; 5]), ..model }.is_sound()
        );
        assert!(
            !CameraModel { distortion: Distortion::Fisheye([f64::INFINITY; 4]), ..model }
                .is_sound()
        );
    }

    proptest! {
        #[test]
        fn a_lens_with_zero_coefficients_does_not_distort(x in -2.0..2.0, y in -2.0..2.0) {
            prop_assert_eq!(Distortion::PlumbBob([0.0; 5]).distort(x, y), (x, y));
            // The equidistant fisheye: the distance from the axis is the angle.
            let (dx, dy) = Distortion::Fisheye([0.0; 4]).distort(x, y);
            prop_assert!((dx.hypot(dy) - x.hypot(y).atan()).abs() < 1e-12);
        }

        #[test]
        fn projecting_an_unprojected_pixel_gives_the_pixel(
            u in -10.0..650.0,
            v in -10.0..200.0,
            depth in 0.1..20.0,
        ) {
            let model = CameraModel::pinhole(640, 192, FRAC_PI_2);
            let (u2, v2) = model.project(&model.unproject(u, v, depth)).unwrap();
            prop_assert!((u - u2).abs() < 1e-9 && (v - v2).abs() < 1e-9);
        }

        #[test]
        fn resizing_keeps_the_direction_behind_every_point_of_the_image(
            x in 0.0..1.0f64,
            y in 0.0..1.0f64,
        ) {
            let model = CameraModel::pinhole(640, 480, 1.2);
            let small = model.resized(320, 96);
            let large_ray = model.ray(x * model.width as f64 - 0.5, y * model.height as f64 - 0.5);
            let small_ray = small.ray(x * small.width as f64 - 0.5, y * small.height as f64 - 0.5);
            prop_assert!((large_ray - small_ray).norm() < 1e-12);
        }

        #[test]
        fn cropping_keeps_the_direction_behind_a_pixel(u in 0.0..100.0, v in 0.0..50.0) {
            let model = CameraModel::pinhole(640, 480, 1.2);
            let part = model.cropped(40.0, 30.0, 100, 50);
            prop_assert!((model.ray(u + 40.0, v + 30.0) - part.ray(u, v)).norm() < 1e-12);
        }
    }
}
