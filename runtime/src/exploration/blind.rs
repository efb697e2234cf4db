//! Policies that look at nothing but the bumper: the paper's baselines.

use std::collections::VecDeque;

use rand::{RngExt, seq::IndexedRandom};
use rand_pcg::Pcg64Mcg;
use serde::{Deserialize, Serialize};

use crate::planning::Primitive;

/// Right turns of `forward` after a collision: 5 steps of 2 degrees (released code of the paper, `ForwardAgent`).
const FORWARD_TURNS: usize = 5;
/// Length of the short arms of `heuristic`'s three moves (released code of the paper, `HeuristicRandomAgent`).
const HEURISTIC_STEPS: usize = 8;

/// A policy without a map.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub enum BlindPolicy {
    /// Forward, left or right, each with probability 1/3, anew every frame.
    Random,
    /// 8 left + 8 forward, 8 right + 8 forward, or 16 forward, each with probability 1/3.
    Heuristic {
        /// Steps still to do.
        queue: VecDeque<Primitive>,
    },
    /// Forward; after a collision 10 degrees to the right.
    Forward {
        /// Turns still to do.
        turns_left: usize,
    },
}

impl BlindPolicy {
    /// The next step. `blocked`: the bumper has just backed off from something.
    pub fn next(&mut self, rng: &mut Pcg64Mcg, blocked: bool) -> Primitive {
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
            Self::Forward { turns_left } => {
                if blocked {
                    *turns_left = FORWARD_TURNS;
                }
                if *turns_left == 0 {
                    return Forward;
                }
                *turns_left -= 1;
                TurnRight
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;

    fn steps(policy: &mut BlindPolicy, count: usize) -> Vec<Primitive> {
        let mut rng = Pcg64Mcg::seed_from_u64(3);
        (0..count).map(|_| policy.next(&mut rng, false)).collect()
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
        let mut policy = BlindPolicy::Forward { turns_left: 0 };
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        assert_eq!(policy.next(&mut rng, false), Primitive::Forward);
        assert_eq!(policy.next(&mut rng, true), Primitive::TurnRight);
        let rest: Vec<_> = (0..5).map(|_| policy.next(&mut rng, false)).collect();
        assert_eq!(rest[..4], [Primitive::TurnRight; 4]);
        assert_eq!(rest[4], Primitive::Forward);
    }

    #[test]
    fn the_same_seed_takes_the_same_steps() {
        assert_eq!(steps(&mut BlindPolicy::Random, 100), steps(&mut BlindPolicy::Random, 100));
    }
}
