//! Errors of the poses that a robot believed, against the true ones.

use hal::{Pose2, wrap_angle};
use serde::{Deserialize, Serialize};

use super::alignment;

/// Length of the path between the two poses of a relative error, metres.
const RELATIVE_M: f64 = 1.0;

/// Errors of the believed poses of a run. The absolute errors are those of the pose in the map, the
/// relative ones those of the smooth pose in `odom`, in which perception works.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct PoseError {
    /// Absolute trajectory error: root mean square of the distances between the believed positions
    /// in the map and the true ones, after the rigid motion that makes it smallest (Sturm et al.,
    /// "A Benchmark for the Evaluation of RGB-D SLAM Systems", 2012), metres.
    pub ate_m: f64,
    /// Relative error of the position in `odom`: root mean square over all pairs of poses that are
    /// 1 m of true path apart, metres per metre of it. Absent on a path that is shorter than that.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub rpe_m_per_m: Option<f64>,
    /// Relative error of the heading over the same pairs, degrees per metre.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub rpe_deg_per_m: Option<f64>,
    /// Size of the error of the last heading in the map if the first one was right, degrees, 0 to
    /// 180.
    pub yaw_end_deg: f64,
}

/// True and believed poses at one moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PosePair {
    /// True pose, `t_world_base`.
    pub truth: Pose2,
    /// Believed pose in the smooth frame, `t_odom_base`.
    pub t_odom_base: Pose2,
    /// Believed pose in the map, `t_map_base`.
    pub t_map_base: Pose2,
}

impl PoseError {
    /// The errors of a run. `None` without any pose.
    #[must_use]
    pub fn of(pairs: &[PosePair]) -> Option<Self> {
        let (first, last) = (pairs.first()?, pairs.last()?);
        let relative = relative_errors(pairs);
        Some(Self {
            ate_m: absolute_error_m(pairs)?,
            rpe_m_per_m: rms(relative.iter().map(|motion| motion.error_m / motion.path_m)),
            rpe_deg_per_m: rms(relative
                .iter()
                .map(|motion| motion.yaw_error_rad.to_degrees() / motion.path_m)),
            yaw_end_deg: error(
                &first.t_map_base.inverse().compose(&last.t_map_base),
                &first.truth.inverse().compose(&last.truth),
            )
            .yaw_rad
            .to_degrees()
            .abs(),
        })
    }
}

fn absolute_error_m(pairs: &[PosePair]) -> Option<f64> {
    let points: Vec<_> = pairs
        .iter()
        .map(|pair| ([pair.truth.x_m, pair.truth.y_m], [pair.t_map_base.x_m, pair.t_map_base.y_m]))
        .collect();
    let t_world_map = alignment::fit(&points)?;
    rms(points.iter().map(|(truth, believed)| {
        let (x_m, y_m) = t_world_map.transform(believed[0], believed[1]);
        (x_m - truth[0]).hypot(y_m - truth[1])
    }))
}

/// The error of a believed motion, and the length of the true path.
struct RelativeError {
    error_m: f64,
    yaw_error_rad: f64,
    path_m: f64,
}

/// Errors of the believed motion between poses at least `RELATIVE_M` of true path apart, from every
/// pose on.
fn relative_errors(pairs: &[PosePair]) -> Vec<RelativeError> {
    let mut path_m = vec![0.0];
    for pair in pairs.windows(2) {
        path_m.push(path_m[path_m.len() - 1] + pair[0].truth.distance_m(&pair[1].truth));
    }
    let mut errors = Vec::new();
    let mut to = 0;
    for (from, pair) in pairs.iter().enumerate() {
        while to < pairs.len() && path_m[to] < path_m[from] + RELATIVE_M {
            to += 1;
        }
        let Some(later) = pairs.get(to) else { break };
        // The pair of a robot that stands would be counted repeatedly.
        if from > 0 && path_m[from] <= path_m[from - 1] {
            continue;
        }
        let wrong = error(
            &pair.t_odom_base.inverse().compose(&later.t_odom_base),
            &pair.truth.inverse().compose(&later.truth),
        );
        errors.push(RelativeError {
            error_m: wrong.distance_m(&Pose2::IDENTITY),
            yaw_error_rad: wrong.yaw_rad,
            path_m: path_m[to] - path_m[from],
        });
    }
    errors
}

