//! Recordings in other layouts.

mod joined;
#[cfg(feature = "lerobot")]
mod lerobot;
mod tum;
mod turns;

pub use joined::joined;
#[cfg(feature = "lerobot")]
pub use lerobot::{ExportedEpisodes, lerobot};
pub use tum::{Exported, tum};
