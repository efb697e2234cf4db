//! The operations of a V4L2 video node, one method each, with V4L2's meaning and error numbers.
//!
//! The streaming logic is written against [`VideoNode`], so that it runs on a device of the kernel,
//! on a simulated camera in another process, and on a strict model of the kernel's queue.

use std::fmt;
use std::os::fd::OwnedFd;

use rustix::io::Errno;

/// The code of a pixel format: four letters, the first in the lowest byte.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct FourCc(pub u32);

impl FourCc {
    /// The code of YUV 4:2:2 packed.
    pub const YUYV: Self = Self::new(b"YUYV");
    /// The code of YUV 4:2:0 with both planes in one buffer.
    pub const NV12: Self = Self::new(b"NV12");
    /// The code of 24 bits per pixel, red first.
    pub const RGB24: Self = Self::new(b"RGB3");
    pub const MJPEG: Self = Self::new(b"MJPG");
    /// Another code that some drivers use for Motion JPEG.
    pub const JPEG: Self = Self::new(b"JPEG");

    #[must_use]
    pub const fn new(letters: &[u8; 4]) -> Self {
        Self(u32::from_le_bytes(*letters))
    }
}

impl fmt::Display for FourCc {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.0.to_le_bytes().escape_ascii())
    }
}

impl fmt::Debug for FourCc {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{self}")
    }
}

/// The capabilities of a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Capability {
    /// Captures frames of one buffer each (single-planar interface).
    pub capture: bool,
    /// Captures frames through the multi-planar interface.
    pub capture_planes: bool,
    /// Buffers can be mapped.
    pub streaming: bool,
}

impl Capability {
    /// Whether the node delivers frames. A camera has other nodes, too, such as for metadata.
    #[must_use]
    pub fn is_camera(self) -> bool {
        (self.capture || self.capture_planes) && self.streaming
    }
}

/// Size and memory layout of the frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Layout {
    pub width: u32,
    pub height: u32,
    pub format: FourCc,
    /// Bytes from one row of the first plane to the next; 0 for compressed formats.
    pub stride: u32,
    /// The largest number of bytes of a frame.
    pub size: u32,
    /// Number of separate buffers of one frame.
    pub planes: u32,
}

/// Time between two frames, in seconds, as a fraction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Interval {
    pub numerator: u32,
    pub denominator: u32,
}

impl Interval {
    /// The interval in nanoseconds. `None` when the node does not know it.
    #[must_use]
    pub fn ns(self) -> Option<u64> {
        (u64::from(self.numerator) * 1_000_000_000)
            .checked_div(u64::from(self.denominator))
            .filter(|ns| *ns > 0)
    }
}

/// A control of the camera, such as exposure or gain.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Control {
    /// V4L2's identifier of the control.
    pub id: u32,
    /// The kernel driver's name for the control.
    pub name: String,
    pub minimum: i32,
    pub maximum: i32,
    /// The allowed values are `minimum` plus multiples of this step.
    pub step: i32,
    /// The control cannot be used on this node.
    pub disabled: bool,
}

/// A filled buffer that was dequeued.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Filled {
    pub index: u32,
    /// Number of bytes of the frame.
    pub bytes_used: u32,
    /// The node's frame counter.
    pub sequence: u32,
    /// The timestamp on `CLOCK_MONOTONIC`. `None` when the node uses another or an unknown clock.
    pub time_ns: Option<u64>,
    /// The timestamp is that of the start of the exposure; otherwise that of the end of the frame.
    pub stamped_at_start: bool,
    /// The node reports that the content is damaged.
    pub damaged: bool,
}

/// An open video node.
///
/// Every method has the meaning and the error numbers of its ioctl. No method waits for a frame,
/// but opening, [`set_layout`](Self::set_layout) and [`start`](Self::start) may block for as long
/// as the device takes.
pub trait VideoNode: Send {
    /// `VIDIOC_QUERYCAP`.
    ///
    /// # Errors
    /// `ENODEV` when the device is gone, as for every method here; `ENOTTY` when it is not a video
    /// node.
    fn capability(&mut self) -> Result<Capability, Errno>;

    /// `VIDIOC_ENUM_FMT`.
    ///
    /// # Errors
    /// `EINVAL` past the last format.
    fn format(&mut self, index: u32) -> Result<FourCc, Errno>;

