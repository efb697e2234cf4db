//! What the plane is told may be wrong: time, stamps, odometry, bumpers, wishes beyond all measure.

use super::tests::{FORWARD, Room, TICK_NS, cart, driving, looked_around, tripped};
use super::*;
use crate::safety::Plan;
use crate::safety::surroundings::tests::wall_ahead;
use hal::{ErrorKind, Range};

const BACK: Twist2 = Twist2 { linear_mps: -0.3, angular_radps: 0.1 };

fn three_good_scans() -> SafetyConfig {
    SafetyConfig { good_scans: 3, ..SafetyConfig::default() }
}

fn faulted(why: FaultReason) -> Option<SafetyEvent> {
    Some(SafetyEvent::Faulted { why })
}

#[test]
fn when_time_goes_back_it_stands_and_nothing_old_counts_as_young() {
    let mut room = driving();
    room.time_ns += 50_000_000;
    room.tick(FORWARD);
    room.time_ns = TICK_NS / 2;
    assert_eq!(room.tick(FORWARD).event, faulted(FaultReason::LoopOverrun));
    assert_eq!(room.tick(FORWARD).event, Some(SafetyEvent::Cleared));
    room.time_ns = 0;
    let input = SafetyInput { wheel: None, ..room.input(FORWARD, None, false) };
    assert_eq!(
        room.turn(&input).event,
        faulted(FaultReason::BaseSilent),
        "what it knew is not of this time"
    );
    assert_eq!(room.tick_with(FORWARD, None, false).event, faulted(FaultReason::LidarSilent));
}

