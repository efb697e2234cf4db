//! Why a picture cannot become the network's.

use hal::PixelFormat;

/// A front end that cannot be, or a picture that it refuses. The text says what was found, what is needed and the way out.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ImagingError {
    /// Intrinsics that no camera has.
    #[error(
        "the {role} camera is {found}; needed: 2x2 to 65535x65535 pixels, positive focal lengths, finite numbers; calibrate the camera again"
    )]
    Camera {
        /// `source` or `target`.
        role: &'static str,
        /// The model.
        found: String,
    },
    /// The picture to make has a lens.
    #[error(
        "the target camera has distortion ({found}); the network sees pinhole pictures: give the target no distortion"
    )]
    TargetDistortion {
        /// The distortion.
        found: String,
    },
    /// The camera cannot send this format at its size.
    #[error(
        "a camera of {width}x{height} cannot send {format:?}, whose pixels come in pairs; choose an even size"
    )]
    OddSize {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// The format.
        format: PixelFormat,
    },
    /// The format is newer than this code.
    #[error(
        "pictures in {format:?} cannot be converted; set the camera to YUYV, NV12, RGB8, GRAY8 or MJPEG"
    )]
    Format {
        /// The format.
        format: PixelFormat,
    },
    /// The two cameras look at different things.
    #[error(
        "no pixel of the target camera is in the source's picture; check focal lengths, centres and distortion of both"
    )]
    NothingInView,
    /// A mean or standard deviation that no network was trained with.
    #[error(
        "mean {mean:?} and standard deviation {std:?} cannot normalise; both must be finite, the deviation above 0"
    )]
    Normalisation {
        /// Means of red, green, blue.
        mean: [f32; 3],
        /// Standard deviations of red, green, blue.
        std: [f32; 3],
    },
    /// The frame is not what the front end was made for.
    #[error(
        "the frame is {found_width}x{found_height} {found:?}, expected {width}x{height} {format:?}; make a front end for each camera mode"
    )]
    Frame {
        /// Expected columns.
        width: usize,
        /// Expected rows.
        height: usize,
        /// Expected format.
        format: PixelFormat,
        /// Columns of the frame.
        found_width: usize,
        /// Rows of the frame.
        found_height: usize,
        /// Format of the frame.
        found: PixelFormat,
    },
    /// The output has no room, or too much.
    #[error("the output has {found} values, needed: 3 x {width} x {height}")]
    Output {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Length that was given.
        found: usize,
    },
    /// The planes to show have another size.
    #[error("the planes have {found} values, needed: 3 x {width} x {height}")]
    Planes {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Length that was given.
        found: usize,
    },
    /// Not a JPEG file, or not a whole one.
    #[error(
        "the camera's JPEG is broken: {reason}; drop the frame (if all are: check cable and USB bandwidth)"
    )]
    Jpeg {
        /// The decoder's words.
        reason: String,
    },
    /// A whole JPEG file of another size than the camera said.
    #[error(
        "the camera's JPEG is {found_width}x{found_height}, expected {width}x{height}; set the camera's mode again"
    )]
    JpegSize {
        /// Expected columns.
        width: usize,
        /// Expected rows.
        height: usize,
        /// Columns of the file.
        found_width: usize,
        /// Rows of the file.
        found_height: usize,
    },
}
