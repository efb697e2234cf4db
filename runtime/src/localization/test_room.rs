//! A flat of straight walls whose scans follow from geometry, and a robot whose wheels are wrong in the usual ways.

use hal::{LaserScan, Pose2, Range, ScanGeometry};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// A wall from one point to another.
pub(crate) type Wall = [[f64; 2]; 2];

/// The sides of a rectangle.
pub(crate) fn rectangle(from: [f64; 2], to: [f64; 2]) -> [Wall; 4] {
    let ([a, b], [c, d]) = (from, to);
    [[[a, b], [c, b]], [[c, b], [c, d]], [[c, d], [a, d]], [[a, d], [a, b]]]
}

/// A room of 6 x 5 m with a table, a shelf, a pillar and a slanting board.
pub(crate) fn furnished_room() -> Vec<Wall> {
    let mut walls = Vec::new();
    walls.extend(rectangle([-2.0, -2.5], [4.0, 2.5]));
    walls.extend(rectangle([2.6, 1.2], [3.4, 2.0]));
    walls.extend(rectangle([-1.9, -2.4], [-0.9, -2.0]));
    walls.extend(rectangle([1.5, -2.2], [1.8, -1.9]));
    walls.push([[-1.8, 1.0], [-1.2, 2.2]]);
    walls
}

/// Distance along the ray to the nearest wall.
pub(crate) fn cast(walls: &[Wall], x: f64, y: f64, angle_rad: f64) -> f64 {
    let (dy, dx) = angle_rad.sin_cos();
    let mut nearest = f64::INFINITY;
    for [[ax, ay], [bx, by]] in walls {
        let (ex, ey) = (bx - ax, by - ay);
        let det = ex * dy - ey * dx;
        if det.abs() < 1e-12 {
            continue;
        }
        let along = (ex * (ay - y) - ey * (ax - x)) / det;
        let across = (dx * (ay - y) - dy * (ax - x)) / det;
        if along > 0.0 && along < nearest && (0.0..=1.0).contains(&across) {
            nearest = along;
        }
    }
    nearest
}

/// A robot in a flat.
pub(crate) struct TestRobot {
    pub walls: Vec<Wall>,
    pub geometry: ScanGeometry,
    pub truth: Pose2,
    pub wheel: Pose2,
    pub time_ns: u64,
    /// Shares of distance and yaw, and radians per metre.
    pub wheel_noise: [f64; 2],
    pub drift_rad_per_m: f64,
    pub range_noise_m: f64,
    /// The motion of the current step.
    motion: Pose2,
    rng: Pcg64Mcg,
}

/// Time of one step.
pub(crate) const STEP_NS: u64 = 100_000_000;

impl TestRobot {
    pub(crate) fn new(walls: Vec<Wall>, seed: u64) -> Self {
        Self {
            walls,
            geometry: ScanGeometry::UTM_30LX,
            truth: Pose2::IDENTITY,
            wheel: Pose2::IDENTITY,
            time_ns: 0,
            wheel_noise: [0.01, 0.02],
            drift_rad_per_m: 0.03,
            range_noise_m: 0.02,
            motion: Pose2::IDENTITY,
            rng: Pcg64Mcg::seed_from_u64(seed),
        }
    }

    /// In the furnished room, where [`round_trip`] begins.
    pub(crate) fn in_room(seed: u64) -> Self {
        Self { truth: Pose2::new(0.0, -1.4, 0.0), ..Self::new(furnished_room(), seed) }
    }

    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.rng.random_range(0.0..1.0)).sum::<f64>() - 6.0
    }

    /// Drives forward, then rotates, with wheels that report something else.
    pub(crate) fn step(&mut self, forward_m: f64, yaw_rad: f64) {
        self.motion = Pose2::new(forward_m, 0.0, yaw_rad);
        self.truth = self.truth.compose(&self.motion);
        let distance = forward_m * (1.0 + self.wheel_noise[0] * self.normal());
        let yaw = yaw_rad * (1.0 + self.wheel_noise[1] * self.normal())
            + self.drift_rad_per_m * forward_m;
        self.wheel = self.wheel.compose(&Pose2::new(distance, 0.0, yaw));
        self.time_ns += STEP_NS;
    }

    /// A scan whose middle is now, of beams that are spread over the sweep while the robot moves as in the last step.
    pub(crate) fn scan(&mut self) -> LaserScan {
        let geometry = self.geometry;
        let mut scan = LaserScan::empty(geometry);
        scan.time_ns = self.time_ns - geometry.period_ns / 2;
        for beam in 0..geometry.beams {
            let share = (beam as f64 + 0.5) / geometry.beams as f64 - 0.5;
            let after = share * geometry.period_ns as f64 / STEP_NS as f64;
            let moved = Pose2::new(self.motion.x_m * after, 0.0, self.motion.yaw_rad * after);
            let pose = self.truth.compose(&moved);
            let exact =
                cast(&self.walls, pose.x_m, pose.y_m, pose.yaw_rad + geometry.angle_rad(beam));
            let range_m = exact + self.range_noise_m * self.normal();
            let is_hit = range_m < f64::from(geometry.range_max_m);
            scan.ranges.push(if is_hit { Range::Hit(range_m as f32) } else { Range::NoReturn });
        }
        scan
    }
}

/// Forward and yaw of each step of a drive around the middle of the furnished room, with stops to look around.
pub(crate) fn round_trip(steps: usize) -> impl Iterator<Item = (f64, f64)> {
    (0..steps).map(|step| match step % 60 {
        0..40 => (0.03, 0.0),
        40..58 => (0.0, 2.5_f64.to_radians()),
        _ => (0.0, 0.0),
    })
}
