//! Export of recordings into other formats.

mod dates;
mod folder;
#[cfg(feature = "lerobot")]
mod lerobot;
mod maps;
mod mcap_file;
mod ros2;
mod ticks;
mod tum;
mod viewer;

#[cfg(feature = "lerobot")]
pub use lerobot::{LerobotSummary, lerobot};
pub use mcap_file::mcap;
pub use ros2::{RosbagSummary, ros2};
pub use tum::{TumSummary, tum};
pub use viewer::{ViewerSummary, viewer, viewer_of_bytes};
