//! The local occupancy map around the robot, in `odom`.
//!
//! One update of the map consists of [`OccupancyGrid::begin_update`], any number of observations,
//! and [`OccupancyGrid::finish_update`]. Observations only collect evidence and finishing applies
//! it. So within one update an occupied observation of a cell wins over a free one, in whatever
//! order they arrive.

mod bits;
mod cell;
mod components;
mod config;
mod error;
mod frame_evidence;
mod frame_map;
mod frontier;
mod grid;
mod ground;
#[cfg(test)]
mod ground_tests;
mod inconsistency;
mod rays;
mod recompose;
mod scan;
mod surfaces;
#[cfg(test)]
mod surfaces_tests;
mod sweep;
#[cfg(test)]
mod tests;
mod window;

pub use cell::{Cell, CellState};
pub use config::{LidarUse, MapConfig};
pub use error::MapError;
pub use frame_map::{FrameCell, FrameMapper, SingleFrameMap};
pub use frontier::{Frontier, FrontierFinder};
pub use grid::OccupancyGrid;
pub use inconsistency::{Inconsistency, inconsistencies};
pub use recompose::{Corrections, Recomposed, Recomposition, Wins};
#[cfg(test)]
pub(crate) use scan::cells_on_line;
pub use surfaces::Surfaces;
pub use sweep::Sweep;
pub use window::CellBox;
