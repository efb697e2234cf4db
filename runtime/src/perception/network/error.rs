//! Why a model is refused when it is loaded.

/// Why a model was refused when it was loaded. The text names what was found, what is needed and how to correct it.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum NetworkError {
    /// The bytes are a well-known kind of file, but not ONNX.
    #[error(
        "the model is {found}, not an ONNX file; export the network with torch.onnx.export and give that file"
    )]
    NotOnnx {
        /// The kind of file according to its first bytes.
        found: &'static str,
    },
    /// ONNX Runtime cannot read the model.
    #[error(
        "ONNX Runtime cannot load the model: {reason}; check that the file is whole (`onnx.checker.check_model`) and exports all of its weights inside"
    )]
    Load {
        /// ONNX Runtime's message.
        reason: String,
    },
    /// An option cannot be set.
    #[error("ONNX Runtime refuses the options of the network ({threads} threads): {reason}")]
    Options {
        threads: usize,
        /// ONNX Runtime's message.
        reason: String,
    },
    /// The loaded ONNX Runtime was built without the execution provider.
    #[error(
        "the loaded ONNX Runtime has no execution provider `{wanted}`, it has: {available}; choose one of these, or point ORT_DYLIB_PATH to a libonnxruntime.so that was built with `{wanted}`"
    )]
    NoProvider { wanted: &'static str, available: String },
    /// The execution provider is available but does not start.
    #[error(
        "ONNX Runtime's execution provider `{wanted}` does not start: {reason}; check the device, its driver and the provider's own libraries, or choose `cpu`"
    )]
    Provider {
        wanted: &'static str,
        /// ONNX Runtime's message.
        reason: String,
    },
    /// The model has too many or too few inputs.
    #[error("the model takes {found}; needed: {needed}")]
    Inputs {
        /// Names and types of the inputs.
        found: String,
        needed: &'static str,
    },
    /// The model does not have exactly one output.
    #[error("the model gives {found}; needed: {needed}")]
    Outputs {
        /// Names and types of the outputs.
        found: String,
        needed: &'static str,
    },
    /// An input or output has another type or shape than it must have.
    #[error("the model's {role} is {found}, needed: {needed}")]
    Tensor {
        /// Role of the tensor: `input` or `output`.
        role: &'static str,
        found: String,
        needed: String,
    },
    /// The model was made for frames of another size.
    #[error(
        "the model works on images of {model}, the camera delivers {camera}; export the model for the camera's size, or set [camera] width and height to the model's"
    )]
    Size {
        /// Width x height of the model's input.
        model: String,
        /// Width x height of the camera model.
        camera: String,
    },
    /// A metadata value of the model is invalid.
    #[error("the model's metadata says {key} = `{value}`, allowed: {allowed}")]
    Metadata { key: &'static str, value: String, allowed: String },
    /// Neither the metadata nor the output's name tells whether the output is depth or disparity.
    #[error(
        "the model does not state whether its output `{name}` is depth or disparity; add the metadata `output` = `depth` or `disparity`, or name the output so"
    )]
    OutputMeaning {
        /// Name of the output.
        name: String,
    },
    /// The model loads but fails on a grey image.
    #[error("the model fails on a plain grey image: {reason}")]
    WarmUp { reason: String },
}

/// The kind of a file that is not an ONNX model, according to its first bytes. `None` if it may be an ONNX model.
pub(super) fn other_kind(bytes: &[u8]) -> Option<&'static str> {
    const KINDS: [(&[u8], &str); 6] = [
        (b"PK\x03\x04", "a ZIP archive (a PyTorch checkpoint?)"),
        (b"version https://git-lfs", "a Git LFS pointer (run `git lfs pull`)"),
        (b"\x1f\x8b", "a gzip archive"),
        (b"\x89PNG", "a PNG image"),
        (b"\x7fELF", "a program or library"),
        (b"<", "an HTML or XML page (a failed download?)"),
    ];
    if bytes.is_empty() {
        return Some("an empty file");
    }
    KINDS.iter().find(|(start, _)| bytes.starts_with(start)).map(|(_, name)| *name)
}
