//! See [`fuzzing::localize_log`].
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| fuzzing::localize_log(bytes));
