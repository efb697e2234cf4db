//! Export of recordings into other formats. ROS 2 and LeRobot have libraries of their own, so those exports are in the trainer
//! (`embodied-depth convert`).

mod dates;
mod folder;
mod mcap_file;
mod ticks;
mod tum;
mod viewer;

pub use mcap_file::mcap;
pub use tum::{TumSummary, tum};
pub use viewer::{ViewerSummary, viewer, viewer_of_bytes};
