//! Motion of a round robot with exact collision checks.

use hal::{Pose2, Twist2};

use super::plan::FloorPlan;

/// Behaviour of the robot on contact.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Body {
    /// Whether the robot slides along obstacles, as simulators for learning commonly do, or stops.
    pub sliding: bool,
}

/// A moving round obstacle, such as a person's body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Disc {
    pub center_m: [f64; 2],
    pub radius_m: f64,
}

/// Result of a motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moved {
    pub pose: Pose2,
    /// Whether the robot touched an obstacle.
    pub contact: bool,
    /// Whether a wheel left the floor. The motion ends there.
    pub fell: bool,
}

/// The robot stands on two wheels and two castors, at this share of its radius from its centre: the
/// wheels beside it, the castors ahead of it and behind it.
const STANCE: f64 = 0.8;

/// Motion is divided into steps of at most this length, metres. Distances to obstacles are exact,
/// so the step length only limits the thinnest obstacle that could be jumped over, and it is far
/// below the robot's radius.
const STEP_M: f64 = 0.01;

/// A stop at an obstacle is accurate to this fraction of a step.
const PRECISION: f64 = 1e-4;

/// The robot may come closer than its radius by this amount, metres: rounding of the corners to
/// single precision.
const SKIN_M: f64 = 1e-5;

impl FloorPlan {
    /// Drives from a pose in the world for some time at a constant velocity. Collisions use the
    /// exact distance to the scene's shapes, to a few micrometres. At the edge of the floor, which
    /// is known to half a cell (2.5 cm), the robot falls.
    ///
    /// A robot that overlaps an obstacle, because a person walked into it, may move away from that
    /// obstacle.
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
        let mut moved = Moved { pose: *from, contact: false, fell: false };
        for _ in 0..steps as usize {
            let next = moved.pose.compose(&step);
            let admitted = self.admits(&moved.pose, &next, discs);
            moved.pose = if admitted {
                next
            } else {
                self.beside_obstacle(&moved.pose, twist, step_s, body, discs)
            };
            moved.contact |= !admitted;
            moved.fell = !self.stands(&moved.pose);
            if moved.fell || (!admitted && !body.sliding) {
                break;
            }
        }
        moved
    }

    /// The end of a step that meets an obstacle.
    fn beside_obstacle(
        &self,
        from: &Pose2,
        twist: &Twist2,
        step_s: f64,
        body: &Body,
        discs: &[Disc],
    ) -> Pose2 {
        let to = from.compose(&twist.integrate(step_s));
        let slid = if body.sliding { self.slide(from, &to, discs) } else { None };
        slid.unwrap_or_else(|| self.up_to_contact(from, twist, step_s, discs))
    }

    /// Whether there is floor under every wheel and castor of a robot.
    #[must_use]
    pub fn stands(&self, pose: &Pose2) -> bool {
        let reach_m = STANCE * self.footprint.radius_m;
        [[0.0, reach_m], [0.0, -reach_m], [reach_m, 0.0], [-reach_m, 0.0]].iter().all(|[x, y]| {
            let (x_m, y_m) = pose.transform(*x, *y);
            self.is_supported(x_m, y_m)
        })
    }

    /// Whether the robot can stand at a position without touching an obstacle or reaching over an
    /// edge of the floor.
    #[must_use]
    pub fn fits(&self, x_m: f64, y_m: f64, discs: &[Disc]) -> bool {
        let inside_m = self.footprint.radius_m - SKIN_M;
        self.gap([x_m, y_m], discs).1 >= -SKIN_M
            && self.is_supported(x_m, y_m)
            && self.edges.nearest([x_m, y_m], inside_m).is_none()
    }

    /// A step is allowed when it ends free of obstacles, or no deeper in an overlap than it began.
    fn admits(&self, from: &Pose2, to: &Pose2, discs: &[Disc]) -> bool {
        let gap = self.gap([to.x_m, to.y_m], discs).1;
        gap >= -SKIN_M || gap >= self.gap([from.x_m, from.y_m], discs).1
    }

    /// Nearest obstacle point and the gap between it and the robot, metres. Gaps of more than 1 cm
    /// are reported as 1 cm.
    fn gap(&self, at: [f64; 2], discs: &[Disc]) -> ([f64; 2], f64) {
        const FAR_M: f64 = 0.01;
        let radius = self.footprint.radius_m;
        // The robot is at most half a diagonal away from the cell's centre.
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
            let gap = distance - disc.radius_m - radius;
            if gap < nearest.1 {
                let share = disc.radius_m / distance.max(f64::MIN_POSITIVE);
                nearest = ([0, 1].map(|i| disc.center_m[i] + share * apart[i]), gap);
            }
        }
        nearest
    }

    /// The pose along the step at which the robot touches the obstacle, by bisection.
    fn up_to_contact(&self, from: &Pose2, twist: &Twist2, step_s: f64, discs: &[Disc]) -> Pose2 {
        let mut reached = 0.0;
        let mut too_far = 1.0;
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

    /// Pushes the end of a step out of the obstacles that it overlaps; `None` when the result does
    /// not advance along the step.
    fn slide(&self, from: &Pose2, to: &Pose2, discs: &[Disc]) -> Option<Pose2> {
        let mut at = [to.x_m, to.y_m];
        for _ in 0..8 {
            let (point, gap) = self.gap(at, discs);
            if gap >= -SKIN_M {
                let desired = [to.x_m - from.x_m, to.y_m - from.y_m];
                let achieved = [at[0] - from.x_m, at[1] - from.y_m];
                let advances = desired[0] * achieved[0] + desired[1] * achieved[1] > 0.0;
                return advances.then(|| Pose2::new(at[0], at[1], to.yaw_rad));
            }
            let away = [at[0] - point[0], at[1] - point[1]];
            let distance = away[0].hypot(away[1]);
            if distance <= 0.0 {
                return None;
            }
            at = [0, 1].map(|i| at[i] - gap * away[i] / distance);
        }
        None
    }
}
