//! Tests with wrong inputs: time that goes backwards, wrong time stamps, odometry resets, stuck
//! bumpers, huge commands.

use super::tests::{FORWARD, Room, TICK_NS, cart, driving, restarts_slowly, rotated_once, tripped};
use super::*;
use crate::safety::Plan;
use crate::safety::surroundings::tests::wall_ahead;
use hal::Range;

const BACK: Twist2 = Twist2 { linear_mps: -0.3, angular_radps: 0.1 };

fn three_good_scans() -> SafetyConfig {
    SafetyConfig { good_scans: 3, ..SafetyConfig::default() }
}

fn faulted(why: FaultReason) -> Option<SafetyEvent> {
    Some(SafetyEvent::Faulted { why })
}

#[test]
fn when_time_goes_backwards_the_robot_stops_and_old_measurements_do_not_count_as_new() {
    let mut room = driving();
    room.time_ns += 50_000_000;
    room.tick(FORWARD);
    room.time_ns = TICK_NS / 2;
    assert_eq!(room.tick(FORWARD).event, faulted(FaultReason::LoopOverrun));
    assert!(restarts_slowly(&mut room));
    room.time_ns = 0;
    for why in [FaultReason::LoopOverrun, FaultReason::BaseSilent] {
        let input = SafetyInput { wheel: None, ..room.input(FORWARD, None, false) };
        assert_eq!(room.step(&input).event, faulted(why), "feedback from before is not used");
    }
    let output = room.tick_with(FORWARD, None, false);
    assert_eq!(output.forbidden, Some(FaultReason::LidarSilent), "nor is a scan from before it");
}

#[test]
fn a_trip_before_time_went_backwards_does_not_count_towards_an_escape() {
    let mut room = Room::new(2.0, Pose2::new(1.5, 0.0, 0.0));
    for _ in 0..2 {
        room.until(FORWARD, tripped);
        room.until(FORWARD, |output| output.blocked_m.is_some());
        room.tick(Twist2::ZERO);
    }
    room.time_ns = 0;
    room.tick(Twist2::ZERO);
    room.until(FORWARD, tripped);
    assert_eq!(room.plane.trips.len(), 1);
}

fn unknown_behind(output: &SafetyOutput) -> bool {
    matches!(output.event, Some(SafetyEvent::BackedOff { end: BackOffEnd::RearUnknown, .. }))
}

#[test]
fn measurements_and_plans_from_the_future_are_refused() {
    let mut room = driving();
    let hour_ns = 3_600_000_000_000;
    let mut stopped = Vec::new();
    for _ in 0..4 {
        let scan = LaserScan { time_ns: room.time_ns + hour_ns, ..room.scan() };
        stopped.extend(room.tick_with(FORWARD, Some(&scan), false).event);
    }
    assert_eq!(stopped, [SafetyEvent::Faulted { why: FaultReason::LidarSilent }]);
    assert!(restarts_slowly(&mut room));
    let scan = room.scan();
    let late = Plan { twist: FORWARD, time_ns: room.time_ns + TICK_NS + 1 };
    let output =
        room.step(&SafetyInput { plan: Some(late), ..room.input(FORWARD, Some(&scan), false) });
    assert_eq!(output.event, Some(SafetyEvent::PlanRefused { why: PlanRefusal::Stale }));
    assert_eq!(output.twist(), Twist2::ZERO);
    stopped.clear();
    for _ in 0..4 {
        let scan = room.scan();
        let mut input = room.input(FORWARD, Some(&scan), false);
        input.wheel =
            input.wheel.map(|wheel| WheelFeedback { time_ns: room.time_ns + hour_ns, ..wheel });
        stopped.extend(room.step(&input).event);
    }
    assert_eq!(stopped, [SafetyEvent::Faulted { why: FaultReason::BaseSilent }]);
}

#[test]
fn measurements_and_plans_at_most_one_period_ahead_are_accepted() {
    let mut room = driving();
    for _ in 0..5 {
        let scan = LaserScan { time_ns: room.time_ns + TICK_NS, ..room.scan() };
        let mut input = room.input(FORWARD, Some(&scan), false);
        input.wheel =
            input.wheel.map(|wheel| WheelFeedback { time_ns: room.time_ns + TICK_NS, ..wheel });
        input.plan = Some(Plan { twist: FORWARD, time_ns: room.time_ns + TICK_NS });
        assert_eq!(room.step(&input).twist(), FORWARD);
    }
}

