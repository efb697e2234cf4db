//! Cameras of Linux's V4L2: USB cameras, CSI cameras behind an image processor, and simulated ones.
//!
//! From the bottom up:
//!
//! * [`VideoNode`](node::VideoNode): V4L2's operations. [`KernelNode`](sys::KernelNode) is the kernel's,
//!   [`RemoteNode`](remote::RemoteNode) a simulated camera in another process; tests have a strict model of the queue.
//! * [`Stream`](stream::Stream): what was agreed with one opened camera, and its queue of mapped buffers.
//! * [`Capture`](capture::Capture): a camera that comes and goes, as a state machine that is told the time.
//! * [`V4l2Camera`]: all of it behind [`hal::Camera`].
//!
//! Linux Media Subsystem documentation, "Video for Linux API", is the source of what is said about V4L2.

pub mod camera;
pub mod capture;
pub mod config;
mod controls;
pub mod error;
pub mod node;
pub mod remote;
pub mod stream;
pub mod sys;
pub mod wire;

pub use camera::{Agreement, V4l2Camera, check, open};
pub use capture::{Capture, Job, Opener, Picture};
pub use config::{CameraDeviceConfig, CameraFormat, Setting};
pub use error::V4l2Error;
