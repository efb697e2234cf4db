//! See [`fuzzing::recording`].
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| fuzzing::recording(bytes));
