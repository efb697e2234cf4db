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
        changes.extend(changed(watch.advance(&robot.wheel, robot.time_ns)));
        self.scan = scan;
        estimate.leg
    }
}

fn changed(report: Option<Report>) -> Option<Change> {
    match report {
        Some(Report::Changed(change)) => Some(change),
        Some(Report::Withdrawn(_)) | None => None,
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

/// A robot whose clocks change after a third of its rotations.
#[derive(Clone, Copy, Default)]
struct Clocks {
    /// Time by which scans, frames and the reports of the wheels are late, s.
    scanner_s: f64,
    camera_s: f64,
    wheels_s: f64,
    /// Error of the wheels' yaw in a tick, rad.
    noise_rad: f64,
    /// Scans do not fit.
    without_scans: bool,
    without_frames: bool,
}

/// The changes that it reports while it rotates for a second and drives for a second, 300 times.
fn changes_of_time(seed: u64, clocks: Clocks) -> Vec<Change> {
    const ROTATIONS: u64 = 300;
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut error = |size: f64| size * random.random_range(-1.7..1.7);
    let mut watch = CalibrationWatch::default();
    let config = LocalizationConfig::default();
    let mut at = Pose2::IDENTITY;
    let mut truth_rad: f64 = 0.0;
    let mut wheels_rad: f64 = 0.0;
    let mut rate_before = 0.0;
    let mut changes = Vec::new();
    for tick in 0..20 * ROTATIONS {
        let has_changed = f64::from(u8::from(tick > 20 * ROTATIONS / 3));
        let rate = [0.0, 0.7][(tick / 10 % 2) as usize];
        truth_rad += 0.1 * rate;
        wheels_rad += 0.1 * rate + if rate > 0.0 { error(clocks.noise_rad) } else { 0.0 };
        let scans_rad = truth_rad - has_changed * clocks.scanner_s * rate + error(0.001);
        let reported_rad = wheels_rad - has_changed * clocks.wheels_s * rate;
        let scan = MatchedScan {
            time_ns: tick * 100_000_000,
            by_wheels: Pose2::new(0.0, 0.0, wrap_angle(reported_rad)),
            by_scans: Pose2::new(0.0, 0.0, wrap_angle(scans_rad)),
            yaw_rate_radps: rate,
        };
        watch.see_scan(Some(scan).filter(|_| !clocks.without_scans), &config);
        let change_radps = rate - rate_before;
        if rotation_starts_or_stops(rate_before, rate) && !clocks.without_frames {
            let late_s = has_changed * (clocks.camera_s - clocks.scanner_s);
            let yaw_error_rad = -late_s * change_radps + error(0.001);
            let factor = Vector1::new(-change_radps);
            watch.see_latency(&Sums::of(factor, yaw_error_rad, 0.003_f64.powi(2)));
        }
        rate_before = rate;
        at = at.compose(&Pose2::new(if rate > 0.0 { 0.0 } else { 0.05 }, 0.0, 0.1 * rate));
        changes.extend(changed(watch.advance(&at, scan.time_ns)));
    }
    changes
}

/// The first change that is reported names `what`, with the right sign. A large one is first reported as much smaller than it is.
fn assert_named(clocks: Clocks, what: Watched, by_s: f64) {
    for seed in 0..20 {
        let changes = changes_of_time(seed, clocks);
        let [change, ..] = changes.as_slice() else { panic!("seed {seed}: nothing was reported") };
        assert_eq!(change.what, what, "seed {seed}: {change:?}");
        let share = change.by / by_s;
        let least = if by_s > 0.01 { 0.03 } else { 0.3 };
        assert!((least..1.5).contains(&share), "seed {seed}: {change:?}");
    }
}

#[test]
fn late_scans_are_not_taken_for_early_frames() {
    for scanner_s in [0.01, 0.05, 0.1] {
        let clocks = Clocks { scanner_s, noise_rad: 0.005, ..Clocks::default() };
        assert_named(clocks, Watched::LidarLatency, scanner_s);
        let alone = Clocks { without_frames: true, ..clocks };
        assert_named(alone, Watched::LidarLatency, scanner_s);
    }
}

#[test]
fn late_frames_are_those_of_the_camera() {
    for camera_s in [0.01, 0.05, 0.1] {
        let clocks = Clocks { camera_s, noise_rad: 0.005, ..Clocks::default() };
        assert_named(clocks, Watched::CameraLatency, camera_s);
    }
}

#[test]
fn frames_and_scans_that_agree_have_wheels_that_are_late() {
    for wheels_s in [0.01, 0.05, 0.1] {
        let clocks = Clocks { wheels_s, noise_rad: 0.005, ..Clocks::default() };
        assert_named(clocks, Watched::WheelLatency, wheels_s);
    }
}

#[test]
fn where_the_wheels_say_too_little_or_nothing_the_camera_is_named() {
    let noisy = Clocks { camera_s: 0.01, noise_rad: 0.04, ..Clocks::default() };
    assert_named(noisy, Watched::CameraLatency, 0.01);
    let without = Clocks { without_scans: true, ..noisy };
    assert_named(without, Watched::CameraLatency, 0.01);
}

#[test]
fn without_a_change_no_time_stamp_is_reported_however_noisy_the_wheels_are() {
    for seed in 0..20 {
        for noise_rad in [0.0, 0.005, 0.02] {
            let clocks = Clocks { noise_rad, ..Clocks::default() };
            assert_eq!(changes_of_time(seed, clocks), [], "seed {seed}, {noise_rad} rad");
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

/// A camera whose pitch is given for each block of the drive.
struct Pitched {
    watch: CalibrationWatch,
    reports: Vec<Report>,
}

impl Pitched {
    /// Each block has ten equations with a noise of 0.02 rad, which is stated as 0.1.
    fn new(seed: u64, blocks: u64, pitch: impl Fn(u64) -> f64) -> Self {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let mut watch = CalibrationWatch::default();
        let mut reports = Vec::new();
        let mut travelled_m = 0.0;
        for block in 0..blocks {
            for _ in 0..10 {
                let noise = 0.02 * random.random_range(-1.7..1.7);
                let factors = Vector3::new(1.0, 0.0, 0.0);
                watch.see_camera(&Sums::of(factors, pitch(block) + noise, 0.1_f64.powi(2)));
                travelled_m += 0.1 * BLOCK_M + 1e-6;
                reports.extend(watch.advance(&Pose2::new(travelled_m, 0.0, 0.0), block));
            }
        }
        Self { watch, reports }
    }

    fn withdrawn(&self) -> usize {
        self.reports.iter().filter(|report| matches!(report, Report::Withdrawn(_))).count()
    }
}

#[test]
fn a_report_that_the_next_metres_do_not_confirm_is_withdrawn_and_the_camera_is_trusted_again() {
    for seed in 0..10 {
        let wall = 100..106;
        let Pitched { watch, reports } =
            &Pitched::new(seed, 400, |block| if wall.contains(&block) { 0.08 } else { 0.0 });
        let [Report::Changed(_), .., Report::Withdrawn(withdrawal)] = reports.as_slice() else {
            panic!("seed {seed}: {reports:?}")
        };
        assert_eq!(withdrawal.what, Watched::CameraPitch);
        assert!(withdrawal.still.abs() < 0.007, "seed {seed}: {withdrawal:?}");
        assert_eq!(watch.changes().count(), 0, "seed {seed}");
        assert!(watch.camera_turned_rad().abs() < f64::EPSILON, "seed {seed}");
    }
}

#[test]
fn a_camera_that_was_turned_stays_so_and_the_change_gets_its_true_size() {
    for seed in 0..10 {
        let turned = Pitched::new(seed, 600, |block| if block < 100 { 0.0 } else { 0.05 });
        assert_eq!(turned.withdrawn(), 0, "seed {seed}: {:?}", turned.reports);
        let changes: Vec<&Change> = turned.watch.changes().collect();
        let [change] = changes.as_slice() else { panic!("seed {seed}: {changes:?}") };
        assert!((change.by - 0.05).abs() < 0.007, "seed {seed}: {change:?}");
        let turned_rad = turned.watch.camera_turned_rad();
        assert!((turned_rad - change.by).abs() < 1e-9, "seed {seed}: {turned_rad}");
    }
}

#[test]
fn a_camera_that_was_turned_back_is_trusted_again() {
    for seed in 0..10 {
        let is_turned = 100..250;
        let back =
            Pitched::new(seed, 600, |block| if is_turned.contains(&block) { 0.05 } else { 0.0 });
        assert_eq!(back.withdrawn(), 1, "seed {seed}: {:?}", back.reports);
        assert_eq!(back.watch.changes().count(), 0, "seed {seed}");
        assert!(back.watch.camera_turned_rad().abs() < f64::EPSILON, "seed {seed}");
    }
}

#[test]
fn what_was_reported_before_the_scanner_changed_is_not_withdrawn() {
    let mut turned = Pitched::new(1, 200, |block| if block < 100 { 0.0 } else { 0.05 });
    let before_rad = turned.watch.camera_turned_rad();
    assert!(before_rad > 0.03);
    turned.watch.settle_camera();
    turned.watch.camera.restart();
    assert!((turned.watch.camera_turned_rad() - before_rad).abs() < 1e-12);
    for block in 200..400_u32 {
        let factors = Vector3::new(1.0, 0.0, 0.0);
        (0..10).for_each(|_| turned.watch.see_camera(&Sums::of(factors, 0.0, 0.01)));
        let at = Pose2::new(0.6 * f64::from(block), 0.0, 0.0);
        turned.watch.last_odom = Some(Pose2::new(at.x_m - 0.501, 0.0, 0.0));
        assert!(turned.watch.advance(&at, u64::from(block)).is_none());
    }
    assert!((turned.watch.camera_turned_rad() - before_rad).abs() < 1e-12);
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
            second.read_layout_13(&mut from).unwrap();
            assert!(from.is_empty());
        } else if tick > 700 {
            leg.iter().for_each(|leg| second.see_leg(leg, &drive.config));
            second.see_scan(drive.scan, &drive.config);
            second.advance(&drive.robot.wheel, drive.robot.time_ns);
        }
    }
    assert_eq!(bytes_of(&second), bytes_of(&drive.watch));
}

#[test]
fn a_snapshot_holds_what_was_reported_of_clocks_and_camera() {
    let turned = Pitched::new(1, 200, |block| if block < 100 { 0.0 } else { 0.05 });
    let mut watch = turned.watch;
    let late = *watch.changes().next().unwrap();
    watch.late =
        [Watched::LidarLatency, Watched::WheelLatency].map(|what| Some(Change { what, ..late }));
    let mut second = CalibrationWatch::default();
    let bytes = bytes_of(&watch);
    let mut from = bytes.as_slice();
    State::read(&mut second, &mut from).unwrap();
    second.read_layout_13(&mut from).unwrap();
    assert_eq!(bytes_of(&second), bytes);
    assert_eq!(second.changes().collect::<Vec<_>>(), watch.changes().collect::<Vec<_>>());
    assert!((second.camera_turned_rad() - watch.camera_turned_rad()).abs() < f64::EPSILON);
    second.forget_layout_13();
    assert_eq!(second.changes().count(), 1, "the scanner and the wheels are forgotten");
}

fn bytes_of(watch: &CalibrationWatch) -> Vec<u8> {
    let mut bytes = Vec::new();
    watch.write(&mut bytes);
    watch.write_layout_13(&mut bytes);
    bytes
}
