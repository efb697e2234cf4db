//! Everything the robot decides. No device, file, socket or clock is opened here: the runtime is given bytes, time and a
//! seed, and returns decisions. The same inputs give the same decisions, bit for bit, on any number of threads.
#![forbid(unsafe_code)]

pub mod accuracy;
pub mod calibration_watch;
pub mod event;
pub mod exploration;
pub mod imaging;
pub mod imu;
pub mod latency;
pub mod lidar_agreement;
pub mod localization;
pub mod mapping;
pub mod model_gate;
pub mod operator;
pub mod outside_pose;
pub mod perception;
pub mod planning;
pub mod recording;
pub mod robot;
pub mod safety;
pub mod session;
pub mod snapshot;
pub mod task;
pub mod tick;
