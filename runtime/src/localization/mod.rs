//! Where the robot is: two-dimensional localization and mapping from wheels, a planar LiDAR, and a gyroscope if there is one.
//!
//! The module is given wheel odometry, scans and their times, and returns poses. It opens nothing, reads no clock, and gives the
//! same poses for the same inputs, bit for bit.
//!
//! | term | meaning |
//! |---|---|
//! | `odom` | the frame of the local pose: smooth, drifts |
//! | `map` | the frame of the global pose: consistent, jumps when a loop is closed (REP-105) |
//! | stretch | some 10 cm of a surface as one scan saw it: a point, a normal, a weight |
//! | surfel | the same piece of surface merged from several scans |
//! | keyframe | a scan that is kept, with the robot's pose |
//! | prior | what the wheels say about the pose before the scan is matched |
//! | lost | the pose in `map` is not known; that in `odom` continues |

mod closing;
mod config;
mod drift;
mod driven_leg;
mod error;
mod global;
mod gyro_model;
mod local;
mod localizer;
mod lost;
#[cfg(test)]
mod lost_tests;
mod map_search;
mod matcher;
mod pose_graph;
mod relocalizer;
mod scan_points;
mod search_grid;
mod seen_through;
#[cfg(test)]
mod separate_maps_tests;
mod slip;
mod submaps;
mod surfel_grid;
#[cfg(test)]
pub(crate) mod test_room;
mod wheel_model;
mod yaw_errors;

pub use config::{LocalizationConfig, PoseSource};
pub use driven_leg::{DrivenLeg, ScanVariances};
pub use error::LocalizationError;
pub use global::Joined;
pub use localizer::{Closure, Estimate, Gyroscope, Localizer};
pub use lost::{LostReason, Whereabouts};
pub use matcher::ScanFit;
pub use slip::WheelError;
