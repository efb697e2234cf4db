//! A robot in a furnished room whose wheels and scanner change while it drives.

use hal::Pose2;

use super::*;
use crate::localization::Localizer;
use crate::localization::test_room::{TestRobot, round_trip};
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
}

impl Drive {
    fn new(seed: u64) -> Self {
        let robot = TestRobot::in_room(seed);
        let config = LocalizationConfig::default();
        let localizer = Localizer::new(&config, robot.geometry, Pose2::IDENTITY).unwrap();
        Self { robot, localizer, watch: CalibrationWatch::default(), config, changes: Vec::new() }
    }

    fn step(&mut self, forward_m: f64, yaw_rad: f64) -> Option<DrivenLeg> {
        self.robot.step(forward_m, yaw_rad);
        let scan = self.robot.scan();
        let Self { robot, localizer, watch, config, changes } = self;
        let input = Some((&scan, &robot.wheel));
        let estimate = localizer.update(&robot.wheel, robot.time_ns, input);
        if let Some(leg) = estimate.leg {
            watch.see_leg(&leg, config);
        }
        changes.extend(watch.advance(&robot.wheel, robot.time_ns));
        estimate.leg
    }
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
    for seed in 0..3 {
        let changes = drive(seed, CHANGE_AT + TEN_METRES, hit);
        let [change] = changes.as_slice() else { panic!("seed {seed}: {changes:?}") };
        assert_eq!(change.what, what, "seed {seed}: {change:?}");
        assert!((change.by - by).abs() < within, "seed {seed}: {change:?}");
        assert!((change.since_m - 24.0).abs() < 2.0, "seed {seed}: {change:?}");
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
            State::read(&mut second, &mut bytes_of(&drive.watch).as_slice()).unwrap();
        } else if tick > 700 {
            leg.iter().for_each(|leg| second.see_leg(leg, &drive.config));
            second.advance(&drive.robot.wheel, drive.robot.time_ns);
        }
    }
    assert_eq!(bytes_of(&second), bytes_of(&drive.watch));
}

fn bytes_of(watch: &CalibrationWatch) -> Vec<u8> {
    let mut bytes = Vec::new();
    watch.write(&mut bytes);
    bytes
}
