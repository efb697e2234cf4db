//! Errors of opening a scene and of placing a robot in it.

use std::path::PathBuf;

/// An error in a scene or in the options of a simulated robot. Each message says what to do about
/// it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SceneError {
    /// The scene's file does not exist.
    #[error("scene '{}' does not exist; give a .glb, .gltf or .obj file, or builtin:apartment, builtin:house, builtin:office", path.display())]
    NotFound { path: PathBuf },
    /// A file exists but cannot be read.
    #[error("cannot read '{}': {source}", path.display())]
    Read { path: PathBuf, source: std::io::Error },
    /// The file name does not end in .glb, .gltf or .obj.
    #[error("'{}' is not a supported scene file: its name must end in .glb, .gltf or .obj; the built-in homes are \
         builtin:apartment, builtin:house and builtin:office", path.display())]
    UnknownFormat { path: PathBuf },
    /// A `builtin:` scene with a name, key or value that does not exist.
    #[error("scene '{spec}': {problem}")]
    Builtin {
        spec: String,
        /// The invalid part and the allowed values.
        problem: String,
    },
    /// The file's content does not match its extension, or the file is damaged.
    #[error("'{}' is not a valid {format} file: {problem}", path.display())]
    Malformed {
        path: PathBuf,
        format: &'static str,
        /// The defect and its location in the file.
        problem: String,
    },
    /// The file is sound but uses something that is not supported.
    #[error("'{}' uses {feature}, which is not supported; {way_out}", path.display())]
    Unsupported {
        path: PathBuf,
        feature: String,
        /// How to produce a file without this feature.
        way_out: &'static str,
    },
    /// A file that the scene refers to does not exist.
    #[error("'{}' refers to the {what} '{}', which does not exist; put it there or export the scene as one .glb", path.display(), file.display())]
    MissingFile {
        path: PathBuf,
        /// Kind of the missing file: texture, material library or buffer.
        what: &'static str,
        /// Path at which the file was expected.
        file: PathBuf,
    },
    /// A texture cannot be decoded.
    #[error("'{}': texture '{texture}' cannot be decoded: {problem}", path.display())]
    Texture {
        path: PathBuf,
        /// File name of the texture or its index in the scene.
        texture: String,
        problem: String,
    },
    /// The scene has no surface at all.
    #[error("'{scene}' has no triangles")]
    Empty { scene: String },
    /// Every triangle of the scene has a corner that is NaN or infinite.
    #[error(
        "'{scene}': all {triangles} triangles have a corner that is NaN or infinite; export the scene again"
    )]
    NotFinite {
        scene: String,
        /// Number of dropped triangles.
        triangles: usize,
    },
    /// The scene has no floor that the robot can drive on.
    #[error(
        "'{scene}' has no floor that a robot can stand on: {problem}; check the up axis and the scale (metres)"
    )]
    NoFloor {
        scene: String,
        /// Which criterion no surface met.
        problem: String,
    },
    /// The robot does not fit at the requested start pose.
    #[error(
        "start pose ({x_m:.2}, {y_m:.2}) is inside a wall, off the floor or too close to an obstacle; the nearest free position is ({nearest_x_m:.2}, {nearest_y_m:.2})"
    )]
    StartBlocked {
        /// Requested position in the world, metres.
        x_m: f64,
        /// Requested position in the world, metres.
        y_m: f64,
        nearest_x_m: f64,
        nearest_y_m: f64,
    },
    /// A field of `Nuisances` is outside its range.
    #[error(transparent)]
    Nuisance(#[from] crate::nuisance::NuisanceError),
    /// An option is outside its range.
    #[error("{option} is {value}, but must be {allowed}")]
    Option { option: &'static str, value: String, allowed: &'static str },
}
