//! An opened unit: where its bytes come from, and how they become samples.

use std::fmt;
use std::os::fd::OwnedFd;
use std::sync::Arc;

use hal::ImuSample;

use super::kernel::{self, KernelDevice};
use super::records::Records;
use super::{Decoder, ImuConfig, ImuError, ImuPlace, Roots, remote, wire};

/// Where a sample's time comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Times {
    /// The kernel, or the other program, took the time at the measurement.
    Measured,
    /// The driver took the time when it read the sample, which is later by an unknown and varying time.
    Read,
}

/// What was set up, for `check` and the log.
#[derive(Debug, Clone, PartialEq)]
pub struct ImuSetup {
    /// The device's own name, or the path of the socket.
    pub name: String,
    /// The rate that the device has taken; `None` if it does not say.
    pub rate_hz: Option<f64>,
    /// Whether it measures forces besides angular velocities; `None` if the first sample will show it.
    pub has_force: Option<bool>,
    pub times: Times,
}

impl fmt::Display for ImuSetup {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.name)?;
        if let Some(rate_hz) = self.rate_hz {
            write!(f, " at {rate_hz} Hz")?;
        }
        if self.has_force == Some(false) {
            f.write_str(", a gyroscope alone")?;
        }
        match self.times {
            Times::Measured => Ok(()),
            Times::Read => f.write_str(", whose times are those of reading"),
        }
    }
}

/// An opened unit.
pub(super) struct Source {
    pub(super) setup: ImuSetup,
    pub(super) records: Records,
    pub(super) decode: Decode,
    /// Dropped with the source, which stops the device.
    pub(super) device: Option<KernelDevice>,
}

/// How a record becomes a sample.
pub(super) enum Decode {
    Kernel(Box<Decoder>),
    Wire,
}

impl Decode {
    pub(super) fn sample(&self, record: &[u8], read_ns: u64) -> Option<ImuSample> {
        match self {
            Self::Kernel(decoder) => decoder.decode(record, read_ns),
            Self::Wire => record.try_into().ok().map(wire::decode),
        }
    }
}

impl Source {
    /// Opens the configured unit.
    pub(super) fn open(
        config: &ImuConfig,
        device: &Arc<str>,
        roots: &Roots,
    ) -> Result<(Self, OwnedFd), ImuError> {
        let ImuPlace::Socket(path) = config.place() else {
            return kernel::open(config, device, roots);
        };
        let socket = remote::connect(path, device)?;
        let setup = ImuSetup {
            name: path.display().to_string(),
            rate_hz: None,
            has_force: None,
            times: Times::Measured,
        };
        let records = Records::new(wire::RECORD_BYTES);
        Ok((Self { setup, records, decode: Decode::Wire, device: None }, socket))
    }
}
