//! Tests of distances and speeds: how close and how fast the safety plane lets plans drive, and how
//! far it backs off and rotates without a plan.

use super::tests::{FORWARD, Room, TICK_NS, cart, driving, rotated_once, tripped};
use super::*;
use crate::safety::surroundings::tests::wall_ahead;
use hal::Range;

const BACK: Twist2 = Twist2 { linear_mps: -0.3, angular_radps: 0.1 };

#[test]
fn an_escape_with_stuck_wheels_is_reported_once_and_ends_after_the_time_of_two_rotations() {
    let mut room = Room::new(2.0, Pose2::new(1.75, 0.0, 0.0));
    room.until(FORWARD, |output| output.event == Some(SafetyEvent::Escaping));
    let stuck = Pose2::new(1.7, 0.0, 0.0);
    let begun_ns = room.time_ns - TICK_NS;
    let mut reported = Vec::new();
    while matches!(room.plane.state(), SafetyState::Escaping(_)) {
        room.pose = stuck;
        reported.extend(room.tick(FORWARD).event);
    }
    assert_eq!(reported, [SafetyEvent::Cleared]);
    let took_s = (room.time_ns - TICK_NS - begun_ns) as f64 * 1e-9;
    assert!((36.0..36.2).contains(&took_s), "one rotation takes 18 s: {took_s}");
}

#[test]
fn a_reverse_command_passes_over_known_ground_only_and_otherwise_keeps_its_rotation() {
    let mut room = Room::new(5.0, Pose2::IDENTITY);
    room.tick(Twist2::ZERO);
    let rotation = Twist2 { linear_mps: 0.0, ..BACK };
    assert_eq!(room.tick(BACK).twist(), rotation, "the ground behind is unknown");
    (0..5).for_each(|_| _ = room.tick(FORWARD));
    let straight_back = Twist2 { angular_radps: 0.0, ..BACK };
    let gone_m = (0..20).map(|_| -room.tick(straight_back).twist().linear_mps * 0.1).sum::<f64>();
    assert!((0.1..=0.21).contains(&gone_m), "the 0.18 m that it drove are known: {gone_m}");
    let mut room = rotated_once(0.5);
    assert_eq!(room.tick(BACK).twist(), BACK);
    let fast = Twist2 { linear_mps: -20.0, angular_radps: 0.0 };
    assert_eq!(room.tick(fast).twist(), Twist2::ZERO, "two metres until the next call");
}

#[test]
fn a_cart_that_may_not_reverse_does_not_rotate_its_corner_into_a_wall_either() {
    let mut room = Room::with(cart(), 2.0, Pose2::new(0.0, 1.84, 0.0));
    room.tick(Twist2::ZERO);
    assert_eq!(room.tick(Twist2 { linear_mps: -0.3, angular_radps: 0.3 }).twist(), Twist2::ZERO);
}

#[test]
fn a_cart_on_a_very_narrow_arc_is_stopped_like_one_that_rotates_on_the_spot() {
    for linear_mps in [1e-9, 1e-4, 1e-3, 1e-2] {
        let mut room = Room::with(cart(), 2.0, Pose2::new(0.0, 1.84, 0.0));
        room.tick(Twist2::ZERO);
        let output = room.tick(Twist2 { linear_mps, angular_radps: 0.3 });
        assert_eq!(output.twist(), Twist2::ZERO, "{linear_mps}");
    }
}

#[test]
fn a_fast_plan_is_slowed_so_that_the_robot_can_stop_within_the_horizon() {
    let config = SafetyConfig { brake_mps2: 1.0, reaction_s: 0.05, ..SafetyConfig::default() };
    let mut room = Room::with(config, 50.0, Pose2::IDENTITY);
    room.tick(Twist2::ZERO);
    let output = room.tick(Twist2 { linear_mps: 3.0, angular_radps: 0.3 });
    let twist = output.twist();
    let needed_m = twist.linear_mps * 0.05 + twist.linear_mps * twist.linear_mps / 2.0;
    assert!((needed_m - (1.5 - 0.16 - 0.1)).abs() < 1e-6, "{needed_m} m to stop in");
    assert!(matches!(output.event, Some(SafetyEvent::Slowed { .. })), "{output:?}");
    assert!((twist.angular_radps / twist.linear_mps - 0.1).abs() < 1e-9, "on the same arc");
}

