//! Tests of what the scanner does not see: errors and missing returns on the path, a wall within
//! its noise, and a scan that repeats.

use super::tests::{FORWARD, Room, driving};
use super::*;

/// Runs a tick in which all beams within `half_deg` of straight ahead are `instead`.
fn tick_with_front(room: &mut Room, half_deg: f64, instead: Range) -> SafetyOutput {
    let mut scan = room.scan();
    for (beam, range) in scan.ranges.iter_mut().enumerate() {
        if scan.geometry.angle_rad(beam).to_degrees().abs() < half_deg {
            *range = instead;
        }
    }
    room.tick_with(FORWARD, Some(&scan), false)
}

#[test]
fn a_front_that_is_not_seen_slows_the_robot_at_once_and_stops_it_within_ten_centimetres() {
    for (half_deg, instead) in [(67.0, Range::Error), (3.0, Range::Error), (90.0, Range::NoReturn)]
    {
        let mut room = driving();
        let from = room.pose;
        let outputs: Vec<_> =
            (0..50).map(|_| tick_with_front(&mut room, half_deg, instead)).collect();
        assert_eq!(outputs[0].event, Some(SafetyEvent::Slowed { limit_mps: BLIND_MPS }));
        let lost = outputs.iter().filter(|output| output.event == Some(SafetyEvent::ViewLost));
        assert_eq!(lost.count(), 1, "{half_deg} {instead:?}");
        // The place is reported after 0.3 s and then once a second while the plan leads ahead, and it lies ahead.
        let unseen: Vec<_> = outputs.iter().filter_map(|output| output.unseen_m).collect();
        assert_eq!(unseen.len(), 5, "{half_deg} {instead:?}");
        assert!(unseen[0][0] > room.pose.x_m + 0.1, "{unseen:?} at {:?}", room.pose);
        let gone_m = room.pose.distance_m(&from);
        assert!(gone_m < 0.1, "{half_deg} {instead:?}: {gone_m} m");
        assert_eq!(room.tick(FORWARD).event, Some(SafetyEvent::Cleared));
        assert_eq!(room.tick(FORWARD).twist(), FORWARD);
    }
}

#[test]
fn a_plan_that_leads_ahead_again_after_a_rotation_is_answered_again_with_the_place() {
    let mut room = driving();
    let mut reports = Vec::new();
    let mut events = 0;
    // Like the policy `forward`: it rotates for half a second after each report and then goes ahead. The scanner sees nothing
    // in any direction.
    for _ in 0..3 {
        for _ in 0..400 {
            let output = tick_with_front(&mut room, 90.0, Range::NoReturn);
            events += usize::from(output.event == Some(SafetyEvent::ViewLost));
            if let Some(place) = output.unseen_m {
                reports.push(place);
                break;
            }
        }
        let rotation = Twist2 { linear_mps: 0.0, angular_radps: 0.35 };
        (0..20).for_each(|_| _ = room.tick(rotation));
    }
    assert_eq!((reports.len(), events), (3, 1));
    assert!(reports[0] != reports[1] && reports[1] != reports[2], "{reports:?}");
}

#[test]
fn a_robot_that_stands_because_it_does_not_see_may_rotate() {
    let mut room = driving();
    (0..10).for_each(|_| _ = tick_with_front(&mut room, 60.0, Range::Error));
    let mut scan = room.scan();
    scan.ranges[300..780].fill(Range::Error);
    let arc = Twist2 { linear_mps: 0.2, angular_radps: 0.4 };
    let output = room.tick_with(arc, Some(&scan), false);
    assert_eq!(output.twist(), Twist2 { linear_mps: 0.0, angular_radps: 0.4 });
}

#[test]
fn a_wall_within_the_scanners_noise_is_passed_slowly_and_one_beyond_it_at_full_speed() {
    for (gap_m, speed) in [(0.001, BESIDE_MPS), (0.025, BESIDE_MPS), (0.035, 0.3)] {
        let mut room = Room::new(5.0, Pose2::new(0.0, 5.0 - 0.16 - gap_m, 0.0));
        room.tick(Twist2::ZERO);
        for _ in 0..5 {
            let twist = room.tick(FORWARD).twist();
            assert!((twist.linear_mps - speed).abs() < 1e-9, "{gap_m}: {twist:?}");
        }
    }
}

