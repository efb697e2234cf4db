//! Pulling from and uploading to object stores.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test that cannot set up its files has failed"
)]

mod common;
mod http;
mod pulling;
mod uploading;
