//! What a driver says of its device, for `check`, `health` and the log.

use std::fmt;

/// How a device is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum DeviceState {
    /// Opened, not yet trusted: being set up, or its first good readings are being counted.
    #[default]
    Starting,
    /// Delivers.
    Working,
    /// Open, but silent for longer than it may be.
    Silent,
    /// Not there. The driver keeps trying to open it.
    Disconnected,
    /// There, and says itself that it is broken.
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

/// One device's state and counts since the driver was made. Plain numbers, so that a real-time thread may copy it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DeviceStatus {
    /// How it is now.
    pub state: DeviceState,
    /// Readings that were taken.
    pub good: u64,
    /// Readings that were dropped because they failed a check.
    pub bad: u64,
    /// Readings that the device counted and that never came.
    pub lost: u64,
    /// Times that the device was opened again after it had gone.
    pub reopened: u64,
    /// When the last good reading was taken, monotonic; 0 before the first.
    pub last_good_ns: u64,
}
