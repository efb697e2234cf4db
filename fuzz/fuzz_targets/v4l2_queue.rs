//! Any order of events at a camera: the driver does not panic, keeps to the queue's rules, and hands out no stale picture.
//! The camera is the tests' own, taken by path: their package would bring the whole runtime along.
#![no_main]

mod video {
    #[path = "../../../tests/src/video/device.rs"]
    pub mod device;
    #[path = "../../../tests/src/video/fake.rs"]
    pub mod fake;
    #[path = "../../../tests/src/video/queue.rs"]
    pub mod queue;
    #[path = "../../../tests/src/video/torture.rs"]
    pub mod torture;

    pub use fake::FakeCamera;
}

libfuzzer_sys::fuzz_target!(|data: &[u8]| video::torture::torture(data));
