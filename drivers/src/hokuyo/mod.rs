//! Driver for Hokuyo's planar scanners over USB, RS-232 or Ethernet, as a [`hal::Lidar`].
//!
//! A reader thread owns the scanner. It opens the port by its path, with a back-off of 50 ms to 1 s
//! between attempts, and sets the scanner up: it leaves SCIP 1.1, checks the model, compares the
//! clocks and switches the laser on. It checks every scan, and publishes scans once
//! [`good_scans`](HokuyoConfig::good_scans) in a row were good. The polling side takes no lock,
//! allocates nothing and checks the age of scans itself, so it also detects a reader thread that
//! stopped.
//!
//! ```no_run
//! use drivers::hokuyo::{HokuyoConfig, HokuyoLidar};
//! use hal::{LaserScan, Lidar};
//!
//! let mut lidar = HokuyoLidar::open(HokuyoConfig::new("/dev/serial/by-id/usb-Hokuyo".parse()?))?;
//! let mut scan = LaserScan::empty(lidar.geometry());
//! if lidar.poll_scan(&mut scan)? {
//!     println!("{} beams", scan.ranges.len());
//! }
//! # Ok::<(), drivers::hokuyo::HokuyoError>(())
//! ```

mod config;
mod error;
mod reader;
mod session;

pub use crate::scanner::{Identity, Port};
pub use config::HokuyoConfig;
pub use error::HokuyoError;

use std::sync::Arc;

use hal::{ErrorType, LaserScan, Lidar, ScanGeometry};

use crate::DeviceStatus;
use crate::scanner::{LidarMonitor, Polled};
use reader::Reader;

/// The driver of one scanner. Dropping it switches the laser off.
#[derive(Debug)]
pub struct HokuyoLidar {
    polled: Polled,
}

impl HokuyoLidar {
    /// Starts the driver. The scanner may be connected later.
    ///
    /// # Errors
    /// [`HokuyoError::Config`] when the configuration is invalid; [`HokuyoError::Link`] when the
    /// system cannot create a thread or descriptor.
    pub fn open(config: HokuyoConfig) -> Result<Self, HokuyoError> {
        config.validate()?;
        let port: Arc<str> = config.port.to_string().into();
        let geometry = config.model.geometry(config.upside_down);
        let polled = Polled::start("hokuyo", port.clone(), geometry, move |end| {
            Reader { config, port, shared: end.shared, scans: end.scans, stop: end.stop }.run();
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

impl ErrorType for HokuyoLidar {
    type Error = HokuyoError;
}

impl Lidar for HokuyoLidar {
    fn geometry(&self) -> ScanGeometry {
        self.polled.geometry()
    }

    fn poll_scan(&mut self, scan: &mut LaserScan) -> Result<bool, Self::Error> {
        Ok(self.polled.poll(scan)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::{Error, ErrorKind};
    use monotonic_clock::monotonic_ns;

    #[test]
    fn the_driver_and_its_monitor_can_be_sent_to_other_threads() {
        fn is_send<T: Send>() {}
        is_send::<HokuyoLidar>();
        is_send::<LidarMonitor>();
    }

    #[test]
    fn a_path_that_is_not_a_serial_port_is_reported_with_the_remedy() {
        let mut lidar =
            HokuyoLidar::open(HokuyoConfig::new(Port::Serial("/dev/null".into()))).unwrap();
        let deadline_ns = monotonic_ns() + 5_000_000_000;
        let problem = loop {
            assert!(monotonic_ns() < deadline_ns, "no problem was reported");
            if let Some(problem) = lidar.monitor().problem() {
                break problem;
            }
            std::thread::yield_now();
        };
        assert!(
            problem.contains("/dev/null") && problem.contains("check cable and `port`"),
            "{problem}"
        );
        let mut scan = LaserScan::empty(lidar.geometry());
        assert_eq!(lidar.poll_scan(&mut scan).unwrap_err().kind(), ErrorKind::Disconnected);
    }
}
