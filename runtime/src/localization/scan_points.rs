//! From a scan to the surfaces that it saw.
//!
//! Neighbouring beams that hit the same surface are averaged over stretches of some 10 cm, so that a scanner with 1,081 noisy
//! beams and one with 180 give the same kind of data: a point, the direction of the surface there, and how exactly both are
//! known. Motion during the sweep is taken out with the predicted velocity.

use hal::{LaserScan, Pose2, ScanGeometry};
use serde::{Deserialize, Serialize};

/// A stretch of surface as a scan saw it.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct Stretch {
    /// Middle of the stretch, metres.
    pub x: f32,
    pub y: f32,
    /// Unit normal; zero where the surface has no clear direction.
    pub nx: f32,
    pub ny: f32,
    /// Inverse variance of the distance along the normal, 1/m².
    pub weight: f32,
}

impl Stretch {
    pub(crate) fn has_normal(&self) -> bool {
        self.nx != 0.0 || self.ny != 0.0
    }

    /// The same stretch seen from another frame; `sin`, `cos`, `x` and `y` are that of the pose of the stretch's frame.
    #[inline]
    pub(crate) fn moved(&self, x: f32, y: f32, sin: f32, cos: f32) -> Self {
        Self {
            x: x + cos * self.x - sin * self.y,
            y: y + sin * self.x + cos * self.y,
            nx: cos * self.nx - sin * self.ny,
            ny: sin * self.nx + cos * self.ny,
            weight: self.weight,
        }
    }
}

/// Velocity in the plane, in the robot's frame.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct Velocity {
    pub x_mps: f64,
    pub y_mps: f64,
    pub yaw_radps: f64,
}

/// Length of a stretch, metres. Furniture is resolved by it, and it holds a dozen beams of a dense scanner 2 m away.
const STRETCH_M: f64 = 0.1;
/// Neighbouring hits belong to different surfaces when they are further apart than this and than
/// [`BREAK_SPACINGS`] times the distance of the beams at that range.
const BREAK_M: f64 = 0.12;
/// A wall that is seen at 7 degrees has its hits eight beam spacings apart.
const BREAK_SPACINGS: f64 = 8.0;
/// A surface that is hit at less than 5 degrees is more likely the edge between two surfaces.
const MIN_INCIDENCE: f64 = 0.09;
/// Surfaces deviate from a line by more than the noise of ranges.
const SURFACE_ROUGHNESS_M: f64 = 0.008;
/// A stretch whose points deviate from a line by more than this has no direction, metres.
const MAX_DEVIATION_M: f64 = 0.04;

/// Turns scans into stretches. It keeps its buffers.
pub(crate) struct ScanPoints {
    geometry: ScanGeometry,
    t_base_laser: Pose2,
    /// Directions of the beams in the robot's frame: cosine and sine.
    directions: Vec<[f64; 2]>,
    range_variance: f64,
    range_limit_m: f64,
    /// Hits of the current scan, in the order of the beams.
    hits: Vec<Hit>,
    /// Sums over all hits before each hit, for means and covariances of any run of hits.
    sums: Vec<Sums>,
    stretches: Vec<Stretch>,
}

#[derive(Clone, Copy)]
struct Hit {
    x: f64,
    y: f64,
    range_m: f64,
}

impl Hit {
    /// By a square root: `hypot` takes several times as long, and its last digit depends on the platform.
    fn distance_m(&self, other: &Self) -> f64 {
        let x = self.x - other.x;
        let y = self.y - other.y;
        (x * x + y * y).sqrt()
    }
}

#[derive(Clone, Copy, Default)]
struct Sums {
    x: f64,
    y: f64,
    xx: f64,
    xy: f64,
    yy: f64,
}

/// A line through points: their mean, the normal, the variance across and along the line.
struct Line {
    nx: f64,
    ny: f64,
    across: f64,
    along: f64,
}

impl ScanPoints {
    pub(crate) fn new(
        geometry: ScanGeometry,
        t_base_laser: Pose2,
        range_noise_m: f64,
        range_limit_m: f64,
    ) -> Self {
        let directions = (0..geometry.beams).map(|beam| {
            let (sin, cos) = (geometry.angle_rad(beam) + t_base_laser.yaw_rad).sin_cos();
            [cos, sin]
        });
        Self {
            geometry,
            t_base_laser,
            directions: directions.collect(),
            range_variance: range_noise_m * range_noise_m,
            range_limit_m: range_limit_m.min(f64::from(geometry.range_max_m)),
            hits: Vec::with_capacity(geometry.beams),
            sums: Vec::with_capacity(geometry.beams + 1),
            stretches: Vec::with_capacity(geometry.beams),
        }
    }

    pub(crate) fn t_base_laser(&self) -> &Pose2 {
        &self.t_base_laser
    }

    pub(crate) fn geometry(&self) -> &ScanGeometry {
        &self.geometry
    }

    /// The stretches of `scan` in the robot's frame at the middle of the scan.
    pub(crate) fn extract(&mut self, scan: &LaserScan, velocity: &Velocity) -> &[Stretch] {
        self.collect_hits(scan, velocity);
        self.sum_up();
        self.stretches.clear();
        let mut from = 0;
        while from < self.hits.len() {
            let end = self.end_of_surface(from);
            self.split_surface(from, end);
            from = end;
        }
        &self.stretches
    }

