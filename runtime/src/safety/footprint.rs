//! The ground that the robot stands on.

use hal::{Pose2, Twist2};

/// Way between two looks along an arc, metres.
const ARC_STEP_M: f64 = 0.01;
/// Turn between two looks at a footprint with corners, radians.
const TURN_STEP_RAD: f64 = 0.03;
/// An arc is looked at up to this turn, radians.
const MAX_ARC_RAD: f64 = 1.0;
/// Below this curvature, 1/m, a way is straight: over half a metre it is off by 6 mm.
const STRAIGHT_PER_M: f64 = 0.05;

/// The outline of the robot on the floor, in `base_link`.
#[derive(Debug, Clone, PartialEq)]
pub enum Footprint {
    /// A circle around the origin.
    Round {
        /// Its radius, metres.
        radius_m: f64,
    },
    /// A polygon.
    Corners {
        /// Its corners in order, metres.
        corners_m: Vec<[f64; 2]>,
    },
}

impl Footprint {
    /// A polygon with these corners, or a circle where there are none.
    #[must_use]
    pub fn new(radius_m: f64, corners_m: &[[f64; 2]]) -> Self {
        if corners_m.is_empty() {
            Self::Round { radius_m }
        } else {
            Self::Corners { corners_m: corners_m.to_vec() }
        }
    }

    /// Distance of its farthest point from the origin, metres.
    #[must_use]
    pub fn reach_m(&self) -> f64 {
        match self {
            Self::Round { radius_m } => *radius_m,
            Self::Corners { corners_m } => {
                corners_m.iter().map(|[x, y]| x.hypot(*y)).fold(0.0, f64::max)
            }
        }
    }

    /// Largest x of the outline at `y_m` (`sign` = 1), or smallest, negated (`sign` = -1); `None` beside the robot.
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
    pub fn straight_edge_m(&self) -> f64 {
        self.edge_m(0.0, 1.0).unwrap_or_else(|| self.reach_m())
    }

    /// Free way straight ahead (`sign` = 1.0) or back (-1.0) from the outline to a point; negative inside of it, `None` where
    /// the robot passes.
    #[must_use]
    pub fn straight_gap_m(&self, [x_m, y_m]: [f64; 2], sign: f64) -> Option<f64> {
        if sign * x_m <= 0.0 {
            return None;
        }
        self.edge_m(y_m, sign).map(|edge_m| sign * x_m - edge_m)
    }

    /// Whether a point lies within.
    #[must_use]
    pub fn contains(&self, [x_m, y_m]: [f64; 2]) -> bool {
        match self {
            Self::Round { radius_m } => x_m.hypot(y_m) < *radius_m,
            Self::Corners { corners_m } => {
                let right_of_it =
                    edges(corners_m).filter_map(|(a, b)| crossing(a, b, y_m)).filter(|x| *x > x_m);
                right_of_it.count() % 2 == 1
            }
        }
    }

    /// Way along `twist` (metres of the origin's way) until the outline meets the point, looked at up to `reach_m`; `None`:
    /// it does not.
    #[must_use]
    pub fn gap_m(&self, point_m: [f64; 2], twist: &Twist2, reach_m: f64) -> Option<f64> {
        let speed = twist.linear_mps.abs();
        if twist.angular_radps.abs() <= STRAIGHT_PER_M * speed {
            return self
                .straight_gap_m(point_m, twist.linear_mps.signum())
                .filter(|gap| *gap < reach_m);
        }
        let radius_m = speed / twist.angular_radps.abs();
        let step_m = match self {
            Self::Round { .. } => ARC_STEP_M,
            // On a narrow arc it is the turn that moves a corner.
            Self::Corners { .. } => ARC_STEP_M.min(TURN_STEP_RAD * radius_m),
        };
        if point_m[0].hypot(point_m[1]) > self.reach_m() + reach_m + step_m {
            return None;
        }
        let steps = (reach_m / step_m).ceil().min(MAX_ARC_RAD * radius_m / step_m);
        let met = (0..=steps as usize).map(|step| step as f64 * step_m).find(|way_m| {
            let t_now_then = twist.integrate(way_m / speed);
            self.contains(seen_from(&t_now_then, point_m))
        });
        // It was met somewhere in the last step: taken as its beginning.
        met.map(|way_m| way_m - step_m)
    }