#[test]
fn a_scan_that_arrives_three_times_is_not_three_good_scans() {
    let mut room = Room::with(three_good_scans(), 5.0, Pose2::IDENTITY);
    let scan = room.scan();
    for _ in 0..3 {
        assert_eq!(room.tick_with(FORWARD, Some(&scan), false).command, None);
    }
    assert_eq!(room.tick(FORWARD).command, None, "it is too old and no longer counts");
    assert_eq!(room.tick(FORWARD).command, None);
    assert_eq!(room.tick(FORWARD).twist(), FORWARD);
}

#[test]
fn an_older_scan_that_arrives_late_does_not_replace_the_newer_one() {
    let mut room = driving();
    let overtaken = room.scan();
    room.time_ns += 50_000_000;
    let wall = LaserScan { time_ns: room.time_ns, ..wall_ahead(0.2) };
    room.tick_with(Twist2::ZERO, Some(&wall), false);
    assert!(tripped(&room.tick_with(FORWARD, Some(&overtaken), false)));
}

#[test]
fn older_feedback_that_arrives_late_is_ignored() {
    let mut room = driving();
    room.tick(FORWARD);
    let scan = room.scan();
    let mut input = room.input(FORWARD, Some(&scan), false);
    let nan = Pose2 { x_m: f64::NAN, ..Pose2::IDENTITY };
    input.wheel = input.wheel.map(|wheel| WheelFeedback { time_ns: 0, odom: nan, ..wheel });
    assert_eq!(room.step(&input).event, None, "the NaN pose was not used");
}

#[test]
fn good_scans_while_the_wheels_are_silent_do_not_move_the_robot() {
    let mut room = Room::with(three_good_scans(), 5.0, Pose2::IDENTITY);
    (0..3).for_each(|_| _ = room.tick(FORWARD));
    for _ in 0..6 {
        let input = SafetyInput { wheel: None, ..room.input(FORWARD, None, false) };
        room.step(&input);
    }
    assert_eq!(room.plane.state(), SafetyState::Fault(FaultReason::BaseSilent));
    (0..10).for_each(|_| assert_eq!(room.tick(FORWARD).command, None));
}

#[test]
fn an_emergency_stop_is_kept_also_while_the_robot_is_disarmed() {
    let mut room = Room::new(5.0, Pose2::IDENTITY);
    let scan = room.scan();
    let input = SafetyInput {
        emergency_stop: true,
        request: None,
        ..room.input(FORWARD, Some(&scan), false)
    };
    assert_eq!(room.step(&input).event, faulted(FaultReason::EmergencyStop));
    assert_eq!(room.tick(FORWARD).command, None, "arming does not clear it");
    let scan = room.scan();
    let clear = SafetyInput {
        request: Some(Request::ClearFault),
        ..room.input(FORWARD, Some(&scan), false)
    };
    assert_eq!(room.step(&clear).event, Some(SafetyEvent::Disarmed));
    assert_eq!(room.tick(FORWARD).twist(), FORWARD);
}

#[test]
fn disarming_does_not_clear_a_fault_that_needs_a_person() {
    let mut room = driving();
    let scan = room.scan();
    let fault = SafetyInput {
        base_error: Some(FaultReason::BaseFault),
        ..room.input(FORWARD, Some(&scan), false)
    };
    room.step(&fault);
    let scan = room.scan();
    let disarm =
        SafetyInput { request: Some(Request::Disarm), ..room.input(FORWARD, Some(&scan), false) };
    assert_eq!(room.step(&disarm), SafetyOutput::STOP);
    assert_eq!(room.tick(FORWARD).command, None);
    assert_eq!(room.plane.state(), SafetyState::Fault(FaultReason::BaseFault));
}

