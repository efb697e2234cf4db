//! Wheels and scans that report different motions, while the scans keep the pose.

use hal::{Pose2, wrap_angle};
use serde::{Deserialize, Serialize};

/// Share of the sums that remains at the next scan: a memory of about ten scans, a second at 10 Hz.
const MEMORY: f64 = 0.9;
/// Differences of this size are no noise of wheels, metres and radians.
const MOST_M: f64 = 0.1;
const MOST_RAD: f64 = 0.15;
/// And they are larger than this share of what the wheels report: a wrong radius or track is less.
const MOST_SHARE: f64 = 0.5;

/// Wheels that spin report at least this share of what the scans take back.
const SPIN_SHARE: f64 = 0.7;
/// What the newest scan takes back, as a multiple of what the wheels report: of wheels that spin, and of wheels that report the wrong
/// direction, whose motion is as long the other way, within a factor of two.
const SPINNING: [f64; 2] = [0.7, 1.4];
const REVERSED: [f64; 2] = [1.5, 3.0];
/// And what is taken back, or the motion the other way, is not less than this, metres and radians, which may be noise.
const LEAST_M: f64 = 0.01;
const LEAST_RAD: f64 = 0.015;
/// A scan that follows late takes back several motions at once. The sums then hold about half of what was taken back, if the robot had stood.
const REVERSED_SUMS: [f64; 2] = [0.4, 0.6];

/// How the wheels contradict the scans.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum WheelError {
    /// The wheels move and the robot does not follow them.
    Spin,
    /// The robot moves and its wheels do not: it is pushed or carried.
    Pushed,
    /// The robot moves about as far as its wheels report, the other way.
    Reversed,
}

/// Compares the wheels with the scans.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct Slip {
    /// The pose in `odom` that the last scan gave.
    last: Option<Pose2>,
    /// Fading sums: what the scans report more than the wheels, and what the wheels report.
    more: Sums,
    wheels: Sums,
    is_reported: bool,
}

/// Sums of motions in the robot's frame.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
struct Sums {
    x_m: f64,
    y_m: f64,
    yaw_rad: f64,
}

impl Sums {
    fn add(&mut self, motion: &Pose2) {
        self.x_m = MEMORY * self.x_m + motion.x_m;
        self.y_m = MEMORY * self.y_m + motion.y_m;
        self.yaw_rad = MEMORY * self.yaw_rad + wrap_angle(motion.yaw_rad);
    }

    fn length_m(&self) -> f64 {
        self.x_m.hypot(self.y_m)
    }
}

impl Slip {
    /// The wheels predicted one pose and the scan corrected it to another. Returns an error of the wheels once, when it begins.
    pub(crate) fn observe(&mut self, predicted: &Pose2, corrected: &Pose2) -> Option<WheelError> {
        let last = self.last.replace(*corrected)?;
        let wheels = last.inverse().compose(predicted);
        let scans = last.inverse().compose(corrected);
        let more = Pose2::new(
            scans.x_m - wheels.x_m,
            scans.y_m - wheels.y_m,
            wrap_angle(scans.yaw_rad - wheels.yaw_rad),
        );
        self.wheels.add(&wheels);
        self.more.add(&more);
        let shifted = is_beyond(self.more.length_m(), MOST_M, MOST_SHARE * self.wheels.length_m());
        let rotated =
            is_beyond(self.more.yaw_rad.abs(), MOST_RAD, MOST_SHARE * self.wheels.yaw_rad.abs());
        let was_reported = self.is_reported;
        self.is_reported = shifted || rotated;
        (self.is_reported && !was_reported).then(|| {
            let newest = if shifted {
                kind_of_newest([wheels.x_m, wheels.y_m], [more.x_m, more.y_m], LEAST_M)
            } else {
                kind_of_newest([wheels.yaw_rad, 0.0], [more.yaw_rad, 0.0], LEAST_RAD)
            };
            newest.unwrap_or_else(|| self.kind(shifted))
        })
    }

    /// Wheels that spin report what the scans take back, and wheels that report the wrong direction half of it.
    fn kind(&self, shifted: bool) -> WheelError {
        let [wheels, more] = [self.wheels, self.more];
        let (reported, taken_back, size) = if shifted {
            (wheels.x_m, -more.x_m, more.length_m())
        } else {
            (wheels.yaw_rad, -more.yaw_rad, more.yaw_rad.abs())
        };
        // A robot that is pushed aside while it drives has moved in a direction that wheels never report.
        if reported.signum() * taken_back < SPIN_SHARE * size {
            return WheelError::Pushed;
        }
        let share = reported.abs() / size;
        let [least, most] = REVERSED_SUMS;
        if share > SPIN_SHARE {
            WheelError::Spin
        } else if (least..=most).contains(&share) {
            WheelError::Reversed
        } else {
            WheelError::Pushed
        }
    }
}

