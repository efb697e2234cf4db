//! See [`fuzzing::onnx_file`].
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| fuzzing::onnx_file(bytes));
