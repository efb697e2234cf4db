//! The boundary between devices and decisions.
//!
//! Four traits ([`Camera`], [`Lidar`], [`Base`], [`Clock`]) and the plain data that crosses them. A driver, the
//! simulator and a fault injector implement the traits; everything that decides is written against them.
//!
//! # Conventions
//!
//! * SI units. A field whose unit is not its type's says so in its name: `_m`, `_rad`, `_ns`, `_mps`, `_radps`.
//! * Right-handed frames as in REP-103 and REP-105: `map`, `odom`, `base_link` (x forward, y left, z up), `laser`
//!   (as `base_link`), `camera_optical` (x right, y down, z forward).
//! * A pose written `t_a_b` maps points of frame b into frame a, so `t_a_c = t_a_b * t_b_c`.
//! * Depth is z-depth (distance along the optical axis), in metres; `0.0` means "no depth here".
//! * Pixel centres are at integer coordinates.
//! * Time is one monotonic clock in nanoseconds, taken at the device (the kernel's timestamp where there is one).
//!
//! # For driver authors
//!
//! Every method is non-blocking: it returns within a millisecond, also when the device is gone. Reading a device is the
//! driver's own thread's work. A driver retries by itself (reopens by stable path, with backoff) and reports what it is
//! doing through its error's [`ErrorKind`]; a caller never has to reopen anything. Stale data is not data: a reading is
//! handed out once.
//!
//! # For callers
//!
//! Act on [`Error::kind`], print the error itself. An error is never a reason to keep the last reading.
#![no_std]
#![forbid(unsafe_code)]

extern crate alloc;

pub mod base;
pub mod camera;
pub mod camera_model;
pub mod clock;
pub mod depth;
pub mod error;
pub mod image;
pub mod lidar;
pub mod pose;
pub mod robot;
pub mod settings;

pub use base::{Base, DriveCommand, Twist2, WheelFeedback};
pub use camera::{Camera, Frame};
pub use camera_model::{CameraModel, Distortion};
pub use clock::{Clock, VirtualClock};
pub use depth::DepthMap;
pub use error::{Error, ErrorKind, ErrorType};
pub use image::{ImageError, ImageView, PixelFormat};
pub use lidar::{LaserScan, Lidar, Range, ScanGeometry};
pub use pose::{Pose2, Pose3, camera_mount, wrap_angle};
pub use robot::RobotDescription;
