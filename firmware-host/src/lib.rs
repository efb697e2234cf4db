//! What the binary is made of, as a library, so that tests and examples can reach it.
#![forbid(unsafe_code)]

pub mod dataset;
