//! A robot whose devices misbehave stops when it must, says why, and goes on when it can.
#![allow(clippy::unwrap_used, reason = "a test that cannot set up its scene has failed")]

use hal::{Pose2, Twist2};
use hil::{Scenario, Turn};
use runtime::event::{Event, FaultReason, RefusedInput, SafetyEvent, TripCause};
use runtime::exploration::PolicyKind;
use runtime::perception::NoDepth;

fn run(policy: PolicyKind, faults: &[&str], turns: usize) -> Vec<Turn> {
    Scenario::new(policy, faults, 3).unwrap().turns(turns).unwrap()
}

fn at(turns: &[Turn], seconds: std::ops::Range<f64>) -> &[Turn] {
    &turns[(seconds.start * 10.0) as usize..(seconds.end * 10.0) as usize]
}

fn way_m(turns: &[Turn]) -> f64 {
    turns.windows(2).map(|pair| pair[0].pose.distance_m(&pair[1].pose)).sum()
}

fn turned_rad(turns: &[Turn]) -> f64 {
    turns
        .windows(2)
        .map(|pair| hal::wrap_angle(pair[1].pose.yaw_rad - pair[0].pose.yaw_rad).abs())
        .sum()
}

fn events(turns: &[Turn]) -> impl Iterator<Item = &Event> {
    turns.iter().flat_map(|turn| &turn.decision.events)
}

fn tripped(turns: &[Turn], cause: TripCause) -> bool {
    events(turns).any(|event| matches!(event, Event::Safety { what: SafetyEvent::Tripped { by, .. } } if *by == cause))
}

fn faulted(turns: &[Turn], why: FaultReason) -> bool {
    events(turns).any(|event| *event == Event::Safety { what: SafetyEvent::Faulted { why } })
}

#[test]
fn a_silent_laser_stops_the_robot_within_its_timeout_and_a_new_scan_lets_it_go_on() {
    for silence in ["lidar:stall@4..6", "lidar:unplug@4..6", "lidar:drop@4..6"] {
        let turns = run(PolicyKind::Forward, &[silence], 100);
        assert!(way_m(at(&turns, 1.0..4.0)) > 0.3, "{silence}: it drives before");
        assert!(
            at(&turns, 4.3..6.0).iter().all(|turn| turn.command() == Twist2::ZERO),
            "{silence}"
        );
        assert!(faulted(at(&turns, 4.0..4.5), FaultReason::LidarSilent), "{silence}");
        assert!(way_m(at(&turns, 6.0..10.0)) > 0.3, "{silence}: it goes on");
    }
}

#[test]
fn a_blind_or_broken_laser_is_not_free_space() {
    for fault in ["lidar:blind@2..4", "lidar:error@2..4"] {
        let turns = run(PolicyKind::Forward, &[fault], 60);
        assert!(at(&turns, 2.0..4.0).iter().all(|turn| turn.command() == Twist2::ZERO));
        assert!(faulted(at(&turns, 2.0..2.2), FaultReason::LidarBad));
    }
}

#[test]
fn single_ghost_returns_do_not_stop_the_robot() {
    let turns = run(PolicyKind::Forward, &["lidar:ghost=0.002"], 30);
    assert!(way_m(&turns) > 0.7, "{} m", way_m(&turns));
}

#[test]
fn without_a_camera_the_bumper_still_works_and_every_turn_says_that_there_is_no_picture() {
    let turns = run(PolicyKind::Forward, &["camera:unplug"], 300);
    assert!(
        turns
            .iter()
            .all(|turn| turn.decision.events.contains(&Event::NoDepth { why: NoDepth::NoFrame }))
    );
    assert!(turns.iter().all(|turn| !turn.contact), "it never touched anything");
    assert!(way_m(&turns) > 2.0);
}

#[test]
fn black_and_saturated_pictures_give_no_depth_and_the_loop_goes_on() {
    let turns = run(PolicyKind::Frontier, &["camera:black@3..5", "camera:white@6..8"], 100);
    for dark in [3.0..5.0, 6.0..8.0] {
        let stretch = at(&turns, dark);
        assert!(stretch.iter().all(|turn| {
            turn.decision.events.contains(&Event::NoDepth { why: NoDepth::NoTexture })
        }));
        assert!(stretch.iter().all(|turn| turn.decision.depth_digest == 0));
    }
    assert!(way_m(&turns) + turned_rad(&turns) > 1.0);
}

#[test]
fn a_picture_of_another_size_is_refused_not_misread() {
    let turns = run(PolicyKind::Frontier, &["camera:resize@2..3"], 60);
    let stretch = at(&turns, 2.0..3.0);
    assert!(
        stretch
            .iter()
            .all(|turn| turn.decision.events.contains(&Event::NoDepth { why: NoDepth::FrameSize }))
    );
}

#[test]
fn nan_odometry_is_refused_and_the_robot_stands_until_it_is_gone() {
    let turns = run(PolicyKind::Forward, &["base:nan@2..3"], 60);
    let refused = Event::InputRefused { why: RefusedInput::OdometryNotFinite };
    for turn in at(&turns, 2.0..3.0) {
        assert_eq!((turn.command(), &turn.decision.events), (Twist2::ZERO, &vec![refused.clone()]));
    }
    assert!(way_m(at(&turns, 3.0..6.0)) > 0.3);
}

