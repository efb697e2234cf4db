//! What the newest scan of the LiDAR tells about the cells of an image: in front of what the scanner hit there is floor, and above it
//! stands a wall.
//!
//! A scan is a line, and an image is not: shelves, table tops and everything that hangs is in front of the wall or behind the hit. How
//! often the assumption holds is measured in each image (`wall_agreement.rs`).

use hal::{CameraModel, LaserScan, Pose2, Pose3};
use nalgebra::{Point2, Vector3};

use super::confidence::logit;
use crate::snapshot::remembers;

/// Directions around the camera, 0.5 degrees each: as fine as a cell of 4 pixels in the middle of a 640 pixel wide image of 90 degrees.
const DIRECTIONS: usize = 720;
/// A direction without a hit takes the nearest hit within this many directions: 2 degrees, because scanners with few beams leave gaps.
const REACH: usize = 4;
/// An older scan tells nothing. A scanner with 5.5 revolutions per second is at most this late.
const MAX_AGE_NS: u64 = 300_000_000;

/// What a scan tells about one cell.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Wall {
    /// Inverse depth, 1/m; 0: the scanner has hit nothing in this direction.
    pub inverse_depth: f32,
    /// Whether the ray meets the floor before the wall.
    pub is_floor: bool,
}

impl Wall {
    /// The features of the probability that it is right: a constant, the logit of the share of the cells around that agree with their
    /// walls, and whether it is floor.
    #[must_use]
    pub fn features(&self, share: f32) -> [f32; 3] {
        [1.0, logit(share), f32::from(u8::from(self.is_floor))]
    }
}

/// The ray of a cell.
#[derive(Debug, Clone, Copy)]
struct Ray {
    /// Its direction around the camera.
    direction: usize,
    /// How far it travels over the floor per metre of depth.
    horizontal: f32,
    /// Inverse depth at which it meets the floor, 1/m; negative above the horizon.
    floor: f32,
}

/// Keeps the newest scan and tells what it means for each cell.
#[derive(Debug, Default)]
pub struct Walls {
    /// One per cell; none for a camera that is not on a robot.
    rays: Vec<Ray>,
    camera_in_base: Point2<f64>,
    /// Hits of the newest scan in `odom`, metres.
    hits: Vec<(f64, f64)>,
    /// When the scanner was halfway through that scan, monotonic.
    seen_ns: u64,
    distance_m: Vec<f32>,
    walls: Vec<Wall>,
}

impl Walls {
    /// Prepares for the cells of a camera that is mounted at `t_base_camera` on a robot that stands on the floor.
    pub fn new(cells: &CameraModel, t_base_camera: &Pose3) -> Self {
        Self {
            rays: (0..cells.width * cells.height)
                .map(|cell| {
                    let right = ((cell % cells.width) as f64 - cells.cx) / cells.fx;
                    let down = ((cell / cells.width) as f64 - cells.cy) / cells.fy;
                    let ray = t_base_camera.rotation * Vector3::new(right, down, 1.0);
                    Ray {
                        direction: direction(ray.x, ray.y),
                        horizontal: ray.x.hypot(ray.y) as f32,
                        floor: (-ray.z / t_base_camera.translation.z) as f32,
                    }
                })
                .collect(),
            camera_in_base: t_base_camera.translation.vector.xy().into(),
            ..Self::default()
        }
    }

    /// Keeps `scan`, which was taken at `t_odom_laser`.
    pub fn see(&mut self, scan: &LaserScan, t_odom_laser: &Pose2) {
        if self.rays.is_empty() {
            return;
        }
        self.seen_ns = scan.middle_ns();
        self.hits.clear();
        for (angle, range_m) in scan.hits() {
            let range_m = f64::from(range_m);
            self.hits.push(t_odom_laser.transform(range_m * angle.cos(), range_m * angle.sin()));
        }
    }

    /// What the newest scan tells about each cell of a frame that was taken at `time_ns` from `t_odom_base`; nothing when the scan is
    /// old.
    pub fn project(&mut self, t_odom_base: &Pose2, time_ns: u64) -> &[Wall] {
        self.distance_m.clear();
        self.distance_m.resize(DIRECTIONS, f32::INFINITY);
        if time_ns.abs_diff(self.seen_ns) <= MAX_AGE_NS {
            self.measure(t_odom_base);
        }
        self.walls.clear();
        self.walls.extend(self.rays.iter().map(|ray| {
            let distance_m = self.distance_m[ray.direction];
            let wall = ray.horizontal / distance_m;
            let is_known = distance_m.is_finite();
            Wall {
                inverse_depth: if is_known { wall.max(ray.floor) } else { 0.0 },
                is_floor: is_known && ray.floor > wall,
            }
        }));
        &self.walls
    }

    /// The result of the last [`project`](Self::project).
    pub fn last(&self) -> &[Wall] {
        &self.walls
    }

