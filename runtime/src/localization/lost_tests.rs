//! Robots that are carried, pushed, held and restarted, in virtual time.

use std::f64::consts::TAU;
use std::sync::OnceLock;

use super::test_room::{FLAT_TOUR, TestRobot, Wall, cast, flat, furnished_room, rectangle};
use super::*;
use hal::{Pose2, wrap_angle};

/// A robot with its localizer, and what was reported.
pub(super) struct Drive {
    pub robot: TestRobot,
    pub localizer: Localizer,
    map_from_world: Pose2,
    pub lost: Vec<LostReason>,
    wheel_errors: Vec<WheelError>,
}

impl Drive {
    pub fn new(robot: TestRobot) -> Self {
        let config = LocalizationConfig::default();
        let localizer = Localizer::new(&config, robot.geometry, Pose2::IDENTITY).unwrap();
        let map_from_world = robot.truth.inverse();
        Self { robot, localizer, map_from_world, lost: Vec::new(), wheel_errors: Vec::new() }
    }

    /// A robot that knows the whole flat, in its last room.
    fn through_flat() -> Self {
        static KNOWN: OnceLock<(Vec<u8>, Pose2, Pose2, u64)> = OnceLock::new();
        let start = TestRobot::in_flat(1);
        let (memory, truth, wheel, time_ns) = KNOWN.get_or_init(|| {
            let mut drive = Self::new(TestRobot::in_flat(1));
            drive.tour(&FLAT_TOUR);
            assert_eq!((drive.lost.len(), drive.wheel_errors.len()), (0, 0));
            drive.assert_right(0.06);
            let TestRobot { truth, wheel, time_ns, .. } = drive.robot;
            (drive.localizer.snapshot(), truth, wheel, time_ns)
        });
        let mut drive = Self::new(start);
        drive.localizer.restore(memory).unwrap();
        drive.robot.truth = *truth;
        drive.robot.wheel = *wheel;
        drive.robot.time_ns = *time_ns;
        drive
    }

    pub fn tour(&mut self, places: &[[f64; 2]]) {
        for place in places {
            while let Some((forward_m, yaw_rad)) = self.robot.step_to(*place) {
                self.step(forward_m, yaw_rad);
            }
        }
    }

    pub fn step(&mut self, forward_m: f64, yaw_rad: f64) -> Estimate {
        self.robot.step(forward_m, yaw_rad);
        self.update()
    }

    fn update(&mut self) -> Estimate {
        let was_lost = self.is_lost();
        let scan = self.robot.scan();
        let wheel = self.robot.wheel;
        let estimate = self.localizer.update(&wheel, self.robot.time_ns, Some((&scan, &wheel)));
        if !was_lost {
            self.lost.extend(estimate.whereabouts.lost());
        }
        self.wheel_errors.extend(estimate.wheel_error);
        estimate
    }

    /// Stands for some scans. Returns their fits.
    pub fn stand(&mut self, steps: usize) -> Vec<Option<ScanFit>> {
        (0..steps).map(|_| self.step(0.0, 0.0).fit).collect()
    }

    pub fn is_lost(&self) -> bool {
        self.localizer.estimate().whereabouts.lost().is_some()
    }

    /// Rotates on the spot until it is found, for two rotations at most. Returns the steps.
    pub fn search(&mut self) -> usize {
        let steps = (1..=360).find(|_| {
            self.step(0.0, 2.0_f64.to_radians());
            !self.is_lost()
        });
        steps.unwrap_or(360)
    }

    fn error(&self) -> Pose2 {
        let truth = self.map_from_world.compose(&self.robot.truth);
        truth.inverse().compose(&self.localizer.estimate().t_map_base())
    }

    pub fn assert_right(&self, within_m: f64) {
        let error = self.error();
        let radians = wrap_angle(error.yaw_rad).abs();
        assert!(error.x_m.hypot(error.y_m) < within_m && radians < 0.02, "{error:?}");
    }

    pub fn submaps_in_map(&self) -> Vec<Pose2> {
        (0..).map_while(|index| self.localizer.submap_in_map(index)).collect()
    }
}

