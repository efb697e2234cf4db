//! Intrinsics.

use nalgebra::{Point3, Vector3};

/// Lens distortion. Models and coefficient order as in OpenCV.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[non_exhaustive]
pub enum Distortion {
    /// A pinhole.
    #[default]
    None,
    /// Brown-Conrady: k1 k2 p1 p2 k3.
    PlumbBob([f64; 5]),
    /// Kannala-Brandt: k1 k2 k3 k4.
    Fisheye([f64; 4]),
}

/// A camera's intrinsics, in pixels, with pixel centres at integer coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraModel {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Focal length along x, pixels.
    pub fx: f64,
    /// Focal length along y, pixels.
    pub fy: f64,
    /// Column of the optical axis.
    pub cx: f64,
    /// Row of the optical axis.
    pub cy: f64,
    /// Lens distortion of the pictures.
    pub distortion: Distortion,
}

impl CameraModel {
    /// A square-pixel pinhole with the optical axis in the middle and the given horizontal field of view.
    /// 640x192 at 90 degrees: f = 320, cx = 319.5, cy = 95.5.
    #[must_use]
    pub fn pinhole(width: usize, height: usize, horizontal_fov_rad: f64) -> Self {
        let focal = width as f64 / 2.0 / nalgebra::ComplexField::tan(horizontal_fov_rad / 2.0);
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

    /// The point at z-depth `depth_m` behind pixel (`u`, `v`), in `camera_optical`. Ignores distortion.
    #[must_use]
    pub fn unproject(&self, u: f64, v: f64, depth_m: f64) -> Point3<f64> {
        Point3::from(self.ray(u, v) * depth_m)
    }

    /// The direction behind pixel (`u`, `v`), scaled so that z = 1. Ignores distortion.
    #[must_use]
    pub fn ray(&self, u: f64, v: f64) -> Vector3<f64> {
        Vector3::new((u - self.cx) / self.fx, (v - self.cy) / self.fy, 1.0)
    }

    /// The pixel of a point in `camera_optical`, or `None` when it is not in front of the camera. May lie outside the
    /// picture. Ignores distortion.
    #[must_use]
    pub fn project(&self, point: &Point3<f64>) -> Option<(f64, f64)> {
        (point.z > 0.0).then(|| (self.fx * point.x / point.z + self.cx, self.fy * point.y / point.z + self.cy))
    }

    /// The model of the picture after cutting out `width` x `height` pixels from column `left`, row `top`.
    #[must_use]
    pub fn cropped(&self, left: f64, top: f64, width: usize, height: usize) -> Self {
        Self { width, height, cx: self.cx - left, cy: self.cy - top, ..*self }
    }

    /// The model of the picture after resampling to `width` x `height`, with the pictures' outer edges aligned (the
    /// half-pixel convention of OpenCV's `resize`).
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

    /// Whether this can be a camera: a size, positive finite focal lengths, a finite centre.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        let finite = [self.fx, self.fy, self.cx, self.cy].iter().all(|value| value.is_finite());
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

    proptest! {
        #[test]
        fn projecting_an_unprojected_pixel_gives_the_pixel(u in -10.0..650.0, v in -10.0..200.0, depth in 0.1..20.0) {
            let model = CameraModel::pinhole(640, 192, FRAC_PI_2);
            let (u2, v2) = model.project(&model.unproject(u, v, depth)).unwrap();
            prop_assert!((u - u2).abs() < 1e-9 && (v - v2).abs() < 1e-9);
        }

        #[test]
        fn resizing_keeps_the_direction_behind_every_place_of_the_picture(x in 0.0..1.0f64, y in 0.0..1.0f64) {
            let model = CameraModel::pinhole(640, 480, 1.2);
            let small = model.resized(320, 96);
            let at = |m: &CameraModel| m.ray(x * m.width as f64 - 0.5, y * m.height as f64 - 0.5);
            prop_assert!((at(&model) - at(&small)).norm() < 1e-12);
        }

        #[test]
        fn cropping_keeps_the_direction_behind_a_pixel(u in 0.0..100.0, v in 0.0..50.0) {
            let model = CameraModel::pinhole(640, 480, 1.2);
            let part = model.cropped(40.0, 30.0, 100, 50);
            prop_assert!((model.ray(u + 40.0, v + 30.0) - part.ray(u, v)).norm() < 1e-12);
        }
    }
}
