//! What a stretch of the drive says of the wheels and of the scanner's mount: the equations of `calibrate` (after Censi, Franchi,
//! Marchionni and Oriolo 2013), linearized at the configuration.

use hal::{Pose2, wrap_angle};
use nalgebra::Vector3;

use super::sums::Sums;
use crate::localization::{DrivenLeg, LocalizationConfig};

/// Legs that rotate further than this say little about distance, radians: as in localization.
const STRAIGHT_RAD: f64 = 0.2;
/// Shorter legs say little about distance, metres.
const LEAST_M: f64 = 0.1;
/// How wrong the wheels' distance may be in the same way every time, as a share: it must not be taken for a shift of the scanner.
const DISTANCE_SCALE: f64 = 0.02;
/// Side slip of the wheels in a rotation, metres per radian.
const SIDE_SLIP_M_PER_RAD: f64 = 0.002;

/// What the wheels do not report: yaw per metre (rad/m), yaw per yaw, distance per distance.
pub(super) fn wheels(leg: &DrivenLeg, config: &LocalizationConfig) -> Sums<3> {
    let mut sums = Sums::default();
    let yaw_variance = leg.variances.yaw_rad2
        + config.wheel_drift_rad_per_m.powi(2) * leg.distance_m.abs()
        + config.wheel_yaw_noise.powi(2) * leg.yaw_rad.abs();
    if yaw_variance.is_finite() && yaw_variance > 0.0 {
        let factors = Vector3::new(leg.distance_m, leg.yaw_rad, 0.0);
        sums.add(&Sums::of(factors, more_yaw_rad(leg), yaw_variance));
    }
    let reported_m = length_m(&leg.by_wheels);
    let is_straight = leg.yaw_rad.abs() < STRAIGHT_RAD && reported_m.abs() > LEAST_M;
    let variance =
        leg.variances.forward_m2 + config.wheel_distance_noise.powi(2) * reported_m.abs();
    if is_straight && variance.is_finite() {
        let more_m = length_m(&leg.by_scans) - reported_m;
        sums.add(&Sums::of(Vector3::new(0.0, 0.0, reported_m), more_m, variance));
    }
    sums
}

/// The scanner's mount beside the configured one: yaw (rad), forward and left (m), about the middle of the axle.
///
/// With the scanner moved by a small `D` in the base's frame, the scans report `D^-1 M D` of a motion `M`: its translation `t` turns by
/// minus the yaw, and a rotation `R` adds `(R - I) d`. The wheels' path takes its yaw from the scans, so that unequal wheels do not
/// matter.
pub(super) fn scanner(leg: &DrivenLeg, config: &LocalizationConfig) -> Sums<3> {
    let mut sums = Sums::default();
    // An arc whose yaw is wrong by some angle has a chord that is wrong by half of it.
    let bend = Pose2::new(0.0, 0.0, 0.5 * more_yaw_rad(leg));
    let t = bend.compose(&leg.by_wheels);
    let (sin, cos) = wrap_angle(leg.by_scans.yaw_rad).sin_cos();
    let slip = (SIDE_SLIP_M_PER_RAD * leg.yaw_rad).powi(2);
    let distance_m = leg.distance_m.abs();
    let along = leg.variances.forward_m2
        + config.wheel_distance_noise.powi(2) * distance_m
        + (DISTANCE_SCALE * distance_m).powi(2)
        + slip;
    // Within the leg, the heading drifts as it does from leg to leg.
    let across = leg.variances.left_m2
        + config.wheel_drift_rad_per_m.powi(2) * distance_m.powi(3) / 12.0
        + slip;
    let rows = [
        (Vector3::new(t.y_m, cos - 1.0, -sin), leg.by_scans.x_m - t.x_m, along),
        (Vector3::new(-t.x_m, sin, cos - 1.0), leg.by_scans.y_m - t.y_m, across),
    ];
    for (factors, value, variance) in rows {
        if variance.is_finite() && variance > 0.0 {
            sums.add(&Sums::of(factors, value, variance));
        }
    }
    sums
}

/// The yaw by the scans less that by the wheels.
fn more_yaw_rad(leg: &DrivenLeg) -> f64 {
    wrap_angle(leg.by_scans.yaw_rad - leg.yaw_rad)
}

fn length_m(motion: &Pose2) -> f64 {
    let length_m = motion.x_m.hypot(motion.y_m);
    if motion.x_m < 0.0 { -length_m } else { length_m }
}
