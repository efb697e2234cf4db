//! Pets: cats and small dogs that walk slowly along paths and lie down from time to time.

use std::f64::consts::TAU;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use crate::body::{BodyFrame, Capsule};
use crate::floor::Disc;
use crate::path::Path;

/// One cat or small dog at one moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pet {
    /// Point of the floor below the middle of the trunk, world frame, metres.
    pub position_m: [f64; 2],
    /// Direction in which it faces, world frame, radians.
    pub yaw_rad: f64,
    /// Phase of the gait, radians; 0 means that all legs are vertical.
    pub stride_rad: f64,
    /// 0 for a pet that stands or walks, 1 for one that lies, and between them while it lies down or rises.
    pub lying: f64,
    /// Height of the shoulders above the floor while it stands, metres.
    pub shoulder_m: f64,
    /// Colour of its fur in linear light, RGB.
    pub fur: [f32; 3],
}

/// Half the length of the axis of the trunk, and radii of the parts, in shoulder heights. The
/// proportions are estimates after photographs of cats and of terriers.
const HALF_TRUNK: f64 = 0.42;
const TRUNK_RADIUS: f64 = 0.15;
const HEAD_RADIUS: f64 = 0.12;
const LEG_RADIUS: f64 = 0.045;
const TAIL_RADIUS: f64 = 0.035;

impl Pet {
    /// A brown animal of 0.35 m that stands and faces along x.
    #[must_use]
    pub fn standing(x_m: f64, y_m: f64) -> Self {
        Self {
            position_m: [x_m, y_m],
            yaw_rad: 0.0,
            stride_rad: 0.0,
            lying: 0.0,
            shoulder_m: 0.35,
            fur: [0.25, 0.15, 0.08],
        }
    }

    /// The capsules of trunk, head, tail and legs. Lying, all of them are lower than a third of the shoulder height.
    #[must_use]
    pub fn body(&self) -> [Capsule; 7] {
        let trunk = [(-HALF_TRUNK, 0.0, 0.85), (HALF_TRUNK, 0.0, 0.85)];
        let trunk_lying = [(-HALF_TRUNK, 0.0, 0.155), (HALF_TRUNK, 0.0, 0.155)];
        let head = [(0.55, 0.0, 1.02), (0.75, 0.0, 0.97)];
        let head_lying = [(0.55, 0.0, 0.19), (0.75, 0.0, 0.14)];
        let tail = [(-0.52, 0.0, 0.9), (-0.85, 0.0, 1.15)];
        let tail_lying = [(-0.52, 0.0, 0.1), (-0.9, 0.2, 0.04)];
        [
            self.part([trunk, trunk_lying], TRUNK_RADIUS),
            self.part([head, head_lying], HEAD_RADIUS),
            self.part([tail, tail_lying], TAIL_RADIUS),
            self.leg(1.0, 1.0),
            self.leg(1.0, -1.0),
            self.leg(-1.0, 1.0),
            self.leg(-1.0, -1.0),
        ]
    }

    /// What blocks the robot: rump, middle, chest and head, as wide as the folded legs.
    #[must_use]
    pub fn discs(&self) -> [Disc; 4] {
        let frame = self.frame();
        [-HALF_TRUNK, 0.0, HALF_TRUNK, 0.72].map(|forward| {
            let center = frame.at(forward, 0.0, 0.0);
            Disc { center_m: [center.x, center.y], radius_m: 0.19 * self.shoulder_m }
        })
    }

    /// A leg; `fore` is 1 for a fore leg and -1 for a hind leg, `side` 1 for left and -1 for right.
    /// Legs across from each other swing together, as in a trot. Lying, they point forwards.
    fn leg(&self, fore: f64, side: f64) -> Capsule {
        let swing = 0.2 * fore * side * self.stride_rad.sin();
        let hip = 0.36 * fore;
        let upright = [(hip + swing, 0.08 * side, LEG_RADIUS), (hip, 0.08 * side, 0.8)];
        let folded = [(hip + 0.4, 0.14 * side, LEG_RADIUS), (hip, 0.14 * side, 0.08)];
        self.part([upright, folded], LEG_RADIUS)
    }