#[test]
fn a_stop_distance_beyond_the_usual_horizon_is_kept() {
    let config = SafetyConfig { stop_distance_m: 2.0, ..SafetyConfig::default() };
    let mut room = Room::with(config, 5.0, Pose2::IDENTITY);
    room.until(FORWARD, tripped);
    let gap_m = room.half_m - room.pose.x_m - 0.16;
    assert!((1.96..=2.0).contains(&gap_m), "{gap_m}");
}

#[test]
fn a_contact_is_assumed_three_centimetres_ahead_of_the_outline() {
    let mut room = Room::new(5.0, Pose2::new(1.0, 2.0, std::f64::consts::FRAC_PI_2));
    let scan = room.scan();
    let Some(SafetyEvent::Tripped { x_m, y_m, .. }) =
        room.tick_with(FORWARD, Some(&scan), true).event
    else {
        panic!("{:?}", room.plane.state())
    };
    assert!((x_m - 0.19).abs() < 1e-12 && y_m == 0.0);
    let SafetyState::Tripped { blocked_m, .. } = room.plane.state() else {
        panic!("{:?}", room.plane.state())
    };
    assert!(
        (blocked_m[0] - 1.0).abs() < 1e-9 && (blocked_m[1] - 2.19).abs() < 1e-9,
        "{blocked_m:?}"
    );
}

#[test]
fn slowing_and_clearing_are_each_reported_once() {
    let config = SafetyConfig { brake_mps2: 0.2, ..SafetyConfig::default() };
    let mut room = Room::with(config, 50.0, Pose2::IDENTITY);
    room.tick(FORWARD);
    let mut reported = Vec::new();
    for wall_m in [0.4, 0.4, 5.0, 5.0] {
        let scan = LaserScan { time_ns: room.time_ns, ..wall_ahead(wall_m) };
        reported.push(room.tick_with(FORWARD, Some(&scan), false).event);
        let slow = room.plane.state() == SafetyState::Slow;
        assert_eq!(slow, wall_m < 1.0);
    }
    let limit_mps = (2.0 * 0.2 * (0.4_f64 - 0.16 - 0.1)).sqrt();
    assert!(
        matches!(reported[0], Some(SafetyEvent::Slowed { limit_mps: got }) if (got - limit_mps).abs() < 0.01)
    );
    assert_eq!(reported[1..], [None, Some(SafetyEvent::Cleared), None]);
}

#[test]
fn the_back_off_begins_after_half_a_second_even_if_the_wheels_never_stand_still() {
    for rolling in [(0.021, 0.0), (-0.021, 0.0), (0.0, 0.051), (0.0, -0.051)] {
        let mut room = blind();
        room.until(FORWARD, tripped);
        let mut waited = 0;
        loop {
            room.driving = Twist2 { linear_mps: rolling.0, angular_radps: rolling.1 };
            if room.tick(FORWARD).twist().linear_mps < 0.0 {
                break;
            }
            waited += 1;
        }
        assert_eq!(waited, 4, "{rolling:?}");
    }
    for standing in [(0.019, 0.0), (0.0, -0.049)] {
        let mut room = blind();
        room.until(FORWARD, tripped);
        room.driving = Twist2 { linear_mps: standing.0, angular_radps: standing.1 };
        assert!(room.tick(FORWARD).twist().linear_mps < 0.0, "{standing:?}");
    }
}

fn blind() -> Room {
    let config = SafetyConfig { blind_back_off_m: 0.05, ..SafetyConfig::default() };
    Room::with(config, 2.0, Pose2::new(1.75, 0.0, 0.0))
}

