//! See [`fuzzing::viewer`].
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| fuzzing::viewer(bytes));
