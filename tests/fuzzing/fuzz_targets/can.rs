//! See [`fuzz::can`].
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| fuzz::can(bytes));
