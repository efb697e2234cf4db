//! The driver of a rotating scanner.

use std::sync::Arc;

use hal::{ErrorType, LaserScan, Lidar, ScanGeometry};

use super::RotaryError;
use super::device::Device;
use super::settings::Settings;
use super::stream::Reader;
use crate::DeviceStatus;
use crate::scanner::{LidarMonitor, Polled};

/// The driver of one scanner. Dropping it stops the motor if the scanner has a command for that.
///
/// A reader thread owns the scanner. It opens the port by its path, with a back-off of 50 ms to 1 s
/// between attempts, collects whole revolutions, and publishes scans once enough of them in a row
/// were good. The polling side takes no lock, allocates nothing and checks the age of scans itself.
#[derive(Debug)]
pub struct RotaryLidar {
    polled: Polled,
}

impl RotaryLidar {
    pub(crate) fn start(settings: Settings, device: Box<dyn Device>) -> Result<Self, RotaryError> {
        let port: Arc<str> = settings.port.to_string().into();
        let geometry = settings.geometry;
        let polled = Polled::start("rotary-lidar", port.clone(), geometry, move |end| {
            Reader::new(settings, port, device, end).run();
        })?;
        Ok(Self { polled })
    }

    /// The scanner's state and counts. Takes no lock.
    #[must_use]
    pub fn status(&self) -> DeviceStatus {
        self.polled.monitor().status()
    }

    /// A handle with which other threads read the state, the identity and the last problem.
    #[must_use]
    pub fn monitor(&self) -> LidarMonitor {
        self.polled.monitor().clone()
    }
}

impl ErrorType for RotaryLidar {
    type Error = RotaryError;
}

impl Lidar for RotaryLidar {
    fn geometry(&self) -> ScanGeometry {
        self.polled.geometry()
    }

    fn poll_scan(&mut self, scan: &mut LaserScan) -> Result<bool, Self::Error> {
        Ok(self.polled.poll(scan)?)
    }
}
