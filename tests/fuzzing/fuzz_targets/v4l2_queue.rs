//! See [`fuzzing::v4l2_queue`].
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| fuzzing::v4l2_queue(bytes));
