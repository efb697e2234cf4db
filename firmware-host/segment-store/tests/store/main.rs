//! Stores on disks and over links, and exports of their runs.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test that cannot set up its files has failed"
)]

mod common;
mod cuts;
mod disks;
mod hostile;
mod left_out;
#[cfg(feature = "lerobot")]
mod lerobot;
mod links;
mod pulling;
mod ros2;
mod signed;
mod viewer;
