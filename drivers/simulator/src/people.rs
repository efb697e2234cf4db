//! Walking people: simple bodies that follow known paths and are seen by the camera and the laser
//! scanner.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use crate::body::{BodyFrame, Capsule};
use crate::path::Path;

/// One person at one moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Person {
    /// Position at which the body's axis meets the floor (z = 0), world frame, metres.
    pub position_m: [f64; 2],
    /// Heading of the person, radians.
    pub yaw_rad: f64,
    /// Phase of the gait, radians; 0 means feet together.
    pub stride_rad: f64,
    /// Height from sole to crown, metres.
    pub height_m: f64,
    pub clothes: Clothes,
}

/// Linear-light colours of a person.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Clothes {
    /// Colour of the torso and the arms.
    pub shirt: [f32; 3],
    pub trousers: [f32; 3],
    pub skin: [f32; 3],
}

impl Person {
    /// An adult of 1.75 m who stands with feet together and faces along x.
    #[must_use]
    pub fn standing(x_m: f64, y_m: f64) -> Self {
        let clothes = Clothes {
            shirt: [0.08, 0.16, 0.42],
            trousers: [0.05, 0.05, 0.06],
            skin: [0.55, 0.33, 0.22],
        };
        Self { position_m: [x_m, y_m], yaw_rad: 0.0, stride_rad: 0.0, height_m: 1.75, clothes }
    }

    /// The capsules of legs, torso, arms and head, with adult proportions scaled by height.
    #[must_use]
    pub fn body(&self) -> [Capsule; 6] {
        // Lengths are those of a 1.75 m person.
        let frame = BodyFrame::new(self.position_m, self.yaw_rad, self.height_m / 1.75);
        let swing = self.stride_rad.sin();
        let Clothes { shirt, trousers, skin } = self.clothes;
        let torso = [frame.at(0.0, 0.0, 0.98), frame.at(0.0, 0.0, 1.3)];
        let head = [frame.at(0.0, 0.0, 1.62), frame.at(0.0, 0.0, 1.64)];
        [
            leg(&frame, 1.0, swing, trousers),
            leg(&frame, -1.0, swing, trousers),
            frame.part(torso, 0.18, shirt),
            arm(&frame, 1.0, swing, shirt),
            arm(&frame, -1.0, swing, shirt),
            frame.part(head, 0.11, skin),
        ]
    }
}

/// A leg; `side` is 1 for left and -1 for right, `swing` the sine of the gait phase.
fn leg(frame: &BodyFrame, side: f64, swing: f64, color: [f32; 3]) -> Capsule {
    let foot = frame.at(0.3 * side * swing, 0.1 * side, 0.07);
    let hip = frame.at(0.0, 0.1 * side, 0.86);
    frame.part([foot, hip], 0.07, color)
}

/// An arm, which swings against the leg of its side.
fn arm(frame: &BodyFrame, side: f64, swing: f64, color: [f32; 3]) -> Capsule {
    let hand = frame.at(-0.2 * side * swing, 0.27 * side, 0.85);
    let shoulder = frame.at(0.0, 0.22 * side, 1.38);
    frame.part([hand, shoulder], 0.045, color)
}

/// A person who walks back and forth along a line of waypoints without stopping.
#[derive(Debug, Clone, PartialEq)]
pub struct Walker {
    path: Path,
    speed_mps: f64,
    start_m: f64,
    height_m: f64,
    clothes: Clothes,
}

/// Length of a full gait cycle (two steps) of a walking adult, metres.
const STRIDE_M: f64 = 1.4;

impl Walker {
    /// Creates a walker on a path of waypoints (metres) at a constant speed (m/s). The seed selects
    /// clothes, height and the start point on the path. Returns `None` without waypoints, when a
    /// number is not finite or when the speed is negative.
    #[must_use]
    pub fn new(waypoints_m: Vec<[f64; 2]>, speed_mps: f64, seed: u64) -> Option<Self> {
        let path = Path::new(waypoints_m)?;
        if !(speed_mps.is_finite() && speed_mps >= 0.0) {
            return None;
        }
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let start_m = rng.random_range(0.0..=1.0) * path.length_m();
        let height_m = rng.random_range(1.55..1.9);
        let shirt = fabric(0.6, &mut rng);
        let trousers = fabric(0.25, &mut rng);
        let clothes = Clothes { shirt, trousers, skin: [0.55, 0.33, 0.22] };
        Some(Self { path, speed_mps, start_m, height_m, clothes })
    }

