use runtime::robot::{Robot, SavedMap};

use crate::snapshot::{ROBOT, run_ticks};

/// Arbitrary bytes as the map of a home. They are refused, or they can be shown and the robot begins in them.
pub fn map_state(bytes: &[u8]) {
    if let Ok(map) = SavedMap::read(bytes) {
        assert!(map.t_map_base.is_finite());
        assert!(map.grid.known_cells().count() <= ROBOT_CELLS);
    }
    let mut robot = Robot::new(ROBOT.clone(), None).expect("a robot");
    if robot.load_map_state(bytes).is_ok() {
        run_ticks(&mut robot);
    }
}

/// Largest grid that a configuration allows.
const ROBOT_CELLS: usize = 4096 * 4096;