/// Trips the safety plane at `at`. A fault that clears itself then ends the back-off, so that only
/// the count of trips remains.
fn trips_at(room: &mut Room, at: Pose2, wall_m: f64) {
    room.pose = at;
    let scan = LaserScan { time_ns: room.time_ns, ..wall_ahead(wall_m) };
    assert!(tripped(&room.tick_with(FORWARD, Some(&scan), false)), "{:?}", room.plane.state());
    for error in [Some(FaultReason::OdometryNotFinite), None] {
        let scan = LaserScan { time_ns: room.time_ns, ..wall_ahead(3.0) };
        room.step(&SafetyInput {
            base_error: error,
            ..room.input(Twist2::ZERO, Some(&scan), false)
        });
    }
}

#[test]
fn trips_close_in_place_and_time_are_counted_together_and_others_are_not() {
    let near = Pose2::new(0.3, 0.3, 0.0);
    let mut room = driving();
    for count in [1, 2, 3, 3] {
        trips_at(&mut room, if count == 2 { near } else { Pose2::IDENTITY }, 0.2);
        assert_eq!(
            (room.plane.trips.len(), room.plane.trips.capacity()),
            (count, TRIPS_BEFORE_ESCAPE + 1)
        );
    }
    assert_eq!(room.plane.trip_count(), 4);
    for far in [Pose2::new(0.51, 0.0, 0.0), Pose2::new(0.0, -0.51, 0.0)] {
        let mut room = driving();
        trips_at(&mut room, Pose2::IDENTITY, 0.2);
        trips_at(&mut room, far, 0.2);
        assert_eq!(room.plane.trips.len(), 1, "{far:?}");
    }
    for (pause_ns, count) in [(29_999_000_000, 2), (30_000_000_000, 1)] {
        let mut room = driving();
        trips_at(&mut room, Pose2::IDENTITY, 0.2);
        // Three ticks have passed since the trip; two more come before the next one.
        let end_ns = room.time_ns + pause_ns - 5 * TICK_NS;
        while room.time_ns + TICK_NS <= end_ns {
            room.tick(Twist2::ZERO);
        }
        room.time_ns = end_ns;
        (0..2).for_each(|_| _ = room.tick(Twist2::ZERO));
        trips_at(&mut room, Pose2::IDENTITY, 0.2);
        assert_eq!(room.plane.trips.len(), count, "{pause_ns}");
    }
}

/// A post at 135 degrees, in the strip behind the robot, this far from the laser: the gap behind
/// the outline is 5.7 cm at 0.195 m, 6.7 at 0.2, 9.7 at 0.213 and 11.1 at 0.218.
fn post_behind(room: &Room, range_m: f32) -> LaserScan {
    let mut scan = room.scan();
    scan.ranges[1077..].fill(Range::Hit(range_m));
    scan
}

#[test]
fn a_reverse_command_keeps_three_centimetres_and_the_distance_of_one_tick_from_an_obstacle() {
    for (range_m, goes) in [(0.195, false), (0.2, true)] {
        let mut room = rotated_once(0.5);
        let scan = post_behind(&room, range_m);
        let command = Twist2 { linear_mps: -0.3, angular_radps: 0.0 };
        let output = room.tick_with(command, Some(&scan), false);
        assert_eq!(output.twist() == command, goes, "{range_m}: {output:?}");
    }
}

#[test]
fn backing_off_keeps_three_centimetres_and_the_stopping_distance_from_an_obstacle() {
    let config = SafetyConfig { brake_mps2: 0.8, reaction_s: 0.05, ..SafetyConfig::default() };
    // 0.3 m/s: 1.5 cm until the brakes answer, 5.6 cm of braking.
    for (range_m, speed, ends) in
        [(0.213, -0.3, true), (0.218, -0.3, false), (0.195, 0.3, false), (0.195, 0.0, false)]
    {
        let mut room = Room::with(config.clone(), 2.0, Pose2::IDENTITY);
        room.until(FORWARD, tripped);
        room.until(FORWARD, |output| output.twist().linear_mps < 0.0);
        let scan = post_behind(&room, range_m);
        room.driving = Twist2 { linear_mps: speed, angular_radps: 0.0 };
        let output = room.tick_with(FORWARD, Some(&scan), false);
        let blocked = matches!(
            output.event,
            Some(SafetyEvent::BackedOff { end: BackOffEnd::RearBlocked, .. })
        );
        assert_eq!(blocked, ends, "{range_m} {speed}: {output:?}");
    }
}

