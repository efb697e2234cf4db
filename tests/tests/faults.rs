//! A robot whose devices fail stops when it must, reports the reason, and continues when it can.
#![allow(clippy::unwrap_used, reason = "a test that cannot set up its scene has failed")]

use std::f64::consts::FRAC_PI_2;

use hal::{CameraModel, CameraMount, Pose2, Twist2};
use hil::{Scenario, Sensors, Tick};
use runtime::event::{Event, FaultReason, PlanRefusal, RefusedInput, SafetyEvent, TripCause};
use runtime::exploration::PolicyKind;
use runtime::perception::NoDepth;
use runtime::robot::DepthSource;
use runtime::safety::Request;
use simulator::laser::LaserModel;

fn run(policy: PolicyKind, faults: &[&str], ticks: usize) -> Vec<Tick> {
    Scenario::new(policy, faults, 3).unwrap().ticks(ticks).unwrap()
}

/// The ticks within a span of time.
fn at(ticks: &[Tick], seconds: std::ops::Range<f64>) -> &[Tick] {
    let [start, end] = [seconds.start, seconds.end]
        .map(|s| ticks.partition_point(|tick| tick.decision.time_ns < (s * 1e9) as u64));
    &ticks[start..end]
}

fn path_m(ticks: &[Tick]) -> f64 {
    ticks.windows(2).map(|pair| pair[0].pose.distance_m(&pair[1].pose)).sum()
}

fn turned_rad(ticks: &[Tick]) -> f64 {
    ticks
        .windows(2)
        .map(|pair| hal::wrap_angle(pair[1].pose.yaw_rad - pair[0].pose.yaw_rad).abs())
        .sum()
}

fn events(ticks: &[Tick]) -> impl Iterator<Item = &Event> {
    ticks.iter().flat_map(|tick| &tick.decision.events)
}

fn tripped(ticks: &[Tick], cause: TripCause) -> bool {
    events(ticks).any(|event| matches!(event, Event::Safety { what: SafetyEvent::Tripped { by, .. } } if *by == cause))
}

fn faulted(ticks: &[Tick], why: FaultReason) -> bool {
    events(ticks).any(|event| *event == Event::Safety { what: SafetyEvent::Faulted { why } })
}

#[test]
fn a_silent_laser_stops_the_robot_within_its_timeout_and_a_new_scan_lets_it_go_on() {
    for silence in ["lidar:stall@4..6", "lidar:unplug@4..6", "lidar:drop@4..6"] {
        let ticks = run(PolicyKind::Forward, &[silence], 100);
        assert!(path_m(at(&ticks, 1.0..4.0)) > 0.3, "{silence}: it drives before");
        assert!(
            at(&ticks, 4.3..6.0).iter().all(|tick| tick.command() == Twist2::ZERO),
            "{silence}"
        );
        assert!(faulted(at(&ticks, 4.0..4.5), FaultReason::LidarSilent), "{silence}");
        assert!(path_m(at(&ticks, 6.0..10.0)) > 0.3, "{silence}: it goes on");
    }
}

#[test]
fn a_blind_or_broken_laser_is_not_free_space() {
    for fault in ["lidar:blind@2..4", "lidar:error@2..4"] {
        let ticks = run(PolicyKind::Forward, &[fault], 60);
        assert!(at(&ticks, 2.2..4.0).iter().all(|tick| tick.command() == Twist2::ZERO), "{fault}");
        assert!(faulted(at(&ticks, 2.0..2.3), FaultReason::LidarBad), "{fault}");
    }
}

#[test]
fn dirt_before_the_scanner_stops_the_robot_within_15_centimetres_and_it_goes_on_without_it() {
    for fault in ["lidar:dirt=15@4..7", "lidar:dirt=45@4..7", "lidar:dirt=67@4..7"] {
        let ticks = run(PolicyKind::Forward, &[fault], 120);
        assert!(path_m(at(&ticks, 1.0..4.0)) > 0.3, "{fault}: it drives before");
        assert!(path_m(at(&ticks, 4.0..7.0)) < 0.15, "{fault}: it drives unseen floor");
        // It rotates to look elsewhere, and may have to back off from what it then has beside it.
        let blind = at(&ticks, 4.4..7.0);
        assert!(blind.iter().all(|tick| tick.command().linear_mps <= 0.0), "{fault}: forward");
        assert!(
            events(&ticks).any(|event| *event == Event::Safety { what: SafetyEvent::ViewLost }),
            "{fault}: it does not say why"
        );
        assert!(path_m(at(&ticks, 7.0..12.0)) > 0.3, "{fault}: it does not go on");
        assert!(ticks.iter().all(|tick| !tick.contact), "{fault}");
    }
}

