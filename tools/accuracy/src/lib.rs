//! Accuracy of depth: compares methods on simulated and recorded sequences, with and without disturbances. Ground truth is
//! used for evaluation only. `cargo xtask accuracy` prints the table.
#![forbid(unsafe_code)]

pub mod choice_fit;
pub mod dense_fit;
pub mod depth_network;
pub mod disturbance;
pub mod engine;
pub mod fit;
pub mod flow_network;
pub mod least_squares;
pub mod measure;
pub mod perceptron;
pub mod reliability;
pub mod sequence;