    /// Whether turning on the spot by `turn_rad` brings a corner onto a point that is free of the robot now.
    #[must_use]
    pub fn meets_when_turned(&self, point_m: [f64; 2], turn_rad: f64) -> bool {
        if matches!(self, Self::Round { .. })
            || self.contains(point_m)
            || point_m[0].hypot(point_m[1]) > self.reach_m()
        {
            return false;
        }
        let steps = (turn_rad.abs() / TURN_STEP_RAD).ceil();
        (1..=steps as usize).any(|step| {
            let turned = Pose2::new(0.0, 0.0, turn_rad * step as f64 / steps);
            self.contains(seen_from(&turned, point_m))
        })
    }
}

/// The point as a robot at `pose` sees it.
fn seen_from(pose: &Pose2, [x_m, y_m]: [f64; 2]) -> [f64; 2] {
    let (x_m, y_m) = pose.inverse().transform(x_m, y_m);
    [x_m, y_m]
}

fn edges(corners_m: &[[f64; 2]]) -> impl Iterator<Item = ([f64; 2], [f64; 2])> + '_ {
    corners_m.iter().copied().zip(corners_m.iter().copied().cycle().skip(1))
}

/// x where an edge crosses the line at `y_m`. The lower end belongs to the edge, the upper one to the next.
fn crossing(a: [f64; 2], b: [f64; 2], y_m: f64) -> Option<f64> {
    let (low, high) = if a[1] <= b[1] { (a, b) } else { (b, a) };
    (low[1] <= y_m && y_m < high[1])
        .then(|| low[0] + (high[0] - low[0]) * (y_m - low[1]) / (high[1] - low[1]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// 40 cm long, 30 cm wide, the axle 10 cm before its end.
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
    fn a_cart_that_turns_on_the_spot_sweeps_what_is_beside_its_nose() {
        let beside_the_nose = [0.25, 0.2];
        assert!(!cart().contains(beside_the_nose));
        assert!(cart().meets_when_turned(beside_the_nose, 0.4));
        assert!(!cart().meets_when_turned(beside_the_nose, -0.4));
        assert!(!cart().meets_when_turned([0.0, 0.4], 3.0), "out of its reach");
        assert!(
            !Footprint::new(0.16, &[]).meets_when_turned([0.161, 0.0], 3.0),
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
    fn a_bow_of_a_metre_is_no_straight_way() {
        let robot = Footprint::new(0.16, &[]);
        assert!(robot.gap_m([0.8, -0.12], &ahead(0.3, 0.0), 0.7).is_some());
        assert_eq!(
            robot.gap_m([0.8, -0.12], &ahead(0.3, 0.3), 0.7),
            None,
            "it has turned away by then"
        );
        assert!(robot.gap_m([0.8, 0.4], &ahead(0.3, 0.3), 0.9).is_some());
    }

    #[test]
    fn what_lies_within_is_not_met_by_turning_and_what_is_on_the_way_of_a_corner_is() {
        assert!(!cart().meets_when_turned([0.0, 0.0], 3.0));
        let reach_m = cart().reach_m();
        assert!((reach_m - 0.3f64.hypot(0.15)).abs() < 1e-12);
        assert!(!cart().meets_when_turned([0.0, reach_m + 0.001], 3.0));
        assert!(cart().meets_when_turned([0.0, reach_m - 0.01], 1.3), "the corner comes by");
        assert!(!cart().meets_when_turned([0.0, reach_m - 0.01], 1.0), "not so far");
    }

    #[test]
    fn a_cart_straight_ahead_reaches_to_its_front_and_one_beside_the_axle_as_far_as_its_corners() {
        assert_eq!(cart().straight_edge_m(), 0.3);
        let beside = Footprint::new(0.0, &[[0.3, 0.2], [0.3, 0.1], [0.0, 0.1], [0.0, 0.2]]);
        assert_eq!(beside.straight_edge_m(), 0.3f64.hypot(0.2));
    }

    #[test]
    fn a_cart_whose_corners_are_given_clockwise_or_bent_inwards_is_the_same_ground() {
        let corners = [[0.3, 0.15], [0.2, 0.0], [0.3, -0.15], [-0.1, -0.15], [-0.1, 0.15]];
        let mut reversed = corners;
        reversed.reverse();
        let (one, other) = (Footprint::new(0.0, &corners), Footprint::new(0.0, &reversed));
        for (point, within) in
            [([0.25, 0.0], false), ([0.25, 0.12], true), ([0.19, 0.0], true), ([0.31, 0.12], false)]
        {
            assert_eq!((one.contains(point), other.contains(point)), (within, within), "{point:?}");
        }
        assert_eq!(one.straight_gap_m([0.4, 0.0], 1.0), other.straight_gap_m([0.4, 0.0], 1.0));
        let notch_m = one.straight_gap_m([0.4, 0.0], 1.0).unwrap();
        assert!((notch_m - 0.2).abs() < 1e-9, "the bow of the notch is met last: {notch_m}");
    }

    #[test]
    fn on_an_arc_it_looks_one_radian_ahead_and_up_to_its_reach() {
        let robot = Footprint::new(0.16, &[]);
        let narrow = ahead(0.1, 0.5);
        let at = |way_m: f64, ahead_m: f64| {
            let (x_m, y_m) = narrow.integrate(way_m / 0.1).transform(ahead_m, 0.0);
            [x_m, y_m]
        };
        assert!(robot.gap_m(at(0.18, 0.159), &narrow, 1.0).is_some(), "0.2 m are a radian");
        assert!(robot.gap_m(at(0.24, 0.159), &narrow, 1.0).is_none());
        assert!(robot.gap_m(at(0.08, 0.159), &narrow, 0.1).is_some());
        assert!(robot.gap_m(at(0.14, 0.159), &narrow, 0.1).is_none());
        let gap_m = robot.gap_m(at(0.1, 0.159), &narrow, 1.0).unwrap();
        assert!((0.08..=0.1).contains(&gap_m), "{gap_m}");
        assert_eq!(robot.gap_m([0.1, 0.0], &narrow, 1.0), Some(-0.01), "within: met already");
        let wide = ahead(0.3, 0.016);
        assert!(robot.gap_m([0.8, 0.02], &wide, 0.9).is_some(), "nine steps and more");
    }

    #[test]
    fn a_cart_on_a_narrow_arc_meets_with_its_corner_what_a_wide_step_would_jump_over() {
        let narrow = ahead(0.01, 1.0);
        let (x_m, y_m) = narrow.integrate(0.5).transform(0.285, 0.135);
        // Steps of 1 cm would look at 0 and at 1 radian.
        let gap_m = cart().gap_m([x_m, y_m], &narrow, 0.5).unwrap();
        assert!((0.004..=0.005).contains(&gap_m), "{gap_m}");
    }

    proptest! {
        #[test]
        fn a_circle_of_many_corners_is_a_circle(x in -0.5..0.5f64, y in -0.5..0.5f64) {
            let corners: Vec<[f64; 2]> = (0..720).map(|i| f64::from(i).to_radians() / 2.0).map(|a| [0.16 * a.cos(), 0.16 * a.sin()]).collect();
            let (round, many) = (Footprint::new(0.16, &[]), Footprint::new(0.0, &corners));
            prop_assume!((x.hypot(y) - 0.16).abs() > 1e-4 && (y.abs() - 0.16).abs() > 1e-4);
            prop_assert_eq!(round.contains([x, y]), many.contains([x, y]));
            for sign in [1.0, -1.0] {
                let (a, b) = (round.straight_gap_m([x, y], sign), many.straight_gap_m([x, y], sign));
                prop_assert_eq!(a.is_some(), b.is_some());
                prop_assert!(a.zip(b).is_none_or(|(a, b)| (a - b).abs() < 2e-3));
            }
        }

        #[test]
        fn a_barely_bent_way_is_as_free_as_a_straight_one(x in 0.2..0.6f64, y in -0.14..0.14f64) {
            let robot = Footprint::new(0.16, &[]);
            let straight = robot.gap_m([x, y], &ahead(0.3, 0.0), 0.4);
            let bent = robot.gap_m([x, y], &ahead(0.3, 0.016), 0.4);
            prop_assume!(straight.is_some_and(|gap| gap > 0.0 && gap < 0.38));
            prop_assert!((straight.unwrap() - bent.unwrap_or(9.0)).abs() < 0.03, "{straight:?} {bent:?}");
        }
    }
}