#[test]
fn single_ghost_returns_do_not_stop_the_robot() {
    let ticks = run(PolicyKind::Forward, &["lidar:ghost=0.002"], 30);
    assert!(path_m(&ticks) > 0.7, "{} m", path_m(&ticks));
}

#[test]
fn without_a_camera_the_robot_says_so_in_every_tick_and_stands_after_a_second_until_it_is_back() {
    let ticks = run(PolicyKind::Forward, &["camera:unplug@3..6"], 100);
    assert!(path_m(at(&ticks, 1.0..3.0)) > 0.3, "it drives before");
    let no_frame = Event::NoDepth { why: NoDepth::NoFrame };
    let without = at(&ticks, 3.1..6.0);
    assert!(without.iter().all(|tick| tick.decision.events.contains(&no_frame)));
    assert_eq!(events(&ticks).filter(|event| **event == Event::StandsWithoutFrames).count(), 1);
    assert!(path_m(at(&ticks, 3.0..4.0)) > 0.1, "a few missing frames do not stop it");
    assert!(at(&ticks, 4.2..6.0).iter().all(|tick| tick.command() == Twist2::ZERO));
    assert!(path_m(at(&ticks, 6.0..10.0)) > 0.3, "it goes on");
    assert!(ticks.iter().all(|tick| !tick.contact), "it never touched anything");
}

#[test]
fn black_and_saturated_pictures_give_no_depth_and_the_loop_goes_on() {
    let ticks = run(PolicyKind::Frontier, &["camera:black@3..5", "camera:white@6..8"], 100);
    for dark in [3.0..5.0, 6.0..8.0] {
        let stretch = at(&ticks, dark);
        assert!(stretch.iter().all(|tick| {
            tick.decision.events.contains(&Event::NoDepth { why: NoDepth::NoTexture })
        }));
        assert!(stretch.iter().all(|tick| tick.decision.depth_digest == 0));
    }
    assert!(path_m(&ticks) + turned_rad(&ticks) > 1.0);
}

#[test]
fn a_picture_of_another_size_is_refused_not_misread() {
    let ticks = run(PolicyKind::Frontier, &["camera:resize@2..3"], 60);
    let stretch = at(&ticks, 2.0..3.0);
    assert!(
        stretch
            .iter()
            .all(|tick| tick.decision.events.contains(&Event::NoDepth { why: NoDepth::FrameSize }))
    );
}

#[test]
fn nan_odometry_is_refused_and_the_robot_stands_until_it_is_gone() {
    let ticks = run(PolicyKind::Forward, &["base:nan@2..3"], 60);
    let refused = Event::InputRefused { why: RefusedInput::OdometryNotFinite };
    for tick in at(&ticks, 2.0..3.0) {
        assert_eq!((tick.command(), &tick.decision.events), (Twist2::ZERO, &vec![refused.clone()]));
    }
    assert!(path_m(at(&ticks, 3.0..6.0)) > 0.3);
}

#[test]
fn a_jump_of_the_odometry_is_named_and_forgets_old_pictures() {
    let ticks = run(PolicyKind::Forward, &["base:jump=3@4.."], 60);
    assert!(
        events(at(&ticks, 4.0..4.2))
            .any(|event| *event == Event::NoDepth { why: NoDepth::PoseJump })
    );
}

