//! What a lost robot does: it stops, rotates on the spot until it is found, and then begins another map, or stands.

use std::f64::consts::TAU;

use hal::{Pose2, Twist2, WheelFeedback, wrap_angle};
use serde::{Deserialize, Serialize};

use super::Robot;
use crate::event::Event;
use crate::localization::{LostReason, Whereabouts};
use crate::snapshot::remembers;

/// It stands this long first: it may have been put down a moment ago, nanoseconds.
const STANDS_NS: u64 = 1_000_000_000;
/// Then it rotates this far. What it has not recognized in two rotations it will not recognize in a third.
const ROTATES_RAD: f64 = 2.0 * TAU;
/// It rotates at most at 20 degrees per second, at which the search for its place was measured (docs/localization.md), rad/s.
const YAW_RATE_RADPS: f64 = 0.35;

/// The motion of a lost robot.
#[derive(Debug, Clone, Default)]
pub(super) struct LostMotion {
    search: Option<Rotation>,
}

remembers!(LostMotion: search);

/// A search on the spot.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Rotation {
    since_ns: u64,
    last_yaw_rad: f64,
    rotated_rad: f64,
    is_over: bool,
}

impl LostMotion {
    /// The robot was lost, or found.
    pub(super) fn reset(&mut self) {
        self.search = None;
    }

    /// It has rotated far enough.
    pub(super) fn is_over(&self) -> bool {
        self.search.as_ref().is_some_and(|search| search.is_over)
    }

    /// The desired motion of a robot that is lost, rotating to the left at `yaw_rate_radps` at most. When it has rotated far enough, it
    /// `goes_on` with another map, or stands for good; scans are searched for all the same, for example while a person moves it.
    pub(super) fn desired(
        &mut self,
        wheel: &WheelFeedback,
        time_ns: u64,
        yaw_rate_radps: f64,
        goes_on: bool,
        events: &mut Vec<Event>,
    ) -> Twist2 {
        let yaw_rad = wheel.odom.yaw_rad;
        let search = self.search.get_or_insert(Rotation {
            since_ns: time_ns,
            last_yaw_rad: yaw_rad,
            rotated_rad: 0.0,
            is_over: false,
        });
        search.rotated_rad += wrap_angle(yaw_rad - search.last_yaw_rad).abs();
        search.last_yaw_rad = yaw_rad;
        if search.is_over || time_ns.saturating_sub(search.since_ns) < STANDS_NS {
            return Twist2::ZERO;
        }
        if search.rotated_rad >= ROTATES_RAD {
            search.is_over = true;
            events.extend((!goes_on).then_some(Event::StandsLost));
            return Twist2::ZERO;
        }
        Twist2 { linear_mps: 0.0, angular_radps: yaw_rate_radps.min(YAW_RATE_RADPS) }
    }
}

impl Robot {
    /// What was remembered of the surroundings does not describe the place where the robot is now.
    pub(super) fn note_lost(&mut self, why: LostReason, events: &mut Vec<Event>) {
        events.push(Event::Lost { why });
        self.coarse.forget();
        self.frame_maps.clear();
        self.lost_motion.reset();
    }

    /// The map stays as it is, but the robot is at another place in it, or in another map: the next tick plans another path.
    pub(super) fn note_found(&mut self, before: &Pose2, events: &mut Vec<Event>) {
        if !self.enter_found_map(events) {
            events.push(Event::Found { shift_m: self.poses.t_map_base().distance_m(before) });
            self.map_correction.jump(&self.location, &mut self.map, self.poses.t_map_odom);
            self.explorer.move_places(|place_m| place_m);
        }
        self.lost_motion.reset();
    }

    /// The robot does not know where it is in its map, because the map was loaded, or because the robot was carried. It makes
    /// no map until it has found itself. Without a map from scans, nothing changes.
    pub fn lose(&mut self, why: LostReason) {
        self.location.lose(why);
        self.coarse.forget();
        self.frame_maps.clear();
        self.collision_at = None;
        self.unseen_at = None;
        self.bumped = false;
        self.last_time_ns = None;
    }

    /// Whether the robot knows where it is.
    #[must_use]
    pub fn whereabouts(&self) -> Whereabouts {
        self.whereabouts
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_stands_then_rotates_twice_then_stands_with_the_reason() {
        let mut motion = LostMotion::default();
        let mut events = Vec::new();
        let mut yaw_rad = 0.0;
        let mut rotated_rad = 0.0;
        for tick in 0..600_u64 {
            let wheel = WheelFeedback {
                time_ns: tick * 100_000_000,
                odom: Pose2::new(0.0, 0.0, yaw_rad),
                twist: Twist2::ZERO,
                contact: false,
                cliff: false,
            };
            let desired = motion.desired(&wheel, wheel.time_ns, 0.35, false, &mut events);
            assert!(desired.linear_mps == 0.0);
            assert!(tick >= 10 || desired.angular_radps == 0.0, "tick {tick}");
            yaw_rad = wrap_angle(yaw_rad + 0.1 * desired.angular_radps);
            rotated_rad += 0.1 * desired.angular_radps;
        }
        assert!((rotated_rad - ROTATES_RAD).abs() < 0.05, "{rotated_rad}");
        assert_eq!(events, [Event::StandsLost]);
    }
}
