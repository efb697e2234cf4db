//! What a video node can be asked: V4L2's operations, one method each, with V4L2's own meaning and error numbers.
//!
//! The streaming logic is written against [`VideoNode`], so that it can be driven by the kernel, by a simulated camera in
//! another process and by a strict model of the kernel's queue.

use std::fmt;
use std::os::fd::OwnedFd;

use rustix::io::Errno;

/// A pixel format's name: four letters, the first in the lowest byte.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct FourCc(pub u32);

impl FourCc {
    /// YUV 4:2:2 packed.
    pub const YUYV: Self = Self::new(b"YUYV");
    /// YUV 4:2:0, both planes in one piece of memory.
    pub const NV12: Self = Self::new(b"NV12");
    /// 24 bits, red first.
    pub const RGB24: Self = Self::new(b"RGB3");
    /// Motion JPEG.
    pub const MJPEG: Self = Self::new(b"MJPG");
    /// JPEG files one after the other: what some drivers call the same.
    pub const JPEG: Self = Self::new(b"JPEG");

    /// From its letters.
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

/// What a node is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Capability {
    /// Hands out pictures in one piece of memory each.
    pub capture: bool,
    /// Hands out pictures through the multi-planar interface.
    pub capture_planes: bool,
    /// Buffers can be mapped.
    pub streaming: bool,
}

/// How pictures lie in memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Layout {
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Pixel format.
    pub format: FourCc,
    /// Bytes from one row to the next, of the first plane; 0 for compressed formats.
    pub stride: u32,
    /// Bytes that a picture may have.
    pub size: u32,
    /// Separate pieces of memory that make one picture.
    pub planes: u32,
}

/// Time between two pictures, in seconds, as a fraction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Interval {
    /// Above the line.
    pub numerator: u32,
    /// Below it.
    pub denominator: u32,
}

impl Interval {
    /// Nanoseconds; `None` when the node does not know.
    #[must_use]
    pub fn ns(self) -> Option<u64> {
        (u64::from(self.numerator) * 1_000_000_000)
            .checked_div(u64::from(self.denominator))
            .filter(|ns| *ns > 0)
    }
}

/// A control: exposure, gain and the like.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Control {
    /// V4L2's number of it.
    pub id: u32,
    /// The driver's name of it.
    pub name: String,
    /// Smallest value.
    pub minimum: i32,
    /// Largest value.
    pub maximum: i32,
    /// Values are `minimum` and whole steps above it.
    pub step: i32,
    /// It cannot be used on this node.
    pub disabled: bool,
}

/// A buffer that came back from the node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Filled {
    /// Which buffer.
    pub index: u32,
    /// Bytes of the picture in it.
    pub bytes_used: u32,
    /// The node's count of pictures.
    pub sequence: u32,
    /// When, on `CLOCK_MONOTONIC`; `None` when the node does not say on which clock it stamps.
    pub time_ns: Option<u64>,
    /// The stamp is the start of the exposure; otherwise the end of the picture.
    pub stamped_at_start: bool,
    /// The node says itself that the content is damaged.
    pub damaged: bool,
}

/// An open video node.
///
/// Every method has the meaning of the ioctl of its name, and the kernel's error numbers. None waits for a picture; opening,
/// [`set_layout`](Self::set_layout) and [`start`](Self::start) may take as long as the device takes.
pub trait VideoNode: Send {
    /// `VIDIOC_QUERYCAP`.
    ///
    /// # Errors
    /// `ENODEV` when it is gone, as every method here; `ENOTTY` when it is no video node.
    fn capability(&mut self) -> Result<Capability, Errno>;

    /// `VIDIOC_ENUM_FMT`.
    ///
    /// # Errors
    /// `EINVAL` past the last format.
    fn format(&mut self, index: u32) -> Result<FourCc, Errno>;

    /// `VIDIOC_S_FMT`: what the node took, which may differ from what was asked.
    ///
    /// # Errors
    /// `EBUSY` while buffers are allocated, also by another program.
    fn set_layout(&mut self, asked: Layout) -> Result<Layout, Errno>;

    /// `VIDIOC_S_PARM` and `VIDIOC_G_PARM`: asks for an interval where there is a wish, and reads back what holds.
    ///
    /// # Errors
    /// `ENOTTY` when the node knows no intervals.
    fn interval(&mut self, wish: Option<Interval>) -> Result<Interval, Errno>;

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
    /// `EINVAL` or `ERANGE` when the value cannot be.
    fn set_control(&mut self, id: u32, value: i32) -> Result<(), Errno>;

    /// `VIDIOC_REQBUFS`, then `VIDIOC_QUERYBUF` and `mmap` of each: how many there are now, which may be more or fewer.
    ///
    /// # Errors
    /// `EBUSY` while streaming, also by another program.
    fn allocate(&mut self, count: u32) -> Result<u32, Errno>;

    /// `VIDIOC_QBUF`: hands the buffer to the node.
    ///
    /// # Errors
    /// `EINVAL` when the node has it already.
    fn queue(&mut self, index: u32) -> Result<(), Errno>;

    /// `VIDIOC_DQBUF`: takes the oldest filled buffer back.
    ///
    /// # Errors
    /// `EAGAIN` when none is filled, `EINVAL` when not streaming, `EIO` when streaming has failed for good.
    fn dequeue(&mut self) -> Result<Filled, Errno>;

    /// `VIDIOC_STREAMON`.
    ///
    /// # Errors
    /// `EINVAL` without buffers.
    fn start(&mut self) -> Result<(), Errno>;

    /// `VIDIOC_STREAMOFF`: every buffer comes back, empty.
    ///
    /// # Errors
    /// As every method here.
    fn stop(&mut self) -> Result<(), Errno>;

    /// `VIDIOC_EXPBUF`: the buffer as a dma-buf that another device can read.
    ///
    /// # Errors
    /// `ENOTTY` when the node cannot.
    fn export(&mut self, index: u32) -> Result<OwnedFd, Errno>;

    /// The memory of a buffer; empty while the node has it.
    fn bytes(&self, index: u32) -> &[u8];
}

/// Added to a control's number: the first control after that one (`V4L2_CTRL_FLAG_NEXT_CTRL`).
pub const NEXT_CONTROL: u32 = 0x8000_0000;

/// All formats of a node.
///
/// # Errors
/// When it is gone.
pub fn formats(node: &mut dyn VideoNode) -> Result<Vec<FourCc>, Errno> {
    let mut formats = Vec::new();
    // 64 bounds a node that never says no.
    for index in 0..64 {
        match node.format(index) {
            Ok(format) => formats.push(format),
            Err(Errno::INVAL) => break,
            Err(errno) => return Err(errno),
        }
    }
    Ok(formats)
}

/// All controls of a node.
///
/// # Errors
/// When it is gone.
pub fn controls(node: &mut dyn VideoNode) -> Result<Vec<Control>, Errno> {
    let mut controls: Vec<Control> = Vec::new();
    loop {
        let last = controls.last().map_or(0, |control| control.id);
        match node.control(last | NEXT_CONTROL) {
            // Numbers rise; a node whose do not would never end.
            Ok(control) if control.id > last => controls.push(control),
            Ok(_) | Err(Errno::INVAL | Errno::NOTTY) => return Ok(controls),
            Err(errno) => return Err(errno),
        }
    }
}
