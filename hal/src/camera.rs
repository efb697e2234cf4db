//! The camera trait, and the frame into which a camera copies its data.

use alloc::vec::Vec;

use crate::{CameraModel, ErrorType, ImageError, ImageView, PixelFormat};

/// A camera frame that owns its memory. It is meant to be reused: a driver overwrites it and grows
/// the buffer at most once.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Middle of the exposure on the monotonic clock.
    pub time_ns: u64,
    /// The camera's own frame counter; a gap is a lost frame.
    pub sequence: u32,
    pub width: usize,
    pub height: usize,
    pub format: PixelFormat,
    pub data: Vec<u8>,
}

impl Frame {
    #[must_use]
    pub fn empty() -> Self {
        Self {
            time_ns: 0,
            sequence: 0,
            width: 0,
            height: 0,
            format: PixelFormat::Rgb8,
            data: Vec::new(),
        }
    }

    /// Borrows the frame as an image.
    ///
    /// # Errors
    /// When the number of bytes does not match the size and format.
    pub fn view(&self) -> Result<ImageView<'_>, ImageError> {
        ImageView::new(self.width, self.height, self.format, &self.data)
    }
}

/// A camera on a robot.
///
/// * *Blocking*: no method blocks.
/// * *Freshness*: returns the newest frame and drops older ones, which the caller sees as a gap in
///   [`Frame::sequence`].
/// * *Unplug*: returns [`Disconnected`](crate::ErrorKind::Disconnected) until the driver has
///   reopened the device by its stable path. The first frame after that may have a different
///   exposure.
/// * *Retries*: the driver retries; the caller only polls.
pub trait Camera: ErrorType {
    /// Intrinsics of the frames that this camera returns.
    fn model(&self) -> &CameraModel;

    /// Copies the newest frame into `frame` and returns true. Returns false when there is no frame
    /// that was not returned before.
    ///
    /// # Errors
    /// [`Timeout`](crate::ErrorKind::Timeout) when no frame has arrived for longer than two frame
    /// periods.
    fn poll_frame(&mut self, frame: &mut Frame) -> Result<bool, Self::Error>;
}
