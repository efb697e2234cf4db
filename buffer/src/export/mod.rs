//! Recordings in other layouts.

mod folder;
mod joined;
mod ros2;
mod tum;
mod turns;

pub use joined::joined;
pub use ros2::{Bagged, ros2};
pub use tum::{Exported, tum};
