//! The drive of `calibrate --drive`: what `calibrate` needs to see, on a free floor of 2 x 2 m.
//!
//! Rotations in both directions show track, scanner and camera; straight lines show the wheel radii and the scanner's yaw; stops show the
//! latencies; arcs show where the camera is (docs/calibration.md, "A good drive"). The robot rotates by a whole turn to each side, then drives
//! to four places around its start, with a stop after each, and begins again. Places follow each other by the golden angle, so that no
//! direction is driven twice.

use std::collections::VecDeque;
use std::f64::consts::TAU;

use hal::{Pose2, wrap_angle};
use serde::{Deserialize, Serialize};

use crate::planning::Primitive;

/// Distance of the places from the start. With the robot's radius, 0.16 m, this stays within a square of 2 m.
const RADIUS_M: f64 = 0.7;
/// Angle from one place to the next, so that the way between them passes the middle: the golden angle.
const NEXT_PLACE_RAD: f64 = 2.399_963;
const PLACES: usize = 4;
/// Ticks of a stop: 0.8 s at 10 Hz, longer than any latency that is measured.
const STOP_TICKS: u32 = 8;
/// A little more than a turn, because the last step ends it early.
const TURN_RAD: f64 = 1.02 * TAU;
/// The place is reached within this distance.
const REACHED_M: f64 = 0.08;
/// Beyond this error of its heading the robot rotates on the spot; beyond the smaller one it drives an arc.
const ROTATE_RAD: f64 = 0.6;
const ARC_RAD: f64 = 0.06;
/// A robot that comes no nearer for so many ticks, because the safety plane holds it, drives to the next place.
const PATIENCE_TICKS: u32 = 40;
const PROGRESS_M: f64 = 0.02;

/// One part of the drive.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
enum Move {
    Stop {
        ticks_left: u32,
    },
    /// Rotates by `rad_left`, positive to the left. `last_rad` is the yaw of the tick before.
    Rotate {
        rad_left: f64,
        last_rad: Option<f64>,
    },
    DriveTo {
        place_m: [f64; 2],
        nearest_m: f64,
        ticks_since: u32,
    },
}

/// The drive and how far it has come.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Pattern {
    /// Where it began.
    start: Option<Pose2>,
    moves: VecDeque<Move>,
    places: u32,
}

impl Pattern {
    /// The step at `pose`. `blocked`: the safety plane has just backed off from an obstacle.
    pub fn next(&mut self, pose: &Pose2, blocked: bool) -> Primitive {
        let start = *self.start.get_or_insert(*pose);
        if blocked && matches!(self.moves.front(), Some(Move::DriveTo { .. })) {
            self.moves.pop_front();
        }
        // Every move that has ended gives way to the next; none of the moves that are appended has ended already.
        loop {
            let Some(current) = self.moves.front_mut() else {
                self.append(&start);
                continue;
            };
            if let Some(step) = current.step(pose) {
                return step;
            }
            self.moves.pop_front();
        }
    }

    /// Appends one round.
    fn append(&mut self, start: &Pose2) {
        let stop = Move::Stop { ticks_left: STOP_TICKS };
        for rad_left in [TURN_RAD, -TURN_RAD] {
            self.moves.push_back(Move::Rotate { rad_left, last_rad: None });
            self.moves.push_back(stop.clone());
        }
        for _ in 0..PLACES {
            let (sin, cos) = (NEXT_PLACE_RAD * f64::from(self.places)).sin_cos();
            let place_m = start.transform(RADIUS_M * cos, RADIUS_M * sin).into();
            self.places = self.places.wrapping_add(1);
            self.moves.push_back(Move::DriveTo {
                place_m,
                nearest_m: f64::INFINITY,
                ticks_since: 0,
            });
            self.moves.push_back(stop.clone());
        }
    }
}

