//! Reports on a run: `summary.json`, the table in the terminal, `map.png`, `depth.png` and
//! progress.

pub mod atomic;
pub mod canvas;
pub(crate) mod colors;
pub mod coverage;
pub mod depth_sample;
pub mod depth_sheet;
pub mod events;
pub mod latency;
pub mod map_picture;
pub mod map_view;
pub mod progress;
pub mod stuck;
pub mod summary;
pub mod table;
pub mod top_view;
