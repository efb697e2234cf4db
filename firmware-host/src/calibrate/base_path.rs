//! Where the robot was at any time, once wheels and scanner are calibrated: the scans say it at their times, and the wheels fill
//! in between.

use hal::Pose2;

use super::laser_parameters::LaserParameters;
use super::scan_path::ScanPose;
use super::wheels::{WheelGeometry, WheelPath};

/// Between scans that are further apart the wheels alone would decide, seconds.
const LONGEST_GAP_S: f64 = 0.6;
/// Metres of path that a radian of rotation counts as.
const METRES_PER_RADIAN: f64 = 0.5;

/// The path of `base_link`, on the wheels' clock.
pub(super) struct BasePath<'a> {
    wheels: &'a WheelPath,
    geometry: WheelGeometry,
    /// Times and poses at the scans that fit.
    poses: Vec<(f64, Pose2)>,
}

impl<'a> BasePath<'a> {
    pub fn new(wheels: &'a WheelPath, path: &[ScanPose], parameters: &LaserParameters) -> Self {
        let t_base_laser = parameters.t_base_laser;
        let to_base = t_base_laser.inverse();
        let matched = path.iter().filter(|scan| scan.matched);
        let poses = matched.map(|scan| {
            let pose = t_base_laser.compose(&scan.pose).compose(&to_base);
            (scan.time_s - parameters.latency_s, pose)
        });
        Self { wheels, geometry: parameters.wheels, poses: poses.collect() }
    }

    /// The pose at a time. `None` before the first scan, after the last, and where scans are missing.
    pub fn at(&self, time_s: f64) -> Option<Pose2> {
        let after = self.poses.partition_point(|(scan_s, _)| *scan_s <= time_s);
        let (from_s, from) = self.poses.get(after.checked_sub(1)?)?;
        let (to_s, to) = self.poses.get(after)?;
        if to_s - from_s > LONGEST_GAP_S {
            return None;
        }
        let there = self.wheels.motion_by_wheels(&self.geometry, *from_s, time_s);
        let whole = self.wheels.motion_by_wheels(&self.geometry, *from_s, *to_s);
        let wrong = whole.inverse().compose(&from.inverse().compose(to));
        let path_m = self.path_m(*from_s, *to_s);
        let share = if path_m > 0.0 { self.path_m(*from_s, time_s) / path_m } else { 0.0 };
        let part = Pose2::new(share * wrong.x_m, share * wrong.y_m, share * wrong.yaw_rad);
        Some(from.compose(&there).compose(&part))
    }

    fn path_m(&self, from_s: f64, to_s: f64) -> f64 {
        let motion = self.wheels.motion(&self.geometry, from_s, to_s);
        motion.distance_m + METRES_PER_RADIAN * motion.rotation_rad
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GEOMETRY: WheelGeometry = WheelGeometry { scale: [1.0, 1.0], track_m: 0.3 };

    /// Wheels that report `reported` metres in the second in which the scans see one metre.
    fn wheels(reported: f64) -> WheelPath {
        let mut wheels = WheelPath::default();
        wheels.push(0.0, &Pose2::IDENTITY, GEOMETRY.track_m);
        wheels.push(1.0, &Pose2::new(reported, 0.0, 0.0), GEOMETRY.track_m);
        wheels
    }

    fn scans(step_s: f64) -> Vec<ScanPose> {
        (0..=4)
            .map(|index: u32| {
                let time_s = step_s * f64::from(index);
                ScanPose { time_s, pose: Pose2::new(time_s, 0.0, 0.0), matched: true }
            })
            .collect()
    }

    fn parameters(t_base_laser: Pose2) -> LaserParameters {
        LaserParameters { wheels: GEOMETRY, t_base_laser, latency_s: 0.0 }
    }

    #[test]
    fn between_scans_the_wheels_are_stretched_to_fit() {
        let wheels = wheels(0.9);
        let path = BasePath::new(&wheels, &scans(0.25), &parameters(Pose2::IDENTITY));
        assert!((path.at(0.6).unwrap().x_m - 0.6).abs() < 1e-9);
    }

    #[test]
    fn the_latency_of_the_scans_is_taken_out() {
        let wheels = wheels(1.0);
        let late = LaserParameters { latency_s: 0.1, ..parameters(Pose2::IDENTITY) };
        let path = BasePath::new(&wheels, &scans(0.25), &late);
        assert!((path.at(0.5).unwrap().x_m - 0.6).abs() < 1e-9);
    }

    #[test]
    fn there_is_no_pose_where_scans_are_missing() {
        let wheels = wheels(1.0);
        let path = BasePath::new(&wheels, &scans(0.25), &parameters(Pose2::IDENTITY));
        assert!(path.at(-0.1).is_none() && path.at(1.1).is_none());
        let sparse = BasePath::new(&wheels, &scans(0.7), &parameters(Pose2::IDENTITY));
        assert!(sparse.at(0.3).is_none());
    }
}
