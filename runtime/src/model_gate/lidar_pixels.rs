//! The metric depth that the safety LiDAR measures in a camera frame: along one line, about one
//! pixel in each column.

use hal::{CameraModel, LaserScan, Pose3};
use nalgebra::Point3;

use crate::tick::TickInput;

/// Largest time difference between a scan and a frame. At 40 degrees per second the robot rotates 2
/// degrees meanwhile, which moves returns to other columns.
const MAX_TIME_DIFFERENCE_NS: u64 = 50_000_000;
/// Depths within this factor of the LiDAR's depth are right (Eigen et al. 2014).
const DELTA1: f32 = 1.25;
/// Returns closer to the camera than this are ignored, metres: no object is that close.
const NEAREST_M: f64 = 0.1;

/// A pixel whose depth the LiDAR has measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LidarPixel {
    /// Column of the pixel in the image.
    pub u: usize,
    /// Row of the pixel in the image.
    pub v: usize,
    /// z-depth in the camera's frame, metres.
    pub depth_m: f32,
}

impl LidarPixel {
    /// Whether a depth at this pixel, metres, is right: within a factor of 1.25 of the LiDAR's. 0
    /// (no depth) is not right.
    #[must_use]
    pub fn agrees(&self, depth_m: f32) -> bool {
        (depth_m / self.depth_m).max(self.depth_m / depth_m) < DELTA1
    }
}

/// Projects LiDAR scans into camera frames.
#[derive(Debug, Clone, Copy)]
pub struct LidarView {
    pub camera: CameraModel,
    /// Maps points of `laser` into `camera_optical`.
    pub t_camera_laser: Pose3,
}

impl LidarView {
    /// The LiDAR pixels of a tick's frame; none if the frame or the scan is missing, or their times
    /// differ too much.
    #[must_use]
    pub fn of_tick(&self, input: &TickInput<'_>) -> Vec<LidarPixel> {
        let scan = input.scan.filter(|_| input.frame.is_some());
        // The wheel feedback has the time of the frame; the time of the tick itself is later.
        scan.map_or_else(Vec::new, |scan| self.at(scan, input.wheel.time_ns))
    }

    /// The LiDAR pixels of a frame that was taken at `frame_ns`; none if the time of the scan
    /// differs too much.
    #[must_use]
    pub fn at(&self, scan: &LaserScan, frame_ns: u64) -> Vec<LidarPixel> {
        if scan.time_ns.abs_diff(frame_ns) > MAX_TIME_DIFFERENCE_NS {
            return Vec::new();
        }
        project_hits(scan, &self.camera, &self.t_camera_laser)
    }
}

