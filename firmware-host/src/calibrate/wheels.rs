//! What the wheels reported: the travel of each one over time.

use hal::Pose2;
use nalgebra::Vector2;

/// Metres of path that a radian of rotation counts as, where an error of the yaw is shared out along a path: half the track of a
/// small robot is less, but rotation is where wheels are most often wrong.
const METRES_PER_RADIAN: f64 = 0.5;

/// How the travel of the wheels becomes motion of `base_link`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct WheelGeometry {
    /// True travel per reported travel, left and right: the scale of the configured radius.
    pub scale: [f64; 2],
    /// Distance between the contact points, metres.
    pub track_m: f64,
}

impl WheelGeometry {
    /// Motion along an arc, in the frame of its beginning: the length of the arc (m) and the yaw (rad).
    fn arc(&self, travel_m: Vector2<f64>) -> [f64; 2] {
        let [left_m, right_m] = [0, 1].map(|side| self.scale[side] * travel_m[side]);
        [0.5 * (left_m + right_m), (right_m - left_m) / self.track_m]
    }
}

/// The sums of both wheels' reported travel at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Knot {
    time_s: f64,
    /// Left and right, metres.
    travel_m: Vector2<f64>,
}

/// The reported travel of both wheels over time. Between two reports the speeds are constant.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct WheelPath {
    knots: Vec<Knot>,
    last_odom: Option<Pose2>,
}

/// A motion by the wheels: what the yaw of an independent measurement is compared with, and the path's shape.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct WheelMotion {
    /// Yaw by the wheels, not wrapped, radians.
    pub yaw_rad: f64,
    /// Length of the path without signs, metres.
    pub distance_m: f64,
    /// Sum of all rotations without signs, radians.
    pub rotation_rad: f64,
}

impl WheelPath {
    /// Adds a pose by dead reckoning with the configured `track_m`. Reports have to come in the order of time; one that is not
    /// newer, or not finite, is left out.
    pub fn push(&mut self, time_s: f64, odom: &Pose2, track_m: f64) {
        let is_newer = self.knots.last().is_none_or(|last| time_s > last.time_s);
        if !odom.is_finite() || !is_newer {
            return;
        }
        let moved = self.last_odom.map_or(Pose2::IDENTITY, |last| last.inverse().compose(odom));
        self.last_odom = Some(*odom);
        let before = self.knots.last().map_or(Vector2::zeros(), |last| last.travel_m);
        self.knots.push(Knot { time_s, travel_m: before + travel(&moved, track_m) });
    }

    /// The same path as wheels with these scales would report it.
    pub fn reported_with(mut self, scale: [f64; 2]) -> Self {
        for knot in &mut self.knots {
            knot.travel_m = Vector2::new(knot.travel_m.x / scale[0], knot.travel_m.y / scale[1]);
        }
        self
    }

    /// The sums of both wheels' travel at a time. Outside of the reports the robot stands.
    fn at(&self, time_s: f64) -> Vector2<f64> {
        let after = self.knots.partition_point(|knot| knot.time_s <= time_s);
        let before = after.checked_sub(1).and_then(|index| self.knots.get(index));
        match (before, self.knots.get(after)) {
            (Some(before), Some(next)) => {
                let share = (time_s - before.time_s) / (next.time_s - before.time_s);
                before.travel_m + share * (next.travel_m - before.travel_m)
            }
            (Some(end), None) | (None, Some(end)) => end.travel_m,
            (None, None) => Vector2::zeros(),
        }
    }

    /// The pieces of the path between two times: reported travel of both wheels, metres.
    fn pieces(&self, from_s: f64, to_s: f64) -> impl Iterator<Item = Vector2<f64>> {
        let first = self.knots.partition_point(|knot| knot.time_s <= from_s);
        let behind = self.knots.partition_point(|knot| knot.time_s < to_s).max(first);
        let mut last_m = self.at(from_s);
        let ends = self.knots[first..behind].iter().map(|knot| knot.travel_m);
        ends.chain([self.at(to_s)]).map(move |end_m| {
            let piece_m = end_m - last_m;
            last_m = end_m;
            piece_m
        })
    }

    /// Yaw, distance and rotation between two times.
    pub fn motion(&self, geometry: &WheelGeometry, from_s: f64, to_s: f64) -> WheelMotion {
        let mut motion = WheelMotion { yaw_rad: 0.0, distance_m: 0.0, rotation_rad: 0.0 };
        for piece in self.pieces(from_s, to_s) {
            let [length_m, yaw_rad] = geometry.arc(piece);
            motion.yaw_rad += yaw_rad;
            motion.distance_m += length_m.abs();
            motion.rotation_rad += yaw_rad.abs();
        }
        motion
    }

