//! Tests of repeated contacts: the safety plane does not push against a hand or a cable again and
//! again.

use super::tests::{FORWARD, Room};
use super::*;

const ROTATION: Twist2 = Twist2 { linear_mps: 0.0, angular_radps: 0.3 };

/// Number of ticks with a bumper that stays pressed until the safety plane gives up.
fn ticks_until_given_up(plan: Twist2) -> usize {
    let mut room = Room::new(3.0, Pose2::IDENTITY);
    room.tick(Twist2::ZERO);
    let given_up = (0..200).position(|_| {
        let scan = room.scan();
        let output = room.tick_with(plan, Some(&scan), true);
        output.event == Some(SafetyEvent::Faulted { why: FaultReason::RepeatedContact })
    });
    given_up.unwrap_or_else(|| panic!("never given up, state {:?}", room.plane.state()))
}

#[test]
fn a_bumper_that_stays_pressed_is_given_up_within_two_seconds_whatever_the_plan_is() {
    for plan in [FORWARD, ROTATION, Twist2 { linear_mps: -0.2, angular_radps: 0.1 }] {
        let ticks = ticks_until_given_up(plan);
        assert!(ticks < 20, "{plan:?}: {ticks} ticks");
    }
}

#[test]
fn a_contact_while_the_robot_rotates_stops_it_and_is_reported() {
    let mut room = Room::new(3.0, Pose2::IDENTITY);
    room.tick(ROTATION);
    let scan = room.scan();
    let output = room.tick_with(ROTATION, Some(&scan), true);
    assert_eq!(output.command, None);
    assert!(matches!(output.event, Some(SafetyEvent::Tripped { by: TripCause::Contact, .. })));
}

#[test]
fn a_contact_during_an_escape_stops_it() {
    let mut room = Room::new(2.0, Pose2::new(1.75, 0.0, 0.0));
    room.until(FORWARD, |output| output.event == Some(SafetyEvent::Escaping));
    let scan = room.scan();
    let output = room.tick_with(FORWARD, Some(&scan), true);
    assert_eq!(output.command, None);
    assert!(matches!(room.plane.state(), SafetyState::Tripped { .. }));
}

#[test]
fn a_robot_that_stands_may_be_touched_as_often_as_one_likes() {
    let mut room = Room::new(3.0, Pose2::IDENTITY);
    for _ in 0..50 {
        let scan = room.scan();
        assert_eq!(room.tick_with(Twist2::ZERO, Some(&scan), true).command, Some(Twist2::ZERO));
        room.tick(Twist2::ZERO);
    }
}

/// One contact while driving forward, then a back-off without further contact.
fn touch(room: &mut Room) {
    let scan = room.scan();
    room.tick_with(FORWARD, Some(&scan), true);
    for _ in 0..400 {
        if !room.plane.state().is_in_charge() {
            return;
        }
        room.tick(Twist2::ZERO);
    }
    panic!("still {:?}", room.plane.state());
}

#[test]
fn contacts_count_together_within_half_a_metre_and_thirty_seconds_only() {
    let given_up = SafetyState::Fault(FaultReason::RepeatedContact);
    for (pause_ns, away_m, gives_up) in
        [(0, 0.0, true), (0, 0.6, false), (29_000_000_000, 0.0, false)]
    {
        let mut room = Room::new(4.0, Pose2::IDENTITY);
        // The ground behind is known, so that every back-off ends without an escape.
        for _ in 0..210 {
            room.tick(ROTATION);
        }
        room.pose = Pose2::IDENTITY;
        room.tick(Twist2::ZERO);
        touch(&mut room);
        touch(&mut room);
        room.time_ns += pause_ns;
        room.pose = Pose2::new(room.pose.x_m + away_m, 0.0, 0.0);
        // After a pause the robot needs a tick in time.
        let stalled = pause_ns > 0;
        if stalled {
            let scan = room.scan();
            room.tick_with(Twist2::ZERO, Some(&scan), false);
            let clear = SafetyInput {
                request: Some(Request::ClearFault),
                ..room.input(Twist2::ZERO, None, false)
            };
            room.step(&clear);
        }
        room.tick(Twist2::ZERO);
        room.tick(FORWARD);
        let scan = room.scan();
        room.tick_with(FORWARD, Some(&scan), true);
        assert_eq!(room.plane.state() == given_up, gives_up, "{pause_ns} {away_m}");
    }
}
