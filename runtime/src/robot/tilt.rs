//! A robot that is tilted stands: on a ramp, on an obstacle or in a person's hands its scan is not level and its map would be wrong.

use serde::{Deserialize, Serialize};

use crate::event::Event;

/// A robot is level again when its tilt is this much less than the one at which it stands: it must not start and stop on the edge.
const HYSTERESIS_DEG: f64 = 3.0;
/// A tilt counts for this long. Samples are interrupted for a moment where a robot is shaken or its computer is busy.
const KNOWN_NS: u64 = 1_000_000_000;

/// Whether the robot is tilted.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Tilt {
    is_tilted: bool,
    /// When the tilt was measured last.
    measured_ns: u64,
}

impl Tilt {
    /// Takes a tick's tilt; it is `None` for a robot that does not measure it. A robot whose unit has been silent for a second goes on
    /// as one without a unit. Changes are noted in `events`.
    pub(super) fn observe(
        &mut self,
        tilt_rad: Option<f64>,
        time_ns: u64,
        most_deg: f64,
        events: &mut Vec<Event>,
    ) {
        if tilt_rad.is_some() {
            self.measured_ns = time_ns;
        } else if time_ns.saturating_sub(self.measured_ns) <= KNOWN_NS {
            return;
        }
        let tilt_deg = tilt_rad.unwrap_or_default().to_degrees();
        let limit_deg = if self.is_tilted { most_deg - HYSTERESIS_DEG } else { most_deg };
        let was_tilted = std::mem::replace(&mut self.is_tilted, tilt_deg > limit_deg);
        match (was_tilted, self.is_tilted) {
            (false, true) => events.push(Event::StandsTilted { tilt_deg }),
            (true, false) => events.push(Event::LevelAgain),
            _ => {}
        }
    }

    pub(super) fn is_tilted(self) -> bool {
        self.is_tilted
    }
}

#[cfg(test)]
mod tests {
    use super::super::test_robot::{cells, config, standing};
    use super::super::{Robot, RobotConfig};
    use super::*;
    use crate::imu::ImuInput;
    use crate::session::recompute;
    use crate::tick::Command;
    use hal::Pose2;

    /// Whether the robot stands at each of these tilts, and what it says.
    fn events_of(tilts_deg: &[Option<f64>]) -> (Vec<bool>, Vec<Event>) {
        let mut tilt = Tilt::default();
        let mut events = Vec::new();
        let mut stands = Vec::new();
        for (tick, degrees) in (0..).zip(tilts_deg) {
            let time_ns = tick * 400_000_000;
            tilt.observe(degrees.map(f64::to_radians), time_ns, 10.0, &mut events);
            stands.push(tilt.is_tilted());
        }
        (stands, events)
    }

    #[test]
    fn a_robot_stands_from_the_limit_on_and_goes_on_three_degrees_below_it() {
        let (stands, events) = events_of(&[2.0, 11.0, 8.0, 12.0, 6.9, 9.0].map(Some));
        assert_eq!(stands, [false, true, true, true, false, false]);
        assert!(matches!(
            events[..],
            [Event::StandsTilted { tilt_deg }, Event::LevelAgain] if (tilt_deg - 11.0).abs() < 1e-9
        ));
    }

    #[test]
    fn a_unit_that_is_silent_for_a_second_ends_the_stop_and_a_moment_does_not() {
        let (stands, events) = events_of(&[Some(20.0), None, None, None, None]);
        assert_eq!(stands, [true, true, true, false, false]);
        assert_eq!(events.len(), 2);
        let (stands, events) = events_of(&[Some(20.0), None, None, Some(19.0), None]);
        assert_eq!(stands, [true; 5]);
        assert_eq!(events.len(), 1);
    }

    #[test]
    fn a_tilted_robot_stands_and_maps_nothing_until_it_is_level() {
        let config = RobotConfig { stop_without_frames: None, ..config() };
        let mut robot = Robot::new(config, None).unwrap();
        let mut moves = Vec::new();
        let mut maps = Vec::new();
        for tick in 0..30 {
            let mut input = standing(tick, &Pose2::IDENTITY, Pose2::IDENTITY);
            let tilt_rad = Some(if (10..20).contains(&tick) { 0.3 } else { 0.02 });
            let yaw_rad = 0.0;
            input.imu = Some(ImuInput { gaps: 0, yaw_rad, yaw_at_scan_rad: yaw_rad, tilt_rad });
            let decision = recompute(&mut robot, &input).unwrap();
            moves.push(decision.desired != Command::default());
            maps.push(cells(&robot.map));
        }
        assert!(moves[9] && !moves[10] && !moves[19] && moves[20], "{moves:?}");
        assert_eq!(maps[9], maps[19]);
        assert_ne!(maps[9], maps[20]);
    }
}
