//! Base motion: the robot follows the commanded arc until it touches an obstacle or falls over an
//! edge of the floor.

use hal::Twist2;

use super::State;
use crate::floor::Body;

impl State {
    /// Drives the robot until `deadline_ns` by the last command, while that command is younger than
    /// the watchdog time. Blocked wheels stall, so the odometry does not count the distance that
    /// was not driven.
    pub(super) fn run_until(&mut self, deadline_ns: u64) {
        if deadline_ns <= self.now_ns {
            return;
        }
        let step_s = (deadline_ns - self.now_ns) as f64 * 1e-9;
        let fresh_until_ns = self.commanded_ns.saturating_add(self.options.watchdog_ns);
        let seconds = (deadline_ns.min(fresh_until_ns).saturating_sub(self.now_ns)) as f64 * 1e-9;
        self.now_ns = deadline_ns;
        if self.fell {
            self.trail.push(deadline_ns, self.pose);
            self.twist = Twist2::ZERO;
            return;
        }
        let body = Body { sliding: self.options.sliding };
        let discs = self.inhabitants.discs(self.now_ns);
        let moved = self.plan.drive(&self.pose, &self.command, seconds, &body, &discs);
        let odom_before = self.odometer.pose();
        self.odometer.advance(&self.pose.inverse().compose(&moved.pose));
        let measured = odom_before.inverse().compose(&self.odometer.pose());
        let step_m = self.pose.distance_m(&moved.pose);
        self.pose = moved.pose;
        self.change_after(step_m);
        self.trail.push(deadline_ns, moved.pose);
        self.fell = moved.fell;
        self.contact = moved.contact;
        self.touched |= moved.contact;
        self.touched_in_truth |= moved.contact;
        self.twist =
            Twist2 { linear_mps: measured.x_m / step_s, angular_radps: measured.yaw_rad / step_s };
    }
}
