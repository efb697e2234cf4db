//! Recordings in other layouts.

mod folder;
mod joined;
#[cfg(feature = "lerobot")]
mod lerobot;
mod ros2;
mod tum;
mod turns;

pub use joined::joined;
#[cfg(feature = "lerobot")]
pub use lerobot::{ExportedEpisodes, lerobot};
pub use ros2::{Bagged, ros2};
pub use tum::{Exported, tum};