/// What the newest scan takes back of what the wheels report, if it says so clearly: about all of it when they spin, about twice as much
/// when they report the wrong direction. The sums cannot tell where the robot drove the other way before.
fn kind_of_newest(wheels: [f64; 2], more: [f64; 2], least: f64) -> Option<WheelError> {
    let reported2 = dot(wheels, wheels);
    let difference2 = dot(more, more);
    let taken_back = -dot(wheels, more);
    // Aside from the wheels' direction, it is a push.
    if difference2 < least * least || taken_back < SPIN_SHARE * (reported2 * difference2).sqrt() {
        return None;
    }
    let share = (difference2 / reported2).sqrt();
    let [least_spin, most_spin] = SPINNING;
    let [least_reversed, most_reversed] = REVERSED;
    if (least_spin..=most_spin).contains(&share) {
        Some(WheelError::Spin)
    } else if (least_reversed..=most_reversed).contains(&share)
        && difference2.sqrt() > reported2.sqrt() + least
    {
        Some(WheelError::Reversed)
    } else {
        None
    }
}

fn dot(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

fn is_beyond(value: f64, bound: f64, other_bound: f64) -> bool {
    value > bound && value > other_bound
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The errors that are reported when the wheels report `wheels` per scan and the robot moves by `truth`.
    fn reported(wheels: &Pose2, truth: &Pose2, scans: usize) -> Vec<WheelError> {
        let mut slip = Slip::default();
        let mut pose = Pose2::IDENTITY;
        let mut errors = Vec::new();
        for _ in 0..scans {
            let predicted = pose.compose(wheels);
            pose = pose.compose(truth);
            errors.extend(slip.observe(&predicted, &pose));
        }
        errors
    }

    #[test]
    fn wheels_that_spin_and_a_robot_that_is_pushed_are_distinguished_and_reported_once() {
        let forward = Pose2::new(0.03, 0.0, 0.0);
        let rotation = Pose2::new(0.0, 0.0, 0.035);
        for motion in [forward, rotation] {
            assert_eq!(reported(&motion, &Pose2::IDENTITY, 30), [WheelError::Spin]);
            assert_eq!(reported(&Pose2::IDENTITY, &motion, 30), [WheelError::Pushed]);
        }
        let sideways = Pose2::new(0.0, 0.03, 0.0);
        assert_eq!(reported(&Pose2::IDENTITY, &sideways, 30), [WheelError::Pushed]);
    }

    #[test]
    fn wheels_that_report_the_wrong_direction_are_distinguished_from_both() {
        let ahead = Pose2::new(0.03, 0.0, 0.0);
        let left = Pose2::new(0.0, 0.0, 0.035);
        for motion in [ahead, left] {
            let other_way = motion.inverse();
            assert_eq!(reported(&motion, &other_way, 30), [WheelError::Reversed]);
            assert_eq!(reported(&other_way, &motion, 30), [WheelError::Reversed]);
        }
        // Wheels that are a tenth too large do not hide it.
        let larger = Pose2::new(0.033, 0.0, 0.0);
        assert_eq!(reported(&larger, &ahead.inverse(), 30), [WheelError::Reversed]);
        // A push aside while the robot drives is none of both.
        assert_eq!(reported(&ahead, &Pose2::new(0.025, 0.04, 0.0), 30), [WheelError::Pushed]);
        // What was driven before does not hide it either.
        let mut slip = Slip::default();
        let mut pose = Pose2::IDENTITY;
        let mut errors = Vec::new();
        for scan in 0..40 {
            let predicted = pose.compose(&ahead);
            pose = pose.compose(&if scan < 25 { ahead } else { ahead.inverse() });
            errors.extend(slip.observe(&predicted, &pose));
        }
        assert_eq!(errors, [WheelError::Reversed]);
        // A robot that is pushed back faster than its wheels drive ahead.
        assert_eq!(reported(&ahead, &Pose2::new(-0.1, 0.0, 0.0), 30), [WheelError::Pushed]);
    }

    /// Two motions after each other: the scans of the first agree with the wheels, and in the second the robot stands.
    #[test]
    fn wheels_that_spin_the_other_way_than_the_robot_drove_before_spin() {
        let ahead = Pose2::new(0.03, 0.0, 0.0);
        let left = Pose2::new(0.0, 0.0, 0.05);
        let curve = Pose2::new(0.03, 0.0, 0.05);
        for (before, spin) in [
            (ahead, ahead.inverse()),
            (ahead.inverse(), ahead),
            (left, left.inverse()),
            (curve, left.inverse()),
            (curve, ahead.inverse()),
            (left, ahead),
            (ahead, left),
        ] {
            let mut slip = Slip::default();
            let mut pose = Pose2::IDENTITY;
            let mut errors = Vec::new();
            for scan in 0..40 {
                let is_driving = scan < 20;
                let wheels = if is_driving { before } else { spin };
                let predicted = pose.compose(&wheels);
                pose = if is_driving { predicted } else { pose };
                errors.extend(slip.observe(&predicted, &pose));
            }
            assert_eq!(errors, [WheelError::Spin], "{before:?} {spin:?}");
        }
    }

    #[test]
    fn a_wrong_radius_and_a_wrong_track_are_not_reported() {
        for [metres, radians] in [[0.03, 0.0], [0.3, 0.0], [0.0, 0.035], [0.2, 0.3]] {
            let wheels = Pose2::new(1.1 * metres, 0.0, 1.1 * radians);
            assert_eq!(reported(&wheels, &Pose2::new(metres, 0.0, radians), 50), []);
        }
    }
}
