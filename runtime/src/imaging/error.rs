//! Errors of the image front end.

use hal::PixelFormat;

/// Why a front end cannot be made, or why it refuses a frame. The text names what was found, what is needed and how to
/// correct it.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ImagingError {
    /// Invalid intrinsics. `role` is `source` or `target`.
    #[error(
        "the {role} camera is {found}; needed: 2x2 to 65535x65535 pixels, positive focal lengths, finite numbers; calibrate the camera again"
    )]
    Camera { role: &'static str, found: String },
    /// The target camera has distortion.
    #[error(
        "the target camera has distortion ({found}); the network takes pinhole images: give the target no distortion"
    )]
    TargetDistortion { found: String },
    /// The format shares chroma between pixels and needs an even size.
    #[error(
        "a camera of {width}x{height} cannot send {format:?}, whose pixels come in pairs; choose an even size"
    )]
    OddSize { width: usize, height: usize, format: PixelFormat },
    /// The format is not supported.
    #[error(
        "frames in {format:?} cannot be converted; set the camera to YUYV, NV12, RGB8, GRAY8 or MJPEG"
    )]
    Format { format: PixelFormat },
    /// The fields of view of the two cameras do not overlap.
    #[error(
        "no pixel of the target camera is in the source's image; check focal lengths, centres and distortion of both"
    )]
    NothingInView,
    /// The frame has another size or format than the front end was made for.
    #[error(
        "the frame is {found_width}x{found_height} {found:?}, expected {width}x{height} {format:?}; make a front end for each camera mode"
    )]
    Frame {
        width: usize,
        height: usize,
        format: PixelFormat,
        found_width: usize,
        found_height: usize,
        found: PixelFormat,
    },
    /// The output buffer has the wrong length.
    #[error("the output has {found} values, needed: 3 x {width} x {height}")]
    Output { width: usize, height: usize, found: usize },
    /// The frame is not a JPEG file, or a damaged or truncated one.
    #[error(
        "the camera's JPEG is broken: {reason}; drop the frame (if all are: check cable and USB bandwidth)"
    )]
    Jpeg { reason: String },
    /// A complete JPEG file whose size differs from the camera mode's.
    #[error(
        "the camera's JPEG is {found_width}x{found_height}, expected {width}x{height}; set the camera's mode again"
    )]
    JpegSize { width: usize, height: usize, found_width: usize, found_height: usize },
}
