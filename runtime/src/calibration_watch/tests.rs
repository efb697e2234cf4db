//! A robot in a furnished room whose wheels and scanner change while it drives.

use hal::{Pose2, wrap_angle};
use nalgebra::{Vector1, Vector3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::*;
use crate::localization::test_room::{TestRobot, round_trip};
use crate::localization::{Estimate, Localizer};
use crate::snapshot::State;

/// Ticks until something changes: 24 m, 26 rotations by 45 degrees.
const CHANGE_AT: usize = 1200;
/// Ticks of 10 m of driving.
const TEN_METRES: usize = 500;

/// A change of the robot.
type Hit = fn(&mut TestRobot);

struct Drive {
    robot: TestRobot,
    localizer: Localizer,
    watch: CalibrationWatch,
    config: LocalizationConfig,
    changes: Vec<Change>,
    /// The last scan.
    scan: Option<MatchedScan>,
}

impl Drive {
    fn new(seed: u64) -> Self {
        let robot = TestRobot::in_room(seed);
        let config = LocalizationConfig::default();
        let localizer = Localizer::new(&config, robot.geometry, Pose2::IDENTITY).unwrap();
        let watch = CalibrationWatch::default();
        Self { robot, localizer, watch, config, changes: Vec::new(), scan: None }
    }

    fn step(&mut self, forward_m: f64, yaw_rad: f64) -> Option<DrivenLeg> {
        self.robot.step(forward_m, yaw_rad);
        let scan = self.robot.scan();
        let Self { robot, localizer, watch, config, changes, .. } = self;
        let input = Some((&scan, &robot.wheel));
        let estimate = localizer.update(&robot.wheel, robot.time_ns, input);
        if let Some(leg) = estimate.leg {
            watch.see_leg(&leg, config);
        }
        let scan = matched_scan(robot, &estimate);
        watch.see_scan(scan, config);
        changes.extend(watch.advance(&robot.wheel, robot.time_ns));
        self.scan = scan;
        estimate.leg
    }
}

fn matched_scan(robot: &TestRobot, estimate: &Estimate) -> Option<MatchedScan> {
    let by_scans = estimate.t_odom_base_at_scan.filter(|_| estimate.matched)?;
    Some(MatchedScan {
        time_ns: robot.time_ns,
        by_wheels: robot.wheel,
        by_scans,
        yaw_rate_radps: estimate.twist.angular_radps,
    })
}

/// Drives on in the room. `hit` changes the robot after [`CHANGE_AT`] ticks.
fn drive(seed: u64, ticks: usize, hit: Hit) -> Vec<Change> {
    let mut drive = Drive::new(seed);
    for (tick, (forward_m, yaw_rad)) in round_trip(ticks).enumerate() {
        if tick == CHANGE_AT {
            hit(&mut drive.robot);
        }
        drive.step(forward_m, yaw_rad);
    }
    if std::env::var_os("MEASURED").is_some() {
        drive.watch.measured().for_each(|measured| eprintln!("{seed} {measured:?}"));
        let Drive { watch, changes, .. } = &drive;
        eprintln!("noise {:?} {:?}", watch.wheels.noises(&WHEELS), watch.lidar.noises(&LIDAR));
        for index in 0..3 {
            let [wheels, lidar] =
                [watch.wheels.suspicion(index, &WHEELS), watch.lidar.suspicion(index, &LIDAR)];
            eprintln!("suspicion {index}: {wheels:.2} {lidar:.2}");
        }
        eprintln!("{changes:?}");
    }
    drive.changes
}

/// The only change that is reported within 10 m is `what`, by `by` within `within`, at the right place.
fn assert_found(hit: Hit, what: Watched, by: f64, within: f64) {
    assert_found_since(hit, what, by, within, 2.0);
}

/// The same, with the place right within `since_m` metres.
fn assert_found_since(hit: Hit, what: Watched, by: f64, within: f64, since_m: f64) {
    for seed in 0..3 {
        let changes = drive(seed, CHANGE_AT + TEN_METRES, hit);
        let [change] = changes.as_slice() else { panic!("seed {seed}: {changes:?}") };
        assert_eq!(change.what, what, "seed {seed}: {change:?}");
        assert!((change.by - by).abs() < within, "seed {seed}: {change:?}");
        assert!((change.since_m - 24.0).abs() < since_m, "seed {seed}: {change:?}");
    }
}

#[test]
fn a_scanner_that_was_turned_by_a_degree_is_named() {
    let turned: Hit = |robot| robot.t_base_laser.yaw_rad = 1_f64.to_radians();
    assert_found(turned, Watched::LidarYaw, 1_f64.to_radians(), 0.007);
}

#[test]
fn a_scanner_that_was_pushed_aside_is_named() {
    assert_found(|robot| robot.t_base_laser.y_m = 0.02, Watched::LidarLeft, 0.02, 0.008);
}

#[test]
fn a_wheel_that_has_changed_is_named() {
    // 1 % of one wheel, 0.24 m apart: the wheels report less yaw to the right, so that the robot turns more to the left.
    let flat: Hit = |robot| robot.drift_rad_per_m -= 0.0417;
    assert_found(flat, Watched::WheelHeading, 0.0417, 0.012);
}

#[test]
fn a_scanner_whose_scans_come_later_is_named() {
    // It shows where a rotation starts, which is every 1.2 m.
    let late: Hit = |robot| robot.scan_late_s = 0.03;
    assert_found_since(late, Watched::LidarLatency, 0.03, 0.008, 3.0);
}

/// The changes that a robot reports which rotates for a second and stands for a second, for `rotations` times. Scans are late by
/// `scanner_s` and frames by `camera_s` after a third of them; `noise` is the error of the wheels' yaw in a tick, rad.
fn changes_of_time(seed: u64, scanner_s: f64, camera_s: f64, noise: f64) -> Vec<Change> {
    const ROTATIONS: u64 = 300;
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut error = |size: f64| size * random.random_range(-1.7..1.7);
    let mut watch = CalibrationWatch::default();
    let config = LocalizationConfig::default();
    let mut truth_rad: f64 = 0.0;
    let mut wheels_rad: f64 = 0.0;
    let mut rate_before = 0.0;
    let mut changes = Vec::new();
    for tick in 0..20 * ROTATIONS {
        let has_changed = tick > 20 * ROTATIONS / 3;
        let [scanner_s, camera_s] =
            [scanner_s, camera_s].map(|s| if has_changed { s } else { 0.0 });
        let rate = [0.0, 0.7][(tick / 10 % 2) as usize];
        truth_rad += 0.1 * rate;
        wheels_rad += 0.1 * rate + if rate > 0.0 { error(noise) } else { 0.0 };
        let scan = MatchedScan {
            time_ns: tick * 100_000_000,
            by_wheels: Pose2::new(0.0, 0.0, wrap_angle(wheels_rad)),
            by_scans: Pose2::new(0.0, 0.0, wrap_angle(truth_rad - scanner_s * rate + error(0.001))),
            yaw_rate_radps: rate,
        };
        watch.see_scan(Some(scan), &config);
        let change_radps = rate - rate_before;
        if rotation_starts_or_stops(rate_before, rate) {
            let late_s = camera_s - scanner_s;
            let yaw_error_rad = -late_s * change_radps + error(0.001);
            let factor = Vector1::new(-change_radps);
            watch.see_latency(&Sums::of(factor, yaw_error_rad, 0.003_f64.powi(2)));
        }
        rate_before = rate;
        changes.extend(watch.advance(&scan.by_wheels, scan.time_ns));
    }
    changes
}

#[test]
fn late_scans_are_not_taken_for_early_frames() {
    for seed in 0..20 {
        let changes = changes_of_time(seed, 0.01, 0.0, 0.005);
        let [change] = changes.as_slice() else { panic!("seed {seed}: {changes:?}") };
        assert_eq!(change.what, Watched::LidarLatency, "seed {seed}: {change:?}");
        assert!((change.by - 0.01).abs() < 0.005, "seed {seed}: {change:?}");
    }
}

#[test]
fn late_frames_are_those_of_the_camera() {
    for seed in 0..20 {
        let changes = changes_of_time(seed, 0.0, 0.01, 0.005);
        let [change] = changes.as_slice() else { panic!("seed {seed}: {changes:?}") };
        assert_eq!(change.what, Watched::CameraLatency, "seed {seed}: {change:?}");
        assert!((change.by - 0.01).abs() < 0.005, "seed {seed}: {change:?}");
    }
}

#[test]
fn without_a_change_no_time_stamp_is_reported_however_noisy_the_wheels_are() {
    for seed in 0..20 {
        for noise in [0.0, 0.005, 0.02] {
            assert_eq!(changes_of_time(seed, 0.0, 0.0, noise), [], "seed {seed}, {noise} rad");
        }
    }
}

#[test]
fn scans_that_did_not_fit_say_nothing_of_the_latency() {
    let config = LocalizationConfig::default();
    let at = |tick: u64, yaw_rad: f64, yaw_rate_radps: f64| MatchedScan {
        time_ns: tick * 100_000_000,
        by_wheels: Pose2::IDENTITY,
        by_scans: Pose2::new(0.0, 0.0, yaw_rad),
        yaw_rate_radps,
    };
    let said = |scans: &[Option<MatchedScan>]| {
        let mut watch = CalibrationWatch::default();
        scans.iter().for_each(|scan| watch.see_scan(*scan, &config));
        watch.measured().find(|measured| measured.what == Watched::LidarLatency).unwrap().value
    };
    let before = Some(at(0, 0.0, 0.0));
    assert!(said(&[before, Some(at(1, 0.01, 0.7))]) < -0.001);
    assert!(said(&[before, None, Some(at(2, 0.01, 0.7))]).abs() < f64::EPSILON);
    assert!(said(&[before, Some(at(3, 0.01, 0.7))]).abs() < f64::EPSILON, "too long ago");
    assert!(said(&[before, Some(at(1, 0.01, 0.05))]).abs() < f64::EPSILON, "no rotation");
}

/// The changes that are reported of a camera whose pitch is `pitch(block)`, and by how much it is turned at the end, rad. Each block
/// has ten equations with a noise of 0.02 rad, which is stated as 0.1.
fn changes_of_pitch(seed: u64, blocks: u64, pitch: impl Fn(u64) -> f64) -> (Vec<Change>, f64) {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut watch = CalibrationWatch::default();
    let mut changes = Vec::new();
    let mut travelled_m = 0.0;
    for block in 0..blocks {
        for _ in 0..10 {
            let noise = 0.02 * random.random_range(-1.7..1.7);
            let factors = Vector3::new(1.0, 0.0, 0.0);
            watch.see_camera(&Sums::of(factors, pitch(block) + noise, 0.1_f64.powi(2)));
            travelled_m += 0.1 * BLOCK_M + 1e-6;
            changes.extend(watch.advance(&Pose2::new(travelled_m, 0.0, 0.0), block));
        }
    }
    (changes, watch.camera_turned_rad())
}

#[test]
fn a_report_that_the_next_metres_do_not_confirm_is_withdrawn_and_the_camera_is_trusted_again() {
    let mut withdrawn = 0;
    for seed in 0..10 {
        let wall = 100..106;
        let (changes, turned) =
            changes_of_pitch(seed, 300, |block| if wall.contains(&block) { 0.08 } else { 0.0 });
        let [first, .., last] = changes.as_slice() else { panic!("seed {seed}: {changes:?}") };
        assert_ne!(first.manner, Manner::Withdrawn, "seed {seed}");
        // The end of the wall may be found as a change back.
        withdrawn += u32::from(last.manner == Manner::Withdrawn);
        assert!(turned < CAMERA.least[0], "seed {seed}: {turned} after {changes:?}");
    }
    assert!(withdrawn >= 5, "{withdrawn}");
}

#[test]
fn a_camera_that_was_turned_stays_so() {
    for seed in 0..10 {
        let (changes, turned) =
            changes_of_pitch(seed, 600, |block| if block < 100 { 0.0 } else { 0.05 });
        assert!(!changes.is_empty(), "seed {seed}");
        assert!(changes.iter().all(|change| change.manner != Manner::Withdrawn), "{changes:?}");
        assert!((turned - 0.05).abs() < 0.01, "seed {seed}: {turned}");
    }
}

#[test]
fn a_camera_that_was_turned_back_is_trusted_again() {
    for seed in 0..10 {
        let is_turned = 100..250;
        let (changes, turned) =
            changes_of_pitch(
                seed,
                500,
                |block| {
                    if is_turned.contains(&block) { 0.05 } else { 0.0 }
                },
            );
        assert!(changes.len() >= 2, "seed {seed}: {changes:?}");
        assert!(turned < 0.01, "seed {seed}: {turned} after {changes:?}");
    }
}

#[test]
fn a_rotation_on_the_spot_takes_only_as_much_of_the_window_as_the_wheels_roll() {
    let mut watch = CalibrationWatch::default();
    for step in 0..400_u64 {
        watch.advance(&Pose2::new(0.0, 0.0, hal::wrap_angle(0.1 * step as f64)), step);
    }
    // 40 rad of a robot whose wheels are 0.12 m from its middle, in blocks of half a metre.
    assert_eq!(watch.wheels.blocks(), 9);
}

#[test]
fn wheels_that_were_wrong_from_the_beginning_are_no_change() {
    for seed in 0..4 {
        assert_eq!(drive(seed, 3000, |_| {}), [], "seed {seed}");
    }
}

#[test]
fn a_second_watch_goes_on_from_a_snapshot_to_the_bit() {
    let mut drive = Drive::new(1);
    let mut second = CalibrationWatch::default();
    for (tick, (forward_m, yaw_rad)) in round_trip(900).enumerate() {
        let leg = drive.step(forward_m, yaw_rad);
        if tick == 700 {
            let bytes = bytes_of(&drive.watch);
            let mut from = bytes.as_slice();
            State::read(&mut second, &mut from).unwrap();
            second.read_newer(&mut from).unwrap();
            assert!(from.is_empty());
        } else if tick > 700 {
            leg.iter().for_each(|leg| second.see_leg(leg, &drive.config));
            second.see_scan(drive.scan, &drive.config);
            second.advance(&drive.robot.wheel, drive.robot.time_ns);
        }
    }
    assert_eq!(bytes_of(&second), bytes_of(&drive.watch));
}

fn bytes_of(watch: &CalibrationWatch) -> Vec<u8> {
    let mut bytes = Vec::new();
    watch.write(&mut bytes);
    watch.write_newer(&mut bytes);
    bytes
}
