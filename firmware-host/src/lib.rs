//! What the binary on the robot is made of: configuration, wiring, command line, telemetry and reports.
#![forbid(unsafe_code)]

pub mod config;
pub mod dataset;
pub mod onnx_runtime;
pub mod record;
pub mod replay;
pub mod report;
