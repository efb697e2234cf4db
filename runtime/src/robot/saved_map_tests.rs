use hal::Pose2;

use super::test_robot::{GEOMETRY, cells, config, drive, robot, stand};
use super::*;
use crate::localization::{LocalizationConfig, PoseSource};
use crate::mapping::MapConfig;

#[test]
fn a_loaded_map_is_the_saved_one_and_the_robot_goes_on_at_its_pose() {
    let mut first = robot();
    let truth = drive(&mut first);
    let mut second = robot();
    second.load_map_state(&first.map_state()).unwrap();
    assert_eq!(cells(second.map()), cells(first.map()));
    assert_eq!(second.poses(), first.poses());
    assert_eq!(second.scanner(), first.scanner());
    // The wheels of the next run count from zero.
    let decision = stand(&mut second, 0, &truth, Pose2::IDENTITY);
    let moved = decision.t_map_base().inverse().compose(&first.poses().t_map_base());
    assert!(moved.x_m.hypot(moved.y_m) < 0.01 && moved.yaw_rad.abs() < 0.01, "{moved:?}");
    let ahead = Pose2::new(truth.x_m + 0.2, 0.0, 0.0);
    let decision = stand(&mut second, 1, &ahead, Pose2::new(0.2, 0.0, 0.0));
    assert!(decision.t_map_base().distance_m(&ahead) < 0.02, "{:?}", decision.t_map_base());
}

#[test]
fn a_robot_with_a_loaded_map_that_begins_from_a_snapshot_decides_the_same() {
    let mut first = robot();
    let truth = drive(&mut first);
    let mut second = robot();
    second.load_map_state(&first.map_state()).unwrap();
    let mut third = robot();
    third.restore(&second.snapshot()).unwrap();
    for tick in 0..10 {
        let wheel = Pose2::new(-0.03 * tick as f64, 0.0, 0.0);
        let at = truth.compose(&wheel);
        let decision = stand(&mut second, tick, &at, wheel);
        assert_eq!(stand(&mut third, tick, &at, wheel), decision);
    }
}

#[test]
fn a_map_that_is_cut_anywhere_or_too_long_is_refused_and_leaves_the_robot_as_it_was() {
    let mut first = robot();
    drive(&mut first);
    let state = first.map_state();
    let mut second = robot();
    let before = second.snapshot();
    for len in (0..60).chain((60..state.len()).step_by(state.len() / 40)) {
        let refusal = second.load_map_state(&state[..len]).unwrap_err();
        assert!(matches!(refusal, MapStateError::Damaged(_)), "{len}: {refusal}");
    }
    let longer = [state.as_slice(), &[0]].concat();
    assert!(matches!(second.load_map_state(&longer), Err(MapStateError::Damaged(_))));
    assert!(second.snapshot() == before);
}

/// The layout of maps before robots had several.
#[test]
fn a_map_of_the_layout_before_is_read() {
    let mut first = robot();
    drive(&mut first);
    let mut added = Vec::new();
    first.separate_maps.write(&mut added);
    let state = first.map_state();
    let mut older = Vec::new();
    // The other maps stand before localization, and what localization knows of them at the end.
    let mut location = Vec::new();
    State::write(&first.location, &mut location);
    let mut at_end = Vec::new();
    first.location.write_layout_14(&mut at_end);
    let until = state.len() - at_end.len() - location.len() - added.len();
    older.extend_from_slice(&2_u32.to_le_bytes());
    older.extend_from_slice(&state[4..until]);
    older.extend_from_slice(&location);
    let mut second = robot();
    second.load_map_state(&older).unwrap();
    assert_eq!(cells(second.map()), cells(first.map()));
    assert_eq!((second.maps(), SavedMap::read(&older).unwrap().maps), (1, 1));
    assert_eq!(second.poses(), first.poses());
}

#[test]
fn a_map_of_another_configuration_is_refused_by_its_key() {
    let mut first = robot();
    drive(&mut first);
    let state = first.map_state();
    let map = MapConfig { cell_m: 0.05, ..config().map };
    assert_eq!(refused_key(&state, RobotConfig { map, ..config() }), "map.cell_m");
    let map = MapConfig { side_cells: 300, ..config().map };
    assert_eq!(refused_key(&state, RobotConfig { map, ..config() }), "map.side_cells");
    for (t_base_laser, key) in [
        (Pose2::new(0.1, 0.0, 0.0), "lidar.forward_m"),
        (Pose2::new(0.0, 0.1, 0.0), "lidar.left_m"),
        (Pose2::new(0.0, 0.0, 0.1), "lidar.yaw_deg"),
    ] {
        assert_eq!(refused_key(&state, RobotConfig { t_base_laser, ..config() }), key);
    }
    let localization = LocalizationConfig { source: PoseSource::Wheels, ..config().localization };
    assert_eq!(
        refused_key(&state, RobotConfig { localization, ..config() }),
        "localization.source"
    );
}

fn refused_key(state: &[u8], config: RobotConfig) -> &'static str {
    let mut other = Robot::new(config, None).unwrap();
    match other.load_map_state(state) {
        Err(MapStateError::OtherRobot { key, .. }) => key,
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_map_of_another_layout_is_refused_by_its_number() {
    let mut state = robot().map_state();
    state[0] ^= 0x40;
    let found = MAP_STATE_VERSION ^ 0x40;
    assert_eq!(robot().load_map_state(&state), Err(MapStateError::Version { found }));
}

#[test]
fn a_map_can_be_shown_without_a_robot() {
    let mut first = robot();
    drive(&mut first);
    let shown = SavedMap::read(&first.map_state()).unwrap();
    assert_eq!(cells(&shown.grid), cells(first.map()));
    assert_eq!(shown.t_map_base, first.poses().t_map_base());
    assert!(shown.submaps >= 1);
    assert_eq!(shown.scanner.map(|scanner| scanner.beams), Some(GEOMETRY.beams));
}
