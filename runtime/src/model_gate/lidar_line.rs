//! What the safety LiDAR says about a picture: metric depth along a line, about one pixel in each column.

use hal::{CameraModel, LaserScan, Pose3};
use nalgebra::Point3;

use crate::tick::TickInput;

/// A scan this much older or newer than its picture shows other columns: at 20 degrees a second, 1 degree.
const MAX_APART_NS: u64 = 50_000_000;
/// Depths within this factor of the truth are right (Eigen et al. 2014).
const DELTA1: f32 = 1.25;
/// What is nearer to the camera than this is no part of a room, metres.
const NEAREST_M: f64 = 0.1;

/// A pixel whose distance the LiDAR knows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinePoint {
    /// Column.
    pub u: usize,
    /// Row.
    pub v: usize,
    /// z-depth, metres.
    pub depth_m: f32,
}

impl LinePoint {
    /// Whether a depth here, metres, is right: within 25 % of the LiDAR's. 0, which is no depth, is not.
    #[must_use]
    pub fn agrees(&self, depth_m: f32) -> bool {
        (depth_m / self.depth_m).max(self.depth_m / depth_m) < DELTA1
    }
}

/// The safety LiDAR as the camera sees it.
#[derive(Debug, Clone, Copy)]
pub struct LidarView {
    /// The camera.
    pub camera: CameraModel,
    /// Maps points of `laser` into `camera_optical`.
    pub t_camera_laser: Pose3,
}

impl LidarView {
    /// What a turn's scan says of its picture; nothing where one of the two is missing or they are of different moments.
    #[must_use]
    pub fn of_turn(&self, input: &TickInput<'_>) -> Vec<LinePoint> {
        let scan = input.scan.filter(|_| input.frame.is_some());
        // The wheels' measurement is that of the picture's moment; the turn itself is later.
        scan.map_or_else(Vec::new, |scan| self.at(scan, input.wheel.time_ns))
    }

    /// What a scan says of a picture that was taken at `picture_ns`; nothing where they are of different moments.
    #[must_use]
    pub fn at(&self, scan: &LaserScan, picture_ns: u64) -> Vec<LinePoint> {
        if scan.time_ns.abs_diff(picture_ns) > MAX_APART_NS {
            return Vec::new();
        }
        lidar_line(scan, &self.camera, &self.t_camera_laser)
    }
}

