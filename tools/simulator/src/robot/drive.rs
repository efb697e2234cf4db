//! Wheels on the floor: motion along the commanded arc until something is in the way.

use hal::{Pose2, Twist2};

use super::{PERSON_RADIUS_M, State};

/// The arc is driven in pieces no longer than this, metres: the robot stops this near to where it touches.
const PIECE_M: f64 = 0.005;
/// ... and no more turn than this, radians.
const PIECE_RAD: f64 = 0.02;
/// Step of the difference that gives the direction of the nearest obstacle, metres.
const GRADIENT_M: f64 = 0.03;

impl State {
    /// Lets the robot drive until `deadline_ns`, by the last command while that is fresh.
    pub(super) fn run_until(&mut self, deadline_ns: u64) {
        if deadline_ns <= self.now_ns {
            return;
        }
        self.pose_before = self.pose;
        let fresh_until_ns = self.commanded_ns.saturating_add(self.options.watchdog_ns);
        let driven_until_ns = deadline_ns.min(fresh_until_ns).max(self.now_ns);
        let seconds = (driven_until_ns - self.now_ns) as f64 * 1e-9;
        let wanted = if seconds > 0.0 { self.command } else { Twist2::ZERO };
        self.now_ns = deadline_ns;
        let before = self.pose;
        self.contact = self.drive(wanted, seconds);
        let motion = before.inverse().compose(&self.pose);
        let reported = self.options.odometry.report(&motion, &mut self.wheel_rng);
        self.odom = self.odom.compose(&reported);
        // Over the whole time, also that after the watchdog.
        let whole_s = seconds.max(1e-9);
        self.twist = Twist2 { linear_mps: reported.x_m / whole_s, angular_radps: reported.yaw_rad / whole_s };
    }

    /// Drives; true when something was in the way.
    fn drive(&mut self, twist: Twist2, seconds: f64) -> bool {
        let length_m = (twist.linear_mps * seconds).abs();
        let turn_rad = (twist.angular_radps * seconds).abs();
        let pieces = (length_m / PIECE_M).max(turn_rad / PIECE_RAD).ceil() as usize;
        let mut touched = false;
        for _ in 0..pieces {
            let next = self.pose.compose(&twist.integrate(seconds / pieces as f64));
            if self.fits(&next) {
                self.pose = next;
                continue;
            }
            touched = true;
            if self.options.sliding {
                self.pose = self.slid(&next);
            } else {
                // The wheels are stalled, and so is a turn that was part of the arc.
                break;
            }
        }
        touched
    }

    /// Whether the footprint fits here. A robot that somebody walked into may move away.
    fn fits(&self, pose: &Pose2) -> bool {
        let radius_m = self.options.footprint_radius_m;
        let room = |at: &Pose2| self.room_m(at);
        room(pose) >= radius_m || (room(&self.pose) < radius_m && room(pose) >= room(&self.pose))
    }

    /// Distance to the nearest obstacle or person, metres.
    fn room_m(&self, pose: &Pose2) -> f64 {
        let person_m = |[x_m, y_m]: [f64; 2]| (x_m - pose.x_m).hypot(y_m - pose.y_m) - PERSON_RADIUS_M;
        let walls_m = self.world.floor.clearance_m(pose.x_m, pose.y_m);
        self.people().iter().map(|person| person_m(person.position_m)).fold(walls_m, f64::min)
    }

    /// The part of a blocked step that runs along the obstacle.
    fn slid(&self, next: &Pose2) -> Pose2 {
        let here = &self.pose;
        let room = |dx: f64, dy: f64| self.room_m(&Pose2::new(here.x_m + dx, here.y_m + dy, 0.0));
        let away_x = room(GRADIENT_M, 0.0) - room(-GRADIENT_M, 0.0);
        let away_y = room(0.0, GRADIENT_M) - room(0.0, -GRADIENT_M);
        let steepness = away_x.hypot(away_y);
        let turned = Pose2::new(here.x_m, here.y_m, next.yaw_rad);
        if steepness < 1e-9 {
            return turned;
        }
        let (nx, ny) = (away_x / steepness, away_y / steepness);
        let (dx, dy) = (next.x_m - here.x_m, next.y_m - here.y_m);
        let into = (dx * nx + dy * ny).min(0.0);
        let along = Pose2::new(here.x_m + dx - into * nx, here.y_m + dy - into * ny, next.yaw_rad);
        if self.fits(&along) { along } else { turned }
    }
}
