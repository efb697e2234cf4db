//! A robot whose devices misbehave stops when it must, says why, and goes on when it can.
#![allow(clippy::unwrap_used, reason = "a test that cannot set up its scene has failed")]

use hal::{Pose2, Twist2};
use hil::{BaseFaults, CameraFaults, Faults, LidarFaults, Scenario, Turn};
use runtime::event::{Event, FaultReason, RefusedInput, SafetyEvent, TripCause};
use runtime::exploration::PolicyKind;
use runtime::perception::NoDepth;

fn run(policy: PolicyKind, faults: Faults, turns: usize) -> Vec<Turn> {
    Scenario::new(policy, faults, 3).unwrap().turns(turns).unwrap()
}

fn at(turns: &[Turn], seconds: std::ops::Range<f64>) -> &[Turn] {
    &turns[(seconds.start * 10.0) as usize..(seconds.end * 10.0) as usize]
}

fn way_m(turns: &[Turn]) -> f64 {
    turns.windows(2).map(|pair| pair[0].pose.distance_m(&pair[1].pose)).sum()
}

fn turned_rad(turns: &[Turn]) -> f64 {
    turns.windows(2).map(|pair| hal::wrap_angle(pair[1].pose.yaw_rad - pair[0].pose.yaw_rad).abs()).sum()
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
    let faults =
        Faults { lidar: LidarFaults { silence: Some(4.0..6.0), ..LidarFaults::default() }, ..Faults::default() };
    let turns = run(PolicyKind::Forward, faults, 100);
    assert!(way_m(at(&turns, 1.0..4.0)) > 0.3, "it drives before");
    assert!(at(&turns, 4.3..6.0).iter().all(|turn| turn.command() == Twist2::ZERO));
    assert!(faulted(at(&turns, 4.0..4.5), FaultReason::LidarSilent));
    assert!(way_m(at(&turns, 6.0..10.0)) > 0.3, "it goes on");
}

#[test]
fn a_blind_or_broken_laser_is_not_free_space() {
    for lidar in [
        LidarFaults { blind: Some(2.0..4.0), ..LidarFaults::default() },
        LidarFaults { errors: Some(2.0..4.0), ..LidarFaults::default() },
    ] {
        let turns = run(PolicyKind::Forward, Faults { lidar, ..Faults::default() }, 60);
        assert!(at(&turns, 2.0..4.0).iter().all(|turn| turn.command() == Twist2::ZERO));
        assert!(faulted(at(&turns, 2.0..2.2), FaultReason::LidarBad));
    }
}

#[test]
fn single_ghost_returns_do_not_stop_the_robot() {
    let ghosts = LidarFaults { ghost_share: 0.002, ..LidarFaults::default() };
    let turns = run(PolicyKind::Forward, Faults { lidar: ghosts, ..Faults::default() }, 30);
    assert!(way_m(&turns) > 0.7, "{} m", way_m(&turns));
}

#[test]
fn without_a_camera_the_bumper_still_works_and_every_turn_says_that_there_is_no_picture() {
    let camera = CameraFaults { unplugged: Some(0.0..1e9), ..CameraFaults::default() };
    let turns = run(PolicyKind::Forward, Faults { camera, ..Faults::default() }, 300);
    assert!(turns.iter().all(|turn| turn.decision.events.contains(&Event::NoDepth { why: NoDepth::NoFrame })));
    assert!(turns.iter().all(|turn| !turn.contact), "it never touched anything");
    assert!(way_m(&turns) > 2.0);
}

#[test]
fn black_and_saturated_pictures_give_no_depth_and_the_loop_goes_on() {
    let camera = CameraFaults { black: Some(3.0..5.0), saturated: Some(6.0..8.0), ..CameraFaults::default() };
    let turns = run(PolicyKind::Frontier, Faults { camera, ..Faults::default() }, 100);
    for dark in [3.0..5.0, 6.0..8.0] {
        let stretch = at(&turns, dark);
        assert!(stretch.iter().all(|turn| turn.decision.events.contains(&Event::NoDepth { why: NoDepth::NoTexture })));
        assert!(stretch.iter().all(|turn| turn.decision.depth_digest == 0));
    }
    assert!(way_m(&turns) + turned_rad(&turns) > 1.0);
}

#[test]
fn a_picture_of_another_size_is_refused_not_misread() {
    let camera = CameraFaults { wrong_size: Some(2.0..3.0), ..CameraFaults::default() };
    let turns = run(PolicyKind::Frontier, Faults { camera, ..Faults::default() }, 60);
    let stretch = at(&turns, 2.0..3.0);
    assert!(stretch.iter().all(|turn| turn.decision.events.contains(&Event::NoDepth { why: NoDepth::FrameSize })));
}

#[test]
fn nan_odometry_is_refused_and_the_robot_stands_until_it_is_gone() {
    let base = BaseFaults { nan_odometry: Some(2.0..3.0), ..BaseFaults::default() };
    let turns = run(PolicyKind::Forward, Faults { base, ..Faults::default() }, 60);
    let refused = Event::InputRefused { why: RefusedInput::OdometryNotFinite };
    for turn in at(&turns, 2.0..3.0) {
        assert_eq!((turn.command(), &turn.decision.events), (Twist2::ZERO, &vec![refused.clone()]));
    }
    assert!(way_m(at(&turns, 3.0..6.0)) > 0.3);
}

#[test]
fn a_jump_of_the_odometry_is_named_and_forgets_old_pictures() {
    let base = BaseFaults { jump: Some((4.0, 3.0)), ..BaseFaults::default() };
    let turns = run(PolicyKind::Forward, Faults { base, ..Faults::default() }, 60);
    assert!(events(at(&turns, 4.0..4.2)).any(|event| *event == Event::NoDepth { why: NoDepth::PoseJump }));
}

#[test]
fn a_bumper_switch_that_is_stuck_does_not_nail_the_robot_down() {
    let base = BaseFaults { stuck_switch: Some(2.0..12.0), ..BaseFaults::default() };
    let turns = run(PolicyKind::Forward, Faults { base, ..Faults::default() }, 300);
    assert!(tripped(&turns, TripCause::Contact));
    let (stuck, after) = (at(&turns, 2.0..12.0), at(&turns, 13.0..30.0));
    assert!(turned_rad(stuck) > 0.5, "it turns to find a way out");
    assert!(way_m(after) > 1.0, "it leaves when the switch lets go");
}

#[test]
fn every_policy_moves_touches_nothing_by_itself_and_does_the_same_again() {
    for policy in PolicyKind::ALL {
        let first = run(policy, Faults::default(), 80);
        let second = run(policy, Faults::default(), 80);
        assert!(way_m(&first) + turned_rad(&first) > 0.5, "{policy:?}");
        let decisions = |turns: &[Turn]| turns.iter().map(|turn| turn.decision.clone()).collect::<Vec<_>>();
        assert_eq!(decisions(&first), decisions(&second), "{policy:?}");
        let last: Pose2 = first[79].pose;
        assert!(last.is_finite());
    }
}