#[test]
fn a_trip_before_time_went_back_does_not_count_as_one_at_this_place() {
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
fn what_claims_to_come_from_the_future_is_not_taken_in() {
    let mut room = driving();
    let hour_ns = 3_600_000_000_000;
    let mut stopped = Vec::new();
    for _ in 0..4 {
        let scan = LaserScan { time_ns: room.time_ns + hour_ns, ..room.scan() };
        stopped.extend(room.tick_with(FORWARD, Some(&scan), false).event);
    }
    assert_eq!(stopped, [SafetyEvent::Faulted { why: FaultReason::LidarSilent }]);
    assert_eq!(room.tick(FORWARD).event, Some(SafetyEvent::Cleared));
    stopped.clear();
    for _ in 0..4 {
        let scan = room.scan();
        let mut input = room.input(FORWARD, Some(&scan), false);
        input.wheel =
            input.wheel.map(|wheel| WheelFeedback { time_ns: room.time_ns + hour_ns, ..wheel });
        stopped.extend(room.turn(&input).event);
    }
    assert_eq!(stopped, [SafetyEvent::Faulted { why: FaultReason::BaseSilent }]);
    assert_eq!(room.tick(FORWARD).twist(), FORWARD);
    let scan = room.scan();
    let late = Plan { twist: FORWARD, time_ns: room.time_ns + TICK_NS + 1 };
    let output =
        room.turn(&SafetyInput { plan: Some(late), ..room.input(FORWARD, Some(&scan), false) });
    assert_eq!(output.event, Some(SafetyEvent::PlanRefused { why: PlanRefusal::Stale }));
    assert_eq!(output.twist(), Twist2::ZERO);
}

#[test]
fn what_is_ahead_by_no_more_than_a_turn_of_the_loop_is_taken_in() {
    let mut room = driving();
    for _ in 0..5 {
        let scan = LaserScan { time_ns: room.time_ns + TICK_NS, ..room.scan() };
        let mut input = room.input(FORWARD, Some(&scan), false);
        input.wheel =
            input.wheel.map(|wheel| WheelFeedback { time_ns: room.time_ns + TICK_NS, ..wheel });
        input.plan = Some(Plan { twist: FORWARD, time_ns: room.time_ns + TICK_NS });
        assert_eq!(room.turn(&input).twist(), FORWARD);
    }
}

#[test]
fn a_scan_that_comes_three_times_is_not_three_good_scans() {
    let mut room = Room::with(three_good_scans(), 5.0, Pose2::IDENTITY);
    let scan = room.scan();
    for _ in 0..3 {
        assert_eq!(room.tick_with(FORWARD, Some(&scan), false).command, None);
    }
    assert_eq!(room.tick(FORWARD).command, None, "it has gone stale and counts no more");
    assert_eq!(room.tick(FORWARD).command, None);
    assert_eq!(room.tick(FORWARD).twist(), FORWARD);
}

#[test]
fn a_scan_that_was_overtaken_does_not_hide_what_the_newer_one_saw() {
    let mut room = driving();
    let overtaken = room.scan();
    room.time_ns += 50_000_000;
    let wall = LaserScan { time_ns: room.time_ns, ..wall_ahead(0.2) };
    room.tick_with(Twist2::ZERO, Some(&wall), false);
    assert!(tripped(&room.tick_with(FORWARD, Some(&overtaken), false)));
}

#[test]
fn feedback_that_was_overtaken_does_not_bring_the_robot_back_to_where_it_was() {
    let mut room = driving();
    room.tick(FORWARD);
    let scan = room.scan();
    let mut input = room.input(FORWARD, Some(&scan), false);
    let nan = Pose2 { x_m: f64::NAN, ..Pose2::IDENTITY };
    input.wheel = input.wheel.map(|wheel| WheelFeedback { time_ns: 0, odom: nan, ..wheel });
    assert_eq!(room.turn(&input).event, None, "it was never used");
}

#[test]
fn scanner_and_wheels_that_fell_silent_together_still_need_good_scans() {
    let mut room = Room::with(three_good_scans(), 5.0, Pose2::IDENTITY);
    (0..3).for_each(|_| _ = room.tick(FORWARD));
    for _ in 0..6 {
        let input = SafetyInput { wheel: None, ..room.input(FORWARD, None, false) };
        room.turn(&input);
    }
    assert_eq!(room.plane.state(), SafetyState::Fault(FaultReason::BaseSilent));
    let moves: Vec<bool> = (0..3).map(|_| room.tick(FORWARD).twist() == FORWARD).collect();
    assert_eq!(moves, [false, false, true]);
}

#[test]
fn an_emergency_stop_is_kept_also_where_nobody_had_armed() {
    let mut room = Room::new(5.0, Pose2::IDENTITY);
    let scan = room.scan();
    let input = SafetyInput {
        emergency_stop: true,
        request: None,
        ..room.input(FORWARD, Some(&scan), false)
    };
    assert_eq!(room.turn(&input).event, faulted(FaultReason::EmergencyStop));
    assert_eq!(room.tick(FORWARD).command, None, "arming does not clear it");
    let scan = room.scan();
    let clear = SafetyInput {
        request: Some(Request::ClearFault),
        ..room.input(FORWARD, Some(&scan), false)
    };
    assert_eq!(room.turn(&clear).event, Some(SafetyEvent::Disarmed));
    assert_eq!(room.tick(FORWARD).twist(), FORWARD);
}

#[test]
fn disarming_is_no_way_around_a_fault_that_needs_a_person() {
    let mut room = driving();
    let scan = room.scan();
    let fault = SafetyInput {
        base_error: Some(ErrorKind::Fault),
        ..room.input(FORWARD, Some(&scan), false)
    };
    room.turn(&fault);
    let scan = room.scan();
    let disarm =
        SafetyInput { request: Some(Request::Disarm), ..room.input(FORWARD, Some(&scan), false) };
    assert_eq!(room.turn(&disarm), SafetyOutput::STOP);
    assert_eq!(room.tick(FORWARD).command, None);
    assert_eq!(room.plane.state(), SafetyState::Fault(FaultReason::BaseFault));
}

#[test]
fn a_fault_that_passes_leaves_a_disarmed_robot_disarmed() {
    let mut room = driving();
    (0..4).for_each(|_| _ = room.tick_with(FORWARD, None, false));
    let disarm = SafetyInput { request: Some(Request::Disarm), ..room.input(FORWARD, None, false) };
    assert_eq!(room.turn(&disarm).event, Some(SafetyEvent::Disarmed));
    let scan = room.scan();
    let idle = SafetyInput { request: None, ..room.input(FORWARD, Some(&scan), false) };
    assert_eq!(room.turn(&idle), SafetyOutput::STOP);
    let again = SafetyInput { request: Some(Request::Disarm), ..room.input(FORWARD, None, false) };
    assert_eq!(room.turn(&again), SafetyOutput::STOP, "said once");
}

#[test]
fn odometry_that_begins_anew_while_backing_off_ends_it() {
    for anew in [Pose2::IDENTITY, Pose2::new(1.7, 0.0, 1.1), Pose2::new(1.2, 0.0, 0.0)] {
        let mut room = Room::new(2.0, Pose2::new(1.2, 0.0, 0.0));
        room.until(FORWARD, tripped);
        room.until(FORWARD, |output| output.twist().linear_mps < 0.0);
        let (scan, before) = (room.scan(), room.pose);
        let mut input = room.input(FORWARD, Some(&scan), false);
        input.wheel = input.wheel.map(|wheel| WheelFeedback { odom: anew, ..wheel });
        let output = room.turn(&input);
        assert!(unknown_behind(&output), "{before:?} -> {anew:?}: {output:?}");
        assert!(matches!(room.plane.state(), SafetyState::Escaping(_)));
    }
}

/// How far it backs off, put before a wall after driving up to it.
fn backs_off_m(mut room: Room) -> f64 {
    room.until(FORWARD, tripped);
    let from = room.pose;
    room.until(FORWARD, |output| output.blocked_m.is_some());
    room.pose.distance_m(&from)
}

#[test]
fn a_base_that_was_away_remembers_nothing_of_the_ground_behind() {
    assert!(backs_off_m(looked_around(1.75)) > 0.19, "the ground is known");
    for kind in [ErrorKind::Timeout, ErrorKind::Disconnected] {
        let mut room = looked_around(1.75);
        let scan = room.scan();
        let away =
            SafetyInput { base_error: Some(kind), ..room.input(FORWARD, Some(&scan), false) };
        room.turn(&away);
        let clear = SafetyInput {
            request: Some(Request::ClearFault),
            ..room.input(Twist2::ZERO, None, false)
        };
        room.turn(&clear);
        let gone_m = backs_off_m(room);
        assert!(gone_m < 0.06, "{kind:?}: {gone_m} m blindly");
    }
}

#[test]
fn odometry_that_turned_by_a_jump_has_forgotten_the_ground_behind() {
    let mut room = looked_around(0.5);
    room.pose.yaw_rad = 1.01;
    room.tick(Twist2::ZERO);
    room.pose.yaw_rad = 0.0;
    room.tick(Twist2::ZERO);
    assert_eq!(room.tick(BACK).twist().linear_mps, 0.0);
}

#[test]
fn a_bumper_that_stays_pressed_for_a_moment_does_not_end_the_back_off_and_one_that_is_pressed_later_does()
 {
    let cases =
        [([true, false, false], false), ([true, false, true], true), ([false, false, true], true)];
    // Slowly, it is still near to what it leaves when it is pressed again.
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
fn a_bumper_that_is_still_pressed_three_centimetres_away_is_one_behind() {
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
fn wishes_beyond_all_measure_are_answered_at_once() {
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
            let wish = Twist2 { linear_mps: twist.0, angular_radps: twist.1 };
            let output = room.tick(wish);
            assert!(
                output.twist().is_finite() && output.twist().linear_mps.abs() < 16.0,
                "{wish:?}: {output:?}"
            );
        }
    }
}

#[test]
fn a_scan_that_comes_before_the_first_feedback_is_good_to_stop_by() {
    let mut room = Room::new(0.25, Pose2::IDENTITY);
    let scan = room.scan();
    let input = SafetyInput { wheel: None, ..room.input(FORWARD, Some(&scan), false) };
    assert_eq!(room.turn(&input), SafetyOutput::STOP);
    assert!(tripped(&room.tick_with(FORWARD, None, false)));
}

#[test]
fn clearing_a_fault_that_passes_by_itself_does_not_hurry_it() {
    let mut room = Room::with(three_good_scans(), 5.0, Pose2::IDENTITY);
    (0..3).for_each(|_| _ = room.tick(FORWARD));
    (0..4).for_each(|_| _ = room.tick_with(FORWARD, None, false));
    let scan = room.scan();
    let clear = SafetyInput {
        request: Some(Request::ClearFault),
        ..room.input(FORWARD, Some(&scan), false)
    };
    assert_eq!(room.turn(&clear), SafetyOutput::STOP);
    assert_eq!(room.plane.state(), SafetyState::Fault(FaultReason::LidarSilent));
}

#[test]
fn what_is_seen_and_touched_at_once_was_seen_and_what_is_too_near_to_be_measured_is_told() {
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
fn a_blocked_place_is_told_also_when_a_fault_comes_while_the_robot_drives_back() {
    let mut room = Room::new(2.0, Pose2::IDENTITY);
    room.until(FORWARD, tripped);
    room.until(FORWARD, |output| output.twist().linear_mps < 0.0);
    let scan = room.scan();
    let input = SafetyInput { emergency_stop: true, ..room.input(FORWARD, Some(&scan), false) };
    let blocked_m = room.turn(&input).blocked_m.unwrap();
    assert!((blocked_m[0] - 2.0).abs() < 0.02, "{blocked_m:?}");
    let mut room = driving();
    let input = SafetyInput { emergency_stop: true, ..room.input(FORWARD, None, false) };
    assert_eq!(room.turn(&input).blocked_m, None, "nothing was blocked");
}

#[test]
fn the_plane_tells_its_configuration() {
    assert_eq!(*SafetyPlane::new(cart()).config(), cart());
}

#[test]
fn two_calls_at_one_time_are_no_fault_and_nothing_is_forgotten() {
    let mut room = driving();
    room.time_ns -= TICK_NS;
    let input = SafetyInput { wheel: None, ..room.input(FORWARD, None, false) };
    assert_eq!(room.turn(&input).twist(), FORWARD);
}