/// The hits of a scan that lie in the image, from left to right. `t_camera_laser` maps points of
/// `laser` into `camera_optical`. Of several hits in one column the nearest is used, because the
/// others may be hidden behind it. Lens distortion is ignored, because frames are rectified before.
fn project_hits(scan: &LaserScan, camera: &CameraModel, t_camera_laser: &Pose3) -> Vec<LidarPixel> {
    let mut nearest: Vec<Option<LidarPixel>> = vec![None; camera.width];
    for (angle, range_m) in scan.hits() {
        let range_m = f64::from(range_m);
        let point = t_camera_laser * Point3::new(range_m * angle.cos(), range_m * angle.sin(), 0.0);
        let pixel = camera.project(&point).filter(|_| point.z > NEAREST_M);
        let Some((u, v)) = pixel.map(|(u, v)| (u.round(), v.round())) else { continue };
        // NaN fails these comparisons.
        let inside = u >= 0.0 && v >= 0.0 && u < camera.width as f64 && v < camera.height as f64;
        if !inside {
            continue;
        }
        let found = LidarPixel { u: u as usize, v: v as usize, depth_m: point.z as f32 };
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
    fn a_wall_ahead_gives_one_row_of_equal_depths() {
        let (camera, t_camera_laser) = mounts();
        // The wall is 3 m ahead of the camera, 2.95 m ahead of the scanner.
        let wall = scan_of(|angle| match angle.cos() {
            cos if cos > 0.05 => Range::Hit((2.95 / cos) as f32),
            _ => Range::NoReturn,
        });
        let line = project_hits(&wall, &camera, &t_camera_laser);
        assert!(line.len() > 300, "{}", line.len());
        // The scanner's plane is 0.62 m below the camera; at 3 m this is 320 * 0.62 / 3 rows below
        // the image centre.
        let row = (95.5 + 320.0 * 0.62 / 3.0f64).round() as usize;
        for point in &line {
            assert!((point.depth_m - 3.0).abs() < 1e-3 && point.v == row, "{point:?}");
        }
        assert!(line.is_sorted_by_key(|point| point.u));
    }

    #[test]
    fn beams_without_a_hit_give_no_depth() {
        let (camera, t_camera_laser) = mounts();
        for range in [Range::NoReturn, Range::TooNear, Range::Error, Range::Hit(f32::NAN)] {
            assert!(
                project_hits(&scan_of(|_| range), &camera, &t_camera_laser).is_empty(),
                "{range:?}"
            );
        }
    }

    #[test]
    fn hits_behind_the_robot_are_not_in_the_image() {
        let (camera, t_camera_laser) = mounts();
        let behind =
            scan_of(|angle| if angle.abs() > 1.7 { Range::Hit(3.0) } else { Range::NoReturn });
        assert!(project_hits(&behind, &camera, &t_camera_laser).is_empty());
    }

    #[test]
    fn of_two_hits_in_a_column_the_nearer_one_is_used() {
        let (camera, t_camera_laser) = mounts();
        let mut nearer = true;
        let both = scan_of(|_| Range::Hit(4.0));
        let mut mixed = both.clone();
        for range in &mut mixed.ranges {
            nearer = !nearer;
            *range = Range::Hit(if nearer { 3.0 } else { 4.0 });
        }
        let far = project_hits(&both, &camera, &t_camera_laser);
        let mixed = project_hits(&mixed, &camera, &t_camera_laser);
        assert!(
            mixed.iter().all(|point| point.depth_m < 4.06)
                && far.iter().any(|point| point.depth_m > 3.9)
        );
        let crowded = mixed.iter().filter(|point| point.depth_m < 3.1).count();
        assert!(crowded * 10 > mixed.len() * 4, "{crowded} of {}", mixed.len());
    }

    #[test]
    fn the_time_of_a_scan_is_compared_with_that_of_the_frame_and_not_of_the_tick() {
        let (camera, t_camera_laser) = mounts();
        let view = LidarView { camera, t_camera_laser };
        assert!(points(&view, 950, true) > 300 && points(&view, 1050, true) > 300);
        // The first scan has the time of the tick, but not that of the frame.
        assert_eq!(
            (points(&view, 1180, true), points(&view, 949, true), points(&view, 1000, false)),
            (0, 0, 0)
        );
    }

    fn points(view: &LidarView, scan_ms: u64, with_frame: bool) -> usize {
        let scan = LaserScan { time_ns: scan_ms * 1_000_000, ..scan_of(|_| Range::Hit(3.0)) };
        let CameraModel { width, height, .. } = view.camera;
        let pixels = vec![0; 3 * width * height];
        let frame = ImageView::rgb8(width, height, &pixels).unwrap();
        let wheel = WheelFeedback { time_ns: 1_000_000_000, ..WheelFeedback::default() };
        view.of_tick(&TickInput {
            tick: 0,
            time_ns: 1_180_000_000,
            wheel,
            scan: Some(&scan),
            scan_odom: wheel.odom,
            imu: None,
            outside: None,
            frame: with_frame.then_some(frame),
            truth: None,
            task: None,
            areas: &[],
            orders: &[],
            safety: &SafetyReport::default(),
        })
        .len()
    }
}
