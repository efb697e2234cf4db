//! What went wrong with a device, in terms that a caller can act on.

use core::fmt::{Debug, Display};

/// An error of a device. Keeps the driver's own detail for people; generic code acts on [`kind`](Error::kind).
pub trait Error: Debug + Display {
    /// The class of this error.
    fn kind(&self) -> ErrorKind;
}

/// Classes of device errors.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum ErrorKind {
    /// The device is not there: unplugged, not powered, path missing. The driver keeps trying to reopen it.
    Disconnected,
    /// The device is open but silent for longer than its data sheet allows. The driver keeps listening.
    Timeout,
    /// The device answered with something that fails its checksum, its length or its allowed range. The reading is dropped.
    Corrupt,
    /// The device refused a request that it understood (wrong mode, not armed, value out of its limits).
    Rejected,
    /// The device reports a fault of its own (over-temperature, bus off, laser failure). Needs an operator or a reset.
    Fault,
    /// The device cannot do this at all. A configuration mistake.
    Unsupported,
    /// Anything else; see the error's text.
    Other,
}

/// Names the error type of a device once for all of its traits.
pub trait ErrorType {
    /// The device's error.
    type Error: Error;
}

impl<T: ErrorType + ?Sized> ErrorType for &mut T {
    type Error = T::Error;
}

/// A fake that cannot fail needs no error type of its own.
impl Error for core::convert::Infallible {
    fn kind(&self) -> ErrorKind {
        match *self {}
    }
}
