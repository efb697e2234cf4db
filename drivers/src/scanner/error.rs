//! Errors of a port, and their remedies.

use std::io;
use std::sync::Arc;

/// Why nothing can be read from or written to a port. Each driver makes its own error of it.
#[derive(Debug)]
pub(crate) enum LinkError {
    /// The port cannot be opened.
    Open { port: Arc<str>, source: io::Error },
    /// The connection to the port was lost.
    Gone { port: Arc<str>, source: io::Error },
}

/// The remedy when a port cannot be opened.
pub(crate) fn remedy(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::NotFound => "is it plugged in? the driver waits for it",
        io::ErrorKind::PermissionDenied => {
            "add the user to the group `dialout` or install the udev rules"
        }
        io::ErrorKind::WouldBlock | io::ErrorKind::ResourceBusy => {
            "another program has opened it; stop that program"
        }
        io::ErrorKind::ConnectionRefused => {
            "the address exists but refuses the connection; check `port` and the scanner's power"
        }
        _ => "check cable and `port`; the driver tries again",
    }
}
