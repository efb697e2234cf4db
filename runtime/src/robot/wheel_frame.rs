//! Wheel odometry that continues where that of a saved map ended.
//!
//! The base counts from zero again after every start, and the poses of a loaded map were made with an earlier count. Localization
//! therefore gets this run's odometry in the frame of the earlier one: the robot stands still between the two runs.

use hal::Pose2;
use serde::{Deserialize, Serialize};

use crate::tick::TickInput;

/// From this run's wheel odometry to that of the run before.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct WheelFrame {
    /// The newest wheel pose, as localization got it.
    last: Option<Pose2>,
    /// Pose of this run's odometry in the earlier one; `None` without an earlier one.
    t_earlier_now: Option<Pose2>,
    /// A map was loaded, and no wheel pose has come since.
    resumes: bool,
}

impl WheelFrame {
    /// The next wheel pose is of a new run.
    pub(super) fn resume(&mut self) {
        self.t_earlier_now = None;
        self.resumes = self.last.is_some();
    }

    /// The input with its wheel poses in the frame that localization knows. They must be finite.
    pub(super) fn apply<'a>(&mut self, input: &TickInput<'a>) -> TickInput<'a> {
        let mut input = *input;
        if let Some(last) = self.last.filter(|last| self.resumes && last.is_finite()) {
            self.t_earlier_now = Some(last.compose(&input.wheel.odom.inverse()));
        }
        self.resumes = false;
        if let Some(t_earlier_now) = self.t_earlier_now.filter(Pose2::is_finite) {
            input.wheel.odom = t_earlier_now.compose(&input.wheel.odom);
            input.scan_odom = t_earlier_now.compose(&input.scan_odom);
        }
        self.last = Some(input.wheel.odom);
        input
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::RecordedTick;

    fn odom(frame: &mut WheelFrame, wheel: Pose2) -> Pose2 {
        let mut tick = RecordedTick::new(0, 0);
        tick.wheel.odom = wheel;
        frame.apply(&tick.input().unwrap()).wheel.odom
    }

    #[test]
    fn without_a_loaded_map_every_bit_of_the_odometry_is_kept() {
        let mut frame = WheelFrame::default();
        // `compose` would wrap this yaw.
        let wheel = Pose2 { x_m: -0.0, y_m: 1.0 / 3.0, yaw_rad: 4.0 };
        assert_eq!(odom(&mut frame, wheel), wheel);
    }

    #[test]
    fn a_new_count_goes_on_at_the_last_pose_of_the_earlier_one() {
        let mut frame = WheelFrame::default();
        let ended = Pose2::new(2.0, 1.0, std::f64::consts::FRAC_PI_2);
        odom(&mut frame, ended);
        frame.resume();
        let first = odom(&mut frame, Pose2::new(7.0, 0.0, 0.0));
        assert!(first.distance_m(&ended) < 1e-12);
        // Half a metre ahead of a robot that faces left is half a metre to the left.
        let next = odom(&mut frame, Pose2::new(7.5, 0.0, 0.0));
        assert!(next.distance_m(&Pose2::new(2.0, 1.5, 0.0)) < 1e-12);
    }
}
