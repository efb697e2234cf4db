//! A fake LiDAR against `hal` alone: a scanner in the middle of a round hall, with one broken beam.
//! Copy this file to start a driver for a new scanner.
//!
//! ```text
//! cargo run -p hal --example fake_lidar
//! ```

use core::convert::Infallible;

use hal::{ErrorType, LaserScan, Lidar, Range, ScanGeometry};

/// A scanner 2 m from the wall in every direction. A real driver receives scans on a thread of its
/// own, so that `poll_scan` never waits for the device.
struct FakeLidar {
    geometry: ScanGeometry,
    time_ns: u64,
}

// A device that cannot fail has no errors. A real driver uses its own error enum and implements
// `hal::Error` for it, so that callers can distinguish an unplugged device from a silent one.
impl ErrorType for FakeLidar {
    type Error = Infallible;
}

impl Lidar for FakeLidar {
    fn geometry(&self) -> ScanGeometry {
        self.geometry
    }

    fn poll_scan(&mut self, scan: &mut LaserScan) -> Result<bool, Infallible> {
        self.time_ns += self.geometry.period_ns;
        scan.time_ns = self.time_ns;
        scan.geometry = self.geometry;
        scan.ranges.clear();
        scan.ranges.resize(self.geometry.beams, Range::Hit(2.0));
        // A beam that could not be measured is an error. It is not `NoReturn`, and never free space.
        scan.ranges[0] = Range::Error;
        Ok(true)
    }
}

fn main() -> Result<(), Infallible> {
    let mut lidar = FakeLidar { geometry: ScanGeometry::UTM_30LX, time_ns: 0 };
    let mut scan = LaserScan::empty(lidar.geometry());
    for _ in 0..3 {
        if lidar.poll_scan(&mut scan)? {
            let hits = scan.hits().count();
            println!("{} ms: {hits} hits of {} beams", scan.time_ns / 1_000_000, scan.ranges.len());
        }
    }
    Ok(())
}
