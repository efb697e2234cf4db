//! When the robot no longer knows where it is.

use hal::{Pose2, wrap_angle};
use serde::{Deserialize, Serialize};

use super::local::Tracked;

/// Scans that do not fit, in a row, after which the robot is lost: half a second at 10 Hz. A person who walks past covers the
/// scanner for less.
const LOST_SCANS: u32 = 5;
/// A scan of fewer stretches says nothing: a hall without walls in range, a covered scanner.
const MIN_STRETCHES: u32 = 12;
/// Share of the known stretches of a scan that lie on their surfaces: a scan with less does not fit. Scans of a robot that
/// drives past people have 0.8 and more.
const MIN_INLIERS: f32 = 0.6;
/// Wheels that moved less since the last scan that fitted did not drive the robot away, metres and radians.
const STANDING_M: f64 = 0.03;
const STANDING_RAD: f64 = 0.05;

/// Why the robot does not know where it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum LostReason {
    /// Scans no longer fit the surfaces that were seen a moment ago, and a search around the predicted pose found no better one.
    ScanDoesNotFit,
    /// The same while the wheels stood still: the robot was lifted or carried.
    Carried,
    /// The robot was started in a saved map.
    Loaded,
}

/// What localization knows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum Whereabouts {
    /// The pose in `map` is known.
    #[default]
    Localized,
    /// The newest scan does not fit. Nothing should be entered into a map until one does.
    Doubtful,
    /// The pose in `map` is not known, and `t_map_odom` is the last one that was. The pose in `odom` continues.
    Lost(LostReason),
}

impl Whereabouts {
    /// Why the robot is lost; `None` if it is not.
    #[must_use]
    pub fn lost(self) -> Option<LostReason> {
        match self {
            Self::Lost(why) => Some(why),
            Self::Localized | Self::Doubtful => None,
        }
    }
}

/// Counts scans that do not fit.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(crate) struct Doubt {
    scans: u32,
    /// Wheel odometry at the last scan that fitted.
    wheel: Option<Pose2>,
}

impl Doubt {
    /// Takes a scan that was taken at `wheel`. Returns a reason when it is one too many that does not fit.
    pub(crate) fn observe(&mut self, tracked: &Tracked, wheel: &Pose2) -> Option<LostReason> {
        let fit = &tracked.fit;
        let is_known = tracked.matched && (tracked.is_first || fit.inliers >= MIN_INLIERS);
        if is_known {
            self.scans = self.scans.saturating_sub(1);
            self.wheel = Some(*wheel);
            return None;
        }
        if fit.stretches < MIN_STRETCHES {
            return None;
        }
        self.scans += 1;
        (self.scans >= LOST_SCANS).then(|| self.reason(wheel))
    }

    /// Whether a scan did not fit a moment ago.
    pub(crate) fn is_doubtful(&self) -> bool {
        self.scans > 0
    }

    fn reason(&self, wheel: &Pose2) -> LostReason {
        let stood = self.wheel.is_some_and(|fitted| {
            fitted.distance_m(wheel) < STANDING_M
                && wrap_angle(fitted.yaw_rad - wheel.yaw_rad).abs() < STANDING_RAD
        });
        if stood { LostReason::Carried } else { LostReason::ScanDoesNotFit }
    }
}

#[cfg(test)]
mod tests {
    use super::super::ScanFit;
    use super::*;

    fn scan(inliers: f32, stretches: u32) -> Tracked {
        let fit = ScanFit { stretches, overlap: 0.8, inliers, rms_m: 0.02 };
        Tracked { fit, matched: inliers > 0.5, keyframe: false, is_first: false }
    }

    #[test]
    fn some_scans_that_do_not_fit_make_the_robot_lost_and_the_wheels_give_the_reason() {
        for (metres, why) in [(0.0, LostReason::Carried), (0.04, LostReason::ScanDoesNotFit)] {
            let mut doubt = Doubt::default();
            assert_eq!(doubt.observe(&scan(0.95, 100), &Pose2::IDENTITY), None);
            let lost = (1..=5).filter_map(|step| {
                doubt.observe(&scan(0.3, 100), &Pose2::new(metres * f64::from(step), 0.0, 0.0))
            });
            assert_eq!(lost.collect::<Vec<_>>(), [why]);
        }
    }

    #[test]
    fn single_scans_that_do_not_fit_and_scans_that_see_nothing_are_no_reason() {
        let mut doubt = Doubt::default();
        for _ in 0..20 {
            assert_eq!(doubt.observe(&scan(0.95, 100), &Pose2::IDENTITY), None);
            assert_eq!(doubt.observe(&scan(0.4, 100), &Pose2::IDENTITY), None);
            assert_eq!(doubt.observe(&scan(0.0, 3), &Pose2::IDENTITY), None);
        }
    }
}
