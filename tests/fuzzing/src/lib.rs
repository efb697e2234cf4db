//! Properties that every reader of external data must satisfy for arbitrary bytes. Each target is a
//! function that panics when its property does not hold.
//!
//! The fuzzer runs the targets (`cargo xtask fuzz`), and an ordinary test runs them over the inputs
//! in `corpus/`, which the fuzzer found to reach different code. A new target is a function here, a
//! line in [`TARGETS`], its three lines in `fuzz_targets/` and its name in `Cargo.toml`.
#![forbid(unsafe_code)]
#![allow(
    clippy::expect_used,
    clippy::indexing_slicing,
    reason = "a check reports a violated property by a panic"
)]

mod buffer_wire;
mod bundle;
mod can;
mod config;
mod iio;
mod ld06;
mod live_view;
mod localize_log;
mod map_state;
mod onnx_file;
mod recording;
mod rplidar;
mod scip;
mod segment;
mod snapshot;
mod viewer;

pub use buffer_wire::buffer_wire;
pub use bundle::bundle;
pub use can::can;
pub use config::config;
/// Arbitrary sequences of camera events: the driver follows the queue's rules and returns no stale
/// frame.
pub use hil::video::check_events as v4l2_queue;
pub use iio::iio;
pub use ld06::ld06;
pub use live_view::live_view;
pub use localize_log::localize_log;
pub use map_state::map_state;
pub use onnx_file::onnx_file;
pub use recording::recording;
pub use rplidar::rplidar;
pub use scip::scip;
pub use segment::segment;
pub use snapshot::snapshot;
pub use viewer::viewer;

/// A property check for arbitrary bytes.
pub type Check = fn(&[u8]);

/// All checks, by the name of their target and corpus.
pub const TARGETS: [(&str, Check); 17] = [
    ("buffer_wire", buffer_wire),
    ("bundle", bundle),
    ("can", can),
    ("config", config),
    ("iio", iio),
    ("ld06", ld06),
    ("live_view", live_view),
    ("localize_log", localize_log),
    ("map_state", map_state),
    ("onnx_file", onnx_file),
    ("recording", recording),
    ("rplidar", rplidar),
    ("scip", scip),
    ("segment", segment),
    ("snapshot", snapshot),
    ("v4l2_queue", v4l2_queue),
    ("viewer", viewer),
];
