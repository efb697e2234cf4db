//! The recent wheel feedback. A frame is processed some milliseconds after it was taken, and it
//! belongs to the pose that the robot had at that time.

use std::collections::VecDeque;

use hal::{Pose2, Twist2, WheelFeedback, wrap_angle};

/// Feedback is kept for this long; the latency of cameras is lower.
const REMEMBERED_NS: u64 = 1_000_000_000;
/// Feedback is extrapolated for at most this long after the newest measurement: soon after that,
/// the wheels count as silent.
const AHEAD_NS: u64 = 100_000_000;
/// A larger distance between two measurements, metres, is no motion of a robot of this kind.
const JUMP_M: f64 = 0.5;

/// The recent measurements of the wheels, oldest first.
#[derive(Debug, Clone, Default)]
pub struct WheelHistory {
    past: VecDeque<WheelFeedback>,
}

impl WheelHistory {
    /// Adds a measurement, unless it is older than the newest one. A measurement that is farther
    /// away than the robot can have driven replaces all earlier ones: odometry was restarted, and
    /// poses before and after that cannot be interpolated.
    pub fn push(&mut self, wheel: WheelFeedback) {
        if let Some(last) = self.past.back() {
            if wheel.time_ns <= last.time_ns {
                return;
            }
            if last.odom.distance_m(&wheel.odom) > JUMP_M {
                self.past.clear();
            }
        }
        self.past.push_back(wheel);
        while self.past.front().is_some_and(|oldest| wheel.time_ns - oldest.time_ns > REMEMBERED_NS)
        {
            self.past.pop_front();
        }
    }

    /// The newest measurement.
    #[must_use]
    pub fn newest(&self) -> Option<&WheelFeedback> {
        self.past.back()
    }

    /// The wheel feedback at `time_ns`: interpolated between two measurements, extrapolated with
    /// the newest twist after the last one, and the oldest measurement before the first one.
    /// Contact and cliff are always those of the newest measurement, so that it is not delayed.
    #[must_use]
    pub fn at(&self, time_ns: u64) -> Option<WheelFeedback> {
        let newest = *self.past.back()?;
        let after = self.past.partition_point(|wheel| wheel.time_ns <= time_ns);
        let Some(before) = after.checked_sub(1).and_then(|index| self.past.get(index)) else {
            return self.past.front().map(|oldest| WheelFeedback {
                contact: newest.contact,
                cliff: newest.cliff,
                ..*oldest
            });
        };
        let Some(after) = self.past.get(after) else {
            let ahead_ns = (time_ns - newest.time_ns).min(AHEAD_NS);
            let way = newest.twist.integrate(ahead_ns as f64 * 1e-9);
            return Some(WheelFeedback {
                time_ns: newest.time_ns + ahead_ns,
                odom: newest.odom.compose(&way),
                ..newest
            });
        };
        let share = (time_ns - before.time_ns) as f64 / (after.time_ns - before.time_ns) as f64;
        let yaw_rad =
            before.odom.yaw_rad + share * wrap_angle(after.odom.yaw_rad - before.odom.yaw_rad);
        Some(WheelFeedback {
            time_ns,
            odom: Pose2::new(
                mix(before.odom.x_m, after.odom.x_m, share),
                mix(before.odom.y_m, after.odom.y_m, share),
                yaw_rad,
            ),
            twist: Twist2 {
                linear_mps: mix(before.twist.linear_mps, after.twist.linear_mps, share),
                angular_radps: mix(before.twist.angular_radps, after.twist.angular_radps, share),
            },
            contact: newest.contact,
            cliff: newest.cliff,
        })
    }
}

fn mix(a: f64, b: f64, share: f64) -> f64 {
    a + share * (b - a)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(time_ns: u64, x_m: f64, yaw_rad: f64) -> WheelFeedback {
        WheelFeedback { time_ns, odom: Pose2::new(x_m, 0.0, yaw_rad), ..WheelFeedback::default() }
    }

    #[test]
    fn between_two_measurements_the_pose_is_between_them_also_across_half_a_turn() {
        let mut past = WheelHistory::default();
        past.push(WheelFeedback {
            twist: Twist2 { linear_mps: 0.1, angular_radps: 0.0 },
            ..at(10, 1.0, 3.1)
        });
        past.push(WheelFeedback {
            twist: Twist2 { linear_mps: 0.3, angular_radps: 0.4 },
            ..at(20, 1.2, -3.1)
        });
        let middle = past.at(15).unwrap();
        assert!((middle.odom.x_m - 1.1).abs() < 1e-12);
        assert!(
            (middle.twist.linear_mps - 0.2).abs() < 1e-12
                && (middle.twist.angular_radps - 0.2).abs() < 1e-12
        );
        assert!(
            (wrap_angle(middle.odom.yaw_rad - std::f64::consts::PI)).abs() < 1e-9,
            "{:?}",
            middle.odom
        );
    }

    #[test]
    fn before_the_past_the_oldest_measurement_counts() {
        let mut past = WheelHistory::default();
        assert!(past.at(5).is_none());
        past.push(at(10, 1.0, 0.0));
        past.push(at(20, 1.2, 0.0));
        assert_eq!(past.at(5).unwrap().time_ns, 10);
    }

    #[test]
    fn a_picture_newer_than_the_wheels_is_where_they_have_turned_to_since() {
        let mut past = WheelHistory::default();
        let twist = Twist2 { linear_mps: 0.0, angular_radps: 1.0 };
        past.push(WheelFeedback { twist, ..at(1_000_000_000, 1.0, 0.5) });
        let soon = past.at(1_020_000_000).unwrap();
        assert_eq!(soon.time_ns, 1_020_000_000);
        assert!((soon.odom.yaw_rad - 0.52).abs() < 1e-9, "{:?}", soon.odom);
        let late = past.at(3_000_000_000).unwrap();
        assert!((late.odom.yaw_rad - 0.6).abs() < 1e-9, "not for ever: {:?}", late.odom);
    }

    #[test]
    fn a_second_is_remembered_however_often_the_wheels_speak() {
        let mut past = WheelHistory::default();
        for index in 0..3000 {
            past.push(at(index * 1_000_000, 0.0, 0.0));
        }
        assert_eq!(past.at(0).unwrap().time_ns, 1_999_000_000);
    }

    #[test]
    fn odometry_that_begins_anew_forgets_the_past() {
        let mut past = WheelHistory::default();
        past.push(at(10, 2.0, 0.0));
        past.push(at(20, 0.0, 0.0));
        assert_eq!(past.at(15).unwrap().odom.x_m, 0.0, "not half-way between two frames");
    }

    #[test]
    fn a_measurement_that_was_overtaken_changes_nothing() {
        let mut past = WheelHistory::default();
        past.push(at(10, 1.0, 0.0));
        past.push(at(30, 1.2, 0.0));
        past.push(at(20, 1.1, 0.0));
        assert_eq!(past.newest().unwrap().time_ns, 30);
        assert!((past.at(20).unwrap().odom.x_m - 1.1).abs() < 1e-12, "the past is still there");
    }
}
