//! A round robot that moves and meets things.

use hal::{Pose2, Twist2};

use super::plan::FloorPlan;

/// How the robot meets things.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Body {
    /// Whether it slides along what it meets (as simulators for learning like to have it) or stops.
    pub sliding: bool,
}

/// Something round that moves about, such as a person's body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Disc {
    /// Middle, metres.
    pub center_m: [f64; 2],
    /// Radius, metres.
    pub radius_m: f64,
}

/// Where a motion has ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moved {
    /// The new pose.
    pub pose: Pose2,
    /// Whether something was in the way.
    pub contact: bool,
}

/// Motion is cut into steps of at most this, metres. Shapes are exact, so a step only bounds what a robot could jump over:
/// far less than its own radius.
const STEP_M: f64 = 0.01;

/// A stop is exact to this share of a step.
const PRECISION: f64 = 1e-4;

/// A robot may be this much nearer than its radius, metres: rounding of the corners to single precision.
const SKIN_M: f64 = 1e-5;

impl FloorPlan {
    /// Drives for a time at a constant velocity, from a pose in the world. The exact distance to the scene's shapes decides,
    /// to a few micrometres; the edge of the floor is known to half a cell (2.5 cm).
    ///
    /// A robot that is where it cannot be, because somebody walked into it, may move away from what it overlaps.
    #[must_use]
    pub fn drive(
        &self,
        from: &Pose2,
        twist: &Twist2,
        seconds: f64,
        body: &Body,
        discs: &[Disc],
    ) -> Moved {
        let steps = (twist.linear_mps.abs() * seconds / STEP_M).ceil().max(1.0);
        let step_s = seconds / steps;
        let step = twist.integrate(step_s);
        let mut moved = Moved { pose: *from, contact: false };
        for _ in 0..steps as usize {
            let next = moved.pose.compose(&step);
            if self.admits(&moved.pose, &next, discs) {
                moved.pose = next;
                continue;
            }
            moved.contact = true;
            if !body.sliding {
                moved.pose = self.up_to_contact(&moved.pose, twist, step_s, discs);
                break;
            }
            let slid = self.slide(&moved.pose, &next, discs);
            moved.pose =
                slid.unwrap_or_else(|| self.up_to_contact(&moved.pose, twist, step_s, discs));
        }
        moved
    }

    /// Whether the robot can stand at a place.
    #[must_use]
    pub fn fits(&self, x_m: f64, y_m: f64, discs: &[Disc]) -> bool {
        self.room([x_m, y_m], discs).1 >= -SKIN_M
    }

    /// A step is fine when it ends free, or no deeper in an overlap than it began.
    fn admits(&self, from: &Pose2, to: &Pose2, discs: &[Disc]) -> bool {
        let room = self.room([to.x_m, to.y_m], discs).1;
        room >= -SKIN_M || room >= self.room([from.x_m, from.y_m], discs).1
    }

    /// Nearest point of what is near, and how much room is left between it and the robot, metres, at most 1 cm.
    fn room(&self, at: [f64; 2], discs: &[Disc]) -> ([f64; 2], f64) {
        const FAR_M: f64 = 0.01;
        let radius = self.footprint.radius_m;
        // From the cell's centre to the robot is at most half a diagonal.
        let far = self.clearance_m(at[0], at[1]) - self.grid().half_diagonal_m() > radius + FAR_M;
        let mut nearest = (at, FAR_M);
        if self.grid().index(at[0], at[1]).is_none() {
            nearest = (at, -radius);
        } else if !far && let Some((point, distance)) = self.obstacles.nearest(at, radius + FAR_M) {
            nearest = (point, distance - radius);
        }
        for disc in discs {
            let apart = [at[0] - disc.center_m[0], at[1] - disc.center_m[1]];
            let distance = apart[0].hypot(apart[1]);
            let room = distance - disc.radius_m - radius;
            if room < nearest.1 {
                let share = disc.radius_m / distance.max(f64::MIN_POSITIVE);
                nearest = ([0, 1].map(|i| disc.center_m[i] + share * apart[i]), room);
            }
        }
        nearest
    }

    /// As far along the step as it goes.
    fn up_to_contact(&self, from: &Pose2, twist: &Twist2, step_s: f64, discs: &[Disc]) -> Pose2 {
        let (mut reached, mut too_far) = (0.0, 1.0);
        let mut pose = *from;
        while too_far - reached > PRECISION {
            let share = f64::midpoint(reached, too_far);
            let next = from.compose(&twist.integrate(share * step_s));
            if self.admits(from, &next, discs) {
                (reached, pose) = (share, next);
            } else {
                too_far = share;
            }
        }
        pose
    }

    /// Pushes the end of a step out of what it overlaps; `None` when that does not lead on along the step.
    fn slide(&self, from: &Pose2, to: &Pose2, discs: &[Disc]) -> Option<Pose2> {
        let mut at = [to.x_m, to.y_m];
        for _ in 0..8 {
            let (point, room) = self.room(at, discs);
            if room >= -SKIN_M {
                let (wanted, got) =
                    ([to.x_m - from.x_m, to.y_m - from.y_m], [at[0] - from.x_m, at[1] - from.y_m]);
                let leads_on = wanted[0] * got[0] + wanted[1] * got[1] > 0.0;
                return leads_on.then(|| Pose2::new(at[0], at[1], to.yaw_rad));
            }
            let away = [at[0] - point[0], at[1] - point[1]];
            let distance = away[0].hypot(away[1]);
            if distance <= 0.0 {
                return None;
            }
            at = [0, 1].map(|i| at[i] - room * away[i] / distance);
        }
        None
    }
}
