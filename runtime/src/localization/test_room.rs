//! A flat of straight walls whose scans follow from geometry, and a robot whose wheels are wrong in the usual ways.

use hal::{LaserScan, Pose2, Range, ScanGeometry};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use crate::imu::ImuInput;

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
    /// Where the scanner really is.
    pub t_base_laser: Pose2,
    pub range_noise_m: f64,
    /// Time by which scans are stamped late, s: less than that of a step.
    pub scan_late_s: f64,
    /// What the gyroscope reports, radians; it rotates at 0.02 rad/s while it stands, and by 1 % too much.
    gyro_rad: f64,
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
            t_base_laser: Pose2::IDENTITY,
            range_noise_m: 0.02,
            scan_late_s: 0.0,
            gyro_rad: 0.0,
            motion: Pose2::IDENTITY,
            rng: Pcg64Mcg::seed_from_u64(seed),
        }
    }

    /// In the furnished room, where [`round_trip`] begins.
    pub(crate) fn in_room(seed: u64) -> Self {
        Self { truth: Pose2::new(0.0, -1.4, 0.0), ..Self::new(furnished_room(), seed) }
    }

    /// In the ring corridor, where [`around_the_ring`] begins.
    pub(crate) fn in_ring(seed: u64) -> Self {
        let truth = Pose2::new(0.0, -0.8, 0.0);
        Self { truth, drift_rad_per_m: 0.06, ..Self::new(ring_corridor(), seed) }
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
        self.gyro_rad += 1.01 * yaw_rad + 0.002;
        self.time_ns += STEP_NS;
    }

    /// The gyroscope's angle after the last step, in which the scan has its middle.
    pub(crate) fn imu(&self) -> ImuInput {
        ImuInput { gaps: 0, yaw_rad: self.gyro_rad, yaw_at_scan_rad: self.gyro_rad, tilt_rad: None }
    }

    /// A scan whose middle is said to be now, of beams that are spread over the revolution while the robot moves as in the last step.
    pub(crate) fn scan(&mut self) -> LaserScan {
        let geometry = self.geometry;
        let mut scan = LaserScan::empty(geometry);
        scan.time_ns = self.time_ns - geometry.period_ns / 2;
        for beam in 0..geometry.beams {
            let after_s = geometry.after_middle_s(beam) - self.scan_late_s;
            let after = after_s * 1e9 / STEP_NS as f64;
            let moved = Pose2::new(self.motion.x_m * after, 0.0, self.motion.yaw_rad * after);
            let pose = self.truth.compose(&moved).compose(&self.t_base_laser);
            let exact =
                cast(&self.walls, pose.x_m, pose.y_m, pose.yaw_rad + geometry.angle_rad(beam));
            let range_m = exact + self.range_noise_m * self.normal();
            let is_hit = range_m < f64::from(geometry.range_max_m);
            scan.ranges.push(if is_hit { Range::Hit(range_m as f32) } else { Range::NoReturn });
        }
        scan
    }
}

/// A corridor of 1.6 m width around a block of 10 x 6 m, with doors, boxes and pillars along it.
pub(crate) fn ring_corridor() -> Vec<Wall> {
    let mut walls = Vec::new();
    walls.extend(rectangle([0.0, 0.0], [10.0, 6.0]));
    walls.extend(rectangle([-1.6, -1.6], [11.6, 7.6]));
    for [x, y] in [[2.0, -1.6], [7.5, -1.6], [11.3, 1.5], [11.3, 4.0], [6.0, 7.3], [-1.6, 2.5]] {
        walls.extend(rectangle([x, y], [x + 0.3, y + 0.3]));
    }
    for [x, y] in [[4.0, -0.2], [10.0, 2.6], [3.0, 6.0], [-0.25, 4.2]] {
        walls.extend(rectangle([x, y], [x + 0.25, y + 0.2]));
    }
    walls
}

/// Forward and yaw of each step of `rounds` rounds through the ring corridor, from (0, -0.8) along x.
pub(crate) fn around_the_ring(rounds: usize) -> impl Iterator<Item = (f64, f64)> {
    (0..rounds).flat_map(move |_| {
        side(10.8)
            .chain(side(7.6))
            .chain(side(11.6))
            .chain(side(7.6))
            .chain(std::iter::repeat_n((0.05, 0.0), 16))
    })
}

