//! The rigid motion in the plane that fits points to other points best.

use hal::Pose2;

/// The pose `t_a_b` that brings points of frame b nearest to their partners in frame a, in the sense
/// of least squares (Umeyama 1991, in the plane and without scale). Pairs are (point in a, point in
/// b), metres. `None` without any pair. If the points do not determine the rotation, it is 0.
#[must_use]
pub fn fit(pairs: &[([f64; 2], [f64; 2])]) -> Option<Pose2> {
    let count = pairs.len() as f64;
    if pairs.is_empty() {
        return None;
    }
    let mut mean_a = [0.0; 2];
    let mut mean_b = [0.0; 2];
    for (a, b) in pairs {
        for axis in 0..2 {
            mean_a[axis] += a[axis] / count;
            mean_b[axis] += b[axis] / count;
        }
    }
    let mut dot = 0.0;
    let mut cross = 0.0;
    for (a, b) in pairs {
        let [ax, ay] = [a[0] - mean_a[0], a[1] - mean_a[1]];
        let [bx, by] = [b[0] - mean_b[0], b[1] - mean_b[1]];
        dot += ax * bx + ay * by;
        cross += ay * bx - ax * by;
    }
    let rotation = Pose2::new(0.0, 0.0, cross.atan2(dot));
    let (x_m, y_m) = rotation.transform(mean_b[0], mean_b[1]);
    Some(Pose2::new(mean_a[0] - x_m, mean_a[1] - y_m, rotation.yaw_rad))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_motion_is_recovered_from_points_that_were_moved_by_it(
            x in -9.0..9.0, y in -9.0..9.0, yaw in -3.1..3.1,
            points in prop::collection::vec((-5.0..5.0_f64, -5.0..5.0_f64), 3..20),
        ) {
            let t_a_b = Pose2::new(x, y, yaw);
            let spread_m = points
                .iter()
                .map(|point| (point.0 - points[0].0).hypot(point.1 - points[0].1))
                .fold(0.0, f64::max);
            prop_assume!(spread_m > 0.1);
            let pairs: Vec<_> =
                points.iter().map(|&(x, y)| (t_a_b.transform(x, y).into(), [x, y])).collect();
            let found = fit(&pairs).unwrap();
            prop_assert!(found.distance_m(&t_a_b) < 1e-6);
            prop_assert!(hal::wrap_angle(found.yaw_rad - yaw).abs() < 1e-6);
        }
    }

    #[test]
    fn one_pair_is_a_translation_and_none_is_nothing() {
        let found = fit(&[([3.0, 4.0], [1.0, 1.0])]).unwrap();
        assert_eq!((found.x_m, found.y_m, found.yaw_rad), (2.0, 3.0, 0.0));
        assert!(fit(&[]).is_none());
    }
}
