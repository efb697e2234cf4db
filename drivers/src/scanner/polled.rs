//! The side of a driver that the safety thread polls. It takes no lock, allocates nothing and checks
//! the age of scans itself, so it also detects a reader thread that stopped.

use std::sync::Arc;
use std::sync::atomic::Ordering::{Acquire, Relaxed};
use std::thread::JoinHandle;

use hal::{LaserScan, Range, ScanGeometry};
use rustix::event::{EventfdFlags, eventfd};
use triple_buffer::{Input, Output, triple_buffer};

use super::{LidarMonitor, LinkError, PollError, Shared, Stop};
use crate::DeviceState;
use monotonic_clock::monotonic_ns;

/// What the reader thread of a driver works with.
pub(crate) struct ReaderEnd {
    pub(crate) shared: Arc<Shared>,
    pub(crate) scans: Input<LaserScan>,
    pub(crate) stop: Stop,
}

/// The polling side of one scanner. Dropping it ends the reader thread.
#[derive(Debug)]
pub(crate) struct Polled {
    scans: Output<LaserScan>,
    geometry: ScanGeometry,
    port: Arc<str>,
    monitor: LidarMonitor,
    /// The number of bad scans that were already reported to the caller.
    bad_reported: u64,
    stop: Stop,
    reader: Option<JoinHandle<()>>,
}

impl Polled {
    /// Starts a reader thread of this name.
    pub(crate) fn start(
        thread: &str,
        port: Arc<str>,
        geometry: ScanGeometry,
        read: impl FnOnce(ReaderEnd) + Send + 'static,
    ) -> Result<Self, LinkError> {
        let empty = LaserScan { time_ns: 0, geometry, ranges: vec![Range::Error; geometry.beams] };
        let (input, scans) = triple_buffer(&empty);
        let stop_event = eventfd(0, EventfdFlags::CLOEXEC)
            .map_err(|error| LinkError::Open { port: port.clone(), source: error.into() })?;
        let stop: Stop = Arc::new(stop_event);
        let monitor = LidarMonitor { shared: Arc::default() };
        monitor.shared.set_state(DeviceState::Disconnected);
        let end = ReaderEnd { shared: monitor.shared.clone(), scans: input, stop: stop.clone() };
        let thread = std::thread::Builder::new()
            .name(thread.to_owned())
            .spawn(|| read(end))
            .map_err(|source| LinkError::Open { port: port.clone(), source })?;
        Ok(Self { scans, geometry, port, monitor, bad_reported: 0, stop, reader: Some(thread) })
    }

    pub(crate) fn geometry(&self) -> ScanGeometry {
        self.geometry
    }

    pub(crate) fn monitor(&self) -> &LidarMonitor {
        &self.monitor
    }

    /// Copies the newest scan that was not returned before.
    pub(crate) fn poll(&mut self, scan: &mut LaserScan) -> Result<bool, PollError> {
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
        if has_dropped { Err(PollError::Corrupt { port: self.port.clone() }) } else { Ok(false) }
    }

    /// Returns an error if no scan can be returned now.
    fn check_alive(&self) -> Result<(), PollError> {
        let limit_ns = 2 * self.geometry.period_ns;
        let is_silent = match self.monitor.shared.state() {
            DeviceState::Starting | DeviceState::Disconnected => {
                return Err(PollError::Disconnected { port: self.port.clone() });
            }
            DeviceState::Faulty => return Err(PollError::Faulty { port: self.port.clone() }),
            DeviceState::Silent => true,
            DeviceState::Working => {
                let last_ns = self.monitor.shared.last_good_ns.load(Acquire);
                monotonic_ns().saturating_sub(last_ns) > limit_ns
            }
        };
        if is_silent {
            return Err(PollError::Silent {
                port: self.port.clone(),
                limit_ms: limit_ns / 1_000_000,
            });
        }
        Ok(())
    }
}

impl Drop for Polled {
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

    /// A driver without a reader thread, whose last good scan has just arrived.
    fn working_without_reader() -> Polled {
        let geometry = ScanGeometry::UTM_30LX;
        let polled = Polled::start("test", "test".into(), geometry, |_| ()).unwrap();
        polled.monitor.shared.set_state(DeviceState::Working);
        // An hour in the future, so that a slow test computer does not cause a time-out.
        polled.monitor.shared.last_good_ns.store(monotonic_ns() + 3_600_000_000_000, Relaxed);
        polled
    }

    #[test]
    fn dropped_scans_are_reported_exactly_once_as_corrupt() {
        let mut polled = working_without_reader();
        let mut scan = LaserScan::empty(polled.geometry());
        assert!(!polled.poll(&mut scan).unwrap());
        for dropped in [1, 3] {
            polled.monitor.shared.bad.fetch_add(dropped, Relaxed);
            assert!(matches!(polled.poll(&mut scan), Err(PollError::Corrupt { .. })));
            assert!(!polled.poll(&mut scan).unwrap(), "reported twice");
        }
    }
}
