//! See [`fuzz::onnx_file`].
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| fuzz::onnx_file(bytes));
