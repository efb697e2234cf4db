//! Recordings in other layouts.

mod joined;
mod tum;

pub use joined::joined;
pub use tum::{Exported, tum};
