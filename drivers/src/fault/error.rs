//! Errors in the text of a fault, and the errors that an injector returns in place of a device.

use std::fmt::Write;

use hal::ErrorKind;

use super::kind::{Device, Kind, kinds_of};

/// A text that cannot be parsed as a [`Fault`](super::Fault).
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum FaultTextError {
    /// The text is not of the form `DEVICE:KIND[=AMOUNT][@FROM..TO]`.
    #[error(
        "`{text}` is not DEVICE:KIND[=AMOUNT][@FROM..TO], such as lidar:stall@4..6; there are {}",
        all_kinds()
    )]
    Form { text: String },
    /// There is no device of this name.
    #[error("there is no device `{name}`; there are {}", all_kinds())]
    Device { name: String },
    /// The device has no fault of this name.
    #[error("`{}` has no fault `{name}`; it has {}", device.name(), kind_names(*device))]
    Kind { device: Device, name: String },
    /// The amount is outside the range of this kind of fault.
    #[error("`{}={text}`: `{}` takes {rule}", kind.name(), kind.name())]
    Amount {
        kind: Kind,
        text: String,
        /// Which amounts the kind allows.
        rule: &'static str,
    },
    /// The time window is malformed or empty.
    #[error(
        "`@{text}` is not a time window: give seconds since the start as @4..6, @4.. or @..6, \
         with the start before the end"
    )]
    Window { text: String },
}

impl FaultTextError {
    /// The class of the error: always a configuration mistake.
    #[must_use]
    pub fn kind(&self) -> ErrorKind {
        ErrorKind::Unsupported
    }
}

fn kind_names(device: Device) -> String {
    kinds_of(device).iter().map(|kind| kind.name()).collect::<Vec<_>>().join(", ")
}

fn all_kinds() -> String {
    let mut text = String::new();
    for device in Device::ALL {
        let separator = if text.is_empty() { "" } else { "; " };
        // Writing into a string cannot fail.
        _ = write!(text, "{separator}{}: {}", device.name(), kind_names(device));
    }
    text
}

/// How an injected fault appears to the caller of the device.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Symptom {
    /// The device appears to be unplugged.
    #[error("not there (an injected fault)")]
    Unplugged,
    /// The device appears to have stopped sending.
    #[error("silent (an injected fault)")]
    Silent,
    /// A reading appears to have failed its checksum.
    #[error("a reading failed its checksum (an injected fault)")]
    Corrupt,
}

impl Symptom {
    #[must_use]
    pub fn kind(self) -> ErrorKind {
        match self {
            Self::Unplugged => ErrorKind::Disconnected,
            Self::Silent => ErrorKind::Timeout,
            Self::Corrupt => ErrorKind::Corrupt,
        }
    }
}

/// An error of a wrapped device: an injected one or the device's own.
#[derive(Debug, thiserror::Error)]
pub enum FaultyError<E> {
    #[error("{}: {symptom}", device.name())]
    Injected { device: Device, symptom: Symptom },
    /// The wrapped device returned this error.
    #[error("{0}")]
    Device(E),
}

impl<E: hal::Error> hal::Error for FaultyError<E> {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::Injected { symptom, .. } => symptom.kind(),
            Self::Device(error) => error.kind(),
        }
    }
}

/// The result type of a wrapper around a device of type `D`.
pub type Faulty<T, D> = Result<T, FaultyError<<D as hal::ErrorType>::Error>>;
