//! The metric depth that the safety LiDAR measures in a camera frame: along one line, about one
//! pixel in each column.

use hal::{CameraModel, LaserScan, Pose2, Pose3, WheelFeedback};
use nalgebra::Point3;

use crate::tick::TickInput;

/// Limits of the time between the middle of a scan and a frame, nanoseconds. It may be two revolutions, because the newest whole
/// scan of a scanner of 10 revolutions a second has its middle up to 150 ms before a frame. The robot's own motion is taken out;
/// a person who walks at 1 m/s moves by 0.25 m in the longest of these times, 13 % at 2 m. Our own choice.
const APART_NS: [u64; 2] = [50_000_000, 250_000_000];
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
    pub t_base_camera: Pose3,
    pub t_base_laser: Pose3,
}

impl LidarView {
    /// The LiDAR pixels of a tick's frame; none if the frame or the scan is missing, or their times
    /// differ too much.
    #[must_use]
    pub fn of_tick(&self, input: &TickInput<'_>) -> Vec<LidarPixel> {
        let scan = input.scan.filter(|_| input.frame.is_some());
        // The wheel feedback has the time of the frame; the time of the tick itself is later.
        scan.map_or_else(Vec::new, |scan| self.at(scan, &input.scan_odom, &input.wheel))
    }

    /// The LiDAR pixels of a frame that was taken at the time of `wheel`; none if the time of the scan
    /// differs too much. `scan_odom` is the wheels' pose at the middle of the scan.
    #[must_use]
    pub fn at(
        &self,
        scan: &LaserScan,
        scan_odom: &Pose2,
        wheel: &WheelFeedback,
    ) -> Vec<LidarPixel> {
        let [shortest_ns, longest_ns] = APART_NS;
        let apart_ns = scan.geometry.period_ns.saturating_mul(2).clamp(shortest_ns, longest_ns);
        if scan.middle_ns().abs_diff(wheel.time_ns) > apart_ns {
            return Vec::new();
        }
        let t_frame_scan = wheel.odom.inverse().compose(scan_odom);
        let t_camera_base = self.t_base_camera.inverse();
        let points = scan.ranges.iter().enumerate().filter_map(|(beam, range)| {
            let range_m = f64::from(range.hit_m()?);
            let (sin, cos) = scan.geometry.angle_rad(beam).sin_cos();
            let point = self.t_base_laser * Point3::new(range_m * cos, range_m * sin, 0.0);
            // Where the robot was when it measured this beam, seen from where it took the frame.
            let after_s = scan.geometry.after_middle_s(beam);
            let base = t_frame_scan.compose(&wheel.twist.integrate(after_s));
            let (x_m, y_m) = base.transform(point.x, point.y);
            Some(t_camera_base * Point3::new(x_m, y_m, point.z))
        });
        project(points, &self.camera)
    }
}