    /// The end of the path in the frame of its beginning, as the wheels drove it, but with the yaw `yaw_rad` of another
    /// measurement: what the wheels' yaw is wrong by is shared out along the path. `yaw_rad` is not wrapped.
    pub fn motion_with_yaw(
        &self,
        geometry: &WheelGeometry,
        from_s: f64,
        to_s: f64,
        yaw_rad: f64,
    ) -> Pose2 {
        let motion = self.motion(geometry, from_s, to_s);
        let path_m = motion.distance_m + METRES_PER_RADIAN * motion.rotation_rad;
        let wrong_per_m = if path_m > 0.0 { (yaw_rad - motion.yaw_rad) / path_m } else { 0.0 };
        let mut pose = Pose2::IDENTITY;
        for piece in self.pieces(from_s, to_s) {
            let [length_m, yaw_rad] = geometry.arc(piece);
            let path_m = length_m.abs() + METRES_PER_RADIAN * yaw_rad.abs();
            pose = pose.compose(&along_arc(length_m, yaw_rad + wrong_per_m * path_m));
        }
        pose
    }

    /// The end of the path in the frame of its beginning by the wheels alone.
    pub fn motion_by_wheels(&self, geometry: &WheelGeometry, from_s: f64, to_s: f64) -> Pose2 {
        let yaw_rad = self.motion(geometry, from_s, to_s).yaw_rad;
        self.motion_with_yaw(geometry, from_s, to_s, yaw_rad)
    }
}

/// The end of an arc in the frame of its beginning.
fn along_arc(length_m: f64, yaw_rad: f64) -> Pose2 {
    let twist = hal::Twist2 { linear_mps: length_m, angular_radps: yaw_rad };
    twist.integrate(1.0)
}

/// Travel of the left and the right wheel for a small motion of `base_link` along an arc, metres.
fn travel(moved: &Pose2, track_m: f64) -> Vector2<f64> {
    let half = 0.5 * moved.yaw_rad;
    // An arc is longer than its chord; to the second order, which is exact to 1e-6 for half a radian.
    let arc = 1.0 + half * half / 6.0;
    let forward = moved.x_m * half.cos() + moved.y_m * half.sin();
    let length_m = arc * forward;
    let side_m = half * track_m;
    Vector2::new(length_m - side_m, length_m + side_m)
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::Twist2;
    use proptest::prelude::*;

    const GEOMETRY: WheelGeometry = WheelGeometry { scale: [1.0, 1.0], track_m: 0.3 };

    /// Reports every tenth of a second of a robot that drives an arc.
    fn arc(twist: Twist2) -> WheelPath {
        let mut path = WheelPath::default();
        for report in 0..=20 {
            let time_s = 0.1 * f64::from(report);
            path.push(time_s, &twist.integrate(time_s), GEOMETRY.track_m);
        }
        path
    }

    proptest! {
        #[test]
        fn the_configured_wheels_give_the_reported_motion(v in -0.5..0.5, w in -1.5..1.5) {
            let twist = Twist2 { linear_mps: v, angular_radps: w };
            let found = arc(twist).motion_by_wheels(&GEOMETRY, 0.25, 1.55);
            let expected = twist.integrate(1.3);
            prop_assert!(found.distance_m(&expected) < 1e-5, "{:?} is not {:?}", found, expected);
            prop_assert!((found.yaw_rad - expected.yaw_rad).abs() < 1e-9);
        }

        #[test]
        fn larger_wheels_scale_the_path_and_a_wider_track_the_yaw(v in 0.1..0.5, w in -1.0..1.0) {
            let path = arc(Twist2 { linear_mps: v, angular_radps: w });
            let larger = WheelGeometry { scale: [1.1, 1.1], track_m: 0.33 };
            let [plain, scaled] = [GEOMETRY, larger].map(|g| path.motion(&g, 0.0, 2.0));
            prop_assert!((scaled.distance_m / plain.distance_m - 1.1).abs() < 1e-9);
            prop_assert!((scaled.yaw_rad - plain.yaw_rad).abs() < 1e-9);
        }
    }

    #[test]
    fn the_yaw_of_another_measurement_bends_the_path_evenly() {
        let straight = arc(Twist2 { linear_mps: 0.5, angular_radps: 0.0 });
        let bent = straight.motion_with_yaw(&GEOMETRY, 0.0, 2.0, 0.4);
        let arc = Twist2 { linear_mps: 0.5, angular_radps: 0.2 }.integrate(2.0);
        assert!(bent.distance_m(&arc) < 1e-9 && (bent.yaw_rad - 0.4).abs() < 1e-12, "{bent:?}");
    }

    #[test]
    fn before_and_after_the_reports_the_robot_stands() {
        let path = arc(Twist2 { linear_mps: 0.5, angular_radps: 0.3 });
        assert_eq!(path.motion_by_wheels(&GEOMETRY, -3.0, -1.0), Pose2::IDENTITY);
        assert_eq!(path.motion_by_wheels(&GEOMETRY, 2.0, 5.0), Pose2::IDENTITY);
    }
}