#[test]
fn what_stands_beside_the_path_limits_the_speed_as_far_ahead_as_the_robot_needs_to_stop() {
    let config = SafetyConfig { brake_mps2: 0.5, reaction_s: 0.2, ..SafetyConfig::default() };
    let mut room = Room::with(config.clone(), 5.0, Pose2::IDENTITY);
    let reach_m = config.stop_distance_m + config.stopping_distance_m(FORWARD.linear_mps);
    // A post beside the outline. The outline that is widened by the margin meets it after nine tenths of the reach.
    let y_m = config.footprint_radius_m + 0.5 * config.lateral_margin_m;
    let wide_m = config.footprint_radius_m + config.lateral_margin_m;
    let x_m = 0.9 * reach_m + (wide_m * wide_m - y_m * y_m).sqrt();
    let mut scan = room.scan();
    for (beam, range) in scan.ranges.iter_mut().enumerate() {
        if (scan.geometry.angle_rad(beam) - y_m.atan2(x_m)).abs() < 0.02 {
            *range = Range::Hit(x_m.hypot(y_m) as f32);
        }
    }
    room.tick_with(FORWARD, Some(&scan), false);
    let wheel = room.plane.wheel.unwrap();
    assert!(room.plane.limit_beside_mps(&wheel, &FORWARD).is_finite());
}

#[test]
fn a_scanner_that_repeats_one_scan_while_the_robot_moves_is_frozen() {
    let mut room = driving();
    let frozen = room.scan();
    let from = room.pose;
    let mut faults = Vec::new();
    for _ in 0..20 {
        let scan = LaserScan { time_ns: room.time_ns, ..frozen.clone() };
        faults.extend(room.tick_with(FORWARD, Some(&scan), false).event);
    }
    assert_eq!(faults, [SafetyEvent::Faulted { why: FaultReason::LidarFrozen }]);
    let gone_m = room.pose.distance_m(&from);
    assert!(gone_m < 0.12, "{gone_m} m");
    assert!(super::tests::restarts_slowly(&mut room), "{:?}", room.plane.state());
}

#[test]
fn a_scanner_that_repeats_one_scan_while_the_robot_rotates_is_frozen() {
    let mut room = driving();
    let frozen = room.scan();
    let rotation = Twist2 { linear_mps: 0.0, angular_radps: 0.4 };
    let mut fault = None;
    for _ in 0..20 {
        let scan = LaserScan { time_ns: room.time_ns, ..frozen.clone() };
        fault = fault.or(room.tick_with(rotation, Some(&scan), false).event);
    }
    assert_eq!(fault, Some(SafetyEvent::Faulted { why: FaultReason::LidarFrozen }));
    assert!(room.pose.yaw_rad < 0.2, "{} rad", room.pose.yaw_rad);
}

#[test]
fn a_scanner_that_repeats_one_scan_while_the_robot_stands_is_not_frozen() {
    let mut room = driving();
    let same = room.scan();
    for _ in 0..100 {
        let scan = LaserScan { time_ns: room.time_ns, ..same.clone() };
        assert_eq!(room.tick_with(Twist2::ZERO, Some(&scan), false).event, None);
    }
}

#[test]
fn scans_that_differ_in_one_beam_have_different_digests() {
    let scan = driving().scan();
    let mut digests: Vec<u64> = (0..32).map(|bit| digest_with(&scan, with_one_bit(bit))).collect();
    // Bit 30 makes 2 m to 0 m.
    digests.extend(
        [Range::NoReturn, Range::TooNear, Range::Error].map(|range| digest_with(&scan, range)),
    );
    let count = digests.len();
    digests.sort_unstable();
    digests.dedup();
    assert_eq!(digests.len(), count);
}

fn digest_with(scan: &LaserScan, range: Range) -> u64 {
    let mut other = scan.clone();
    other.ranges[0] = range;
    digest_of(&other)
}

/// 2 m with another value of one bit.
fn with_one_bit(bit: u32) -> Range {
    Range::Hit(f32::from_bits(2.0_f32.to_bits() ^ (1_u32 << bit)))
}

#[test]
fn wheels_that_turn_while_the_room_stands_still_stop_the_robot_until_a_person_has_looked() {
    let mut room = Room::new(3.0, Pose2::new(-1.0, 0.5, 0.3));
    room.tick(FORWARD);
    let start = room.pose;
    let mut odom_m = 0.0;
    let mut event = None;
    while event.is_none() && odom_m < 5.0 {
        room.pose = start;
        let mut scan = room.scan();
        // Noise makes every scan of a working scanner different.
        scan.ranges[0] = Range::Hit(1.0 + odom_m as f32);
        let mut input = room.input(FORWARD, Some(&scan), false);
        let odom = start.compose(&Pose2::new(odom_m, 0.0, 0.0));
        input.wheel = input.wheel.map(|wheel| WheelFeedback { odom, ..wheel });
        event = room.step(&input).event;
        odom_m += 0.03;
    }
    assert_eq!(event, Some(SafetyEvent::Faulted { why: FaultReason::WheelsDisagree }));
    assert!(odom_m < 0.6, "{odom_m} m by the wheels");
}
