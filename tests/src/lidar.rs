//! A LiDAR that misbehaves.

use hal::{ErrorType, LaserScan, Lidar, Range, ScanGeometry};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use crate::{Seconds, holds};

/// What goes wrong, and when.
#[derive(Debug, Clone, Default)]
pub struct LidarFaults {
    /// No scan is handed out.
    pub silence: Option<Seconds>,
    /// All beams are errors: a covered or broken sensor.
    pub errors: Option<Seconds>,
    /// All beams come back with nothing: a blinded sensor.
    pub blind: Option<Seconds>,
    /// Share of beams that are errors at any time.
    pub error_share: f64,
    /// Share of beams that report something 0.15 m away that is not there, at any time.
    pub ghost_share: f64,
}

/// The wrapper.
#[derive(Debug)]
pub struct FaultyLidar<L> {
    inner: L,
    faults: LidarFaults,
    rng: Pcg64Mcg,
}

impl<L> FaultyLidar<L> {
    /// Wraps a LiDAR.
    pub fn new(inner: L, faults: LidarFaults, seed: u64) -> Self {
        Self { inner, faults, rng: Pcg64Mcg::seed_from_u64(seed) }
    }
}

impl<L: ErrorType> ErrorType for FaultyLidar<L> {
    type Error = L::Error;
}

impl<L: Lidar> Lidar for FaultyLidar<L> {
    fn geometry(&self) -> ScanGeometry {
        self.inner.geometry()
    }

    fn poll_scan(&mut self, scan: &mut LaserScan) -> Result<bool, Self::Error> {
        if !self.inner.poll_scan(scan)? {
            return Ok(false);
        }
        let now_ns = scan.time_ns;
        if holds(self.faults.errors.as_ref(), now_ns) {
            scan.ranges.fill(Range::Error);
        }
        if holds(self.faults.blind.as_ref(), now_ns) {
            scan.ranges.fill(Range::NoReturn);
        }
        for range in &mut scan.ranges {
            let draw: f64 = self.rng.random();
            if draw < self.faults.error_share {
                *range = Range::Error;
            } else if draw < self.faults.error_share + self.faults.ghost_share {
                *range = Range::Hit(0.15);
            }
        }
        Ok(!holds(self.faults.silence.as_ref(), now_ns))
    }
}
