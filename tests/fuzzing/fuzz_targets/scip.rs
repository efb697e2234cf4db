//! See [`fuzz::scip`].
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| fuzz::scip(bytes));
