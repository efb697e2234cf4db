//! What must hold of everything that reads bytes from outside, for any bytes: a function for each, which ends the program when it
//! does not hold.
//!
//! The fuzzer drives them (`cargo xtask fuzz`), and an ordinary test runs them over the inputs in `corpus/`, which are those that
//! fuzzing found to reach different code. A new target is a function here, a line in [`TARGETS`], its three lines in `fuzz_targets/`
//! and its name in `Cargo.toml`.
#![forbid(unsafe_code)]
#![allow(
    clippy::expect_used,
    clippy::indexing_slicing,
    reason = "to end the program is how a check says no"
)]

mod buffer_wire;
mod bundle;
mod can;
mod config;
mod onnx_file;
mod recording;
mod scip;
mod segment;
mod snapshot;

pub use buffer_wire::buffer_wire;
pub use bundle::bundle;
pub use can::can;
pub use config::config;
/// Any order of events at a camera: the driver keeps to the queue's rules, and hands out no stale picture.
pub use hil::video::torture as v4l2_queue;
pub use onnx_file::onnx_file;
pub use recording::recording;
pub use scip::scip;
pub use segment::segment;
pub use snapshot::snapshot;

/// A check for any bytes.
pub type Check = fn(&[u8]);

/// Every check by the name of its target and of its corpus.
pub const TARGETS: [(&str, Check); 10] = [
    ("buffer_wire", buffer_wire),
    ("bundle", bundle),
    ("can", can),
    ("config", config),
    ("onnx_file", onnx_file),
    ("recording", recording),
    ("scip", scip),
    ("segment", segment),
    ("snapshot", snapshot),
    ("v4l2_queue", v4l2_queue),
];
