//! Stores on disks, over links and in object stores, and exports of their runs.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test that cannot set up its files has failed"
)]

#[cfg(feature = "object-store")]
mod bucket;
mod common;
mod cuts;
mod disks;
mod hostile;
mod left_out;
mod links;
mod pulling;
mod signed;
mod viewer;
