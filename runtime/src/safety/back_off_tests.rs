//! Tests of the ground behind: the safety plane reverses the robot only where it knows that the ground is free.

use super::tests::{FORWARD, Room, TICK_NS, cart, tripped};
use super::*;

const SECOND_NS: u64 = 1_000_000_000;

/// Drives up to a wall and trips, after which the robot has stood `stands_s` on the way, `before_m`
/// before it tripped.
fn tripped_after_standing(stands_s: u64, before_m: f64) -> Room {
    let mut room = Room::new(2.0, Pose2::new(1.0, 0.0, 0.0));
    while room.half_m - 0.16 - 0.1 - room.pose.x_m > before_m {
        room.tick(FORWARD);
    }
    (0..stands_s * SECOND_NS / TICK_NS).for_each(|_| _ = room.tick(Twist2::ZERO));
    room.until(FORWARD, tripped);
    room
}

/// The event that ends the back-off, and how far the robot went.
fn backed_off(room: &mut Room) -> (f64, BackOffEnd) {
    let from = room.pose;
    let output = room.until(FORWARD, |output| output.blocked_m.is_some());
    let Some(SafetyEvent::BackedOff { distance_m, end }) = output.event else {
        panic!("{output:?}")
    };
    assert!((room.pose.distance_m(&from) - distance_m).abs() < 1e-9);
    (distance_m, end)
}

#[test]
fn a_robot_that_does_not_know_the_ground_behind_it_stands_says_so_and_rotates() {
    for config in [SafetyConfig::default(), cart()] {
        let front_m = Footprint::new(config.footprint_radius_m, &config.footprint_m).front_edge_m();
        let mut room = Room::with(config, 2.0, Pose2::new(1.91 - front_m, 0.0, 0.0));
        room.until(FORWARD, tripped);
        assert_eq!(backed_off(&mut room), (0.0, BackOffEnd::RearUnknown));
        let output = room.tick(FORWARD);
        assert!(output.twist().linear_mps == 0.0, "{output:?}");
    }
}

#[test]
fn a_robot_goes_on_when_its_rotation_has_shown_it_a_way() {
    let mut room = Room::new(2.0, Pose2::new(1.75, 0.0, 0.0));
    room.until(FORWARD, tripped);
    room.until(FORWARD, |output| output.event == Some(SafetyEvent::Escaping));
    room.until(FORWARD, |output| output.event == Some(SafetyEvent::Cleared));
    assert_eq!(room.tick(FORWARD).twist(), FORWARD);
}

#[test]
fn ground_that_the_robot_left_within_five_seconds_is_known_however_long_it_stood_there() {
    for stands_s in [0, 4, 60] {
        let mut room = tripped_after_standing(stands_s, 0.25);
        let (distance_m, end) = backed_off(&mut room);
        assert_eq!(end, BackOffEnd::Distance, "{stands_s} s");
        assert!((distance_m - 0.2).abs() < 2e-3, "{distance_m} m after {stands_s} s");
    }
}

#[test]
fn ground_that_the_robot_left_more_than_five_seconds_ago_is_unknown_again() {
    // It stood 0.1 m before the place of the trip: a person may have come close behind it.
    let (distance_m, end) = backed_off(&mut tripped_after_standing(6, 0.1));
    assert_eq!(end, BackOffEnd::RearUnknown);
    assert!((0.05..0.13).contains(&distance_m), "{distance_m}");
}

#[test]
fn knowledge_that_becomes_too_old_while_the_robot_reverses_stops_it() {
    let config = SafetyConfig { back_off_timeout_s: 60.0, ..SafetyConfig::default() };
    let memory_s = config.rear_memory_s;
    let mut room = Room::with(config, 2.0, Pose2::new(1.0, 0.0, 0.0));
    room.until(FORWARD, tripped);
    // The scans keep coming, and the wheels take their time.
    while matches!(room.plane.state(), SafetyState::Tripped { .. } | SafetyState::BackingOff(_)) {
        let stood_at = room.pose;
        let output = room.tick(FORWARD);
        let slow = Twist2 { linear_mps: output.twist().linear_mps / 20.0, ..Twist2::ZERO };
        room.pose = stood_at.compose(&slow.integrate(0.1));
        if let Some(SafetyEvent::BackedOff { distance_m, end }) = output.event {
            assert_eq!(end, BackOffEnd::RearUnknown);
            assert!(distance_m < 0.015 * memory_s + 0.02, "{distance_m} m at 1.5 cm/s");
            return;
        }
    }
    panic!("{:?}", room.plane.state());
}

#[test]
fn a_scanner_that_sees_all_around_backs_off_over_what_it_sees() {
    let config = SafetyConfig::default();
    let mut rear = RearMemory::new(config.rear_memory_s);
    let surroundings = Surroundings::new(&config);
    let mut scan = super::super::surroundings::tests::scan_of(|_| Range::Hit(2.0));
    for yaw_rad in [0.0, 3.0] {
        rear.record_scan(&scan, &Pose2::new(0.0, 0.0, yaw_rad), &surroundings);
    }
    assert_eq!(known_m(&rear, 5 * SECOND_NS), 0.2, "five seconds are not too long");
    assert_eq!(known_m(&rear, 5 * SECOND_NS + 1), 0.0);
    scan.time_ns = SECOND_NS;
    rear.record_scan(&scan, &Pose2::new(0.0, 0.0, 3.0), &surroundings);
    assert_eq!(known_m(&rear, 6 * SECOND_NS), 0.2, "seen again in the meantime");
}

fn known_m(rear: &RearMemory, now_ns: u64) -> f64 {
    let config = SafetyConfig::default();
    let footprint = Footprint::new(config.footprint_radius_m, &config.footprint_m);
    rear.known_free_m(now_ns, &Pose2::IDENTITY, &footprint, config.back_off_m)
}
