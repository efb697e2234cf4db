//! What is where: a local occupancy map around the robot, in `odom`.
//!
//! One update of the map is [`OccupancyGrid::begin_update`], any number of observations, then
//! [`OccupancyGrid::finish_update`]. Observations only collect evidence; finishing applies it, so within one update an
//! occupied cell wins over a free one whatever came first.

mod bits;
mod cell;
mod components;
mod config;
mod error;
mod frame_map;
mod frontier;
mod grid;
mod inconsistency;
mod rays;
mod scan;
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
#[cfg(test)]
pub(crate) use scan::line;
pub use window::CellBox;
