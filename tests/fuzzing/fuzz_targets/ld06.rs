//! See [`fuzzing::ld06`].
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| fuzzing::ld06(bytes));
