use runtime::model_gate::check_onnx_file;

/// Arbitrary bytes as a model. A fault is reported with its position, which is inside the file.
pub fn onnx_file(bytes: &[u8]) {
    if let Err(runtime::model_gate::OnnxFault::Broken { at }) = check_onnx_file(bytes) {
        assert!(at <= bytes.len(), "byte {at} of {}", bytes.len());
    }
}