    /// A part of the body by its ends (forward, left, up) while the pet stands and while it lies.
    fn part(&self, [upright, lying]: [[(f64, f64, f64); 2]; 2], radius: f64) -> Capsule {
        let frame = self.frame();
        let ends = [0, 1].map(|end| {
            let (forward, left, up) = upright[end];
            let (forward_lying, left_lying, up_lying) = lying[end];
            let between = |a: f64, b: f64| a + self.lying * (b - a);
            frame.at(
                between(forward, forward_lying),
                between(left, left_lying),
                between(up, up_lying),
            )
        });
        frame.part(ends, radius, self.fur)
    }

    fn frame(&self) -> BodyFrame {
        BodyFrame::new(self.position_m, self.yaw_rad, self.shoulder_m)
    }
}

/// A pet that walks back and forth along a line of waypoints and rests from time to time.
#[derive(Debug, Clone, PartialEq)]
pub struct PetWalker {
    path: Path,
    /// Distance from the first waypoint at time 0, metres.
    start_m: f64,
    /// Time for which it walks, and then rests.
    walk_s: f64,
    rest_s: f64,
    shoulder_m: f64,
    fur: [f32; 3],
}

/// Speed of a pet that strolls, m/s: half of that of the simulated people.
const STROLL_MPS: f64 = 0.4;
/// Time to lie down, and to rise, seconds. It is part of a rest.
const LIE_DOWN_S: f64 = 0.8;
/// Length of a full gait cycle, in shoulder heights.
const STRIDE: f64 = 1.4;

impl PetWalker {
    /// Creates a pet on a path of waypoints (metres). The seed selects size, fur, the start point on
    /// the path, and for how long it walks and rests. Returns `None` without waypoints or when a
    /// number is not finite.
    #[must_use]
    pub fn new(waypoints_m: Vec<[f64; 2]>, seed: u64) -> Option<Self> {
        let path = Path::new(waypoints_m)?;
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let start_m = rng.random_range(0.0..=1.0) * path.length_m();
        let walk_s = rng.random_range(5.0..15.0);
        let rest_s = rng.random_range(5.0..15.0);
        let shoulder_m = rng.random_range(0.25..0.45);
        let brightness: f32 = rng.random_range(0.02..0.5);
        // From grey to ginger: fur reflects more red than blue.
        let ginger: f32 = rng.random_range(0.3..1.0);
        let fur = [brightness, brightness * (0.5 + 0.5 * ginger), brightness * ginger];
        Some(Self { path, start_m, walk_s, rest_s, shoulder_m, fur })
    }

