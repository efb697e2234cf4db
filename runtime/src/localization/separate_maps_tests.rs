//! Robots that do not find themselves, begin another map, and come to a place of the one before.

use super::lost_tests::Drive;
use super::test_room::{FLAT_TOUR, TestRobot, Wall, furnished_room};
use super::*;
use hal::Pose2;

/// Rooms of the flat that the robot has mapped: those on the left, and the corridor before them.
const LEFT: &[[f64; 2]] = FLAT_TOUR.split_at(11).0;
/// Rooms on the right, seen from their middle.
const RIGHT: [[f64; 2]; 5] = [[7.45, 2.0], [7.45, 2.4], [7.45, 3.7], [8.45, 3.7], [8.45, 5.5]];
/// From there through the corridor into the first room on the left.
const BACK: [[f64; 2]; 5] = [[8.45, 3.7], [5.9, 3.75], [1.95, 3.6], [1.95, 2.2], [3.0, 1.5]];

/// A robot that knows the left half, was put into the right one, and has begun another map there.
fn in_another_map() -> Drive {
    let mut drive = Drive::new(TestRobot::in_flat(1));
    drive.tour(LEFT);
    drive.robot.carry_to(Pose2::new(5.2, 1.8, 1.0));
    drive.stand(6);
    assert_eq!(drive.search(), 360);
    drive.localizer.begin_map();
    assert!(!drive.is_lost());
    assert_eq!((drive.localizer.map(), drive.localizer.maps()), (1, 2));
    drive
}

/// Drives to places. Returns what moved each time that two maps met.
fn meetings(drive: &mut Drive, places: &[[f64; 2]]) -> Vec<Joined> {
    let mut found = Vec::new();
    for place in places {
        while let Some((forward_m, yaw_rad)) = drive.robot.step_to(*place) {
            found.extend(drive.step(forward_m, yaw_rad).joined);
        }
    }
    found
}

#[test]
fn a_robot_that_begins_another_map_joins_both_where_they_meet_and_every_submap_is_right() {
    let mut drive = in_another_map();
    let left = drive.submaps_in_map().len() - 1;
    assert_eq!(meetings(&mut drive, &RIGHT), []);
    let right = drive.submaps_in_map().len();
    assert!((left..right).all(|submap| drive.localizer.map_of(submap) == 1));
    let joined = meetings(&mut drive, &BACK);
    assert_eq!(joined.len(), 1);
    assert_eq!(joined[0].moved, 1);
    assert_eq!((drive.localizer.map(), drive.localizer.maps()), (0, 1));
    drive.assert_right(0.06);
    // And so it is in the right half, which was mapped before both met.
    meetings(&mut drive, &[[1.95, 2.2], [1.95, 3.6], [5.9, 3.75], [7.45, 3.7], [7.45, 2.2]]);
    drive.assert_right(0.06);
    assert_eq!(drive.lost.len(), 1);
}

#[test]
fn loops_are_closed_between_both_parts_of_a_joined_map() {
    let mut drive = in_another_map();
    let first_right = drive.localizer.submap();
    meetings(&mut drive, &RIGHT);
    meetings(&mut drive, &BACK);
    meetings(&mut drive, &[[1.95, 2.2], [1.95, 3.6], [3.45, 3.7]]);
    drive.stand(100);
    let across = drive
        .localizer
        .held_closures()
        .filter(|closure| closure.from < first_right && closure.to >= first_right);
    // One of them is the place where both maps met.
    assert!(across.count() > 1);
}

#[test]
fn in_another_home_the_maps_are_never_joined_and_the_first_stays_as_it_is() {
    let mut drive = Drive::new(TestRobot::in_flat(1));
    drive.tour(&FLAT_TOUR);
    let before = drive.submaps_in_map();
    drive.robot.walls = furnished_room();
    drive.robot.carry_to(Pose2::new(0.0, -1.4, 0.0));
    drive.stand(6);
    drive.search();
    drive.localizer.begin_map();
    let round: [[f64; 2]; 4] = [[1.0, -1.4], [3.0, -1.4], [3.0, 0.4], [0.0, 0.4]];
    for _ in 0..4 {
        assert_eq!(meetings(&mut drive, &round), []);
    }
    assert_eq!(drive.localizer.maps(), 2);
    assert!(drive.localizer.scans_searched() > 20, "{}", drive.localizer.scans_searched());
    let after = drive.submaps_in_map();
    for (before, after) in before.iter().zip(after) {
        assert!(before.distance_m(&after) < 1e-6, "{before:?} {after:?}");
    }
}