#[test]
fn a_bumper_switch_that_is_stuck_is_given_up_after_three_contacts_and_a_person_sets_it_free() {
    let mut scenario = Scenario::new(PolicyKind::Forward, &["base:contact@2..12"], 3).unwrap();
    let stuck = scenario.ticks(150).unwrap();
    assert!(tripped(&stuck, TripCause::Contact));
    assert!(faulted(at(&stuck, 2.0..5.0), FaultReason::RepeatedContact));
    assert!(path_m(at(&stuck, 5.0..15.0)) < 1e-9, "it stands, although the switch has let go");
    scenario.request(Request::ClearFault);
    scenario.tick().unwrap();
    scenario.request(Request::Arm);
    assert!(path_m(&scenario.ticks(60).unwrap()) > 0.3, "it goes on");
}

#[test]
fn a_scanner_whose_scans_come_too_late_is_as_silent_as_one_that_says_nothing() {
    // Scans come every 30 ms. With a delay of ten scans, each is older than the 0.2 s up to which the robot may use it.
    let ticks = run(PolicyKind::Forward, &["lidar:delay=10@3..5"], 80);
    assert!(at(&ticks, 3.5..5.0).iter().all(|tick| tick.command() == Twist2::ZERO));
    assert!(faulted(at(&ticks, 3.0..3.5), FaultReason::LidarSilent));
    assert!(path_m(at(&ticks, 5.0..8.0)) > 0.3, "it goes on");
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
        let ticks = run(PolicyKind::Forward, &[fault], 120);
        assert!(ticks.iter().all(|tick| !tick.contact), "{fault}: it touched something");
        assert!(path_m(&ticks) > 1.0, "{fault}: {} m", path_m(&ticks));
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
        let ticks = run(PolicyKind::Frontier, &[fault], 120);
        assert!(ticks.iter().all(|tick| !tick.contact), "{fault}: it touched something");
        assert!(path_m(&ticks) + turned_rad(&ticks) > 1.0, "{fault}");
    }
}

#[test]
fn wheels_that_say_nothing_stop_the_robot_until_a_person_has_armed_it() {
    for silence in ["base:stall@2..4", "base:corrupt@2..4", "base:drop@2..4", "base:delay=30@2..4"]
    {
        let mut scenario = Scenario::new(PolicyKind::Forward, &[silence], 3).unwrap();
        let ticks = scenario.ticks(80).unwrap();
        assert!(
            at(&ticks, 2.4..8.0).iter().all(|tick| tick.command() == Twist2::ZERO),
            "{silence}"
        );
        assert!(path_m(at(&ticks, 2.5..8.0)) < 1e-9, "{silence}: it stands");
        assert!(faulted(at(&ticks, 2.0..2.5), FaultReason::BaseSilent), "{silence}");
        scenario.request(Request::ClearFault);
        scenario.tick().unwrap();
        scenario.request(Request::Arm);
        assert!(path_m(&scenario.ticks(40).unwrap()) > 0.3, "{silence}: it goes on");
    }
}

#[test]
fn an_unplugged_base_stops_the_robot_until_the_operator_has_cleared_the_fault_and_armed_it() {
    let mut scenario = Scenario::new(PolicyKind::Forward, &["base:unplug@2..4"], 3).unwrap();
    let before = scenario.ticks(80).unwrap();
    assert!(faulted(at(&before, 2.0..2.5), FaultReason::BaseFault));
    assert!(path_m(at(&before, 4.2..8.0)) < 1e-9, "it stands, although the base is back");
    scenario.request(Request::ClearFault);
    scenario.tick().unwrap();
    scenario.request(Request::Arm);
    assert!(path_m(&scenario.ticks(40).unwrap()) > 0.3, "it goes on");
}

#[test]
fn wheels_on_a_lossy_bus_lead_into_nothing() {
    for fault in
        ["base:drop=0.3", "base:duplicate", "base:reorder", "base:delay=1", "base:corrupt=0.3"]
    {
        let ticks = run(PolicyKind::Forward, &[fault], 120);
        assert!(ticks.iter().all(|tick| !tick.contact), "{fault}: it touched something");
        assert!(path_m(&ticks) > 1.0, "{fault}: {} m", path_m(&ticks));
    }
}

