//! How much floor that the map does not know might be seen from a place.

use core::f64::consts::TAU;

use crate::mapping::{CellState, OccupancyGrid};

/// Rays around the place. At 2 m they are 0.26 m apart.
const RAYS: u32 = 48;

/// Unknown floor around a place in `map`, metres, up to obstacles and to the range at which the map takes floor for free; in square
/// metres.
pub(super) fn unseen_m2(map: &OccupancyGrid, [x_m, y_m]: [f64; 2]) -> f64 {
    let rays = (0..RAYS).map(|ray| f64::from(ray) * TAU / f64::from(RAYS));
    rays.map(|bearing_rad| unseen_along_m2(map, [x_m, y_m], bearing_rad)).sum()
}

/// The part of one ray: the area of its sector where the map is unknown.
fn unseen_along_m2(map: &OccupancyGrid, [x_m, y_m]: [f64; 2], bearing_rad: f64) -> f64 {
    let (sin, cos) = bearing_rad.sin_cos();
    let step_m = map.cell_m();
    let steps = (f64::from(map.config().clear_range_m) / step_m) as u32;
    let mut unseen_m2 = 0.0;
    for step in 1..=steps {
        let range_m = f64::from(step) * step_m;
        match map.state_at(x_m + range_m * cos, y_m + range_m * sin) {
            CellState::Occupied => break,
            CellState::Unknown => unseen_m2 += range_m * step_m * TAU / f64::from(RAYS),
            CellState::Free => {}
        }
    }
    unseen_m2
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mapping::{MapConfig, Sweep};
    use core::f64::consts::PI;
    use hal::{LaserScan, Pose2, Range, ScanGeometry};

    /// Area of the disc that the default map may clear at once, square metres.
    const DISC_M2: f64 = PI * 2.0 * 2.0;

    /// A map after scans from the origin, forward and backward, within a ring of this radius.
    fn ring(radius_m: f32) -> OccupancyGrid {
        let mut map = OccupancyGrid::new(&MapConfig::default()).unwrap();
        let geometry = ScanGeometry::UTM_30LX;
        for yaw_rad in [0.0, PI] {
            let pose = Pose2::new(0.0, 0.0, yaw_rad);
            let ranges = vec![Range::Hit(radius_m); geometry.beams];
            map.begin_update(&pose).unwrap();
            map.integrate_scan(&LaserScan { time_ns: 0, geometry, ranges }, &Sweep::at_rest(pose))
                .unwrap();
            map.finish_update();
        }
        map
    }

    #[test]
    fn everything_within_reach_may_be_seen_where_nothing_is_known() {
        let map = OccupancyGrid::new(&MapConfig::default()).unwrap();
        let unseen_m2 = unseen_m2(&map, [0.01, 0.02]);
        assert!((unseen_m2 / DISC_M2 - 1.0).abs() < 0.02, "{unseen_m2}");
    }

    #[test]
    fn nothing_is_seen_behind_obstacles() {
        let map = ring(1.5);
        assert!(unseen_m2(&map, [0.0, 0.0]) < 0.1, "{}", unseen_m2(&map, [0.0, 0.0]));
        // Outside of the ring, the half of the disc that the ring does not fill.
        let outside_m2 = unseen_m2(&map, [1.6, 0.0]);
        assert!((5.0..11.0).contains(&outside_m2), "{outside_m2}");
    }

    #[test]
    fn known_floor_counts_for_nothing_and_floor_behind_it_does() {
        // The scanner clears floor up to 2 m, and hits nothing.
        let map = ring(9.0);
        let middle_m2 = unseen_m2(&map, [0.0, 0.0]);
        let edge_m2 = unseen_m2(&map, [1.9, 0.0]);
        assert!(middle_m2 < 0.5, "{middle_m2}");
        assert!((0.4..0.7).contains(&(edge_m2 / DISC_M2)), "{edge_m2}");
    }
}
