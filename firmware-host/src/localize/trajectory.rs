//! Trajectories as text files of the TUM form: `time x y z qx qy qz qw`.

use std::fmt::Write as _;

use hal::Pose2;

use super::log::Log;

/// One line per line of the log, with its time.
pub(super) fn tum(log: &Log, poses: &[Pose2]) -> String {
    let mut text = String::new();
    for (line, pose) in log.lines.iter().zip(poses) {
        let Pose2 { x_m, y_m, yaw_rad } = pose;
        let (qz, qw) = (0.5 * yaw_rad).sin_cos();
        // Writing into a String cannot fail.
        let _ = writeln!(text, "{} {x_m:.6} {y_m:.6} 0 0 0 {qz:.9} {qw:.9}", line.time_s);
    }
    text
}

/// Length of the path through the poses, metres.
pub(super) fn length_m(poses: &[Pose2]) -> f64 {
    poses.windows(2).map(|pair| pair[0].distance_m(&pair[1])).sum()
}

#[cfg(test)]
mod tests {
    use super::super::log::{Line, Odometry};
    use super::*;
    use hal::ScanGeometry;

    #[test]
    fn every_line_has_its_time_and_a_rotation_about_the_vertical() {
        let log = Log {
            geometry: ScanGeometry::UTM_30LX,
            t_base_laser: Pose2::IDENTITY,
            sweep_ns: 0,
            wheels: None,
            odometry: Odometry::Lines,
            lines: vec![line(1.5), line(0.0)],
            other_shape: 0,
        };
        let quarter = Pose2::new(1.0, -2.0, std::f64::consts::FRAC_PI_2);
        let text = tum(&log, &[Pose2::IDENTITY, quarter]);
        let expected = "1.5 0.000000 0.000000 0 0 0 0.000000000 1.000000000\n\
                        0 1.000000 -2.000000 0 0 0 0.707106781 0.707106781\n";
        assert_eq!(text, expected);
    }

    fn line(time_s: f64) -> Line {
        Line { time_s, wheel: Pose2::IDENTITY, ranges: None }
    }

    #[test]
    fn the_length_is_that_of_the_path_and_not_of_the_line_between_its_ends() {
        let there_and_back = [0.0, 3.0, 0.0].map(|x_m| Pose2::new(x_m, 0.0, 0.0));
        assert!((length_m(&there_and_back) - 6.0).abs() < 1e-12);
    }
}
