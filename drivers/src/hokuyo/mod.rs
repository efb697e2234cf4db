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
mod link;
mod reader;
mod session;
mod shared;

pub use config::{HokuyoConfig, Port};
pub use error::HokuyoError;
pub use shared::{HokuyoMonitor, Identity};

use std::sync::Arc;
use std::sync::atomic::Ordering::{Acquire, Relaxed};
use std::thread::JoinHandle;

use hal::{ErrorType, LaserScan, Lidar, Range, ScanGeometry};
use rustix::event::{EventfdFlags, eventfd};
use triple_buffer::{Output, triple_buffer};

use crate::{DeviceState, DeviceStatus};
use link::Stop;
use monotonic_clock::monotonic_ns;
use reader::Reader;

/// The driver of one scanner. Dropping it switches the laser off.
#[derive(Debug)]
pub struct HokuyoLidar {
    scans: Output<LaserScan>,
    geometry: ScanGeometry,
    port: Arc<str>,
    monitor: HokuyoMonitor,
    /// The number of bad scans that were already reported to the caller.
    bad_reported: u64,
    stop: Stop,
    reader: Option<JoinHandle<()>>,
}

impl HokuyoLidar {
    /// Starts the driver. The scanner may be connected later.
    ///
    /// # Errors
    /// [`HokuyoError::Config`] when the configuration is invalid; [`HokuyoError::Open`] when the
    /// system cannot create a thread or descriptor.
    pub fn open(config: HokuyoConfig) -> Result<Self, HokuyoError> {
        config.validate()?;
        let port: Arc<str> = config.port.to_string().into();
        let geometry = config.model.geometry(config.upside_down);
        let empty = LaserScan { time_ns: 0, geometry, ranges: vec![Range::Error; geometry.beams] };
        let (input, scans) = triple_buffer(&empty);
        let stop_event = eventfd(0, EventfdFlags::CLOEXEC)
            .map_err(|error| HokuyoError::Open { port: port.clone(), source: error.into() })?;
        let stop: Stop = Arc::new(stop_event);
        let monitor = HokuyoMonitor { shared: Arc::default() };
        monitor.shared.set_state(DeviceState::Disconnected);
        let reader = Reader {
            config,
            port: port.clone(),
            shared: monitor.shared.clone(),
            scans: input,
            stop: stop.clone(),
        };
        let thread = std::thread::Builder::new()
            .name("hokuyo".to_owned())
            .spawn(|| reader.run())
            .map_err(|source| HokuyoError::Open { port: port.clone(), source })?;
        Ok(Self { scans, geometry, port, monitor, bad_reported: 0, stop, reader: Some(thread) })
    }

    /// The scanner's state and counts. Takes no lock.
    #[must_use]
    pub fn status(&self) -> DeviceStatus {
        self.monitor.status()
    }

    /// A handle with which other threads read the state, the identity and the last problem.
    #[must_use]
    pub fn monitor(&self) -> HokuyoMonitor {
        self.monitor.clone()
    }

    /// Returns an error if no scan can be returned now.
    fn check_alive(&self) -> Result<(), HokuyoError> {
        let limit_ns = 2 * self.geometry.period_ns;
        let is_silent = match self.monitor.shared.state() {
            DeviceState::Starting | DeviceState::Disconnected => {
                return Err(HokuyoError::Disconnected { port: self.port.clone() });
            }
            DeviceState::Faulty => return Err(HokuyoError::Faulty { port: self.port.clone() }),
            DeviceState::Silent => true,
            DeviceState::Working => {
                let last_ns = self.monitor.shared.last_good_ns.load(Acquire);
                monotonic_ns().saturating_sub(last_ns) > limit_ns
            }
        };
        if is_silent {
            let limit_ms = limit_ns / 1_000_000;
            return Err(HokuyoError::Silent { port: self.port.clone(), limit_ms });
        }
        Ok(())
    }
}

impl ErrorType for HokuyoLidar {
    type Error = HokuyoError;
}

impl Lidar for HokuyoLidar {
    fn geometry(&self) -> ScanGeometry {
        self.geometry
    }

    fn poll_scan(&mut self, scan: &mut LaserScan) -> Result<bool, Self::Error> {
        // The scan is taken before the check, so that a scan from before a fault is not returned
        // after it.
        let is_new = self.scans.update();
        let bad = self.monitor.shared.bad.load(Relaxed);
        let has_dropped = std::mem::replace(&mut self.bad_reported, bad) != bad;
        self.check_alive()?;
        if is_new {
            let newest = self.scans.output_buffer();
            scan.time_ns = newest.time_ns;
            scan.geometry = newest.geometry;
            scan.ranges.clone_from(&newest.ranges);
            return Ok(true);
        }
        if has_dropped { Err(HokuyoError::Corrupt { port: self.port.clone() }) } else { Ok(false) }
    }
}

impl Drop for HokuyoLidar {
    fn drop(&mut self) {
        _ = rustix::io::write(&*self.stop, &1_u64.to_ne_bytes());
        if let Some(reader) = self.reader.take() {
            _ = reader.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::{Error, ErrorKind};

    #[test]
    fn the_driver_and_its_monitor_can_be_sent_to_other_threads() {
        fn is_send<T: Send>() {}
        is_send::<HokuyoLidar>();
        is_send::<HokuyoMonitor>();
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

    /// A driver without a reader thread, whose last good scan has just arrived.
    fn working_without_reader() -> HokuyoLidar {
        let geometry = ScanGeometry::UTM_30LX;
        let (_, scans) = triple_buffer(&LaserScan::empty(geometry));
        let monitor = HokuyoMonitor { shared: Arc::default() };
        monitor.shared.set_state(DeviceState::Working);
        // An hour in the future, so that a slow test computer does not cause a time-out.
        monitor.shared.last_good_ns.store(monotonic_ns() + 3_600_000_000_000, Relaxed);
        HokuyoLidar {
            scans,
            geometry,
            port: "test".into(),
            monitor,
            bad_reported: 0,
            stop: Arc::new(eventfd(0, EventfdFlags::CLOEXEC).unwrap()),
            reader: None,
        }
    }

    #[test]
    fn dropped_scans_are_reported_exactly_once_as_corrupt() {
        let mut lidar = working_without_reader();
        let mut scan = LaserScan::empty(lidar.geometry());
        assert!(!lidar.poll_scan(&mut scan).unwrap());
        for dropped in [1, 3] {
            lidar.monitor.shared.bad.fetch_add(dropped, Relaxed);
            assert_eq!(lidar.poll_scan(&mut scan).unwrap_err().kind(), ErrorKind::Corrupt);
            assert!(!lidar.poll_scan(&mut scan).unwrap(), "reported twice");
        }
    }
}