/// Error of a motion, in the frame of its true end.
fn error(believed: &Pose2, truth: &Pose2) -> Pose2 {
    let error = truth.inverse().compose(believed);
    Pose2 { yaw_rad: wrap_angle(error.yaw_rad), ..error }
}

/// Root mean square; `None` without any error.
fn rms(errors: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = errors.fold((0.0, 0_u64), |(sum, count), e| (sum + e * e, count + 1));
    (count > 0).then(|| (sum / count as f64).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A drive around a square with sides of 3 m, in steps of 2 cm. `believe` gives the believed
    /// pose after a distance for the true one.
    fn drive(believe: impl Fn(f64, &Pose2) -> Pose2) -> Vec<PosePair> {
        (0..600)
            .map(|step| {
                let along_m = f64::from(step) * 0.02;
                let side = (along_m / 3.0) as i32;
                let yaw = f64::from(side) * std::f64::consts::FRAC_PI_2;
                let corners = [[0.0, 0.0], [3.0, 0.0], [3.0, 3.0], [0.0, 3.0]];
                let [x, y] = corners[side as usize % 4];
                let on_m = along_m - 3.0 * f64::from(side);
                let truth = Pose2::new(x + on_m * yaw.cos(), y + on_m * yaw.sin(), yaw);
                let t_odom_base = believe(along_m, &truth);
                PosePair { truth, t_odom_base, t_map_base: t_odom_base }
            })
            .collect()
    }

    #[test]
    fn another_origin_of_the_map_is_no_error() {
        let t_map_world = Pose2::new(5.0, -2.0, 1.1);
        let error = PoseError::of(&drive(|_, truth| t_map_world.compose(truth))).unwrap();
        assert!(error.ate_m < 1e-9 && error.yaw_end_deg < 1e-9);
        assert!(error.rpe_m_per_m.unwrap() < 1e-9 && error.rpe_deg_per_m.unwrap() < 1e-6);
    }

    #[test]
    fn a_heading_that_drifts_by_two_degrees_per_metre_is_measured_as_that() {
        let error = PoseError::of(&drive(|along_m, truth| Pose2 {
            yaw_rad: truth.yaw_rad + (2.0 * along_m).to_radians(),
            ..*truth
        }))
        .unwrap();
        assert!(error.ate_m < 1e-9, "positions are right");
        assert!((error.rpe_deg_per_m.unwrap() - 2.0).abs() < 1e-6);
        assert!((error.yaw_end_deg - 2.0 * 599.0 * 0.02).abs() < 1e-6);
    }

    #[test]
    fn a_scale_that_is_wrong_by_three_percent_is_three_centimetres_per_metre() {
        let pairs = drive(|_, truth| Pose2::new(1.03 * truth.x_m, 1.03 * truth.y_m, truth.yaw_rad));
        let error = PoseError::of(&pairs).unwrap();
        // Around a corner the chord is shorter than the path.
        assert!((0.025..0.0301).contains(&error.rpe_m_per_m.unwrap()), "{error:?}");
        assert!(error.ate_m > 0.04 && error.ate_m < 0.07, "{error:?}");
    }

    #[test]
    fn a_jump_of_the_map_does_not_count_as_a_relative_error() {
        let mut pairs = drive(|_, truth| *truth);
        for pair in &mut pairs[300..] {
            pair.t_map_base = Pose2::new(0.4, 0.0, 0.0).compose(&pair.t_map_base);
        }
        let error = PoseError::of(&pairs).unwrap();
        assert!(error.rpe_m_per_m.unwrap() < 1e-9 && error.ate_m > 0.1);
    }

    #[test]
    fn a_short_path_has_no_relative_error_and_no_pose_no_error_at_all() {
        let pairs = drive(|_, truth| *truth);
        assert_eq!(PoseError::of(&pairs[..20]).unwrap().rpe_m_per_m, None);
        assert_eq!(PoseError::of(&[]), None);
    }
}