fn side(metres: f64) -> impl Iterator<Item = (f64, f64)> {
    let forward = std::iter::repeat_n((0.05, 0.0), (metres / 0.05).round() as usize);
    forward.chain(std::iter::repeat_n((0.0, std::f64::consts::FRAC_PI_2 / 30.0), 30))
}

/// Forward and yaw of each step of a drive around the middle of the furnished room, with stops to look around.
pub(crate) fn round_trip(steps: usize) -> impl Iterator<Item = (f64, f64)> {
    (0..steps).map(|step| match step % 60 {
        0..40 => (0.03, 0.0),
        40..58 => (0.0, 2.5_f64.to_radians()),
        _ => (0.0, 0.0),
    })
}

/// A flat of 10 x 7 m: four furnished rooms beside a corridor.
pub(crate) fn flat() -> Vec<Wall> {
    let mut walls = Vec::new();
    walls.extend(rectangle([0.0, 0.0], [10.0, 7.0]));
    // The walls between rooms and corridor, with a door of 0.9 m for each room.
    for [from, to, y] in [
        [0.0, 1.5, 3.0],
        [2.4, 7.0, 3.0],
        [7.9, 10.0, 3.0],
        [0.0, 3.0, 4.2],
        [3.9, 8.0, 4.2],
        [8.9, 10.0, 4.2],
    ] {
        walls.push([[from, y], [to, y]]);
    }
    walls.push([[4.0, 0.0], [4.0, 3.0]]);
    walls.push([[6.0, 4.2], [6.0, 7.0]]);
    for [x, y, to_x, to_y] in [
        [0.1, 0.1, 1.1, 1.6],
        [3.2, 2.5, 3.9, 2.9],
        [6.5, 0.8, 7.7, 1.4],
        [9.3, 0.5, 9.9, 2.2],
        [0.3, 6.2, 2.2, 6.9],
        [5.2, 4.4, 5.9, 5.4],
        [8.9, 6.2, 9.9, 6.9],
        [6.5, 5.0, 6.8, 5.3],
        [5.0, 3.0, 5.4, 3.3],
        [9.5, 3.1, 9.9, 3.6],
    ] {
        walls.extend(rectangle([x, y], [to_x, to_y]));
    }
    walls
}

/// A tour of all rooms of the flat, from its first point.
pub(crate) const FLAT_TOUR: [[f64; 2]; 18] = [
    [0.8, 3.6],
    [1.95, 3.6],
    [1.95, 2.2],
    [3.0, 1.5],
    [1.95, 2.2],
    [1.95, 3.6],
    [3.45, 3.7],
    [3.45, 5.4],
    [1.2, 5.2],
    [3.45, 5.5],
    [3.45, 3.7],
    [7.45, 3.7],
    [7.45, 2.2],
    [5.2, 1.8],
    [7.45, 2.2],
    [8.45, 3.7],
    [8.45, 5.5],
    [7.4, 6.2],
];

impl TestRobot {
    /// In the flat, where [`FLAT_TOUR`] begins.
    pub(crate) fn in_flat(seed: u64) -> Self {
        let [x_m, y_m] = FLAT_TOUR[0];
        Self { truth: Pose2::new(x_m, y_m, 0.0), ..Self::new(flat(), seed) }
    }

    /// The next step to a place: forward and yaw. `None` when it is there.
    pub(crate) fn step_to(&self, [x_m, y_m]: [f64; 2]) -> Option<(f64, f64)> {
        let dx = x_m - self.truth.x_m;
        let dy = y_m - self.truth.y_m;
        let off_rad = hal::wrap_angle(dy.atan2(dx) - self.truth.yaw_rad);
        let distance_m = dx.hypot(dy);
        if distance_m < 0.01 {
            None
        } else if off_rad.abs() > 0.02 {
            Some((0.0, off_rad.clamp(-0.1, 0.1)))
        } else {
            Some((distance_m.min(0.05), 0.0))
        }
    }

    /// Is put elsewhere. Its wheels do not notice.
    pub(crate) fn carry_to(&mut self, truth: Pose2) {
        self.truth = truth;
        self.step(0.0, 0.0);
    }
}