    /// Position and posture at a time.
    #[must_use]
    pub fn at(&self, time_ns: u64) -> Pet {
        let time_s = time_ns as f64 * 1e-9;
        let cycle_s = self.walk_s + self.rest_s;
        let cycles = (time_s / cycle_s).floor();
        let within_s = time_s - cycles * cycle_s;
        let walking_s = cycles * self.walk_s + within_s.min(self.walk_s);
        let walked_m = self.start_m + STROLL_MPS * walking_s;
        // It lies down at the beginning of a rest and rises at its end.
        let from_rest_s = (within_s - self.walk_s).min(cycle_s - within_s);
        let place = self.path.after(walked_m);
        Pet {
            position_m: place.position_m,
            yaw_rad: place.yaw_rad,
            stride_rad: walked_m / (STRIDE * self.shoulder_m) * TAU,
            lying: (from_rest_s / LIE_DOWN_S).clamp(0.0, 1.0),
            shoulder_m: self.shoulder_m,
            fur: self.fur,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND_NS: u64 = 1_000_000_000;

    fn pet(seed: u64) -> PetWalker {
        PetWalker::new(vec![[0.0, 0.0], [4.0, 0.0], [4.0, 3.0]], seed).unwrap()
    }

    /// Height of the highest point of a body, metres.
    fn top_m(pet: &Pet) -> f64 {
        let tops = pet.body().map(|part| part.from.z.max(part.to.z) + part.radius_m);
        tops.into_iter().fold(0.0, f64::max)
    }

    /// Height of the lowest point of a body, metres.
    fn bottom_m(pet: &Pet) -> f64 {
        let bottoms = pet.body().map(|part| part.from.z.min(part.to.z) - part.radius_m);
        bottoms.into_iter().fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn a_pet_has_the_height_of_a_cat_or_a_small_dog_and_lying_it_is_lower_than_15_cm() {
        for seed in 0..100 {
            let moments = (0..400).map(|step| pet(seed).at(step * SECOND_NS / 8));
            for now in moments {
                assert!((0.25..0.45).contains(&now.shoulder_m));
                let [trunk, ..] = now.body();
                if now.lying == 0.0 {
                    let shoulder_m = trunk.from.z + trunk.radius_m;
                    assert!((shoulder_m - now.shoulder_m).abs() < 1e-9, "{shoulder_m}");
                }
                if now.lying == 1.0 {
                    assert!(top_m(&now) < 0.15, "{}", top_m(&now));
                }
                assert!((0.0..0.01).contains(&bottom_m(&now)), "{}", bottom_m(&now));
            }
        }
    }

    #[test]
    fn a_pet_rests_where_it_stopped_and_walks_no_faster_than_it_strolls() {
        for seed in 0..20 {
            let walker = pet(seed);
            let mut before = walker.at(0);
            let mut rests = 0;
            for step in 1..2000 {
                let now = walker.at(step * SECOND_NS / 20);
                let moved_m = (now.position_m[0] - before.position_m[0])
                    .hypot(now.position_m[1] - before.position_m[1]);
                assert!(moved_m <= STROLL_MPS / 20.0 + 1e-9);
                assert!((now.lying - before.lying).abs() <= 1.0 / 20.0 / LIE_DOWN_S + 1e-9);
                if before.lying > 0.0 && now.lying > 0.0 {
                    assert!(moved_m < 1e-9, "it does not glide: {moved_m}");
                }
                rests += usize::from(before.lying < 1.0 && now.lying == 1.0);
                before = now;
            }
            // 100 s, and 10 to 30 s for a walk and a rest.
            assert!((3..=10).contains(&rests), "{rests}");
        }
    }

    #[test]
    fn what_blocks_the_robot_covers_the_body_of_the_pet_to_5_mm() {
        for lying in [0.0, 1.0] {
            let pet = Pet { yaw_rad: 0.7, lying, ..Pet::standing(1.0, 2.0) };
            // The tail is soft.
            let [trunk, head, _, legs @ ..] = pet.body();
            for part in [trunk, head].iter().chain(&legs) {
                let ends = [part.from, part.to].into_iter();
                for (end, step) in ends.flat_map(|end| (0..36).map(move |step| (end, step))) {
                    let (sin, cos) = (f64::from(step) * TAU / 36.0).sin_cos();
                    let [x, y] = [end.x + part.radius_m * cos, end.y + part.radius_m * sin];
                    let outside = pet.discs().map(|disc| {
                        (x - disc.center_m[0]).hypot(y - disc.center_m[1]) - disc.radius_m
                    });
                    let outside_m = outside.into_iter().fold(f64::INFINITY, f64::min);
                    assert!(outside_m < 0.005, "{outside_m} of {part:?}");
                }
            }
        }
    }

    #[test]
    fn the_seed_alone_selects_a_pet_and_one_without_a_path_is_refused() {
        assert_eq!(pet(3).at(5 * SECOND_NS), pet(3).at(5 * SECOND_NS));
        assert_ne!(pet(3).at(0).fur, pet(4).at(0).fur);
        assert!(PetWalker::new(vec![], 0).is_none());
        assert!(PetWalker::new(vec![[f64::NAN, 0.0]], 0).is_none());
    }
}
