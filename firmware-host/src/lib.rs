//! The parts of the robot's program: configuration, device setup, command line, recording and
//! reports.
#![forbid(unsafe_code)]

// First, because its macros replace those of the standard library in the modules below.
#[macro_use]
pub mod output;

pub mod areas;
pub mod buffer;
pub mod calibrate;
pub mod camera_latency;
pub mod check;
pub mod cli;
pub mod config;
pub mod control_panel;
pub mod dataset;
mod dump;
#[cfg(feature = "simulator")]
pub mod evaluation;
#[cfg(feature = "simulator")]
pub mod explore;
pub mod failure;
pub mod faults;
pub mod frame_depth;
pub mod health;
pub mod identity;
pub mod init;
pub mod live;
pub mod localize;
pub mod logging;
pub mod manual;
pub mod map;
pub mod model;
pub mod mounts;
pub mod onnx_runtime;
pub mod perceive;
pub mod record;
pub mod recorded;
pub mod replay;
pub mod replay_run;
pub mod report;
pub mod reproduce;
#[cfg(feature = "rerun")]
pub mod rerun_stream;
pub mod run;
pub mod setup;
#[cfg(feature = "simulator")]
pub mod simulation;
pub mod stopwatch;
pub mod task;
#[cfg(feature = "simulator")]
pub mod views;