#[test]
fn a_disarmed_robot_stays_disarmed_when_a_fault_clears_itself() {
    let mut room = driving();
    (0..4).for_each(|_| _ = room.tick_with(FORWARD, None, false));
    let disarm = SafetyInput { request: Some(Request::Disarm), ..room.input(FORWARD, None, false) };
    assert_eq!(room.step(&disarm).event, Some(SafetyEvent::Disarmed));
    let scan = room.scan();
    let idle = SafetyInput { request: None, ..room.input(FORWARD, Some(&scan), false) };
    assert_eq!(room.step(&idle), SafetyOutput::STOP);
    let again = SafetyInput { request: Some(Request::Disarm), ..room.input(FORWARD, None, false) };
    assert_eq!(room.step(&again), SafetyOutput::STOP, "the event is reported once");
}

#[test]
fn an_odometry_reset_ends_the_back_off() {
    for anew in [Pose2::IDENTITY, Pose2::new(1.7, 0.0, 1.1), Pose2::new(1.2, 0.0, 0.0)] {
        let mut room = Room::new(2.0, Pose2::new(1.2, 0.0, 0.0));
        room.until(FORWARD, tripped);
        room.until(FORWARD, |output| output.twist().linear_mps < 0.0);
        let scan = room.scan();
        let before = room.pose;
        let mut input = room.input(FORWARD, Some(&scan), false);
        input.wheel = input.wheel.map(|wheel| WheelFeedback { odom: anew, ..wheel });
        let output = room.step(&input);
        assert!(unknown_behind(&output), "{before:?} -> {anew:?}: {output:?}");
        assert!(matches!(room.plane.state(), SafetyState::Escaping(_)));
    }
}

/// The distance of the back-off after the robot drove up to a wall.
fn backs_off_m(mut room: Room) -> f64 {
    room.until(FORWARD, tripped);
    let from = room.pose;
    room.until(FORWARD, |output| output.blocked_m.is_some());
    room.pose.distance_m(&from)
}

#[test]
fn a_base_that_was_disconnected_makes_the_ground_behind_unknown() {
    assert!(backs_off_m(rotated_once(1.75)) > 0.19, "the ground is known");
    for why in [FaultReason::BaseSilent, FaultReason::BaseFault] {
        let mut room = rotated_once(1.75);
        let scan = room.scan();
        let away = SafetyInput { base_error: Some(why), ..room.input(FORWARD, Some(&scan), false) };
        room.step(&away);
        let clear = SafetyInput {
            request: Some(Request::ClearFault),
            ..room.input(Twist2::ZERO, None, false)
        };
        room.step(&clear);
        let gone_m = backs_off_m(room);
        assert!(gone_m < 0.06, "{why:?}: {gone_m} m over unknown ground");
    }
}

#[test]
fn a_jump_of_the_yaw_makes_the_ground_behind_unknown() {
    let mut room = rotated_once(0.5);
    room.pose.yaw_rad = 1.01;
    room.tick(Twist2::ZERO);
    room.pose.yaw_rad = 0.0;
    room.tick(Twist2::ZERO);
    assert_eq!(room.tick(BACK).twist().linear_mps, 0.0);
}

#[test]
fn a_bumper_that_stays_pressed_at_first_does_not_end_the_back_off_and_a_later_contact_does() {
    let cases =
        [([true, false, false], false), ([true, false, true], true), ([false, false, true], true)];
    // At 0.05 m/s the robot is still near the obstacle when the bumper is pressed again.
    for ((felt, ends), back_off_mps) in
        cases.into_iter().flat_map(|case| [(case, 0.3), (case, 0.05)])
    {
        let config = SafetyConfig { back_off_mps, ..SafetyConfig::default() };
        let mut room = Room::with(config, 2.0, Pose2::IDENTITY);
        room.until(FORWARD, tripped);
        let mut end = None;
        for contact in felt {
            let scan = room.scan();
            end = end.or(room.tick_with(FORWARD, Some(&scan), contact).event);
        }
        let blocked =
            matches!(end, Some(SafetyEvent::BackedOff { end: BackOffEnd::RearBlocked, .. }));
        assert_eq!(blocked, ends, "{felt:?}: {end:?}");
    }
}

#[test]
fn a_bumper_that_is_still_pressed_three_centimetres_away_counts_as_a_contact_behind() {
    let mut room = Room::new(2.0, Pose2::IDENTITY);
    room.until(FORWARD, tripped);
    let from = room.pose;
    let end = loop {
        let scan = room.scan();
        let output = room.tick_with(FORWARD, Some(&scan), true);
        if output.blocked_m.is_some() {
            break output;
        }
        room.pose.x_m = room.pose.x_m.max(from.x_m - 0.031);
    };
    assert!(
        matches!(end.event, Some(SafetyEvent::BackedOff { end: BackOffEnd::RearBlocked, .. })),
        "{end:?}"
    );
    assert!(room.pose.distance_m(&from) > 0.029);
}

