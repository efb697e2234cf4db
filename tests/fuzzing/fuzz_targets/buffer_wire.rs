//! See [`fuzz::buffer_wire`].
#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| fuzz::buffer_wire(bytes));
