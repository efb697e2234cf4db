//! Device errors, classified so that a caller can act on them without knowing the driver.

use core::fmt::{Debug, Display};

/// A device error. Its text carries the driver's details for the operator; generic code acts on
/// [`kind`](Error::kind).
pub trait Error: Debug + Display {
    fn kind(&self) -> ErrorKind;
}

/// The class of a device error.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum ErrorKind {
    /// The device is absent: unplugged, not powered, or its path is missing. The driver keeps
    /// trying to reopen it.
    Disconnected,
    /// The device is open but silent for longer than its data sheet allows. The driver keeps
    /// listening.
    Timeout,
    /// A reading failed its checksum, its length or its allowed range, and was dropped.
    Corrupt,
    /// The device understood a request and refused it (wrong mode, not armed, value out of limits).
    Rejected,
    /// The device reports a fault of its own (over-temperature, bus off, laser failure). Needs an
    /// operator or a reset.
    Fault,
    /// The device does not support the request at all. This is a configuration mistake.
    Unsupported,
    /// Any other error; its text says more.
    Other,
}

/// Names the error type of a device once for all of its traits.
pub trait ErrorType {
    type Error: Error;
}

impl<T: ErrorType + ?Sized> ErrorType for &mut T {
    type Error = T::Error;
}

/// Lets a fake device that cannot fail use `Infallible` instead of defining an error type.
impl Error for core::convert::Infallible {
    fn kind(&self) -> ErrorKind {
        match *self {}
    }
}