/// The points, in `camera_optical`, that lie in the image, from left to right. Of several in one column the nearest is used,
/// because the others may be hidden behind it. Lens distortion is ignored, because frames are rectified before.
fn project(points: impl Iterator<Item = Point3<f64>>, camera: &CameraModel) -> Vec<LidarPixel> {
    let mut nearest: Vec<Option<LidarPixel>> = vec![None; camera.width];
    for point in points {
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
    use hal::{ImageView, Range, ScanGeometry, Twist2, camera_mount};

    fn scan_of(range: impl Fn(f64) -> Range) -> LaserScan {
        let geometry = ScanGeometry::UTM_30LX;
        let mut scan = LaserScan::empty(geometry);
        scan.ranges = (0..geometry.beams).map(|beam| range(geometry.angle_rad(beam))).collect();
        scan
    }

    fn view() -> LidarView {
        LidarView {
            camera: CameraModel::pinhole(640, 192, std::f64::consts::FRAC_PI_2),
            t_base_camera: camera_mount(0.0, 0.8, 0.0),
            t_base_laser: Pose3::translation(0.05, 0.0, 0.18),
        }
    }

    /// The pixels of a scan whose middle is the time of the frame, of a robot that stands.
    fn project_hits(scan: &LaserScan) -> Vec<LidarPixel> {
        let wheel = WheelFeedback { time_ns: scan.middle_ns(), ..WheelFeedback::default() };
        view().at(scan, &wheel.odom, &wheel)
    }

    #[test]
    fn a_wall_ahead_gives_one_row_of_equal_depths() {
        // The wall is 3 m ahead of the camera, 2.95 m ahead of the scanner.
        let wall = scan_of(|angle| match angle.cos() {
            cos if cos > 0.05 => Range::Hit((2.95 / cos) as f32),
            _ => Range::NoReturn,
        });
        let line = project_hits(&wall);
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
        for range in [Range::NoReturn, Range::TooNear, Range::Error, Range::Hit(f32::NAN)] {
            assert!(project_hits(&scan_of(|_| range)).is_empty(), "{range:?}");
        }
    }

    #[test]
    fn hits_behind_the_robot_are_not_in_the_image() {
        let behind =
            scan_of(|angle| if angle.abs() > 1.7 { Range::Hit(3.0) } else { Range::NoReturn });
        assert!(project_hits(&behind).is_empty());
    }

    #[test]
    fn of_two_hits_in_a_column_the_nearer_one_is_used() {
        let mut nearer = true;
        let both = scan_of(|_| Range::Hit(4.0));
        let mut mixed = both.clone();
        for range in &mut mixed.ranges {
            nearer = !nearer;
            *range = Range::Hit(if nearer { 3.0 } else { 4.0 });
        }
        let far = project_hits(&both);
        let mixed = project_hits(&mixed);
        assert!(
            mixed.iter().all(|point| point.depth_m < 4.06)
                && far.iter().any(|point| point.depth_m > 3.9)
        );
        let crowded = mixed.iter().filter(|point| point.depth_m < 3.1).count();
        assert!(crowded * 10 > mixed.len() * 4, "{crowded} of {}", mixed.len());
    }

    #[test]
    fn the_time_of_a_scan_is_compared_with_that_of_the_frame_and_not_of_the_tick() {
        let view = view();
        // The middle of a scan is 12.5 ms after its beginning.
        assert!(points(&view, 938, true) > 300 && points(&view, 1037, true) > 300);
        // The first scan has the time of the tick, but not that of the frame.
        assert_eq!(
            (points(&view, 1180, true), points(&view, 937, true), points(&view, 1000, false)),
            (0, 0, 0)
        );
    }

    /// The newest scan of an LD06 is 120 ms old, and the robot rotates by .12 rad until the frame is taken.
    #[test]
    fn a_wall_is_where_it_is_in_the_frame_although_a_slow_scanner_saw_it_before() {
        let geometry = ScanGeometry::LD06;
        let twist = Twist2 { linear_mps: 0.0, angular_radps: 1.0 };
        let scan_odom = Pose2::new(0.0, 0.0, -0.12);
        // A wall 3 m ahead of the robot in the frame.
        let ranges = (0..geometry.beams).map(|beam| {
            let yaw_rad = -0.12 + geometry.after_middle_s(beam);
            let towards_wall = (yaw_rad + geometry.angle_rad(beam)).cos();
            let range_m = (3.0 - 0.05 * yaw_rad.cos()) / towards_wall;
            if towards_wall > 0.1 { Range::Hit(range_m as f32) } else { Range::NoReturn }
        });
        let scan = LaserScan { time_ns: 1_000_000_000, geometry, ranges: ranges.collect() };
        let frame_ns = scan.middle_ns() + 120_000_000;
        let wheel = WheelFeedback { time_ns: frame_ns, twist, ..WheelFeedback::default() };
        let line = view().at(&scan, &scan_odom, &wheel);
        assert!(line.len() > 90, "{}", line.len());
        assert!(line.iter().all(|point| (point.depth_m - 3.0).abs() < 0.002), "{line:?}");
        let late = WheelFeedback { time_ns: frame_ns + 81_000_000, ..wheel };
        assert!(view().at(&scan, &scan_odom, &late).is_empty(), "more than two revolutions");
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
