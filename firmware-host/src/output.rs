//! Printing that survives a closed pipe.
//!
//! The standard library's `println!` and `eprintln!` panic when nothing reads any more, as in `health --json | head -1`, and a
//! robot that drives must not end because the terminal behind a pipe was closed. The macros below have the same names, so that
//! they replace the standard ones in the whole crate. Work and exit code of a command stay the same without a reader. Any other
//! error of standard output, such as a full disk behind `check > robot.toml`, is kept for [`finish`].

use std::fmt;
use std::io::{self, ErrorKind, Write};
use std::sync::Mutex;

/// The first error of standard output.
static FAILED: Mutex<Option<io::Error>> = Mutex::new(None);

macro_rules! print {
    ($($text:tt)*) => { $crate::output::print(format_args!($($text)*)) };
}

macro_rules! println {
    ($($text:tt)*) => { $crate::output::print(format_args!("{}\n", format_args!($($text)*))) };
}

macro_rules! eprintln {
    ($($text:tt)*) => { $crate::output::print_error(format_args!("{}\n", format_args!($($text)*))) };
}

/// Prints to standard output.
pub fn print(text: fmt::Arguments<'_>) {
    keep_first(io::stdout().write_fmt(text));
}

/// Prints to standard error. There is nowhere to report that this failed.
pub fn print_error(text: fmt::Arguments<'_>) {
    let _ = io::stderr().write_fmt(text);
}

/// Shows what was printed at once, also without a line break at its end.
pub fn flush() {
    keep_first(io::stdout().flush());
}

/// Whether the reader of standard output has closed it, so that more output is useless.
#[must_use]
pub fn is_closed() -> bool {
    let failed = FAILED.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    failed.as_ref().is_some_and(|error| error.kind() == ErrorKind::BrokenPipe)
}

/// Writes what is still buffered.
///
/// # Errors
/// When standard output did not take everything, unless its reader has closed it.
pub fn finish() -> io::Result<()> {
    flush();
    match FAILED.lock().unwrap_or_else(std::sync::PoisonError::into_inner).take() {
        Some(error) if error.kind() != ErrorKind::BrokenPipe => Err(error),
        _ => Ok(()),
    }
}

fn keep_first(result: io::Result<()>) {
    let Err(error) = result else { return };
    FAILED.lock().unwrap_or_else(std::sync::PoisonError::into_inner).get_or_insert(error);
}

/// Standard output for code that takes any writer. Its errors are kept like those of [`print`], so writing never fails.
#[derive(Debug)]
pub struct Output;

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        keep_first(io::stdout().write_all(bytes));
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        flush();
        Ok(())
    }
}