    /// The distance of the nearest hit in each direction around the camera.
    fn measure(&mut self, t_odom_base: &Pose2) {
        let t_base_odom = t_odom_base.inverse();
        for (x_m, y_m) in &self.hits {
            let (ahead_m, left_m) = t_base_odom.transform(*x_m, *y_m);
            let away = Point2::new(ahead_m, left_m) - self.camera_in_base;
            let nearest = &mut self.distance_m[direction(away.x, away.y)];
            *nearest = nearest.min(away.norm() as f32);
        }
        let measured = self.distance_m.clone();
        for gap in (0..DIRECTIONS).filter(|index| measured[*index].is_infinite()) {
            let mut around = (1..=REACH).map(|step| {
                let left = measured[(gap + step) % DIRECTIONS];
                left.min(measured[(gap + DIRECTIONS - step) % DIRECTIONS])
            });
            self.distance_m[gap] = around.find(|m| m.is_finite()).unwrap_or(f32::INFINITY);
        }
    }
}

fn direction(x: f64, y: f64) -> usize {
    let turns = (y.atan2(x) / std::f64::consts::TAU).rem_euclid(1.0);
    (turns * DIRECTIONS as f64) as usize % DIRECTIONS
}

remembers!(Walls: hits, seen_ns);

#[cfg(test)]
mod tests {
    use super::*;
    use hal::{Range, ScanGeometry, camera_mount};

    const WIDTH: usize = 160;
    const HEIGHT: usize = 48;
    const CAMERA_M: f64 = 0.8;

    fn cells() -> CameraModel {
        CameraModel::pinhole(WIDTH, HEIGHT, std::f64::consts::FRAC_PI_2)
    }

    fn walls() -> Walls {
        Walls::new(&cells(), &camera_mount(0.1, CAMERA_M, 0.0))
    }

    /// A scan that begins at 1 s, of a wall at x = 3 m before a scanner at `at`; nothing elsewhere.
    fn scan(at: &Pose2) -> LaserScan {
        let geometry = ScanGeometry::UTM_30LX;
        let mut scan = LaserScan::empty(geometry);
        scan.time_ns = 1_000_000_000;
        scan.ranges = (0..geometry.beams)
            .map(|beam| {
                let range_m = (3.0 - at.x_m) / (at.yaw_rad + geometry.angle_rad(beam)).cos();
                if (0.0..8.0).contains(&range_m) {
                    Range::Hit(range_m as f32)
                } else {
                    Range::NoReturn
                }
            })
            .collect();
        scan
    }

    fn at(row: usize, column: usize) -> usize {
        row * WIDTH + column
    }

    #[test]
    fn a_wall_stands_above_the_scan_and_floor_lies_before_it() {
        let mut walls = walls();
        let here = Pose2::new(0.5, 0.0, 0.0);
        walls.see(&scan(&Pose2::IDENTITY), &Pose2::IDENTITY);
        let seen = walls.project(&here, 1_050_000_000);
        // The camera is at x = 0.6 m, and the wall at x = 3 m.
        for row in [0, 20] {
            for column in [10, 80, 150] {
                let depth_m = 1.0 / seen[at(row, column)].inverse_depth;
                assert!((depth_m - 2.4).abs() < 0.03, "{depth_m}");
                assert!(!seen[at(row, column)].is_floor);
            }
        }
        let down = (47.0 - cells().cy) / cells().fy;
        let low = seen[at(47, 80)];
        assert!(!low.is_floor, "the floor would be at {} m", CAMERA_M / down);
        let far = walls.project(&Pose2::new(-2.0, 0.0, 0.0), 1_050_000_000)[at(47, 80)];
        assert!(far.is_floor);
        assert!((f64::from(far.inverse_depth) - down / CAMERA_M).abs() < 1e-6);
    }

    #[test]
    fn a_robot_that_has_rotated_since_the_scan_sees_the_wall_from_its_side() {
        let mut walls = walls();
        walls.see(&scan(&Pose2::IDENTITY), &Pose2::IDENTITY);
        let seen = walls.project(&Pose2::new(0.0, 0.0, 0.5), 1_000_000_000);
        // The column straight ahead meets the wall at an angle of 0.5 rad.
        let camera_m = 0.1 * 0.5_f64.cos();
        let expected = (3.0 - camera_m) / 0.5_f64.cos();
        let depth_m = 1.0 / f64::from(seen[at(20, 80)].inverse_depth);
        assert!((depth_m - expected).abs() < 0.03, "{depth_m} {expected}");
    }

    #[test]
    fn a_direction_without_a_return_tells_nothing_not_even_floor() {
        let mut walls = walls();
        let mut gap = scan(&Pose2::IDENTITY);
        // 10 degrees around the axis: 0.25 degrees per beam.
        gap.ranges[520..561].fill(Range::NoReturn);
        walls.see(&gap, &Pose2::IDENTITY);
        let seen = walls.project(&Pose2::IDENTITY, 1_000_000_000);
        assert_eq!(seen[at(47, 80)], Wall::default());
        assert!(seen[at(47, 40)].inverse_depth > 0.0);
    }

    #[test]
    fn an_old_scan_tells_nothing() {
        let mut walls = walls();
        walls.see(&scan(&Pose2::IDENTITY), &Pose2::IDENTITY);
        let seen = walls.project(&Pose2::IDENTITY, 1_000_000_000 + 2 * MAX_AGE_NS);
        assert!(seen.iter().all(|wall| *wall == Wall::default()));
    }

    #[test]
    fn a_camera_that_is_not_on_a_robot_has_no_walls() {
        let mut walls = Walls::default();
        walls.see(&scan(&Pose2::IDENTITY), &Pose2::IDENTITY);
        assert!(walls.project(&Pose2::IDENTITY, 1_000_000_000).is_empty());
    }
}
