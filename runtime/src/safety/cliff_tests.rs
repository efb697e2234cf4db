//! Tests of cliff sensors: the safety plane keeps the robot from an edge that scanner and map do not show.

use super::tests::{FORWARD, Room};
use super::*;

/// Where the floor of the room ends.
const EDGE_M: f64 = 1.0;

/// One tick, in which the cliff sensors report this.
fn tick(room: &mut Room, desired: Twist2, cliff: bool) -> SafetyOutput {
    let scan = room.scan();
    let mut input = room.input(desired, Some(&scan), false);
    if let Some(wheel) = &mut input.wheel {
        wheel.cliff = cliff;
    }
    room.step(&input)
}

/// One tick of a robot whose cliff sensors are at its front edge.
fn tick_before_the_edge(room: &mut Room, desired: Twist2) -> SafetyOutput {
    let front_m = room.pose.x_m + SafetyConfig::default().footprint_radius_m;
    tick(room, desired, front_m > EDGE_M)
}

#[test]
fn a_cliff_ahead_stops_the_robot_which_backs_off_and_reports_the_place() {
    let mut room = Room::new(3.0, Pose2::IDENTITY);
    let mut farthest_m = 0.0_f64;
    let mut tripped = false;
    let blocked_m = loop {
        let output = tick_before_the_edge(&mut room, FORWARD);
        farthest_m = farthest_m.max(room.pose.x_m);
        tripped |= matches!(output.event, Some(SafetyEvent::Tripped { by: TripCause::Cliff, .. }));
        if let Some(blocked_m) = output.blocked_m {
            assert!(
                matches!(
                    output.event,
                    Some(SafetyEvent::BackedOff { end: BackOffEnd::Distance, .. })
                ),
                "{output:?}"
            );
            break blocked_m;
        }
        assert!(room.time_ns < 100 * TRIP_MEMORY_NS, "no back-off");
    };
    assert!(tripped);
    // 0.1 s at 0.3 m/s pass until the next tick.
    assert!(farthest_m + 0.16 < EDGE_M + 0.031, "{farthest_m}");
    assert!((blocked_m[0] - (EDGE_M + CONTACT_AHEAD_M)).abs() < 0.031, "{blocked_m:?}");
    assert!(room.pose.x_m < farthest_m - 0.19, "{:?}", room.pose);
}

#[test]
fn a_robot_does_not_rotate_at_an_edge_and_may_stand_there() {
    let rotation = Twist2 { linear_mps: 0.0, angular_radps: 0.3 };
    let mut room = Room::new(3.0, Pose2::IDENTITY);
    tick(&mut room, Twist2::ZERO, true);
    assert_eq!(tick(&mut room, Twist2::ZERO, true).event, None);
    let output = tick(&mut room, rotation, true);
    assert_eq!(output.command, None);
    assert!(matches!(output.event, Some(SafetyEvent::Tripped { by: TripCause::Cliff, .. })));
}

#[test]
fn a_cliff_that_is_reported_again_and_again_at_one_place_needs_a_person() {
    let mut room = Room::new(3.0, Pose2::IDENTITY);
    room.tick(FORWARD);
    let given_up = (0..600).any(|_| {
        let output = tick(&mut room, FORWARD, true);
        output.event == Some(SafetyEvent::Faulted { why: FaultReason::RepeatedContact })
    });
    assert!(given_up, "{:?}", room.plane.state());
}

#[test]
fn a_cliff_that_appears_while_the_robot_backs_off_is_behind_it() {
    let mut room = Room::new(3.0, Pose2::IDENTITY);
    // The ground behind is known for longer than a back-off.
    for _ in 0..20 {
        room.tick(FORWARD);
    }
    let ends: Vec<_> = [true, true, true, false, true]
        .into_iter()
        .filter_map(|cliff| match tick(&mut room, FORWARD, cliff).event {
            Some(SafetyEvent::BackedOff { end, .. }) => Some(end),
            _ => None,
        })
        .collect();
    assert_eq!(ends, [BackOffEnd::RearBlocked]);
}

#[test]
fn a_cliff_during_an_escape_stops_it() {
    let mut room = Room::new(2.0, Pose2::new(1.75, 0.0, 0.0));
    room.until(FORWARD, |output| output.event == Some(SafetyEvent::Escaping));
    assert_eq!(tick(&mut room, FORWARD, true).command, None);
    assert!(matches!(room.plane.state(), SafetyState::Tripped { .. }));
}
