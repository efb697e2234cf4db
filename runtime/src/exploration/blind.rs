//! Policies that use no map: the paper's baselines, and the drive of `calibrate --drive`.

use std::collections::VecDeque;

use hal::Pose2;
use rand::{RngExt, seq::IndexedRandom};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use crate::planning::Primitive;

use super::pattern::Pattern;

/// Rotation steps to the right of `forward` after a collision (released code of the paper,
/// `ForwardAgent`, whose steps have 2 degrees).
const FORWARD_ROTATIONS: usize = 5;
/// Steps in each half of one of `heuristic`'s three moves (released code of the paper,
/// `HeuristicRandomAgent`).
const HEURISTIC_STEPS: usize = 8;

/// A policy without a map, with its state.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub enum BlindPolicy {
    /// Each frame one step forward, left or right, each with probability 1/3.
    Random,
    /// Moves of 16 steps: 8 left + 8 forward, 8 right + 8 forward, or 16 forward, each with
    /// probability 1/3.
    Heuristic {
        /// Remaining steps of the current move.
        queue: VecDeque<Primitive>,
    },
    /// Forward; after a collision it rotates 5 steps to the right.
    Forward {
        /// Number of rotation steps that are left.
        rotations_left: usize,
    },
    /// The drive of `calibrate --drive`.
    Calibration(Pattern),
}

impl BlindPolicy {
    /// The next step of a robot at `pose`. `blocked`: the safety plane has just backed off from an obstacle.
    pub fn next(&mut self, rng: &mut Pcg64Mcg, pose: &Pose2, blocked: bool) -> Primitive {
        use Primitive::{Forward, TurnLeft, TurnRight};
        match self {
            Self::Random => [Forward, TurnLeft, TurnRight].choose(rng).copied().unwrap_or(Forward),
            Self::Heuristic { queue } => {
                if blocked {
                    queue.clear();
                }
                if queue.is_empty() {
                    let first = [TurnLeft, TurnRight, Forward][rng.random_range(0..3)];
                    queue.extend(std::iter::repeat_n(first, HEURISTIC_STEPS));
                    queue.extend(std::iter::repeat_n(Forward, HEURISTIC_STEPS));
                }
                queue.pop_front().unwrap_or(Forward)
            }
            Self::Forward { rotations_left } => {
                if blocked {
                    *rotations_left = FORWARD_ROTATIONS;
                }
                if *rotations_left == 0 {
                    return Forward;
                }
                *rotations_left -= 1;
                TurnRight
            }
            Self::Calibration(pattern) => pattern.next(pose, blocked),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    fn steps(policy: &mut BlindPolicy, count: usize) -> Vec<Primitive> {
        let mut rng = Pcg64Mcg::seed_from_u64(3);
        (0..count).map(|_| policy.next(&mut rng, &Pose2::IDENTITY, false)).collect()
    }

    #[test]
    fn random_takes_each_step_about_a_third_of_the_time() {
        let taken = steps(&mut BlindPolicy::Random, 3000);
        for primitive in [Primitive::Forward, Primitive::TurnLeft, Primitive::TurnRight] {
            let share = taken.iter().filter(|step| **step == primitive).count() as f64 / 3000.0;
            assert!((share - 1.0 / 3.0).abs() < 0.03, "{primitive:?}: {share}");
        }
    }

    #[test]
    fn heuristic_moves_in_blocks_of_sixteen_that_end_forward() {
        let taken = steps(&mut BlindPolicy::Heuristic { queue: VecDeque::new() }, 16 * 50);
        for block in taken.chunks(16) {
            assert!(block[8..].iter().all(|step| *step == Primitive::Forward));
            assert!(block[..8].iter().all(|step| step == &block[0]));
        }
    }

    #[test]
    fn forward_turns_ten_degrees_to_the_right_after_a_collision_and_drives_on() {
        let mut policy = BlindPolicy::Forward { rotations_left: 0 };
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        assert_eq!(policy.next(&mut rng, &Pose2::IDENTITY, false), Primitive::Forward);
        assert_eq!(policy.next(&mut rng, &Pose2::IDENTITY, true), Primitive::TurnRight);
        let rest: Vec<_> = (0..5).map(|_| policy.next(&mut rng, &Pose2::IDENTITY, false)).collect();
        assert_eq!(rest[..4], [Primitive::TurnRight; 4]);
        assert_eq!(rest[4], Primitive::Forward);
    }

    #[test]
    fn the_same_seed_takes_the_same_steps() {
        assert_eq!(steps(&mut BlindPolicy::Random, 100), steps(&mut BlindPolicy::Random, 100));
    }
}