#[test]
fn a_loop_that_is_woken_late_stops_the_robot_and_time_never_goes_back() {
    let ticks = run(PolicyKind::Forward, &["clock:slow=400@2..4"], 80);
    let why = PlanRefusal::Stale;
    let refused = Event::Safety { what: SafetyEvent::PlanRefused { why } };
    assert!(
        events(at(&ticks, 2.0..5.0)).any(|event| *event == refused),
        "the safety loop is on time"
    );
    assert!(ticks.windows(2).all(|pair| pair[0].decision.time_ns <= pair[1].decision.time_ns));
    assert!(path_m(at(&ticks, 5.0..8.0)) > 0.3, "it goes on");
}

/// No sensor sees obstacles lower than the scan plane (0.18 m) within 1.25 m of the default mount (docs/faults.md). In these six
/// minutes the default robot touches none of them; the seeds are not chosen. The scanner sees glass here: with glass and lacquer
/// that it misses, one of the six minutes has a touch.
#[test]
fn in_minutes_of_random_faults_nothing_is_touched_and_all_repeats_exactly() {
    let mut touched = Vec::new();
    for seed in 1..=6 {
        let first = drive_with_random_faults(seed, 600);
        if first.iter().any(|tick| tick.contact) {
            touched.push(seed);
        }
        let moved = path_m(&first[300..]) + turned_rad(&first[300..]);
        assert!(moved > 1.0, "seed {seed}: it moved {moved} m and rad in half a minute");
        let second = drive_with_random_faults(seed, 100);
        assert!(first.iter().zip(&second).all(|(a, b)| a.decision == b.decision), "seed {seed}");
    }
    assert!(touched.is_empty(), "touches with the seeds {touched:?}");
}

/// A drive with random faults. The scanner sees glass and lacquer. The camera has half of the default width; with a quarter of
/// it, the robot touches the top of a table in one of twelve minutes.
fn drive_with_random_faults(seed: u64, ticks: usize) -> Vec<Tick> {
    let laser = LaserModel { misses_materials: false, ..LaserModel::UTM_30LX };
    let camera = CameraModel::pinhole(320, 128, FRAC_PI_2);
    let sensors = Sensors { laser, camera, ..Sensors::default() };
    let scenario = Scenario::with_sensors(PolicyKind::Active, &["random"], seed, sensors);
    scenario.unwrap().ticks(ticks).unwrap()
}

#[test]
fn every_policy_moves_without_contact_and_repeats_exactly() {
    for policy in PolicyKind::ALL {
        let first = run(policy, &[], 80);
        let second = run(policy, &[], 80);
        assert!(path_m(&first) + turned_rad(&first) > 0.5, "{policy:?}");
        assert!(first.iter().all(|tick| !tick.contact), "{policy:?} touched something");
        let [first_decisions, second_decisions] = [&first, &second]
            .map(|ticks| ticks.iter().map(|tick| &tick.decision).collect::<Vec<_>>());
        assert_eq!(first_decisions, second_decisions, "{policy:?}");
        let last: Pose2 = first[79].pose;
        assert!(last.is_finite());
    }
}

/// The share of ticks in which the safety loop sends less than the desired forward speed, and the
/// number of stops for reasons other than an obstacle.
fn interference(ticks: &[Tick]) -> (f64, usize) {
    let mut slow = 0;
    for pair in ticks.windows(2) {
        let desired_mps = pair[0].decision.desired.linear_mps;
        let sent_mps = pair[1].decision.sent.map_or(0.0, |sent| sent.linear_mps);
        slow += usize::from(sent_mps > 0.0 && sent_mps < 0.95 * desired_mps);
    }
    let events = ticks.iter().flat_map(|tick| &tick.decision.events);
    let stops = events.filter(|event| {
        matches!(
            event,
            Event::Safety {
                what: SafetyEvent::Faulted { .. }
                    | SafetyEvent::ViewLost
                    | SafetyEvent::ArmingLapsed { .. }
            }
        )
    });
    (slow as f64 / ticks.len() as f64, stops.count())
}

/// The [`interference`] of each of `drives` drives of a minute with healthy devices and these sensors.
fn interference_of(drives: u64, sensors: &Sensors) -> Vec<(f64, usize)> {
    (1..=drives)
        .map(|seed| {
            let mut scenario =
                Scenario::with_sensors(PolicyKind::Frontier, &[], seed, sensors.clone()).unwrap();
            let (slow, stops) = interference(&scenario.ticks(600).unwrap());
            println!("seed {seed}: slow for {:.1} % of the ticks, {stops} stops", 100.0 * slow);
            (slow, stops)
        })
        .collect()
}

