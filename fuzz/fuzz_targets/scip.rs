#![no_main]

#[path = "../src/scip.rs"]
mod scip;

libfuzzer_sys::fuzz_target!(|data: &[u8]| scip::check(data));
