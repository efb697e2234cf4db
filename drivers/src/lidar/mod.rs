//! The scanner that a robot's configuration names, whichever of the supported ones it is.

mod any;
mod config;

pub use any::{AnyLidar, AnyLidarError};
pub use config::{LidarConfig, LidarKind};