#[test]
fn a_jump_of_the_odometry_is_named_and_forgets_old_pictures() {
    let turns = run(PolicyKind::Forward, &["base:jump=3@4.."], 60);
    assert!(
        events(at(&turns, 4.0..4.2))
            .any(|event| *event == Event::NoDepth { why: NoDepth::PoseJump })
    );
}

#[test]
fn a_bumper_switch_that_is_stuck_does_not_nail_the_robot_down() {
    let turns = run(PolicyKind::Forward, &["base:contact@2..12"], 300);
    assert!(tripped(&turns, TripCause::Contact));
    let (stuck, after) = (at(&turns, 2.0..12.0), at(&turns, 13.0..30.0));
    assert!(turned_rad(stuck) > 0.5, "it turns to find a way out");
    assert!(way_m(after) > 1.0, "it leaves when the switch lets go");
}

#[test]
fn a_scanner_whose_scans_come_too_late_is_as_silent_as_one_that_says_nothing() {
    // With a scan that is four turns late, every scan is older than the robot may drive by.
    let turns = run(PolicyKind::Forward, &["lidar:delay=4@3..5"], 80);
    assert!(at(&turns, 3.5..5.0).iter().all(|turn| turn.command() == Twist2::ZERO));
    assert!(faulted(at(&turns, 3.0..3.5), FaultReason::LidarSilent));
    assert!(way_m(at(&turns, 5.0..8.0)) > 0.3, "it goes on");
}

#[test]
fn scans_that_come_twice_late_or_in_the_wrong_order_lead_into_nothing() {
    for fault in [
        "lidar:duplicate",
        "lidar:delay=1",
        "lidar:reorder",
        "lidar:drop=0.5",
        "lidar:corrupt=0.01",
    ] {
        let turns = run(PolicyKind::Forward, &[fault], 120);
        assert!(turns.iter().all(|turn| !turn.contact), "{fault}: it touched something");
        assert!(way_m(&turns) > 1.0, "{fault}: {} m", way_m(&turns));
    }
}

#[test]
fn pictures_that_are_late_torn_or_in_the_wrong_order_lead_into_nothing() {
    for fault in [
        "camera:delay=2",
        "camera:duplicate",
        "camera:reorder",
        "camera:corrupt=0.5",
        "camera:drop=0.5",
    ] {
        let turns = run(PolicyKind::Frontier, &[fault], 120);
        assert!(turns.iter().all(|turn| !turn.contact), "{fault}: it touched something");
        assert!(way_m(&turns) + turned_rad(&turns) > 1.0, "{fault}");
    }
}

#[test]
fn wheels_that_say_nothing_stop_the_robot_until_they_speak() {
    for silence in [
        "base:stall@2..4",
        "base:unplug@2..4",
        "base:corrupt@2..4",
        "base:drop@2..4",
        "base:delay=4@2..4",
    ] {
        let turns = run(PolicyKind::Forward, &[silence], 80);
        assert!(
            at(&turns, 2.4..4.0).iter().all(|turn| turn.command() == Twist2::ZERO),
            "{silence}"
        );
        assert!(way_m(at(&turns, 2.5..4.0)) < 1e-9, "{silence}: it stands");
        assert!(faulted(at(&turns, 2.0..2.5), FaultReason::BaseSilent), "{silence}");
        assert!(way_m(at(&turns, 4.2..8.0)) > 0.3, "{silence}: it goes on");
    }
}

#[test]
fn wheels_on_a_lossy_bus_lead_into_nothing() {
    for fault in
        ["base:drop=0.3", "base:duplicate", "base:reorder", "base:delay=1", "base:corrupt=0.3"]
    {
        let turns = run(PolicyKind::Forward, &[fault], 120);
        assert!(turns.iter().all(|turn| !turn.contact), "{fault}: it touched something");
        assert!(way_m(&turns) > 1.0, "{fault}: {} m", way_m(&turns));
    }
}

#[test]
fn a_loop_that_is_woken_late_stops_the_robot_and_time_never_goes_back() {
    let turns = run(PolicyKind::Forward, &["clock:slow=400@2..4"], 80);
    assert!(faulted(&turns, FaultReason::LoopOverrun));
    assert!(turns.windows(2).all(|pair| pair[0].decision.time_ns <= pair[1].decision.time_ns));
    assert!(way_m(at(&turns, 5.0..8.0)) > 0.3, "it goes on");
}

#[test]
fn a_minute_of_random_faults_ends_without_a_touch_and_can_be_had_again() {
    let run =
        |turns| Scenario::new(PolicyKind::Active, &["random"], 1).unwrap().turns(turns).unwrap();
    let (first, second) = (run(600), run(150));
    assert!(first.iter().all(|turn| !turn.contact));
    assert!(way_m(&first[300..]) + turned_rad(&first[300..]) > 1.0, "it still moves");
    assert!(first.iter().zip(&second).all(|(a, b)| a.decision == b.decision));
}

#[test]
fn every_policy_moves_touches_nothing_by_itself_and_does_the_same_again() {
    for policy in PolicyKind::ALL {
        let first = run(policy, &[], 80);
        let second = run(policy, &[], 80);
        assert!(way_m(&first) + turned_rad(&first) > 0.5, "{policy:?}");
        let decisions =
            |turns: &[Turn]| turns.iter().map(|turn| turn.decision.clone()).collect::<Vec<_>>();
        assert_eq!(decisions(&first), decisions(&second), "{policy:?}");
        let last: Pose2 = first[79].pose;
        assert!(last.is_finite());
    }
}
