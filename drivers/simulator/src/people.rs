//! Walking people: simple bodies that follow known paths and are seen by the camera and the laser
//! scanner.

use nalgebra::Vector3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

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

/// A capsule: every point nearer to the segment from `from` to `to` than `radius_m`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Capsule {
    pub from: Vector3<f64>,
    pub to: Vector3<f64>,
    pub radius_m: f64,
    pub color: [f32; 3],
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
    pub(crate) fn body(&self) -> [Capsule; 6] {
        let frame = BodyFrame::new(self);
        let swing = self.stride_rad.sin();
        let Clothes { shirt, trousers, skin } = self.clothes;
        let torso = [frame.at(0.0, 0.0, 0.98), frame.at(0.0, 0.0, 1.3)];
        let head = [frame.at(0.0, 0.0, 1.62), frame.at(0.0, 0.0, 1.64)];
        [
            frame.leg(1.0, swing, trousers),
            frame.leg(-1.0, swing, trousers),
            frame.part(torso, 0.18, shirt),
            frame.arm(1.0, swing, shirt),
            frame.arm(-1.0, swing, shirt),
            frame.part(head, 0.11, skin),
        ]
    }
}

/// Position, heading and scale of a body. Its methods take metres of a 1.75 m person.
struct BodyFrame {
    position_m: [f64; 2],
    sin: f64,
    cos: f64,
    scale: f64,
}

impl BodyFrame {
    fn new(person: &Person) -> Self {
        let scale = person.height_m / 1.75;
        let (sin, cos) = person.yaw_rad.sin_cos();
        Self { position_m: person.position_m, sin, cos, scale }
    }

    fn at(&self, forward: f64, left: f64, up: f64) -> Vector3<f64> {
        let [x, y] = self.position_m;
        let forward = forward * self.scale;
        let left = left * self.scale;
        Vector3::new(
            x + forward * self.cos - left * self.sin,
            y + forward * self.sin + left * self.cos,
            up * self.scale,
        )
    }

    fn part(&self, [from, to]: [Vector3<f64>; 2], radius_m: f64, color: [f32; 3]) -> Capsule {
        Capsule { from, to, radius_m: radius_m * self.scale, color }
    }

    /// A leg; `side` is 1 for left and -1 for right, `swing` the sine of the gait phase.
    fn leg(&self, side: f64, swing: f64, color: [f32; 3]) -> Capsule {
        let foot = self.at(0.3 * side * swing, 0.1 * side, 0.07);
        let hip = self.at(0.0, 0.1 * side, 0.86);
        self.part([foot, hip], 0.07, color)
    }

    /// An arm, which swings against the leg of its side.
    fn arm(&self, side: f64, swing: f64, color: [f32; 3]) -> Capsule {
        let hand = self.at(-0.2 * side * swing, 0.27 * side, 0.85);
        let shoulder = self.at(0.0, 0.22 * side, 1.38);
        self.part([hand, shoulder], 0.045, color)
    }
}

impl Capsule {
    /// Distance at which a ray enters the capsule, in lengths of `direction`. `None` for a ray that
    /// misses it or starts inside.
    pub fn entry(&self, origin: &Vector3<f64>, direction: &Vector3<f64>) -> Option<f64> {
        let axis = self.to - self.from;
        let start = origin - self.from;
        let length_2 = axis.dot(&axis);
        let axis_direction = axis.dot(direction);
        let axis_start = axis.dot(&start);
        // The infinite cylinder gives a quadratic equation in the ray's component perpendicular to
        // the axis.
        let a = length_2 * direction.norm_squared() - axis_direction * axis_direction;
        let b = length_2 * direction.dot(&start) - axis_start * axis_direction;
        let c = length_2 * (start.norm_squared() - self.radius_m * self.radius_m)
            - axis_start * axis_start;
        let discriminant = b * b - a * c;
        if discriminant < 0.0 {
            return None;
        }
        let mut end = if axis_direction > 0.0 { &self.from } else { &self.to };
        if a > f64::EPSILON * length_2 {
            let t = (-b - discriminant.sqrt()) / a;
            let along = axis_start + t * axis_direction;
            if along > 0.0 && along < length_2 {
                return (t >= 0.0).then_some(t);
            }
            end = if along <= 0.0 { &self.from } else { &self.to };
        }
        sphere_entry(&(origin - end), direction, self.radius_m)
    }

    /// Unit normal at a point of the surface.
    pub fn normal(&self, point: &Vector3<f64>) -> Vector3<f64> {
        let axis = self.to - self.from;
        let along = ((point - self.from).dot(&axis) / axis.norm_squared()).clamp(0.0, 1.0);
        (point - self.from - axis * along) / self.radius_m
    }
}

/// Distance at which a ray enters a sphere; `start` is the ray's origin relative to the sphere's
/// centre.
fn sphere_entry(start: &Vector3<f64>, direction: &Vector3<f64>, radius: f64) -> Option<f64> {
    let a = direction.norm_squared();
    let b = direction.dot(start);
    let discriminant = b * b - a * (start.norm_squared() - radius * radius);
    if discriminant < 0.0 {
        return None;
    }
    let t = (-b - discriminant.sqrt()) / a;
    (t >= 0.0).then_some(t)
}