#[test]
fn a_robot_that_is_lifted_and_put_elsewhere_notices_it_and_finds_itself() {
    let mut drive = Drive::through_flat();
    let odom = drive.localizer.estimate().t_odom_base;
    drive.robot.carry_to(Pose2::new(1.6, 5.2, 2.0));
    let fits = drive.stand(6);
    assert_eq!(drive.lost, [LostReason::Carried], "{fits:?}");
    assert!(drive.localizer.estimate().t_odom_base.distance_m(&odom) < 0.02);
    let steps = drive.search();
    assert!(!drive.is_lost() && steps < 180, "{steps}");
    drive.assert_right(0.06);
}

#[test]
fn a_robot_that_was_found_goes_on_and_closes_loops_with_its_old_map() {
    let mut drive = Drive::through_flat();
    let submaps = drive.submaps_in_map();
    drive.robot.carry_to(Pose2::new(1.6, 5.2, 2.0));
    drive.stand(6);
    drive.search();
    let closures = drive.localizer.closures();
    drive.tour(&[[3.45, 5.5], [3.45, 3.7], [7.45, 3.7], [7.45, 2.2]]);
    assert_eq!(drive.lost.len(), 1);
    assert!(drive.localizer.closures() > closures);
    drive.assert_right(0.06);
    for (before, after) in submaps.iter().zip(drive.submaps_in_map()) {
        assert!(before.distance_m(&after) < 0.03, "{before:?} {after:?}");
    }
}

#[test]
fn a_robot_that_is_carried_for_two_metres_past_its_scanner_knows_where_it_is() {
    let mut drive = Drive::through_flat();
    drive.tour(&[[8.45, 5.5], [8.45, 3.7]]);
    drive.stand(40);
    for _ in 0..25 {
        let truth = drive.robot.truth;
        drive.robot.carry_to(Pose2 { x_m: truth.x_m - 0.08, ..truth });
        drive.update();
    }
    if drive.is_lost() {
        drive.search();
    }
    assert!(!drive.wheel_errors.contains(&WheelError::Spin), "{:?}", drive.wheel_errors);
    assert!(!drive.wheel_errors.is_empty() || !drive.lost.is_empty());
    drive.assert_right(0.06);
}

#[test]
fn a_robot_that_is_pushed_by_20_cm_is_not_lost_and_reports_it() {
    for (steps, x_m, y_m) in [(5, 0.04, 0.0), (5, 0.0, 0.04), (10, -0.02, 0.0), (1, 0.2, 0.0)] {
        let mut drive = Drive::through_flat();
        drive.stand(40);
        for _ in 0..steps {
            drive.robot.carry_to(drive.robot.truth.compose(&Pose2::new(x_m, y_m, 0.0)));
            drive.update();
        }
        drive.stand(5);
        assert_eq!(
            (drive.lost.len(), drive.wheel_errors.as_slice()),
            (0, &[WheelError::Pushed][..])
        );
        // The error of the map, up to 5 cm, is in this too.
        drive.assert_right(0.105);
    }
}

#[test]
fn wheels_that_spin_for_three_seconds_are_reported_and_move_nothing() {
    for motion in [Pose2::new(0.03, 0.0, 0.0), Pose2::new(0.0, 0.0, 0.035)] {
        let mut drive = Drive::through_flat();
        for _ in 0..30 {
            drive.robot.wheel = drive.robot.wheel.compose(&motion);
            drive.step(0.0, 0.0);
        }
        assert_eq!((drive.lost.len(), drive.wheel_errors.as_slice()), (0, &[WheelError::Spin][..]));
        drive.assert_right(0.06);
        drive.tour(&[[8.45, 5.5]]);
        drive.assert_right(0.06);
    }
}

/// Its wheels stand while a person rotates it, and its gyroscope does not.
#[test]
fn a_robot_with_a_gyroscope_that_was_carried_does_not_blame_its_wheels() {
    let mut drive = Drive::through_flat();
    let mut errors = Vec::new();
    for tick in 0..60 {
        if tick == 20 {
            drive.localizer.lose(LostReason::Carried);
        }
        // It is rotated by 1.5 rad in the air.
        let carried_rad = if (20..35).contains(&tick) { 0.1 } else { 0.0 };
        let wheel = drive.robot.wheel;
        drive.robot.step(0.0, carried_rad);
        drive.robot.wheel = wheel;
        let scan = drive.robot.scan();
        let scan = Some((&scan, &wheel)).filter(|_| carried_rad == 0.0);
        let imu = Some(drive.robot.imu());
        let time_ns = drive.robot.time_ns;
        let estimate = drive.localizer.update_with_imu(&wheel, time_ns, scan, imu.as_ref());
        errors.extend(estimate.wheel_error);
    }
    assert_eq!(errors, []);
}

