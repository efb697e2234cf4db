//! The protocol and driver of Slamtec's RPLIDAR A1, A2, A3 and S2 (Slamtec, "RPLIDAR interface
//! protocol and application notes", LR001, version 2).
//!
//! The host sends requests, the scanner answers with a descriptor and data packets. A request to scan
//! is answered with packets until the next request: single measurements (standard scan) or capsules
//! of 32 or 40 (express scan). All numbers begin with their low byte; angles count clockwise.
//!
//! [`Request`], [`Descriptor`], [`Measurement`], [`Capsule`] and [`Decoder`] do no I/O and allocate
//! nothing. The compressed "ultra" capsules of the A3 are not read; its legacy express scan is.
//!
//! ```no_run
//! use drivers::rotary::Place;
//! use drivers::rplidar::{RplidarConfig, open};
//! use hal::{LaserScan, Lidar};
//!
//! let place = Place::new("/dev/serial/by-id/usb-Silicon_Labs_CP2102".parse()?);
//! let mut lidar = open(place, &RplidarConfig::default())?;
//! let mut scan = LaserScan::empty(lidar.geometry());
//! if lidar.poll_scan(&mut scan)? {
//!     println!("{} beams", scan.ranges.len());
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod capsule;
mod config;
mod decoder;
mod descriptor;
mod device;
mod error;
mod info;
mod measurement;
mod model;
mod request;

pub use capsule::{CAPSULE_BYTES, Capsule, Cell, Layout};
pub use config::RplidarConfig;
pub use decoder::Decoder;
pub use descriptor::{DESCRIPTOR_BYTES, Descriptor};
pub use device::open;
pub use error::AnswerError;
pub use info::{Health, HealthState, Info};
pub use measurement::{MEASUREMENT_BYTES, Measurement};
pub use model::{Model, ModelSpec, MotorControl, ScanMode};
pub use request::{REQUEST_BYTES, Request};

use measurement::FULL_CIRCLE_Q6;
