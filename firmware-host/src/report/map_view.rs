//! Converts the occupancy grid for viewers (the `/map` channel and Rerun).

use runtime::mapping::{CellBox, CellState, OccupancyGrid};
use runtime::recording::MapView;

/// The known part of the map in the convention of ROS: -1 unknown, 0 free, 100 occupied. `None` if
/// nothing is known.
#[must_use]
pub fn map_view(map: &OccupancyGrid) -> Option<MapView> {
    let known: CellBox = map.known_box()?;
    let columns = known.width();
    let corner = map.center_m(known.min);
    let occupancy = map.known_states().into_iter().map(|state| match state {
        CellState::Unknown => -1,
        CellState::Free => 0,
        CellState::Occupied => 100,
    });
    let cell_m = map.cell_m();
    Some(MapView {
        origin_m: corner.map(|c| c - cell_m / 2.0),
        cell_m,
        columns,
        occupancy: occupancy.collect(),
    })
}
