//! The live view of a simulated run: over the robot's socket, and in a real browser.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test that cannot set up its scene has failed"
)]

mod browser;
mod devtools;
mod explore;
mod measure;
mod orders;
