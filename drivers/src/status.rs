//! The state of a device as its driver reports it, for `check`, `health` and the log.

use std::fmt;

/// The state of a device.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum DeviceState {
    /// Open but not in use yet: the device is being set up, or its first good readings are being
    /// counted.
    #[default]
    Starting,
    /// Readings arrive as they should.
    Working,
    /// Open, but no reading has arrived for longer than the device's time-out.
    Silent,
    /// The device is absent. The driver keeps trying to open it.
    Disconnected,
    /// The device is present and reports a fault of its own.
    Faulty,
}

impl fmt::Display for DeviceState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Starting => "starting",
            Self::Working => "working",
            Self::Silent => "silent",
            Self::Disconnected => "disconnected",
            Self::Faulty => "faulty",
        })
    }
}

/// A device's state, and counts since its driver was made. Plain numbers, so that a real-time
/// thread can copy it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DeviceStatus {
    pub state: DeviceState,
    /// Readings that passed every check.
    pub good: u64,
    /// Readings that were dropped because they failed a check.
    pub bad: u64,
    /// Readings that never arrived, as gaps in the device's own counter show.
    pub lost: u64,
    /// How often the device was opened again after it had disappeared.
    pub reopened: u64,
    /// Monotonic time of the last good reading; 0 before the first.
    pub last_good_ns: u64,
}