#[test]
fn the_last_steps_back_cover_the_remaining_distance_and_respect_the_brakes() {
    for (brake_mps2, left_m, speed) in
        [(100.0, 0.02, 0.2), (0.5, 0.02, 0.02_f64.sqrt()), (100.0, 0.05, 0.3)]
    {
        let mut room = Room::with(
            SafetyConfig { brake_mps2, ..SafetyConfig::default() },
            2.0,
            Pose2::IDENTITY,
        );
        room.until(FORWARD, tripped);
        let from = room.pose;
        room.until(FORWARD, |output| output.twist().linear_mps < 0.0);
        room.pose = Pose2::new(from.x_m - 0.2 + left_m, 0.0, 0.0);
        let output = room.tick(FORWARD);
        assert!(
            (output.twist().linear_mps + speed).abs() < 1e-9,
            "{left_m} with {brake_mps2}: {output:?}"
        );
        assert_eq!(output.twist().angular_radps, 0.0);
    }
}

#[test]
fn an_escape_rotates_once_towards_the_side_with_more_space_at_the_configured_speed() {
    for (y_m, side) in [(-0.05, 1.0), (0.05, -1.0)] {
        let mut room = Room::new(0.3, Pose2::new(0.0, y_m, 0.0));
        room.until(FORWARD, |output| output.event == Some(SafetyEvent::Escaping));
        let begun_ns = room.time_ns - TICK_NS;
        let output = room.tick(FORWARD);
        assert_eq!(
            output.twist(),
            Twist2 { linear_mps: 0.0, angular_radps: side * 20_f64.to_radians() }
        );
        room.until(FORWARD, |output| output.event == Some(SafetyEvent::Cleared));
        let took_s = (room.time_ns - TICK_NS - begun_ns) as f64 * 1e-9;
        assert!((17.9..18.2).contains(&took_s), "{took_s}");
        assert!(room.plane.trips.is_empty());
    }
}

#[test]
fn an_escape_ends_where_a_corner_would_meet_the_wall() {
    let mut room = Room::with(cart(), 2.0, Pose2::new(1.65, 1.84, 0.0));
    room.until(FORWARD, |output| matches!(output.event, Some(SafetyEvent::BackedOff { .. })));
    assert!(matches!(room.plane.state(), SafetyState::Escaping(Escape { direction: -1.0, .. })));
    // An obstacle appears on the other side.
    room.pose.y_m = -1.84;
    let shut = room.scan();
    room.pose.y_m = 1.84;
    let output = room.tick_with(FORWARD, Some(&shut), false);
    assert_eq!(output, SafetyOutput::STOP.because(SafetyEvent::Cleared));
}

#[test]
fn a_rotation_on_the_spot_is_checked_for_the_reaction_time_and_0_3_s_more() {
    // 0.15 rad at 0.5 rad/s; 0.25 rad with a reaction time of 0.2 s. The front corner is 0.335 m
    // from the axle.
    for (reaction_s, y_m, turns) in [(0.0, 1.79, true), (0.2, 1.79, false), (0.0, 1.82, false)] {
        let mut room =
            Room::with(SafetyConfig { reaction_s, ..cart() }, 2.0, Pose2::new(0.0, y_m, 0.0));
        room.tick(Twist2::ZERO);
        let left = Twist2 { linear_mps: 0.0, angular_radps: 0.5 };
        assert_eq!(room.tick(left).twist() == left, turns, "{reaction_s} {y_m}");
    }
}
