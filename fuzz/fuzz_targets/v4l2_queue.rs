//! Any order of events at a camera: the driver does not panic, keeps to the queue's rules, and hands out no stale picture.
#![no_main]

#[path = "../src/video.rs"]
mod video;

libfuzzer_sys::fuzz_target!(|data: &[u8]| video::torture::torture(data));