/// The wheels of the robot that made the log FR079 do so.
#[test]
fn wheels_that_report_a_drive_back_as_one_ahead_are_named_and_the_scans_keep_the_pose() {
    let mut drive = Drive::through_flat();
    drive.stand(40);
    for _ in 0..18 {
        drive.robot.carry_to(drive.robot.truth.compose(&Pose2::new(-0.03, 0.0, 0.0)));
        drive.robot.wheel = drive.robot.wheel.compose(&Pose2::new(0.03, 0.0, 0.0));
        drive.update();
    }
    assert_eq!((drive.lost.len(), drive.wheel_errors.as_slice()), (0, &[WheelError::Reversed][..]));
    drive.assert_right(0.06);
}

#[test]
fn a_corridor_of_15_metres_without_features_is_no_reason_to_be_lost() {
    let walls = rectangle([-2.0, -0.9], [60.0, 0.9]).to_vec();
    let mut drive = Drive::new(TestRobot::new(walls, 3));
    for _ in 0..700 {
        drive.step(0.03, 0.0);
    }
    assert_eq!((drive.lost.len(), drive.wheel_errors.len()), (0, 0));
}

/// Where one of six people is: they walk to and fro in the flat.
fn person(index: usize, step: usize) -> [f64; 2] {
    let [from, to] = [FLAT_TOUR[(2 * index + 1) % 18], FLAT_TOUR[(2 * index + 2) % 18]];
    let phase = 0.5 - 0.5 * (0.06 * step as f64 + index as f64).cos();
    [0, 1].map(|axis| from[axis] + phase * (to[axis] - from[axis]))
}

#[test]
fn six_people_who_walk_through_the_flat_do_not_make_a_robot_lost() {
    let mut drive = Drive::new(TestRobot::in_flat(4));
    let empty = drive.robot.walls.clone();
    let mut step = 0;
    for place in FLAT_TOUR {
        while let Some((forward_m, yaw_rad)) = drive.robot.step_to(place) {
            drive.robot.walls = empty.clone();
            for index in 0..6 {
                let [x, y] = person(index, step);
                let is_clear = (x - drive.robot.truth.x_m).hypot(y - drive.robot.truth.y_m) > 0.5;
                if is_clear {
                    let person = rectangle([x - 0.2, y - 0.2], [x + 0.2, y + 0.2]);
                    drive.robot.walls.extend(person);
                }
            }
            drive.step(forward_m, yaw_rad);
            step += 1;
        }
    }
    assert_eq!(drive.lost, []);
    drive.assert_right(0.1);
}

#[test]
fn a_robot_that_is_restarted_elsewhere_in_a_saved_map_finds_itself() {
    let saved = Drive::through_flat().localizer.snapshot();
    for (x, y, yaw) in [(2.2, 3.6, 1.0), (4.6, 1.2, -2.0), (7.4, 6.2, 0.3)] {
        let mut drive = Drive::new(TestRobot::in_flat(9));
        drive.localizer.restore(&saved).unwrap();
        drive.localizer.lose(LostReason::Loaded);
        drive.robot.carry_to(Pose2::new(x, y, yaw));
        assert_eq!(drive.update().whereabouts, Whereabouts::Lost(LostReason::Loaded));
        drive.search();
        assert!(!drive.is_lost(), "at {x} {y}, {} scans", drive.localizer.scans_searched());
        drive.assert_right(0.06);
    }
}

/// The flat with the door of the room at (7, 2) closed.
fn flat_with_closed_door() -> Vec<Wall> {
    let mut walls = flat();
    walls.push([[7.0, 3.0], [7.9, 3.0]]);
    walls
}

/// The flat with the sofa of the room at (2, 2) moved along its wall.
fn flat_with_moved_sofa(by_m: f64) -> Vec<Wall> {
    flat_with_sofa_moved_by([0.0, by_m])
}