    /// The stretches of the scan that was extracted last.
    pub(crate) fn stretches(&self) -> &[Stretch] {
        &self.stretches
    }

    fn collect_hits(&mut self, scan: &LaserScan, velocity: &Velocity) {
        let Pose2 { x_m, y_m, .. } = self.t_base_laser;
        self.hits.clear();
        for (beam, (range, [cos, sin])) in scan.ranges.iter().zip(&self.directions).enumerate() {
            let Some(range_m) = range.hit_m().map(f64::from) else { continue };
            if !(range_m > 0.0 && range_m <= self.range_limit_m) {
                continue;
            }
            let after_s = scan.geometry.after_middle_s(beam);
            let x = x_m + cos * range_m;
            let y = y_m + sin * range_m;
            // The robot rotates by some hundredths of a radian during half a sweep.
            let yaw = velocity.yaw_radps * after_s;
            let shrink = 1.0 - 0.5 * yaw * yaw;
            self.hits.push(Hit {
                x: shrink * x - yaw * y + velocity.x_mps * after_s,
                y: shrink * y + yaw * x + velocity.y_mps * after_s,
                range_m,
            });
        }
    }

    fn sum_up(&mut self) {
        self.sums.clear();
        let mut sum = Sums::default();
        self.sums.push(sum);
        for hit in &self.hits {
            sum.x += hit.x;
            sum.y += hit.y;
            sum.xx += hit.x * hit.x;
            sum.xy += hit.x * hit.y;
            sum.yy += hit.y * hit.y;
            self.sums.push(sum);
        }
    }

    /// The first hit after `from` that is on another surface.
    fn end_of_surface(&self, from: usize) -> usize {
        let spacing = self.geometry.angle_increment_rad.abs() * BREAK_SPACINGS;
        let mut end = from + 1;
        while let (Some(last), Some(next)) = (self.hits.get(end - 1), self.hits.get(end)) {
            let apart_m = next.distance_m(last);
            if apart_m > BREAK_M.max(spacing * last.range_m.min(next.range_m)) {
                break;
            }
            end += 1;
        }
        end
    }

    /// Cuts the hits `from..end` of one surface into stretches.
    fn split_surface(&mut self, from: usize, end: usize) {
        let mut first = from;
        while first < end {
            let start = self.hits[first];
            let mut behind = first + 1;
            while behind < end {
                let hit = self.hits[behind];
                if hit.distance_m(&start) >= STRETCH_M {
                    break;
                }
                behind += 1;
            }
            // The line is fitted over the stretches beside it too: it must be long against the noise.
            let margin = (behind - first).max(2);
            let window = first.saturating_sub(margin).max(from)..(behind + margin).min(end);
            let stretch = self.stretch(first, behind, window);
            self.stretches.push(stretch);
            first = behind;
        }
    }

    fn stretch(&self, first: usize, behind: usize, window: std::ops::Range<usize>) -> Stretch {
        let count = (behind - first) as f64;
        let x = (self.sums[behind].x - self.sums[first].x) / count;
        let y = (self.sums[behind].y - self.sums[first].y) / count;
        let variance = self.range_variance / count + SURFACE_ROUGHNESS_M * SURFACE_ROUGHNESS_M;
        let mut stretch = Stretch {
            x: x as f32,
            y: y as f32,
            weight: (1.0 / variance) as f32,
            ..Stretch::default()
        };
        if window.len() >= 3 {
            let line = self.line(&window);
            let (dx, dy) = (x - self.t_base_laser.x_m, y - self.t_base_laser.y_m);
            let incidence = (line.nx * dx + line.ny * dy) / (dx * dx + dy * dy).sqrt().max(1e-6);
            let limit = (MAX_DEVIATION_M * MAX_DEVIATION_M).max(4.0 * self.range_variance);
            let is_line = line.across < 0.12 * line.along && line.across < limit;
            if is_line && incidence.abs() > MIN_INCIDENCE {
                // Normals point to the scanner, so that both sides of a thin wall stay apart.
                let sign = -incidence.signum();
                stretch.nx = (sign * line.nx) as f32;
                stretch.ny = (sign * line.ny) as f32;
            }
        }
        stretch
    }

    /// The line of least squares through the hits of `window`.
    fn line(&self, window: &std::ops::Range<usize>) -> Line {
        let (a, b) = (&self.sums[window.start], &self.sums[window.end]);
        let count = window.len() as f64;
        let (x, y) = ((b.x - a.x) / count, (b.y - a.y) / count);
        let xx = (b.xx - a.xx) / count - x * x;
        let xy = (b.xy - a.xy) / count - x * y;
        let yy = (b.yy - a.yy) / count - y * y;
        let mean = 0.5 * (xx + yy);
        let spread = (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt();
        // Direction of the largest variance, at half the angle of the double-angle vector.
        let angle = 0.5 * (2.0 * xy).atan2(xx - yy);
        let (sin, cos) = angle.sin_cos();
        Line { nx: -sin, ny: cos, across: (mean - spread).max(0.0), along: mean + spread }
    }
}
