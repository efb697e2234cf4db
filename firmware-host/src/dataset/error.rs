//! Errors in recorded datasets.

use std::path::PathBuf;

/// A dataset that cannot be used. The message names the file and, where possible, the line.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DatasetError {
    /// A file cannot be read.
    #[error(
        "cannot read {path}: {source}; a dataset is a folder with rgb.txt, groundtruth.txt and dataset.toml, as \
         `buffer export --as tum` writes it",
        path = path.display()
    )]
    Read { path: PathBuf, source: std::io::Error },
    /// `dataset.toml` is not valid TOML, or has an unknown key or a value of the wrong type.
    #[error("{path}: {detail}", path = path.display())]
    Manifest {
        path: PathBuf,
        /// Message of the parser, with the line.
        detail: String,
    },
    /// A value in `dataset.toml` is out of range.
    #[error("{path}: {key} = {value} is out of range; allowed: {allowed}", path = path.display())]
    Value { path: PathBuf, key: &'static str, value: String, allowed: &'static str },
    /// A line of a list is invalid.
    #[error("{path}:{line}: {what}", path = path.display())]
    Line {
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
        /// What is wrong, with the value.
        what: String,
    },
    /// A list is empty.
    #[error("{path}: the list is empty; it needs at least one line `{form}`", path = path.display())]
    EmptyList {
        path: PathBuf,
        /// Format of a line.
        form: &'static str,
    },
    /// A listed image does not exist.
    #[error("{list}:{line}: {path} does not exist", list = list.display(), path = path.display())]
    MissingImage {
        list: PathBuf,
        /// Line number, from 1.
        line: usize,
        path: PathBuf,
    },
    /// No image has a pose near it in time.
    #[error("{path}: none of the {images} images has a pose within {tolerance_ms:.1} ms; do both lists use the same clock?", path = path.display())]
    NoPose { path: PathBuf, images: usize, tolerance_ms: f64 },
    /// An image is damaged, truncated or of an unknown format.
    #[error("{path}: {source}", path = path.display())]
    Image { path: PathBuf, source: image::ImageError },
    /// The size of an image differs from the camera's.
    #[error(
        "{path}: the image is {width}x{height}, but [camera] in dataset.toml is {camera_width}x{camera_height}",
        path = path.display()
    )]
    ImageSize { path: PathBuf, width: u32, height: u32, camera_width: usize, camera_height: usize },
    /// A depth image does not have a single channel of 16 bits.
    #[error("{path}: a depth image must have one channel of 16 bits, but this one has the format {color}", path = path.display())]
    DepthFormat { path: PathBuf, color: String },
}
