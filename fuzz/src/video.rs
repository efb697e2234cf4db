//! The tests' own simulated camera, taken by path: their package would bring the whole runtime along.

#[path = "../../tests/src/video/device.rs"]
pub mod device;
#[path = "../../tests/src/video/fake.rs"]
pub mod fake;
#[path = "../../tests/src/video/queue.rs"]
pub mod queue;
#[path = "../../tests/src/video/torture.rs"]
pub mod torture;

pub use fake::FakeCamera;
