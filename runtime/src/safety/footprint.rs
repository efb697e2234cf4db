//! The robot's footprint and the free distance from its outline to obstacles.

use hal::{Pose2, Twist2};

/// Distance between two collision checks along an arc, metres.
const ARC_STEP_M: f64 = 0.01;
/// Rotation between two collision checks of a footprint with corners, radians.
const ROTATION_STEP_RAD: f64 = 0.03;
/// An arc is checked up to this rotation, radians.
const MAX_ARC_RAD: f64 = 1.0;
/// A path with at most this curvature, 1/m, is treated as straight: over half a metre it deviates
/// by 6 mm.
const STRAIGHT_PER_M: f64 = 0.05;

/// The outline of the robot on the floor, in `base_link`.
#[derive(Debug, Clone, PartialEq)]
pub enum Footprint {
    /// A circle around the origin of `base_link`.
    Round { radius_m: f64 },
    /// A polygon, its corners in order (either direction), metres.
    Corners { corners_m: Vec<[f64; 2]> },
}

impl Footprint {
    /// A polygon with these corners, or a circle if there are none.
    #[must_use]
    pub fn new(radius_m: f64, corners_m: &[[f64; 2]]) -> Self {
        if corners_m.is_empty() {
            Self::Round { radius_m }
        } else {
            Self::Corners { corners_m: corners_m.to_vec() }
        }
    }

    /// Distance of the outline's farthest point from the origin, metres.
    #[must_use]
    pub fn circumscribed_radius_m(&self) -> f64 {
        match self {
            Self::Round { radius_m } => *radius_m,
            Self::Corners { corners_m } => {
                corners_m.iter().map(|[x, y]| x.hypot(*y)).fold(0.0, f64::max)
            }
        }
    }

    /// Largest distance of the outline from the x axis, metres.
    #[must_use]
    pub fn half_width_m(&self) -> f64 {
        match self {
            Self::Round { radius_m } => *radius_m,
            Self::Corners { corners_m } => {
                corners_m.iter().map(|[_, y]| y.abs()).fold(0.0, f64::max)
            }
        }
    }

    /// The outline with every point farther out by `margin_m`: exact for a circle and for a
    /// rectangle around the origin.
    #[must_use]
    pub fn widened(&self, margin_m: f64) -> Self {
        match self {
            Self::Round { radius_m } => Self::Round { radius_m: radius_m + margin_m },
            Self::Corners { corners_m } => Self::Corners {
                corners_m: corners_m
                    .iter()
                    .map(|corner_m| corner_m.map(|at_m| at_m + margin_m.copysign(at_m)))
                    .collect(),
            },
        }
    }

    /// With `sign` = 1 the largest x of the outline at `y_m`; with `sign` = -1 the smallest x,
    /// negated. `None` where the line at `y_m` does not cross the outline.
    #[inline]
    fn edge_m(&self, y_m: f64, sign: f64) -> Option<f64> {
        match self {
            Self::Round { radius_m } => {
                (y_m.abs() < *radius_m).then(|| (radius_m * radius_m - y_m * y_m).sqrt())
            }
            Self::Corners { corners_m } => edges(corners_m)
                .filter_map(|(a, b)| crossing(a, b, y_m))
                .map(|x_m| sign * x_m)
                .reduce(f64::max),
        }
    }

    /// How far the outline reaches straight ahead of the origin, metres.
    #[must_use]
    pub fn front_edge_m(&self) -> f64 {
        self.edge_m(0.0, 1.0).unwrap_or_else(|| self.circumscribed_radius_m())
    }

    /// Free distance straight ahead (`sign` = 1.0) or straight back (-1.0) from the outline to a
    /// point, metres. Negative for a point inside the outline; `None` if the robot passes beside
    /// the point.
    #[must_use]
    #[inline]
    pub fn straight_gap_m(&self, [x_m, y_m]: [f64; 2], sign: f64) -> Option<f64> {
        if sign * x_m <= 0.0 {
            return None;
        }
        self.edge_m(y_m, sign).map(|edge_m| sign * x_m - edge_m)
    }

    /// Whether a point lies inside the outline.
    #[must_use]
    pub fn contains(&self, [x_m, y_m]: [f64; 2]) -> bool {
        match self {
            Self::Round { radius_m } => x_m.hypot(y_m) < *radius_m,
            Self::Corners { corners_m } => {
                let crossings_to_the_right =
                    edges(corners_m).filter_map(|(a, b)| crossing(a, b, y_m)).filter(|x| *x > x_m);
                crossings_to_the_right.count() % 2 == 1
            }
        }
    }