fn flat_with_sofa_moved_by([x_m, y_m]: [f64; 2]) -> Vec<Wall> {
    let mut walls = flat();
    let sofa = rectangle([0.1, 0.1], [1.1, 1.6]);
    let before = walls.len();
    walls.retain(|wall| !sofa.contains(wall));
    assert_eq!(walls.len(), before - 4);
    walls.extend(rectangle([0.1 + x_m, 0.1 + y_m], [1.1 + x_m, 1.6 + y_m]));
    walls
}

/// Restarts at places on both sides of the door, and in the room of the sofa.
fn assert_that_restarts_are_found(walls: &[Wall]) {
    let saved = Drive::through_flat().localizer.snapshot();
    for (x, y, yaw) in [(1.9, 2.0, 2.5), (2.2, 3.6, 1.0), (7.4, 3.6, -1.2), (5.2, 1.8, 0.4)] {
        let mut drive = Drive::new(TestRobot::in_flat(9));
        drive.localizer.restore(&saved).unwrap();
        drive.localizer.lose(LostReason::Loaded);
        drive.robot.walls = walls.to_vec();
        drive.robot.carry_to(Pose2::new(x, y, yaw));
        drive.search();
        assert!(!drive.is_lost(), "at {x} {y}, {} scans", drive.localizer.scans_searched());
        drive.assert_right(0.06);
    }
}

/// With its sofa 2.3 m further to the right, the room of 4 x 3 m fits the one beside it better than itself: 89 % of a scan lie on known
/// surfaces of that room, and 80 % on its own.
#[test]
fn a_room_that_fits_another_better_than_itself_is_not_taken_for_it() {
    let saved = Drive::through_flat().localizer.snapshot();
    for (x, y, yaw) in [(1.9, 2.0, 2.5), (1.6, 1.2, 0.4), (1.2, 2.2, -1.0)] {
        let mut drive = Drive::new(TestRobot::in_flat(9));
        drive.localizer.restore(&saved).unwrap();
        drive.localizer.lose(LostReason::Loaded);
        drive.robot.walls = flat_with_sofa_moved_by([2.3, 0.0]);
        drive.robot.carry_to(Pose2::new(x, y, yaw));
        drive.search();
        if !drive.is_lost() {
            drive.assert_right(0.06);
        }
    }
}

#[test]
fn a_door_that_was_open_and_is_closed_does_not_hide_the_place_from_a_restarted_robot() {
    assert_that_restarts_are_found(&flat_with_closed_door());
}

#[test]
fn a_sofa_that_was_moved_does_not_hide_the_place_from_a_restarted_robot() {
    for by_m in [0.5, 1.3] {
        assert_that_restarts_are_found(&flat_with_moved_sofa(by_m));
    }
}

#[test]
fn a_door_that_is_closed_and_a_sofa_that_is_moved_behind_the_robots_back_do_not_make_it_lost() {
    for walls in [flat_with_closed_door(), flat_with_moved_sofa(0.5), flat_with_moved_sofa(1.3)] {
        let mut drive = Drive::through_flat();
        drive.robot.walls = walls;
        // Past the closed door, into the room of the sofa.
        drive.tour(&[
            [8.45, 5.5],
            [8.45, 3.7],
            [7.45, 3.7],
            [3.45, 3.7],
            [1.95, 3.6],
            [1.95, 2.0],
            [2.6, 1.4],
        ]);
        drive.stand(10);
        assert_eq!((drive.lost.as_slice(), drive.wheel_errors.as_slice()), (&[][..], &[][..]));
        drive.assert_right(0.06);
    }
}

/// The change happens in view of a robot that stands before it.
#[test]
fn a_door_that_is_closed_before_the_robots_eyes_does_not_make_it_lost() {
    let mut drive = Drive::through_flat();
    drive.tour(&[[8.45, 5.5], [8.45, 3.7], [7.45, 3.7]]);
    drive.stand(20);
    drive.robot.walls = flat_with_closed_door();
    drive.stand(20);
    drive.tour(&[[5.5, 3.7], [7.45, 3.7]]);
    assert_eq!((drive.lost.as_slice(), drive.wheel_errors.as_slice()), (&[][..], &[][..]));
    drive.assert_right(0.06);
}

