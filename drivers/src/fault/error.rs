//! What an injector says: of its own text, and in the place of a device.

use std::fmt::Write;

use hal::ErrorKind;

use super::schedule::{Device, Kind, kinds_of};

/// A text that names no fault.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum FaultTextError {
    /// It has another form.
    #[error(
        "`{text}` is not DEVICE:KIND[=AMOUNT][@FROM..TO], such as lidar:stall@4..6; there are {}",
        all_kinds()
    )]
    Form {
        /// The whole text.
        text: String,
    },
    /// No such device.
    #[error("there is no device `{name}`; there are {}", all_kinds())]
    Device {
        /// What was asked for.
        name: String,
    },
    /// The device has no such fault.
    #[error("`{}` has no fault `{name}`; it has {}", device.name(), kind_names(*device))]
    Kind {
        /// The device.
        device: Device,
        /// What was asked for.
        name: String,
    },
    /// An amount that cannot be.
    #[error("`{}={text}`: `{}` takes {rule}", kind.name(), kind.name())]
    Amount {
        /// The kind.
        kind: Kind,
        /// What was given.
        text: String,
        /// What it may be.
        rule: &'static str,
    },
    /// A time that cannot be.
    #[error(
        "`@{text}` is no time: give seconds since the start as @4..6, @4.. or @..6, the first below the second"
    )]
    Window {
        /// What was given.
        text: String,
    },
}

impl FaultTextError {
    /// A configuration mistake, always.
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

/// What an injected fault looks like from outside.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Symptom {
    /// As of a device that is not there.
    #[error("not there (an injected fault)")]
    Unplugged,
    /// As of a device that says nothing any more.
    #[error("silent (an injected fault)")]
    Silent,
    /// As of a reading that fails its checksum.
    #[error("a reading failed its checksum (an injected fault)")]
    Corrupt,
}

impl Symptom {
    /// The class of the error.
    #[must_use]
    pub fn kind(self) -> ErrorKind {
        match self {
            Self::Unplugged => ErrorKind::Disconnected,
            Self::Silent => ErrorKind::Timeout,
            Self::Corrupt => ErrorKind::Corrupt,
        }
    }
}

/// An error of a wrapped device.
#[derive(Debug, thiserror::Error)]
pub enum FaultyError<E> {
    /// Injected.
    #[error("{}: {symptom}", device.name())]
    Injected {
        /// In the place of which device.
        device: Device,
        /// What it looks like.
        symptom: Symptom,
    },
    /// The device's own.
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

/// What a wrapper around a device of type `D` returns.
pub type Faulty<T, D> = Result<T, FaultyError<<D as hal::ErrorType>::Error>>;
