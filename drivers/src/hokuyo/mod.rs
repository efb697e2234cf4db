//! Hokuyo's planar scanners over USB, RS-232 or Ethernet, as a [`hal::Lidar`].
//!
//! A thread of its own reads the scanner. It opens the port by its path again and again, waiting 50 ms to 1 s in between,
//! brings the scanner up (out of SCIP 1.1, model checked, clocks compared, laser on), checks every scan, and hands out scans
//! when [`good_scans`](HokuyoConfig::good_scans) in a row were good. The polling side takes no lock, allocates nothing and
//! judges the age of scans by itself, so that it notices even if the reading thread has stopped.
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

/// A scanner. Dropping it switches the laser off.
#[derive(Debug)]
pub struct HokuyoLidar {
    scans: Output<LaserScan>,
    geometry: ScanGeometry,
    port: Arc<str>,
    monitor: HokuyoMonitor,
    /// Bad scans that the caller knows of.
    bad_told: u64,
    stop: Stop,
    reader: Option<JoinHandle<()>>,
}

impl HokuyoLidar {
    /// Starts the driver. The scanner need not be there yet.
    ///
    /// # Errors
    /// [`HokuyoError::Config`] when the configuration cannot work; [`HokuyoError::Open`] when the system has no thread or
    /// descriptor left.
    pub fn open(config: HokuyoConfig) -> Result<Self, HokuyoError> {
        config.validate()?;
        let port: Arc<str> = config.port.to_string().into();
        let failed = |source| HokuyoError::Open { port: port.clone(), source };
        let geometry = config.model.geometry(config.upside_down);
        let empty = LaserScan { time_ns: 0, geometry, ranges: vec![Range::Error; geometry.beams] };
        let (input, scans) = triple_buffer(&empty);
        let stop: Stop =
            Arc::new(eventfd(0, EventfdFlags::CLOEXEC).map_err(|error| failed(error.into()))?);
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
            .map_err(failed)?;
        Ok(Self { scans, geometry, port, monitor, bad_told: 0, stop, reader: Some(thread) })
    }

    /// State and counts. Takes no lock.
    #[must_use]
    pub fn status(&self) -> DeviceStatus {
        self.monitor.status()
    }

    /// For other threads: state, identity, last problem.
    #[must_use]
    pub fn monitor(&self) -> HokuyoMonitor {
        self.monitor.clone()
    }

    /// Why there can be no scan now.
    fn check_alive(&self) -> Result<(), HokuyoError> {
        let port = || self.port.clone();
        let limit_ns = 2 * self.geometry.period_ns;
        let silent = || HokuyoError::Silent { port: port(), limit_ms: limit_ns / 1_000_000 };
        match self.monitor.shared.state() {
            DeviceState::Starting | DeviceState::Disconnected => {
                Err(HokuyoError::Disconnected { port: port() })
            }
            DeviceState::Faulty => Err(HokuyoError::Faulty { port: port() }),
            DeviceState::Silent => Err(silent()),
            DeviceState::Working => {
                let last_ns = self.monitor.shared.last_good_ns.load(Acquire);
                if monotonic_ns().saturating_sub(last_ns) > limit_ns {
                    Err(silent())
                } else {
                    Ok(())
                }
            }
        }
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
        // What came before a fault is not handed out after it.
        let is_new = self.scans.update();
        let bad = self.monitor.shared.bad.load(Relaxed);
        let has_dropped = std::mem::replace(&mut self.bad_told, bad) != bad;
        self.check_alive()?;
        if is_new {
            let newest = self.scans.output_buffer();
            (scan.time_ns, scan.geometry) = (newest.time_ns, newest.geometry);
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
    fn it_may_move_to_the_safety_thread_and_its_monitor_to_another() {
        fn is_send<T: Send>() {}
        is_send::<HokuyoLidar>();
        is_send::<HokuyoMonitor>();
    }

    #[test]
    fn a_path_that_is_no_serial_port_is_refused_with_the_way_out() {
        let mut lidar =
            HokuyoLidar::open(HokuyoConfig::new(Port::Serial("/dev/null".into()))).unwrap();
        let deadline_ns = monotonic_ns() + 5_000_000_000;
        let problem = loop {
            assert!(monotonic_ns() < deadline_ns, "no problem is told");
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