#[test]
fn a_robot_with_two_maps_goes_on_from_a_snapshot_to_the_bit() {
    let mut first = in_another_map();
    meetings(&mut first, &RIGHT);
    // In the middle of a search.
    let mut second =
        Localizer::new(&LocalizationConfig::default(), first.robot.geometry, Pose2::IDENTITY)
            .unwrap();
    second.restore(&first.localizer.snapshot()).unwrap();
    let mut joined = 0;
    for place in BACK {
        while let Some((forward_m, yaw_rad)) = first.robot.step_to(place) {
            first.robot.step(forward_m, yaw_rad);
            let scan = first.robot.scan();
            let scan = Some((&scan, &first.robot.wheel));
            let time_ns = first.robot.time_ns;
            let estimate = first.localizer.update(&first.robot.wheel, time_ns, scan);
            assert_eq!(second.update(&first.robot.wheel, time_ns, scan), estimate);
            joined += usize::from(estimate.joined.is_some());
        }
    }
    assert_eq!(joined, 1);
}

#[test]
fn a_robot_that_is_lost_in_its_second_map_finds_itself_in_the_first() {
    let mut drive = in_another_map();
    meetings(&mut drive, &RIGHT);
    drive.robot.carry_to(Pose2::new(1.6, 5.2, 2.0));
    drive.stand(6);
    assert_eq!(drive.lost.len(), 2);
    assert!(drive.search() < 180);
    assert_eq!((drive.localizer.map(), drive.localizer.maps()), (0, 2));
    drive.assert_right(0.06);
    // From here it can meet the second map in the same way.
    let joined = meetings(&mut drive, &[[3.45, 5.5], [3.45, 3.7], [7.45, 3.7], [7.45, 2.2]]);
    assert_eq!((joined.len(), drive.localizer.maps()), (1, 1));
    // The older map keeps its frame, although the robot was in it.
    assert_eq!((joined[0].moved, drive.localizer.map()), (1, 0));
    drive.assert_right(0.06);
}

#[test]
fn a_robot_that_keeps_to_its_map_neither_joins_another_nor_finds_itself_in_one() {
    let mut drive = in_another_map();
    drive.localizer.stay_in_map(true);
    meetings(&mut drive, &RIGHT);
    assert_eq!(meetings(&mut drive, &BACK), []);
    // Where both maps show the place, it is found in its own.
    drive.robot.carry_to(Pose2::new(7.45, 2.2, 2.0));
    drive.stand(6);
    assert!(drive.search() < 180);
    assert_eq!((drive.localizer.map(), drive.localizer.maps()), (1, 2));
    drive.localizer.stay_in_map(false);
    drive.tour(&[[7.45, 3.7], [5.9, 3.75], [1.95, 3.6], [1.95, 2.2], [3.0, 1.5]]);
    assert_eq!((drive.localizer.map(), drive.localizer.maps()), (0, 1));
}

#[test]
fn a_robot_that_is_not_lost_begins_no_other_map() {
    let mut drive = Drive::new(TestRobot::in_flat(1));
    drive.tour(&FLAT_TOUR[..2]);
    drive.localizer.begin_map();
    assert_eq!((drive.localizer.map(), drive.localizer.maps()), (0, 1));
    let walls: Vec<Wall> = Vec::new();
    let mut blind = Drive::new(TestRobot::new(walls, 1));
    blind.localizer.lose(LostReason::Loaded);
    blind.localizer.begin_map();
    assert_eq!(blind.localizer.maps(), 0);
}