/// The hits of a scan that lie in the picture, left to right; `t_camera_laser` maps points of `laser` into `camera_optical`. Of
/// several hits in one column the nearest counts: the others may be hidden behind it. No return is not a distance, and neither
/// is an error. Distortion is ignored, as everywhere behind the front end.
fn lidar_line(scan: &LaserScan, camera: &CameraModel, t_camera_laser: &Pose3) -> Vec<LinePoint> {
    let mut nearest: Vec<Option<LinePoint>> = vec![None; camera.width];
    for (angle, range_m) in scan.hits() {
        let range_m = f64::from(range_m);
        let point = t_camera_laser * Point3::new(range_m * angle.cos(), range_m * angle.sin(), 0.0);
        let pixel = camera.project(&point).filter(|_| point.z > NEAREST_M);
        let Some((u, v)) = pixel.map(|(u, v)| (u.round(), v.round())) else { continue };
        // NaN is in no picture.
        let inside = u >= 0.0 && v >= 0.0 && u < camera.width as f64 && v < camera.height as f64;
        if !inside {
            continue;
        }
        let found = LinePoint { u: u as usize, v: v as usize, depth_m: point.z as f32 };
        if let Some(best) = nearest.get_mut(found.u)
            && best.is_none_or(|best| found.depth_m < best.depth_m)
        {
            *best = Some(found);
        }
    }
    nearest.into_iter().flatten().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tick::SafetyReport;
    use hal::{ImageView, Range, ScanGeometry, WheelFeedback, camera_mount};

    fn scan_of(range: impl Fn(f64) -> Range) -> LaserScan {
        let geometry = ScanGeometry::UTM_30LX;
        let mut scan = LaserScan::empty(geometry);
        scan.ranges = (0..geometry.beams).map(|beam| range(geometry.angle_rad(beam))).collect();
        scan
    }

    fn mounts() -> (CameraModel, Pose3) {
        let camera = CameraModel::pinhole(640, 192, std::f64::consts::FRAC_PI_2);
        (camera, camera_mount(0.0, 0.8, 0.0).inverse() * Pose3::translation(0.05, 0.0, 0.18))
    }

    #[test]
    fn a_wall_across_the_way_is_one_row_of_one_depth() {
        let (camera, t_camera_laser) = mounts();
        // The wall is 3 m ahead of the camera, 2.95 m ahead of the scanner.
        let wall = scan_of(|angle| match angle.cos() {
            cos if cos > 0.05 => Range::Hit((2.95 / cos) as f32),
            _ => Range::NoReturn,
        });
        let line = lidar_line(&wall, &camera, &t_camera_laser);
        assert!(line.len() > 300, "{}", line.len());
        // 0.62 m below the camera at 3 m: 320 * 0.62 / 3 rows below the middle.
        let row = (95.5 + 320.0 * 0.62 / 3.0f64).round() as usize;
        for point in &line {
            assert!((point.depth_m - 3.0).abs() < 1e-3 && point.v == row, "{point:?}");
        }
        assert!(line.is_sorted_by_key(|point| point.u));
    }

    #[test]
    fn nothing_came_back_and_errors_are_no_depth() {
        let (camera, t_camera_laser) = mounts();
        for range in [Range::NoReturn, Range::TooNear, Range::Error, Range::Hit(f32::NAN)] {
            assert!(
                lidar_line(&scan_of(|_| range), &camera, &t_camera_laser).is_empty(),
                "{range:?}"
            );
        }
    }

    #[test]
    fn what_stands_behind_the_robot_is_not_in_the_picture() {
        let (camera, t_camera_laser) = mounts();
        let behind =
            scan_of(|angle| if angle.abs() > 1.7 { Range::Hit(3.0) } else { Range::NoReturn });
        assert!(lidar_line(&behind, &camera, &t_camera_laser).is_empty());
    }

    #[test]
    fn of_two_hits_in_a_column_the_nearer_counts() {
        let (camera, t_camera_laser) = mounts();
        let mut nearer = true;
        let both = scan_of(|_| Range::Hit(4.0));
        let mut mixed = both.clone();
        for range in &mut mixed.ranges {
            nearer = !nearer;
            *range = Range::Hit(if nearer { 3.0 } else { 4.0 });
        }
        let (far, mixed) = (
            lidar_line(&both, &camera, &t_camera_laser),
            lidar_line(&mixed, &camera, &t_camera_laser),
        );
        assert!(
            mixed.iter().all(|point| point.depth_m < 4.06)
                && far.iter().any(|point| point.depth_m > 3.9)
        );
        let crowded = mixed.iter().filter(|point| point.depth_m < 3.1).count();
        assert!(crowded * 10 > mixed.len() * 4, "{crowded} of {}", mixed.len());
    }

    #[test]
    fn a_scan_counts_by_the_moment_of_its_picture_however_late_the_turn_is() {
        let (camera, t_camera_laser) = mounts();
        let view = LidarView { camera, t_camera_laser };
        let pixels = vec![0; 3 * camera.width * camera.height];
        let points = |scan_ms: u64, with_frame: bool| {
            let scan = LaserScan { time_ns: scan_ms * 1_000_000, ..scan_of(|_| Range::Hit(3.0)) };
            let frame = ImageView::rgb8(camera.width, camera.height, &pixels).unwrap();
            let wheel = WheelFeedback { time_ns: 1_000_000_000, ..WheelFeedback::default() };
            view.of_turn(&TickInput {
                tick: 0,
                time_ns: 1_180_000_000,
                wheel,
                scan: Some(&scan),
                scan_odom: wheel.odom,
                frame: with_frame.then_some(frame),
                truth: None,
                safety: &SafetyReport::default(),
            })
            .len()
        };
        assert!(points(950, true) > 300 && points(1050, true) > 300);
        // Of the turn's moment, but not of the picture's.
        assert_eq!((points(1180, true), points(949, true), points(1000, false)), (0, 0, 0));
    }
}