impl Move {
    /// The step of this tick; `None` if the move has ended.
    fn step(&mut self, pose: &Pose2) -> Option<Primitive> {
        match self {
            Self::Stop { ticks_left } => {
                *ticks_left = ticks_left.checked_sub(1)?;
                Some(Primitive::Stay)
            }
            Self::Rotate { rad_left, last_rad } => {
                let direction = rad_left.signum();
                if let Some(last_rad) = last_rad.replace(pose.yaw_rad) {
                    *rad_left -= wrap_angle(pose.yaw_rad - last_rad);
                }
                let has_ended = *rad_left * direction <= 0.0;
                (!has_ended).then_some(rotation(direction))
            }
            Self::DriveTo { place_m, nearest_m, ticks_since } => {
                let (ahead_m, left_m) = pose.inverse().transform(place_m[0], place_m[1]);
                let distance_m = ahead_m.hypot(left_m);
                if distance_m < *nearest_m - PROGRESS_M {
                    *nearest_m = distance_m;
                    *ticks_since = 0;
                }
                *ticks_since += 1;
                let off_rad = left_m.atan2(ahead_m);
                // A robot that rotates comes no nearer.
                if off_rad.abs() > ROTATE_RAD && distance_m > 3.0 * REACHED_M {
                    *ticks_since = (*ticks_since).min(PATIENCE_TICKS / 2);
                    return Some(rotation(off_rad));
                }
                let has_ended = distance_m < REACHED_M
                    || off_rad.abs() > ROTATE_RAD
                    || *ticks_since > PATIENCE_TICKS;
                (!has_ended).then_some(forward(off_rad))
            }
        }
    }
}

fn rotation(direction: f64) -> Primitive {
    if direction > 0.0 { Primitive::TurnLeft } else { Primitive::TurnRight }
}

fn forward(off_rad: f64) -> Primitive {
    match off_rad {
        off if off > ARC_RAD => Primitive::ArcLeft,
        off if off < -ARC_RAD => Primitive::ArcRight,
        _ => Primitive::Forward,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FORWARD_M: f64 = 0.03;
    const TURN_STEP_RAD: f64 = 0.07;

    fn moved(pose: &Pose2, step: Primitive) -> Pose2 {
        let motion = match step {
            Primitive::Forward => [FORWARD_M, 0.0],
            Primitive::TurnLeft => [0.0, TURN_STEP_RAD],
            Primitive::TurnRight => [0.0, -TURN_STEP_RAD],
            Primitive::ArcLeft => [FORWARD_M / 2.0, TURN_STEP_RAD],
            Primitive::ArcRight => [FORWARD_M / 2.0, -TURN_STEP_RAD],
            Primitive::Stay => [0.0, 0.0],
        };
        pose.compose(&Pose2::new(motion[0], 0.0, motion[1]))
    }

    #[test]
    fn two_minutes_hold_rotations_to_both_sides_lines_arcs_and_stops_within_two_metres() {
        let start = Pose2::new(3.0, -2.0, 1.0);
        let mut pattern = Pattern::default();
        let mut pose = start;
        let mut counts = std::collections::BTreeMap::new();
        for _ in 0..1200 {
            let step = pattern.next(&pose, false);
            *counts.entry(format!("{step:?}")).or_insert(0) += 1;
            pose = moved(&pose, step);
            assert!(start.distance_m(&pose) < RADIUS_M + REACHED_M, "{pose:?}");
        }
        let count = |step: &str| counts.get(step).copied().unwrap_or(0);
        assert!(count("TurnLeft") > 200 && count("TurnRight") > 200, "{counts:?}");
        assert!(count("Forward") > 250, "{counts:?}");
        assert!(count("ArcLeft") + count("ArcRight") > 20, "{counts:?}");
        assert!(count("Stay") > 80, "{counts:?}");
    }

    #[test]
    fn a_place_behind_an_obstacle_is_given_up_when_the_safety_plane_has_backed_off() {
        let mut pattern = Pattern { start: Some(Pose2::IDENTITY), ..Pattern::default() };
        let place_m = [RADIUS_M, 0.0];
        let drive = Move::DriveTo { place_m, nearest_m: f64::INFINITY, ticks_since: 0 };
        pattern.moves.push_back(drive);
        pattern.moves.push_back(Move::Stop { ticks_left: 1 });
        assert_eq!(pattern.next(&Pose2::IDENTITY, false), Primitive::Forward);
        assert_eq!(pattern.next(&Pose2::IDENTITY, true), Primitive::Stay);
    }

    #[test]
    fn a_robot_that_is_held_goes_on_with_another_place() {
        let mut pattern = Pattern { start: Some(Pose2::IDENTITY), ..Pattern::default() };
        let place_m = [RADIUS_M, 0.0];
        pattern.moves.push_back(Move::DriveTo {
            place_m,
            nearest_m: f64::INFINITY,
            ticks_since: 0,
        });
        pattern.moves.push_back(Move::Stop { ticks_left: 1 });
        let steps: Vec<_> =
            (0..=PATIENCE_TICKS).map(|_| pattern.next(&Pose2::IDENTITY, false)).collect();
        assert_eq!(steps.iter().filter(|step| **step == Primitive::Stay).count(), 1);
    }
}