    /// Distance that the origin can travel along `twist` until the outline meets the point, metres.
    /// `None` if it does not meet the point within `reach_m`.
    #[must_use]
    #[inline]
    pub fn gap_m(&self, point_m: [f64; 2], twist: &Twist2, reach_m: f64) -> Option<f64> {
        let speed = twist.linear_mps.abs();
        if twist.angular_radps.abs() <= STRAIGHT_PER_M * speed {
            return self
                .straight_gap_m(point_m, twist.linear_mps.signum())
                .filter(|gap| *gap < reach_m);
        }
        self.gap_on_arc_m(point_m, twist, reach_m)
    }

    /// As [`gap_m`](Self::gap_m) for a path that is not straight.
    fn gap_on_arc_m(&self, point_m: [f64; 2], twist: &Twist2, reach_m: f64) -> Option<f64> {
        let speed = twist.linear_mps.abs();
        let radius_m = speed / twist.angular_radps.abs();
        let step_m = match self {
            Self::Round { .. } => ARC_STEP_M,
            // On a narrow arc the rotation moves a corner farther than the origin travels.
            Self::Corners { .. } => ARC_STEP_M.min(ROTATION_STEP_RAD * radius_m),
        };
        if point_m[0].hypot(point_m[1]) > self.circumscribed_radius_m() + reach_m + step_m {
            return None;
        }
        let steps = (reach_m / step_m).ceil().min(MAX_ARC_RAD * radius_m / step_m);
        let met = (0..=steps as usize).map(|step| step as f64 * step_m).find(|travelled_m| {
            let t_now_then = twist.integrate(travelled_m / speed);
            self.contains(in_frame_of(&t_now_then, point_m))
        });
        // The outline met the point somewhere within the last step; the start of that step is the
        // safe answer.
        met.map(|travelled_m| travelled_m - step_m)
    }

    /// Whether rotating on the spot by `rotation_rad` moves a corner onto a point that is outside
    /// of the outline now.
    #[must_use]
    pub fn collides_when_rotated(&self, point_m: [f64; 2], rotation_rad: f64) -> bool {
        if matches!(self, Self::Round { .. })
            || self.contains(point_m)
            || point_m[0].hypot(point_m[1]) > self.circumscribed_radius_m()
        {
            return false;
        }
        let steps = (rotation_rad.abs() / ROTATION_STEP_RAD).ceil();
        (1..=steps as usize).any(|step| {
            let turned = Pose2::new(0.0, 0.0, rotation_rad * step as f64 / steps);
            self.contains(in_frame_of(&turned, point_m))
        })
    }
}

/// The point in the frame of `pose`.
fn in_frame_of(pose: &Pose2, [x_m, y_m]: [f64; 2]) -> [f64; 2] {
    pose.inverse().transform(x_m, y_m).into()
}

fn edges(corners_m: &[[f64; 2]]) -> impl Iterator<Item = ([f64; 2], [f64; 2])> + '_ {
    corners_m.iter().copied().zip(corners_m.iter().copied().cycle().skip(1))
}

