//! See [`fuzzing::map_state`].
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| fuzzing::map_state(bytes));
