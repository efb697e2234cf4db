//! See [`fuzzing::buffer_wire`].
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| fuzzing::buffer_wire(bytes));