/// x where an edge crosses the line at `y_m`. The lower end belongs to the edge and the upper end
/// to the next edge, so that a crossing at a corner counts once.
fn crossing(a: [f64; 2], b: [f64; 2], y_m: f64) -> Option<f64> {
    let (low, high) = if a[1] <= b[1] { (a, b) } else { (b, a) };
    (low[1] <= y_m && y_m < high[1])
        .then(|| low[0] + (high[0] - low[0]) * (y_m - low[1]) / (high[1] - low[1]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// 40 cm long and 30 cm wide, with the axle 10 cm before the rear end.
    fn cart() -> Footprint {
        Footprint::new(0.0, &[[0.3, 0.15], [-0.1, 0.15], [-0.1, -0.15], [0.3, -0.15]])
    }

    fn ahead(linear_mps: f64, angular_radps: f64) -> Twist2 {
        Twist2 { linear_mps, angular_radps }
    }

    #[test]
    fn the_gap_of_a_cart_is_counted_from_its_front_and_from_its_back() {
        assert!((cart().straight_gap_m([0.5, 0.1], 1.0).unwrap() - 0.2).abs() < 1e-12);
        assert!((cart().straight_gap_m([-0.5, 0.1], -1.0).unwrap() - 0.4).abs() < 1e-12);
        assert_eq!(cart().straight_gap_m([0.5, 0.16], 1.0), None);
        assert_eq!(cart().straight_gap_m([-0.5, 0.0], 1.0), None);
    }

    #[test]
    fn a_widened_outline_is_wider_by_the_margin_on_every_side() {
        assert!((cart().half_width_m() - 0.15).abs() < 1e-12);
        let wide = cart().widened(0.03);
        assert!((wide.half_width_m() - 0.18).abs() < 1e-12);
        assert!((wide.straight_gap_m([0.5, 0.17], 1.0).unwrap() - 0.17).abs() < 1e-12);
        let round = Footprint::new(0.16, &[]).widened(0.03);
        assert!((round.half_width_m() - 0.19).abs() < 1e-12);
    }

    #[test]
    fn a_cart_that_turns_on_the_spot_sweeps_what_is_beside_its_nose() {
        let beside_the_nose = [0.25, 0.2];
        assert!(!cart().contains(beside_the_nose));
        assert!(cart().collides_when_rotated(beside_the_nose, 0.4));
        assert!(!cart().collides_when_rotated(beside_the_nose, -0.4));
        assert!(!cart().collides_when_rotated([0.0, 0.4], 3.0), "out of its reach");
        assert!(
            !Footprint::new(0.16, &[]).collides_when_rotated([0.161, 0.0], 3.0),
            "a round robot sweeps nothing"
        );
    }

    #[test]
    fn on_an_arc_to_the_left_what_stands_straight_ahead_is_passed_and_what_stands_on_the_arc_is_met()
     {
        let left = ahead(0.3, 0.6);
        let robot = Footprint::new(0.16, &[]);
        assert_eq!(robot.gap_m([0.6, -0.25], &left, 0.5), None);
        let on_the_arc = left.integrate(1.5);
        let gap_m = robot.gap_m([on_the_arc.x_m, on_the_arc.y_m], &left, 0.5).unwrap();
        assert!((gap_m - (0.45 - 0.16)).abs() < 0.02, "{gap_m}");
    }

    #[test]
    fn a_point_at_the_end_of_the_reach_of_a_wide_arc_is_met() {
        let robot = Footprint::new(0.16, &[]);
        let wide = ahead(0.3, 0.15);
        let at_the_end = wide.integrate(0.498 / 0.3).transform(0.159, 0.0);
        assert!(robot.gap_m(at_the_end.into(), &wide, 0.5).is_some());
    }

    #[test]
    fn an_arc_of_one_metre_radius_is_not_treated_as_straight() {
        let robot = Footprint::new(0.16, &[]);
        assert!(robot.gap_m([0.8, -0.12], &ahead(0.3, 0.0), 0.7).is_some());
        assert_eq!(
            robot.gap_m([0.8, -0.12], &ahead(0.3, 0.3), 0.7),
            None,
            "the robot has rotated away by then"
        );
        assert!(robot.gap_m([0.8, 0.4], &ahead(0.3, 0.3), 0.9).is_some());
    }

    #[test]
    fn a_rotation_collides_with_a_point_on_the_arc_of_a_corner_and_not_with_one_inside_the_outline()
    {
        assert!(!cart().collides_when_rotated([0.0, 0.0], 3.0));
        let reach_m = cart().circumscribed_radius_m();
        assert!((reach_m - 0.3f64.hypot(0.15)).abs() < 1e-12);
        assert!(!cart().collides_when_rotated([0.0, reach_m + 0.001], 3.0));
        assert!(cart().collides_when_rotated([0.0, reach_m - 0.01], 1.3), "the corner comes by");
        assert!(!cart().collides_when_rotated([0.0, reach_m - 0.01], 1.0), "not so far");
    }

    #[test]
    fn the_front_edge_of_a_footprint_beside_the_axle_is_its_circumscribed_radius() {
        assert_eq!(cart().front_edge_m(), 0.3);
        let beside = Footprint::new(0.0, &[[0.3, 0.2], [0.3, 0.1], [0.0, 0.1], [0.0, 0.2]]);
        assert_eq!(beside.front_edge_m(), 0.3f64.hypot(0.2));
    }

    #[test]
    fn clockwise_and_counter_clockwise_corners_give_the_same_concave_footprint() {
        let corners = [[0.3, 0.15], [0.2, 0.0], [0.3, -0.15], [-0.1, -0.15], [-0.1, 0.15]];
        let mut reversed = corners;
        reversed.reverse();
        let one = Footprint::new(0.0, &corners);
        let other = Footprint::new(0.0, &reversed);
        for (point, within) in
            [([0.25, 0.0], false), ([0.25, 0.12], true), ([0.19, 0.0], true), ([0.31, 0.12], false)]
        {
            assert_eq!((one.contains(point), other.contains(point)), (within, within), "{point:?}");
        }
        assert_eq!(one.straight_gap_m([0.4, 0.0], 1.0), other.straight_gap_m([0.4, 0.0], 1.0));
        let notch_m = one.straight_gap_m([0.4, 0.0], 1.0).unwrap();
        assert!(
            (notch_m - 0.2).abs() < 1e-9,
            "the inner corner of the notch is met last: {notch_m}"
        );
    }

    #[test]
    fn an_arc_is_checked_for_one_radian_and_up_to_the_reach() {
        let robot = Footprint::new(0.16, &[]);
        let narrow = ahead(0.1, 0.5);
        fn at(travelled_m: f64, ahead_m: f64) -> [f64; 2] {
            ahead(0.1, 0.5).integrate(travelled_m / 0.1).transform(ahead_m, 0.0).into()
        }
        assert!(robot.gap_m(at(0.18, 0.159), &narrow, 1.0).is_some(), "0.2 m are a radian");
        assert!(robot.gap_m(at(0.21, 0.159), &narrow, 1.0).is_none());
        assert!(robot.gap_m(at(0.24, 0.159), &narrow, 1.0).is_none());
        assert!(robot.gap_m(at(0.08, 0.159), &narrow, 0.1).is_some());
        assert!(robot.gap_m(at(0.14, 0.159), &narrow, 0.1).is_none());
        let gap_m = robot.gap_m(at(0.1, 0.159), &narrow, 1.0).unwrap();
        assert!((0.08..=0.1).contains(&gap_m), "{gap_m}");
        assert_eq!(
            robot.gap_m([0.1, 0.0], &narrow, 1.0),
            Some(-0.01),
            "the point is inside already"
        );
        let wide = ahead(0.3, 0.016);
        assert!(robot.gap_m([0.8, 0.02], &wide, 0.9).is_some(), "more than nine steps away");
    }

    #[test]
    fn on_a_narrow_arc_the_steps_are_short_enough_that_no_corner_jumps_over_a_point() {
        let narrow = ahead(0.01, 1.0);
        let (x_m, y_m) = narrow.integrate(0.5).transform(0.285, 0.135);
        // Steps of 1 cm would check 0 and 1 radian only.
        let gap_m = cart().gap_m([x_m, y_m], &narrow, 0.5).unwrap();
        assert!((0.004..=0.005).contains(&gap_m), "{gap_m}");
    }

    proptest! {
        #[test]
        fn a_circle_of_many_corners_is_a_circle(x in -0.5..0.5f64, y in -0.5..0.5f64) {
            let corners: Vec<[f64; 2]> = (0..720).map(|i| f64::from(i).to_radians() / 2.0).map(|a| [0.16 * a.cos(), 0.16 * a.sin()]).collect();
            let round = Footprint::new(0.16, &[]);
            let many = Footprint::new(0.0, &corners);
            prop_assume!((x.hypot(y) - 0.16).abs() > 1e-4 && (y.abs() - 0.16).abs() > 1e-4);
            prop_assert_eq!(round.contains([x, y]), many.contains([x, y]));
            for sign in [1.0, -1.0] {
                let a = round.straight_gap_m([x, y], sign);
                let b = many.straight_gap_m([x, y], sign);
                prop_assert_eq!(a.is_some(), b.is_some());
                prop_assert!(a.zip(b).is_none_or(|(a, b)| (a - b).abs() < 2e-3));
            }
        }

        #[test]
        fn a_slightly_curved_path_has_the_same_gap_as_a_straight_one(x in 0.2..0.6f64, y in -0.14..0.14f64) {
            let robot = Footprint::new(0.16, &[]);
            let straight = robot.gap_m([x, y], &ahead(0.3, 0.0), 0.4);
            let bent = robot.gap_m([x, y], &ahead(0.3, 0.016), 0.4);
            prop_assume!(straight.is_some_and(|gap| gap > 0.0 && gap < 0.38));
            prop_assert!((straight.unwrap() - bent.unwrap_or(9.0)).abs() < 0.03, "{straight:?} {bent:?}");
        }
    }
}
