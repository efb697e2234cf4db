//! Segments in an object store.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "helpers of tests")]

mod common;
mod http;
mod pulling;
mod uploading;
