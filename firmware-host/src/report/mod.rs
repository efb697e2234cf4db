//! What a person and a program read after a run, and while it lasts.

pub mod atomic;
pub mod coverage;
pub mod events;
pub mod latency;
pub mod progress;
pub mod stuck;
pub mod summary;
pub mod table;
