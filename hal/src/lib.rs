//! The hardware abstraction layer: the boundary between devices and the code that decides.
//!
//! Five traits ([`Camera`], [`Lidar`], [`Base`], [`Imu`], [`Clock`]) and the plain data that they exchange.
//! Drivers, the simulator and the fault injectors implement the traits; perception, mapping,
//! planning and safety are written against them. `examples/fake_devices.rs` is the smallest
//! complete implementation, to copy when porting a new device.
//!
//! # Conventions
//!
//! * SI units. The name of a number ends with its unit: `_m`, `_rad`, `_ns`, `_mps`, `_radps`.
//! * Right-handed frames as in REP-103 and REP-105: `map`, `odom`, `base_link` (x forward, y left,
//!   z up), `laser` (as `base_link`), `imu`, `camera_optical` (x right, y down, z forward).
//! * A pose written `t_a_b` maps points of frame b into frame a, so `t_a_c = t_a_b * t_b_c`.
//! * Depth is z-depth (distance along the optical axis), in metres; `0.0` means "no depth here".
//! * Pixel centres are at integer coordinates.
//! * All times are of one monotonic clock, in nanoseconds, and are taken at the device (the
//!   kernel's timestamp where there is one).
//!
//! # For driver authors
//!
//! No method may block: each returns within a millisecond, even when the device is absent. A driver
//! reads its device on a thread of its own. It reopens the device automatically (by stable path,
//! with back-off) and reports its state through the [`ErrorKind`] of its errors, so a caller never
//! has to reopen anything. A reading is returned once: a driver must not return stale data as new.
//!
//! # For callers
//!
//! Act on [`Error::kind`] and print the error itself. After an error, do not go on using the last
//! reading.
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
pub mod imu;
pub mod lidar;
pub mod mount;
pub mod pose;
pub mod robot;
pub mod settings;

pub use base::{Base, DriveCommand, PowerReport, StopCause, Twist2, WheelFeedback};
pub use camera::{Camera, Frame};
pub use camera_model::{CameraModel, Distortion};
pub use clock::{Clock, VirtualClock};
pub use depth::DepthMap;
pub use error::{Error, ErrorKind, ErrorType};
pub use image::{ImageError, ImageView, PixelFormat};
pub use imu::{Imu, ImuMount, ImuSample};
pub use lidar::{LaserScan, Lidar, Range, ScanGeometry};
pub use mount::{CameraMount, LidarMount, camera_mount};
pub use pose::{Pose2, Pose3, wrap_angle};
pub use robot::RobotDescription;