#[test]
fn healthy_devices_in_a_home_without_glass_cause_no_stop_and_little_slow_driving() {
    let sees_all = LaserModel { misses_materials: false, ..LaserModel::UTM_30LX };
    for (slow, stops) in interference_of(4, &Sensors { laser: sees_all, ..Sensors::default() }) {
        assert_eq!(stops, 0);
        assert!(slow < 0.05, "slow for {slow} of the ticks");
    }
}

#[test]
fn before_glass_and_black_lacquer_the_robot_is_slow_and_stops_at_most_once_in_a_minute() {
    let level = Sensors { mount: CameraMount::LEVEL, ..Sensors::default() };
    for (slow, stops) in interference_of(4, &level) {
        assert!(stops <= 1, "{stops} stops");
        assert!(slow < 0.15, "slow for {slow} of the ticks");
    }
}

/// The robot stops seldom, at most once in most of the drives, and at most `most_stops` times in all of them.
fn assert_seldom_stops(drives: &[(f64, usize)], most_stops: usize) {
    let stops: usize = drives.iter().map(|(_, stops)| stops).sum();
    assert!(drives.iter().filter(|(_, stops)| *stops > 1).count() <= 1, "{drives:?}");
    assert!(stops <= most_stops, "{stops} stops");
    assert!(drives.iter().all(|(slow, _)| *slow < 0.15), "{drives:?}");
}

/// With this mount the robot takes other paths. One of them leads along a wide glass, where it stops twice within five seconds: only
/// the part of the glass before which it has stopped is known then.
#[test]
fn before_glass_a_robot_whose_camera_looks_down_stops_at_most_twice_in_four_minutes() {
    let coarse = Sensors { depth: DepthSource::Coarse, ..Sensors::default() };
    assert_seldom_stops(&interference_of(4, &coarse), 2);
}

/// A map of dense depth leads along other glass. In twelve minutes the robot stopped once; with
/// earlier builds, whose paths differ by chance, four and six times.
#[test]
fn before_glass_a_robot_that_maps_dense_depth_stops_at_most_three_times_in_six_minutes() {
    assert_seldom_stops(&interference_of(6, &Sensors::default()), 3);
}

/// The largest errors of the pose in `odom` since the first of these ticks, metres and radians.
fn worst_pose(ticks: &[Tick]) -> [f64; 2] {
    let first = &ticks[0];
    let mut worst = [0.0_f64; 2];
    for tick in ticks {
        let truth = first.pose.inverse().compose(&tick.pose);
        let believed = first.decision.t_odom_base.inverse().compose(&tick.decision.t_odom_base);
        let error = truth.inverse().compose(&believed);
        worst[0] = worst[0].max(error.x_m.hypot(error.y_m));
        worst[1] = worst[1].max(error.yaw_rad.abs());
    }
    worst
}

/// A fault of the inertial unit from the third second to the ninth. A bias that jumps by 0.3 rad/s, 17 degrees per second, rotates the pose by
/// 0.03 rad until the next scan.
#[test]
fn whatever_the_inertial_unit_says_the_pose_stays_right_and_the_robot_goes_on() {
    let sensors = Sensors { imu: true, ..Sensors::default() };
    for fault in [
        "corrupt@3..9",
        "bias=0.3@3..9",
        "bias=-2@3..9",
        "stall@3..9",
        "drop=0.5@3..9",
        "delay=8@3..9",
    ] {
        let fault = format!("imu:{fault}");
        let ticks = Scenario::with_sensors(PolicyKind::Active, &[&fault], 3, sensors.clone())
            .unwrap()
            .ticks(160)
            .unwrap();
        let [metres, radians] = worst_pose(&ticks[10..]);
        assert!(metres < 0.08 && radians < 0.06, "{fault}: {metres} m, {radians} rad");
        let later = at(&ticks, 10.0..16.0);
        assert!(path_m(later) > 0.3 || turned_rad(later) > 1.0, "{fault}: it does not go on");
        assert!(ticks.iter().all(|tick| !tick.contact), "{fault}");
    }
}
