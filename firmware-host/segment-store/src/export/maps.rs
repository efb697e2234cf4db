//! The maps of a segment, which the recorder writes for viewers and a replay does not read.

use std::collections::BTreeMap;
use std::fs::File;
use std::path::Path;

use foxglove::{Decode, messages as fox};

use crate::error::StoreError;
use crate::recover::{Rewriter, failure};

/// Bytes of a cell: four of colour, then the occupancy.
const CELL_BYTES: usize = 5;

/// A map as in nav_msgs/OccupancyGrid.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Map {
    /// Corner of the first cell, in `map`, metres.
    pub origin_m: [f64; 2],
    /// Edge of a cell, metres.
    pub cell_m: f64,
    pub columns: u32,
    pub rows: u32,
    /// Row-major: -1 unknown, 0 free to 100 occupied.
    pub occupancy: Vec<i8>,
}

/// The maps of a segment by the time of their tick. Maps in damaged chunks are missing.
///
/// # Errors
/// When the segment is not an MCAP file or cannot be read.
pub(super) fn maps(segment: &Path) -> Result<BTreeMap<u64, Map>, StoreError> {
    let mut maps = BTreeMap::new();
    let file = File::open(segment).map_err(StoreError::read(segment))?;
    let mut reader =
        Rewriter::begin(std::io::sink()).map_err(|error| failure(error, segment, segment))?;
    reader
        .add_edited(&file, &mut |_, message| {
            if message.topic == "/map" {
                let grid = fox::Grid::decode(message.data).ok().and_then(|grid| map(&grid));
                maps.extend(grid.map(|map| (message.header.log_time, map)));
            }
            Ok(())
        })
        .map_err(|error| failure(error, segment, segment))?;
    Ok(maps)
}

/// `None` when the grid is not one that the recorder writes.
fn map(grid: &fox::Grid) -> Option<Map> {
    let columns = grid.column_count;
    let (cells, rest) = grid.data.as_chunks::<CELL_BYTES>();
    let is_ours = grid.cell_stride as usize == CELL_BYTES
        && columns > 0
        && rest.is_empty()
        && cells.len().is_multiple_of(columns as usize);
    let at = grid.pose.and_then(|pose| pose.position).filter(|_| is_ours)?;
    Some(Map {
        origin_m: [at.x, at.y],
        cell_m: grid.cell_size?.x,
        columns,
        rows: u32::try_from(cells.len() / columns as usize).ok()?,
        occupancy: cells.iter().map(|[.., value]| i8::from_le_bytes([*value])).collect(),
    })
}
