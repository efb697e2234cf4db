//! An emergency stop whose contact is wired to an input line of the computer (GPIO).
//!
//! The contact is normally closed, so a broken wire reads like a press. A line that cannot be read is
//! pressed, too. [`Debounce`] decides from samples and performs no I/O; a thread of [`StopLine`] reads the
//! line, because a line behind a slow bus blocks for milliseconds, and the safety loop reads only
//! what the thread has published.

mod config;
mod debounce;
mod line;
mod reader;

pub use config::{Level, StopLineConfig, StopLineError};
pub use debounce::Debounce;
pub use line::{Line, open_line};
pub use reader::{StopLine, StopLineMonitor};