    /// `VIDIOC_S_FMT`. Returns the layout that the node selected, which may differ from the
    /// requested one.
    ///
    /// # Errors
    /// `EBUSY` while buffers are allocated, also by another program.
    fn set_layout(&mut self, requested: Layout) -> Result<Layout, Errno>;

    /// `VIDIOC_S_PARM` and `VIDIOC_G_PARM`: sets the desired interval, if any, and reads the actual
    /// one back.
    ///
    /// # Errors
    /// `ENOTTY` when the node has no frame intervals.
    fn interval(&mut self, desired: Option<Interval>) -> Result<Interval, Errno>;

    /// `VIDIOC_QUERYCTRL`; with [`NEXT_CONTROL`] added to `id`, the first control after it.
    ///
    /// # Errors
    /// `EINVAL` when there is none.
    fn control(&mut self, id: u32) -> Result<Control, Errno>;

    /// `VIDIOC_G_CTRL`.
    ///
    /// # Errors
    /// `EINVAL` when there is no such control.
    fn control_value(&mut self, id: u32) -> Result<i32, Errno>;

    /// `VIDIOC_S_CTRL`.
    ///
    /// # Errors
    /// `EINVAL` or `ERANGE` when the value is not allowed.
    fn set_control(&mut self, id: u32, value: i32) -> Result<(), Errno>;

    /// `VIDIOC_REQBUFS`, then `VIDIOC_QUERYBUF` and `mmap` of each buffer. Returns the number of
    /// buffers, which may be larger or smaller than `count`.
    ///
    /// # Errors
    /// `EBUSY` while streaming, also by another program.
    fn allocate(&mut self, count: u32) -> Result<u32, Errno>;

    /// `VIDIOC_QBUF`: passes the buffer to the node.
    ///
    /// # Errors
    /// `EINVAL` when the buffer is queued already.
    fn queue(&mut self, index: u32) -> Result<(), Errno>;

    /// `VIDIOC_DQBUF`: dequeues the oldest filled buffer.
    ///
    /// # Errors
    /// `EAGAIN` when none is filled, `EINVAL` when not streaming, `EIO` when streaming has failed
    /// for good.
    fn dequeue(&mut self) -> Result<Filled, Errno>;

    /// `VIDIOC_STREAMON`.
    ///
    /// # Errors
    /// `EINVAL` without buffers.
    fn start(&mut self) -> Result<(), Errno>;

    /// `VIDIOC_STREAMOFF`: removes every buffer from the queue, empty.
    ///
    /// # Errors
    /// `ENODEV` when the device is gone.
    fn stop(&mut self) -> Result<(), Errno>;

    /// `VIDIOC_EXPBUF`: the buffer as a dma-buf that another device can read.
    ///
    /// # Errors
    /// `ENOTTY` when the node cannot export buffers.
    fn export(&mut self, index: u32) -> Result<OwnedFd, Errno>;

    /// The memory of a buffer; empty while the buffer is queued.
    fn bytes(&self, index: u32) -> &[u8];
}

/// Added to a control id to query the first control after it (`V4L2_CTRL_FLAG_NEXT_CTRL`).
pub const NEXT_CONTROL: u32 = 0x8000_0000;

/// Lists the formats of a node.
///
/// # Errors
/// When the device is gone.
pub fn formats(node: &mut dyn VideoNode) -> Result<Vec<FourCc>, Errno> {
    let mut formats = Vec::new();
    // The limit of 64 ends the loop for a node that never returns EINVAL.
    for index in 0..64 {
        match node.format(index) {
            Ok(format) => formats.push(format),
            Err(Errno::INVAL) => break,
            Err(errno) => return Err(errno),
        }
    }
    Ok(formats)
}

/// Lists the controls of a node.
///
/// # Errors
/// When the device is gone.
pub fn controls(node: &mut dyn VideoNode) -> Result<Vec<Control>, Errno> {
    let mut controls: Vec<Control> = Vec::new();
    loop {
        let last = controls.last().map_or(0, |control| control.id);
        match node.control(last | NEXT_CONTROL) {
            // Ids must increase; otherwise the loop would not end.
            Ok(control) if control.id > last => controls.push(control),
            Ok(_) | Err(Errno::INVAL | Errno::NOTTY) => return Ok(controls),
            Err(errno) => return Err(errno),
        }
    }
}
