//! What can be wrong with a recorded dataset.

use std::path::PathBuf;

/// A dataset that cannot be used, and where to look.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DatasetError {
    /// A file cannot be read.
    #[error(
        "cannot read {path}: {source}; a dataset is a folder with rgb.txt, groundtruth.txt and dataset.toml, as \
         `buffer export --as tum` writes it",
        path = path.display()
    )]
    Read {
        /// The file.
        path: PathBuf,
        /// The operating system's words.
        source: std::io::Error,
    },
    /// `dataset.toml` is not valid TOML or holds an unknown key or a value of the wrong type.
    #[error("{path}: {detail}", path = path.display())]
    Manifest {
        /// The file.
        path: PathBuf,
        /// What the parser says, with the line.
        detail: String,
    },
    /// A value in `dataset.toml` is impossible.
    #[error("{path}: {key} = {value} is impossible; allowed: {allowed}", path = path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// The key.
        key: &'static str,
        /// The value as it stands there.
        value: String,
        /// What it may be.
        allowed: &'static str,
    },
    /// A line of a list cannot be used.
    #[error("{path}:{line}: {what}", path = path.display())]
    Line {
        /// The list.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// What is wrong with it, with the value.
        what: String,
    },
    /// A list has no entry.
    #[error("{path}: the list is empty; it needs at least one line `{form}`", path = path.display())]
    EmptyList {
        /// The list.
        path: PathBuf,
        /// What a line looks like.
        form: &'static str,
    },
    /// A listed image does not exist.
    #[error("{list}:{line}: {path} does not exist", list = list.display(), path = path.display())]
    MissingImage {
        /// The list that names it.
        list: PathBuf,
        /// The line, from 1.
        line: usize,
        /// The image.
        path: PathBuf,
    },
    /// No picture has a pose near it in time.
    #[error("{path}: none of the {pictures} pictures has a pose within {tolerance_ms:.1} ms; do both lists use the same clock?", path = path.display())]
    NoPose {
        /// The list of poses.
        path: PathBuf,
        /// How many pictures there are.
        pictures: usize,
        /// The tolerance.
        tolerance_ms: f64,
    },
    /// An image is damaged, truncated or of an unknown format.
    #[error("{path}: {source}", path = path.display())]
    Image {
        /// The image.
        path: PathBuf,
        /// The decoder's words.
        source: image::ImageError,
    },
    /// An image has another size than the camera.
    #[error(
        "{path}: the image is {width}x{height}, [camera] in dataset.toml says {want_width}x{want_height}",
        path = path.display()
    )]
    ImageSize {
        /// The image.
        path: PathBuf,
        /// Columns of the image.
        width: u32,
        /// Rows of the image.
        height: u32,
        /// Columns of the camera.
        want_width: usize,
        /// Rows of the camera.
        want_height: usize,
    },
    /// A depth image is not one channel of 16 bits.
    #[error("{path}: a depth image has one channel of 16 bits, this one is {color}", path = path.display())]
    DepthFormat {
        /// The image.
        path: PathBuf,
        /// What it is.
        color: String,
    },
}