/// A person who walks back and forth along a line of waypoints without stopping.
#[derive(Debug, Clone, PartialEq)]
pub struct Walker {
    waypoints_m: Vec<[f64; 2]>,
    /// Path length up to each waypoint, metres.
    reached_m: Vec<f64>,
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
        let sound = waypoints_m.iter().flatten().all(|c| c.is_finite())
            && speed_mps.is_finite()
            && speed_mps >= 0.0;
        if waypoints_m.is_empty() || !sound {
            return None;
        }
        let mut reached_m = vec![0.0];
        for pair in waypoints_m.windows(2) {
            let step = (pair[1][0] - pair[0][0]).hypot(pair[1][1] - pair[0][1]);
            reached_m.push(reached_m[reached_m.len() - 1] + step);
        }
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let start_m = rng.random_range(0.0..=1.0) * reached_m[reached_m.len() - 1];
        let height_m = rng.random_range(1.55..1.9);
        let shirt = fabric(0.6, &mut rng);
        let trousers = fabric(0.25, &mut rng);
        let clothes = Clothes { shirt, trousers, skin: [0.55, 0.33, 0.22] };
        Some(Self { waypoints_m, reached_m, speed_mps, start_m, height_m, clothes })
    }

    /// Position and posture at a time.
    #[must_use]
    pub fn at(&self, time_ns: u64) -> Person {
        let length = self.reached_m[self.reached_m.len() - 1];
        let walked = self.start_m + self.speed_mps * time_ns as f64 * 1e-9;
        // Walking back and forth is a triangle wave of the path length.
        let lap = if length > 0.0 { walked.rem_euclid(2.0 * length) } else { 0.0 };
        let (along, backwards) =
            if lap <= length { (lap, false) } else { (2.0 * length - lap, true) };
        let segment = self
            .reached_m
            .partition_point(|&r| r <= along)
            .clamp(1, self.reached_m.len().max(2) - 1);
        let from = self.waypoints_m[segment - 1];
        let to = self.waypoints_m.get(segment).copied().unwrap_or(from);
        let step = [to[0] - from[0], to[1] - from[1]];
        let share =
            (along - self.reached_m[segment - 1]) / step[0].hypot(step[1]).max(f64::MIN_POSITIVE);
        let heading = if backwards { [-step[0], -step[1]] } else { step };
        Person {
            position_m: [from[0] + share * step[0], from[1] + share * step[1]],
            yaw_rad: heading[1].atan2(heading[0]),
            stride_rad: if length > 0.0 { walked / STRIDE_M * std::f64::consts::TAU } else { 0.0 },
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
    use proptest::prelude::*;

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

    #[test]
    fn a_capsule_is_entered_at_its_side_and_at_its_caps() {
        let part = Capsule {
            from: Vector3::new(0.0, 0.0, 1.0),
            to: Vector3::new(0.0, 0.0, 2.0),
            radius_m: 0.5,
            color: [0.0; 3],
        };
        let entry =
            |origin: [f64; 3], direction: [f64; 3]| part.entry(&origin.into(), &direction.into());
        assert!((entry([-3.0, 0.0, 1.5], [1.0, 0.0, 0.0]).unwrap() - 2.5).abs() < 1e-12);
        // Along the axis, and parallel to it.
        assert!((entry([0.0, 0.0, 5.0], [0.0, 0.0, -1.0]).unwrap() - 2.5).abs() < 1e-12);
        assert!((entry([0.3, 0.0, 5.0], [0.0, 0.0, -1.0]).unwrap() - 2.6).abs() < 1e-12);
        assert_eq!(entry([0.6, 0.0, 5.0], [0.0, 0.0, -1.0]), None);
        assert_eq!(entry([-3.0, 0.0, 1.5], [-1.0, 0.0, 0.0]), None);
        assert_eq!(
            entry([0.1, 0.0, 1.5], [1.0, 0.0, 0.0]),
            None,
            "a ray that starts inside does not enter"
        );
    }

    fn distance_m(point: &Vector3<f64>, part: &Capsule) -> f64 {
        part.normal(point).norm() * part.radius_m
    }

    proptest! {
        #[test]
        fn where_a_ray_enters_is_on_the_surface_and_outside_before(
            origin in prop::array::uniform3(-4.0..4.0_f64), target in prop::array::uniform3(-0.6..0.6_f64),
            from in prop::array::uniform3(-0.5..0.5_f64), to in prop::array::uniform3(-0.5..0.5_f64),
        ) {
            let part = Capsule { from: from.into(), to: to.into(), radius_m: 0.3, color: [0.0; 3] };
            let origin: Vector3<f64> = origin.into();
            let target: Vector3<f64> = target.into();
            prop_assume!(distance_m(&origin, &part) > 0.31);
            let direction = target - origin;
            let first_inside = (0..4000).map(|i| f64::from(i) / 2000.0).find(|s| distance_m(&(origin + direction * *s), &part) < 0.3);
            match part.entry(&origin, &direction) {
                Some(t) => {
                    prop_assert!((distance_m(&(origin + direction * t), &part) - 0.3).abs() < 1e-6);
                    prop_assert!(first_inside.is_none_or(|s| s >= t - 1e-9));
                }
                None => prop_assert!(first_inside.is_none()),
            }
        }
    }
}
