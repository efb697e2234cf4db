//! Why a model cannot be one of the robot's networks.

/// A model was refused when it was loaded. The text says what was found, what is needed and the way out.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum NetworkError {
    /// The bytes are a well-known kind of file, but not ONNX.
    #[error(
        "the model is {found}, not an ONNX file; export the network with torch.onnx.export and give that file"
    )]
    NotOnnx {
        /// What the first bytes say.
        found: &'static str,
    },
    /// ONNX Runtime cannot read the model.
    #[error(
        "ONNX Runtime cannot load the model: {reason}; check that the file is whole (`onnx.checker.check_model`) and exports all of its weights inside"
    )]
    Load {
        /// ONNX Runtime's own words.
        reason: String,
    },
    /// An option cannot be set.
    #[error("ONNX Runtime refuses the options of the network ({threads} threads): {reason}")]
    Options {
        /// Threads that were asked for.
        threads: usize,
        /// ONNX Runtime's own words.
        reason: String,
    },
    /// The loaded ONNX Runtime was built without the execution provider.
    #[error(
        "the loaded ONNX Runtime has no execution provider `{wanted}`, it has: {available}; choose one of these, or point ORT_DYLIB_PATH to a libonnxruntime.so that was built with `{wanted}`"
    )]
    NoProvider {
        /// What was asked for.
        wanted: &'static str,
        /// What there is.
        available: String,
    },
    /// The execution provider is there but does not start.
    #[error(
        "ONNX Runtime's execution provider `{wanted}` does not start: {reason}; check the device, its driver and the provider's own libraries, or choose `cpu`"
    )]
    Provider {
        /// What was asked for.
        wanted: &'static str,
        /// ONNX Runtime's own words.
        reason: String,
    },
    /// The model takes too many or too few inputs.
    #[error("the model takes {found}; needed: {needed}")]
    Inputs {
        /// Names and types of the inputs.
        found: String,
        /// What would be right.
        needed: &'static str,
    },
    /// The model gives more or less than one output.
    #[error("the model gives {found}; needed: {needed}")]
    Outputs {
        /// Names and types of the outputs.
        found: String,
        /// What would be right.
        needed: &'static str,
    },
    /// An input or output has another type or shape than it must have.
    #[error("the model's {role} is {found}, needed: {needed}")]
    Tensor {
        /// `input` or `output`.
        role: &'static str,
        /// Name and type as the model has it.
        found: String,
        /// What would be right.
        needed: String,
    },
    /// The model was made for pictures of another size.
    #[error(
        "the model works on pictures of {model}, the camera gives {camera}; export the model for the camera's size, or set [camera] width and height to the model's"
    )]
    Size {
        /// Width x height that the model wants.
        model: String,
        /// Width x height of the camera model.
        camera: String,
    },
    /// The model says something about itself that cannot be.
    #[error("the model's metadata says {key} = `{value}`, allowed: {allowed}")]
    Metadata {
        /// The key.
        key: &'static str,
        /// What the model says.
        value: String,
        /// What it may say.
        allowed: String,
    },
    /// Nothing says what the output means.
    #[error(
        "the model does not say whether its output `{name}` is depth or disparity; add the metadata `output` = `depth` or `disparity`, or name the output so"
    )]
    OutputMeaning {
        /// Name of the output.
        name: String,
    },
    /// The model loads, but fails on a grey picture.
    #[error("the model fails on a plain grey picture: {reason}")]
    WarmUp {
        /// What went wrong.
        reason: String,
    },
}

/// What a file that is no ONNX model most likely is, by its first bytes. `None`: it may be one.
pub(super) fn other_kind(bytes: &[u8]) -> Option<&'static str> {
    const KINDS: [(&[u8], &str); 6] = [
        (b"PK\x03\x04", "a ZIP archive (a PyTorch checkpoint?)"),
        (b"version https://git-lfs", "a Git LFS pointer (run `git lfs pull`)"),
        (b"\x1f\x8b", "a gzip archive"),
        (b"\x89PNG", "a PNG picture"),
        (b"\x7fELF", "a program or library"),
        (b"<", "an HTML or XML page (a failed download?)"),
    ];
    if bytes.is_empty() {
        return Some("an empty file");
    }
    KINDS.iter().find(|(start, _)| bytes.starts_with(start)).map(|(_, name)| *name)
}
