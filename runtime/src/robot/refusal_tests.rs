//! Ticks that are refused.

use hal::Pose2;

use super::test_robot::{cells, drive, robot, stand};
use super::*;

/// The time of a tick is before that of the last one: the clock was set, or ticks come in the wrong order.
#[test]
fn a_tick_whose_time_goes_back_is_refused_with_the_reason_and_overwrites_nothing() {
    let mut robot = robot();
    let truth = drive(&mut robot);
    let memory = robot.snapshot();
    let known = cells(robot.map());
    let poses = *robot.poses();
    // The room of another time and place: whatever is taken from this tick would be wrong.
    let elsewhere = Pose2::new(-1.2, 0.5, 2.0);
    let refused = stand(&mut robot, 3, &elsewhere, elsewhere);
    assert_eq!(refused.events, [Event::InputRefused { why: RefusedInput::TimeWentBack }]);
    assert_eq!(refused.desired, Twist2::ZERO.into());
    assert_eq!(
        (refused.t_odom_base, refused.t_map_odom, refused.lost),
        (poses.t_odom_base, poses.t_map_odom, None)
    );
    assert_eq!((refused.map_digest, refused.depth_digest), (0, 0));
    assert!(cells(robot.map()) == known && robot.snapshot() == memory);

    // The next good ticks are decided as if the refused one had never come.
    let mut other = super::test_robot::robot();
    other.restore(&memory).unwrap();
    for tick in 30..35 {
        let wheel = Pose2::new(truth.x_m + 0.02 * (tick - 29) as f64, 0.0, 0.0);
        let decision = stand(&mut robot, tick, &wheel, wheel);
        assert_eq!(decision, stand(&mut other, tick, &wheel, wheel));
        let is_refused = |event: &Event| matches!(event, Event::InputRefused { .. });
        assert!(!decision.events.iter().any(is_refused), "{:?}", decision.events);
        assert!(decision.map_digest != 0 && decision.lost.is_none());
        assert!(decision.t_map_base().distance_m(&wheel) < 0.02, "{:?}", decision.t_map_base());
    }
}

#[test]
fn as_long_as_time_is_behind_every_tick_is_refused_and_the_first_one_after_it_is_not() {
    let mut robot = robot();
    let truth = drive(&mut robot);
    for tick in 20..32 {
        let decision = stand(&mut robot, tick, &truth, truth);
        let why = RefusedInput::TimeWentBack;
        assert_eq!(decision.events.contains(&Event::InputRefused { why }), tick < 29, "{tick}");
    }
}