#[test]
fn in_the_map_of_another_home_the_robot_stays_lost_and_changes_nothing() {
    let saved = Drive::through_flat();
    let mut drive = Drive::new(TestRobot::new(furnished_room(), 2));
    drive.localizer.restore(&saved.localizer.snapshot()).unwrap();
    drive.localizer.lose(LostReason::Loaded);
    drive.search();
    drive.tour(&[[1.0, 0.0], [0.0, -1.4], [1.0, 1.0]]);
    drive.search();
    assert!(drive.is_lost() && drive.localizer.scans_searched() > 20);
    assert_eq!(drive.submaps_in_map(), saved.submaps_in_map());
}

/// Two rooms that are the same, one beside the other.
#[test]
fn of_two_rooms_that_look_the_same_neither_is_chosen() {
    let mut walls = furnished_room();
    walls.extend(
        furnished_room().into_iter().map(|[[ax, ay], [bx, by]]| [[ax + 12.0, ay], [bx + 12.0, by]]),
    );
    let mut first = TestRobot::in_room(6);
    first.walls = walls;
    let mut drive = Drive::new(first);
    drive.tour(&[[1.0, 0.0], [0.0, -1.4]]);
    // To the second room through the walls, with a covered scanner; its map begins where the wheels say.
    while let Some((forward_m, yaw_rad)) = drive.robot.step_to([12.0, -1.4]) {
        drive.robot.step(forward_m, yaw_rad);
        drive.localizer.update(&drive.robot.wheel, drive.robot.time_ns, None);
    }
    drive.localizer.lose(LostReason::Carried);
    drive.localizer.continue_by_wheels();
    drive.tour(&[[13.0, 0.0], [12.0, -1.4]]);
    assert_eq!(drive.lost, []);
    drive.localizer.lose(LostReason::Carried);
    drive.search();
    assert!(drive.is_lost() && drive.localizer.scans_searched() > 10);
}

#[test]
fn a_lost_robot_goes_on_from_a_snapshot_to_the_bit() {
    let mut drive = Drive::through_flat();
    drive.robot.carry_to(Pose2::new(1.6, 5.2, 2.0));
    let mut second: Option<Localizer> = None;
    let mut found = false;
    for step in 0..150 {
        drive.robot.step(0.0, 2.0_f64.to_radians());
        let scan = drive.robot.scan();
        let wheel = drive.robot.wheel;
        let input = Some((&scan, &wheel));
        let time_ns = drive.robot.time_ns;
        let estimate = drive.localizer.update(&wheel, time_ns, input);
        if let Some(second) = &mut second {
            assert_eq!(second.update(&wheel, time_ns, input), estimate, "step {step}");
            found |= estimate.whereabouts == Whereabouts::Localized;
        }
        if step % 7 == 6 {
            let mut restored = Drive::new(TestRobot::in_flat(1)).localizer;
            restored.restore(&drive.localizer.snapshot()).unwrap();
            second = Some(restored);
        }
    }
    assert!(found);
}

#[test]
fn without_a_map_there_is_nothing_to_be_lost_in() {
    let mut drive = Drive::new(TestRobot::in_flat(1));
    drive.localizer.lose(LostReason::Loaded);
    assert!(!drive.is_lost());
    assert_eq!(drive.step(0.0, 0.0).whereabouts, Whereabouts::Localized);
}

/// The robot is put down within one scan, and stands or rotates there.
#[test]
fn a_robot_that_is_put_down_anywhere_in_a_known_flat_notices_it() {
    let mut trials = 0;
    for index in 0..80 {
        // Places and headings that are spread over the flat.
        let x_m = 0.6 + 8.0 * f64::from(index * 37 % 83) / 83.0;
        let y_m = 0.6 + 6.0 * f64::from(index * 53 % 79) / 79.0;
        let place = Pose2::new(x_m, y_m, wrap_angle(2.4 * f64::from(index)));
        let mut drive = Drive::through_flat();
        let free_m = (0..36).map(|k| cast(&drive.robot.walls, x_m, y_m, f64::from(k) * TAU / 36.0));
        if free_m.fold(f64::INFINITY, f64::min) < 0.3 {
            continue;
        }
        drive.robot.carry_to(place);
        drive.stand(8);
        assert!(!drive.lost.is_empty(), "{place:?} {:?}", drive.error());
        trials += 1;
    }
    assert!(trials > 50, "{trials}");
}