#[test]
fn huge_commands_are_limited_without_a_long_computation() {
    for corners in [cart(), SafetyConfig::default()] {
        for twist in [
            (0.0, 1e300),
            (1e300, 1e300),
            (1e300, 1e299),
            (-1e300, 1e300),
            (1e300, 0.0),
            (-1e300, 0.0),
        ] {
            let mut room = Room::with(corners.clone(), 0.7, Pose2::IDENTITY);
            room.tick(Twist2::ZERO);
            let command = Twist2 { linear_mps: twist.0, angular_radps: twist.1 };
            let output = room.tick(command);
            assert!(
                output.twist().is_finite() && output.twist().linear_mps.abs() < 16.0,
                "{command:?}: {output:?}"
            );
        }
    }
}

#[test]
fn a_scan_that_arrives_before_the_first_feedback_can_trip_the_safety_plane() {
    let mut room = Room::new(0.25, Pose2::IDENTITY);
    let scan = room.scan();
    let input = SafetyInput { wheel: None, ..room.input(FORWARD, Some(&scan), false) };
    assert_eq!(room.step(&input).command, None);
    assert!(tripped(&room.tick_with(FORWARD, None, false)));
}

#[test]
fn a_clear_request_does_not_shorten_a_fault_that_resumes_on_evidence() {
    let mut room = Room::with(three_good_scans(), 5.0, Pose2::IDENTITY);
    (0..3).for_each(|_| _ = room.tick(FORWARD));
    (0..4).for_each(|_| _ = room.tick_with(FORWARD, None, false));
    let scan = room.scan();
    let clear = SafetyInput {
        request: Some(Request::ClearFault),
        ..room.input(FORWARD, Some(&scan), false)
    };
    assert_eq!(room.step(&clear), SafetyOutput::STOP);
    assert_eq!(room.plane.state(), SafetyState::Fault(FaultReason::LidarSilent));
}

#[test]
fn a_trip_reports_the_lidar_before_the_contact_and_a_too_near_return_as_such() {
    let mut room = driving();
    let mut scan = LaserScan { time_ns: room.time_ns, ..wall_ahead(0.2) };
    let output = room.tick_with(FORWARD, Some(&scan), true);
    assert!(
        matches!(output.event, Some(SafetyEvent::Tripped { by: TripCause::LidarHit, .. })),
        "{output:?}"
    );
    let mut room = driving();
    scan.ranges[530..550].fill(Range::TooNear);
    scan.time_ns = room.time_ns;
    let output = room.tick_with(FORWARD, Some(&scan), false);
    assert!(
        matches!(output.event, Some(SafetyEvent::Tripped { by: TripCause::LidarTooNear, .. })),
        "{output:?}"
    );
}

#[test]
fn a_fault_during_a_back_off_still_reports_the_blocked_point() {
    let mut room = Room::new(2.0, Pose2::IDENTITY);
    room.until(FORWARD, tripped);
    room.until(FORWARD, |output| output.twist().linear_mps < 0.0);
    let scan = room.scan();
    let input = SafetyInput { emergency_stop: true, ..room.input(FORWARD, Some(&scan), false) };
    let blocked_m = room.step(&input).blocked_m.unwrap();
    assert!((blocked_m[0] - 2.0).abs() < 0.02, "{blocked_m:?}");
    let mut room = driving();
    let input = SafetyInput { emergency_stop: true, ..room.input(FORWARD, None, false) };
    assert_eq!(room.step(&input).blocked_m, None, "nothing was blocked");
}

#[test]
fn the_configuration_can_be_read_back() {
    assert_eq!(*SafetyPlane::new(cart()).config(), cart());
}

#[test]
fn two_calls_at_the_same_time_are_no_fault_and_discard_nothing() {
    let mut room = driving();
    room.time_ns -= TICK_NS;
    let input = SafetyInput { wheel: None, ..room.input(FORWARD, None, false) };
    assert_eq!(room.step(&input).twist(), FORWARD);
}
