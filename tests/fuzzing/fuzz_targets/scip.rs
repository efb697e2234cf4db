//! See [`fuzzing::scip`].
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| fuzzing::scip(bytes));
