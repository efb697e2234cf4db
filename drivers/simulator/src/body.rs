//! Bodies of capsules, which the camera and the laser scanner see: what people and pets are made of.

use nalgebra::Vector3;

/// A capsule: every point nearer to the segment from `from` to `to` than `radius_m`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Capsule {
    /// End of the axis, world frame, metres.
    pub from: Vector3<f64>,
    /// The other end of the axis.
    pub to: Vector3<f64>,
    pub radius_m: f64,
    /// Colour in linear light, RGB.
    pub color: [f32; 3],
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

/// Position, heading and scale of a body. Its methods take lengths before scaling, metres.
pub(crate) struct BodyFrame {
    position_m: [f64; 2],
    sin: f64,
    cos: f64,
    scale: f64,
}

impl BodyFrame {
    /// `position_m` is on the floor, world frame, metres.
    pub fn new(position_m: [f64; 2], yaw_rad: f64, scale: f64) -> Self {
        let (sin, cos) = yaw_rad.sin_cos();
        Self { position_m, sin, cos, scale }
    }

    /// A point of the body in the world.
    pub fn at(&self, forward: f64, left: f64, up: f64) -> Vector3<f64> {
        let [x, y] = self.position_m;
        let forward = forward * self.scale;
        let left = left * self.scale;
        Vector3::new(
            x + forward * self.cos - left * self.sin,
            y + forward * self.sin + left * self.cos,
            up * self.scale,
        )
    }

    /// The part of the body around the line between two points in the world.
    pub fn part(&self, [from, to]: [Vector3<f64>; 2], radius_m: f64, color: [f32; 3]) -> Capsule {
        Capsule { from, to, radius_m: radius_m * self.scale, color }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

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
