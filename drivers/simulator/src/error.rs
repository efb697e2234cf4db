//! Why a scene cannot be opened or a robot cannot be put into it.

use std::path::PathBuf;

/// Everything that can be wrong with a scene, with the way out.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SceneError {
    /// The scene's file does not exist.
    #[error("scene '{}' does not exist; give a .glb, .gltf or .obj file, or builtin:apartment, builtin:house, builtin:office", path.display())]
    NotFound {
        /// The path as given.
        path: PathBuf,
    },
    /// A file is there but cannot be read.
    #[error("cannot read '{}': {source}", path.display())]
    Read {
        /// Which file.
        path: PathBuf,
        /// What the system says.
        source: std::io::Error,
    },
    /// The file's name says that it is something else than a scene.
    #[error("'{}' is not a scene that can be read: its name must end in .glb, .gltf or .obj; homes of our own are \
         builtin:apartment, builtin:house and builtin:office", path.display())]
    UnknownFormat {
        /// The path as given.
        path: PathBuf,
    },
    /// A `builtin:` scene with a name, key or value that does not exist.
    #[error("scene '{spec}': {problem}")]
    Builtin {
        /// The scene as given.
        spec: String,
        /// What is wrong, and what is allowed.
        problem: String,
    },
    /// The file's content is not what its name says, or it is damaged.
    #[error("'{}' is not a sound {format} file: {problem}", path.display())]
    Malformed {
        /// Which file.
        path: PathBuf,
        /// glTF or OBJ.
        format: &'static str,
        /// What is wrong, and where in the file.
        problem: String,
    },
    /// The file is sound but uses something that is not supported.
    #[error("'{}' uses {feature}, which is not supported; {way_out}", path.display())]
    Unsupported {
        /// Which file.
        path: PathBuf,
        /// What it uses.
        feature: String,
        /// How to make a file without it.
        way_out: &'static str,
    },
    /// A file that the scene refers to does not exist.
    #[error("'{}' refers to the {what} '{}', which does not exist; put it there or export the scene as one .glb", path.display(), file.display())]
    MissingFile {
        /// The scene.
        path: PathBuf,
        /// Texture, material library or buffer.
        what: &'static str,
        /// Where it was looked for.
        file: PathBuf,
    },
    /// A texture cannot be decoded.
    #[error("'{}': texture '{texture}' cannot be used: {problem}", path.display())]
    Texture {
        /// The scene.
        path: PathBuf,
        /// The texture's file or its place in the scene.
        texture: String,
        /// What is wrong.
        problem: String,
    },
    /// The scene has no surface at all.
    #[error("'{scene}' has no triangles; nothing can be seen or driven on")]
    Empty {
        /// The scene.
        scene: String,
    },
    /// No vertex of the scene is a number.
    #[error(
        "'{scene}': all {triangles} triangles have a corner that is NaN or infinite; export the scene again"
    )]
    NotFinite {
        /// The scene.
        scene: String,
        /// How many triangles were dropped.
        triangles: usize,
    },
    /// Nothing in the scene can be driven on.
    #[error(
        "'{scene}' has no floor that a robot can stand on: {problem}; check the up axis and the scale (metres)"
    )]
    NoFloor {
        /// The scene.
        scene: String,
        /// What was looked for and not found.
        problem: String,
    },
    /// The robot cannot stand where it is to start.
    #[error(
        "start pose ({x_m:.2}, {y_m:.2}) is inside a wall, off the floor or too near to something; the nearest free place is ({nearest_x_m:.2}, {nearest_y_m:.2})"
    )]
    StartBlocked {
        /// Wanted place in the world, metres.
        x_m: f64,
        /// Wanted place in the world, metres.
        y_m: f64,
        /// Nearest free place, metres.
        nearest_x_m: f64,
        /// Nearest free place, metres.
        nearest_y_m: f64,
    },
    /// A nuisance outside its range.
    #[error(transparent)]
    Nuisance(#[from] crate::nuisance::NuisanceError),
    /// An option outside its range.
    #[error("{option} is {value}, but must be {allowed}")]
    Option {
        /// Name of the option.
        option: &'static str,
        /// What was given.
        value: String,
        /// What is allowed.
        allowed: &'static str,
    },
}
