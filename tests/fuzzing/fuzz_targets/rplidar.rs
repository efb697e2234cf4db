//! See [`fuzzing::rplidar`].
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| fuzzing::rplidar(bytes));
