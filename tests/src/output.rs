//! Printing that survives a closed pipe, as in `hil world | head -3`: a simulator whose reader has gone goes on.
//!
//! The macros have the names of the standard library's, which panic, and replace them in the whole crate.

use std::fmt;
use std::io::{self, Write};

macro_rules! print {
    ($($text:tt)*) => { $crate::output::print(format_args!($($text)*)) };
}

macro_rules! println {
    () => { $crate::output::print(format_args!("\n")) };
    ($($text:tt)*) => { $crate::output::print(format_args!("{}\n", format_args!($($text)*))) };
}

/// Prints to standard output.
pub fn print(text: fmt::Arguments<'_>) {
    let _ = io::stdout().write_fmt(text);
}
