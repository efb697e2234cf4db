//! How right depth is: engines beside each other, on simulated and on recorded sequences, undisturbed and disturbed.
//! Ground truth is used to judge and for nothing else. `cargo xtask accuracy` prints the table.
#![forbid(unsafe_code)]

pub mod disturbance;
pub mod engine;
pub mod fit;
pub mod measure;
pub mod reliability;
pub mod sequence;
