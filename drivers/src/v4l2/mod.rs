//! Cameras of Linux's V4L2: USB cameras, CSI cameras behind an image signal processor, and
//! simulated cameras.
//!
//! From the bottom up:
//!
//! * [`VideoNode`](node::VideoNode): the operations of V4L2. [`KernelNode`](sys::KernelNode) is a
//!   device of the kernel, [`RemoteNode`](remote::RemoteNode) a simulated camera in another
//!   process. Tests implement a strict model of the queue.
//! * [`Stream`](stream::Stream): one opened camera with its negotiated format and its queue of
//!   mapped buffers.
//! * [`Capture`]: a camera that can be unplugged and reopened, as a state machine
//!   without a clock.
//! * [`V4l2Camera`]: all of this behind [`hal::Camera`].
//!
//! Statements about V4L2 are from the Linux Media Subsystem documentation, "Video for Linux API".

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

pub use camera::{Negotiated, Offer, V4l2Camera, check, offer, open};
pub use capture::{BorrowedFrame, Capture, Job, Opener};
pub use config::{CameraDeviceConfig, CameraFormat, Setting};
pub use error::V4l2Error;
