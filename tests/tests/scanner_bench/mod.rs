//! A simulated scanner and its driver, which a test polls until something happens.

use std::path::PathBuf;

use drivers::LidarMonitor;
use hal::{Clock, Error, ErrorKind, LaserScan, Lidar};
use monotonic_clock::{MonotonicClock, monotonic_ns};

pub const MS: u64 = 1_000_000;
/// Bring-up takes 50 ms. A computer that is busy with other tests may need much longer.
pub const TIMEOUT_NS: u64 = 20_000 * MS;

/// A simulated scanner, and its driver.
pub struct Bench<D, L> {
    pub device: D,
    pub lidar: L,
    pub scan: LaserScan,
    pub monitor: LidarMonitor,
    /// The folder of the scanner's path, which is removed at the end.
    pub folder: tempfile::TempDir,
}

/// Folder and path for a scanner's symbolic link.
pub fn stable_path() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("usb-lidar");
    (folder, path)
}

impl<D, L: Lidar> Bench<D, L> {
    pub fn new(device: D, lidar: L, monitor: LidarMonitor, folder: tempfile::TempDir) -> Self {
        let scan = LaserScan::empty(lidar.geometry());
        Self { device, lidar, scan, monitor, folder }
    }

    pub fn poll(&mut self) -> Result<bool, L::Error> {
        MonotonicClock.sleep_until_ns(monotonic_ns() + MS);
        self.lidar.poll_scan(&mut self.scan)
    }

    pub fn until(
        &mut self,
        what: &str,
        mut condition: impl FnMut(&Result<bool, L::Error>) -> bool,
    ) {
        let deadline_ns = monotonic_ns() + TIMEOUT_NS;
        while !condition(&self.poll()) {
            let status = self.monitor.status();
            let problem = self.monitor.problem();
            assert!(
                monotonic_ns() < deadline_ns,
                "timed out waiting for {what}: {status:?}, {problem:?}"
            );
        }
    }

    pub fn until_scan(&mut self) {
        self.until("a scan", |polled| matches!(polled, Ok(true)));
    }

    pub fn until_error(&mut self, kind: ErrorKind) {
        self.until(&format!("{kind:?}"), |polled| {
            polled.as_ref().is_err_and(|error| error.kind() == kind)
        });
    }

    pub fn until_problem(&mut self, word: &str) -> String {
        let monitor = self.monitor.clone();
        self.until(word, |_| monitor.problem().is_some_and(|problem| problem.contains(word)));
        monitor.problem().unwrap()
    }
}