    /// Position and posture at a time.
    #[must_use]
    pub fn at(&self, time_ns: u64) -> Person {
        let walked = self.start_m + self.speed_mps * time_ns as f64 * 1e-9;
        let place = self.path.after(walked);
        let walks = self.path.length_m() > 0.0;
        Person {
            position_m: place.position_m,
            yaw_rad: place.yaw_rad,
            stride_rad: if walks { walked / STRIDE_M * std::f64::consts::TAU } else { 0.0 },
            height_m: self.height_m,
            clothes: self.clothes,
        }
    }
}

fn fabric(brightest: f32, rng: &mut Pcg64Mcg) -> [f32; 3] {
    [(); 3].map(|()| rng.random_range(0.02..brightest))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND_NS: u64 = 1_000_000_000;

    fn corridor(speed_mps: f64, seed: u64) -> Walker {
        Walker::new(vec![[0.0, 0.0], [4.0, 0.0], [4.0, 3.0]], speed_mps, seed).unwrap()
    }

    #[test]
    fn a_walker_stays_on_its_path_and_keeps_its_speed() {
        let walker = corridor(1.2, 7);
        let mut before = walker.at(0);
        let mut slow_steps = 0;
        for step in 1..2000 {
            let now = walker.at(step * SECOND_NS / 50);
            let [x, y] = now.position_m;
            let on_line = (y.abs() < 1e-9 && (-1e-9..=4.0 + 1e-9).contains(&x))
                || ((x - 4.0).abs() < 1e-9 && (-1e-9..=3.0 + 1e-9).contains(&y));
            assert!(on_line, "({x}, {y})");
            let moved = (x - before.position_m[0]).hypot(y - before.position_m[1]);
            assert!(moved <= 1.2 / 50.0 + 1e-9);
            slow_steps += usize::from(moved < 1.2 / 50.0 - 1e-6);
            before = now;
        }
        // 48 m on a line of 7 m with one corner: the walker reverses or rounds the corner about 13
        // times.
        assert!((8..=16).contains(&slow_steps), "{slow_steps}");
    }

    #[test]
    fn a_walker_faces_its_direction_of_motion() {
        let walker = corridor(1.0, 1);
        for step in 0..700 {
            let now = walker.at(step * SECOND_NS / 10);
            let next = walker.at(step * SECOND_NS / 10 + 1_000_000);
            let going =
                [next.position_m[0] - now.position_m[0], next.position_m[1] - now.position_m[1]];
            let ahead = going[0] * now.yaw_rad.cos() + going[1] * now.yaw_rad.sin();
            assert!(ahead > 0.9e-3 || going[0].hypot(going[1]) < 0.95e-3, "{ahead}");
        }
    }

    #[test]
    fn the_seed_alone_selects_clothes_and_start_point() {
        assert_eq!(corridor(1.0, 3).at(5 * SECOND_NS), corridor(1.0, 3).at(5 * SECOND_NS));
        let a = corridor(1.0, 3).at(0);
        let b = corridor(1.0, 4).at(0);
        assert!(a.clothes != b.clothes && a.position_m != b.position_m);
    }

    #[test]
    fn one_waypoint_makes_a_standing_person_and_no_waypoint_is_refused() {
        let still = Walker::new(vec![[1.0, 2.0]], 1.0, 0).unwrap();
        assert_eq!(still.at(9 * SECOND_NS).position_m, [1.0, 2.0]);
        assert!(Walker::new(vec![], 1.0, 0).is_none());
        assert!(Walker::new(vec![[f64::NAN, 0.0]], 1.0, 0).is_none());
        assert!(Walker::new(vec![[0.0, 0.0]], -1.0, 0).is_none());
    }
}
