//! The camera.

use alloc::vec::Vec;

use crate::{CameraModel, ErrorType, ImageError, ImageView, PixelFormat};

/// One picture with its own memory, made to be reused: a driver writes into it and grows it at most once.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Middle of the exposure, monotonic.
    pub time_ns: u64,
    /// The camera's own frame counter; a gap is a lost frame.
    pub sequence: u32,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// How `data` is laid out.
    pub format: PixelFormat,
    /// The picture's bytes.
    pub data: Vec<u8>,
}

impl Frame {
    /// An empty frame to hand to [`Camera::poll_frame`].
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

    /// The picture.
    ///
    /// # Errors
    /// When the bytes do not fit the size and format.
    pub fn view(&self) -> Result<ImageView<'_>, ImageError> {
        ImageView::new(self.width, self.height, self.format, &self.data)
    }
}

/// A camera on a robot.
///
/// * *Blocking*: none.
/// * *Freshness*: hands out the newest frame and drops older ones; a caller sees the loss as a gap in
///   [`Frame::sequence`].
/// * *Unplug*: [`Disconnected`](crate::ErrorKind::Disconnected) until the driver has reopened it by its stable path; the
///   first frame after that may follow a jump in exposure.
/// * *Who retries*: the driver.
pub trait Camera: ErrorType {
    /// Intrinsics of the frames that this camera hands out.
    fn model(&self) -> &CameraModel;

    /// Copies the newest frame that was not handed out before into `frame` and returns true; false when there is none.
    ///
    /// # Errors
    /// [`Timeout`](crate::ErrorKind::Timeout) when no frame has come for longer than two frame periods.
    fn poll_frame(&mut self, frame: &mut Frame) -> Result<bool, Self::Error>;
}
