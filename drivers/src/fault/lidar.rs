//! Injects faults into a laser scanner.

use hal::{ErrorType, LaserScan, Lidar, Range, ScanGeometry};
use rand::RngExt;

use super::error::{Faulty, FaultyError};
use super::injector::{Faults, Injector};
use super::kind::{Device, Kind};
use super::reorder_buffer::ReorderBuffer;

/// Distance of ghost obstacles, metres: inside of every stop zone.
const GHOST_M: f32 = 0.15;

/// Wraps a scanner and injects faults into its scans.
pub struct FaultyLidar<L> {
    inner: L,
    injector: Injector,
    buffer: ReorderBuffer<LaserScan>,
}

impl<L: Lidar> FaultyLidar<L> {
    pub fn new(inner: L, faults: &Faults) -> Self {
        let injector = faults.for_device(Device::Lidar);
        let geometry = inner.geometry();
        let buffer = ReorderBuffer::new(&injector, || LaserScan::empty(geometry));
        Self { inner, injector, buffer }
    }

    pub fn inner(&self) -> &L {
        &self.inner
    }

    pub fn injector(&self) -> &Injector {
        &self.injector
    }

    fn apply_faults(&mut self, scan: &mut LaserScan) {
        if self.injector.active(Kind::Blind).is_some() {
            scan.ranges.fill(Range::NoReturn);
        }
        if let Some(fault) = self.injector.active(Kind::Dirt) {
            let half_rad = fault.amount().to_radians();
            for (beam, range) in scan.ranges.iter_mut().enumerate() {
                if hal::wrap_angle(scan.geometry.angle_rad(beam)).abs() <= half_rad {
                    *range = Range::Error;
                }
            }
        }
        let min_m = scan.geometry.range_min_m;
        let max_m = scan.geometry.range_max_m;
        for kind in [Kind::Error, Kind::Ghost, Kind::Corrupt] {
            let Some(fault) = self.injector.active(kind) else { continue };
            for range in &mut scan.ranges {
                if self.injector.draw(fault.amount()) {
                    *range = match kind {
                        Kind::Error => Range::Error,
                        Kind::Ghost => Range::Hit(GHOST_M),
                        _ => Range::Hit(
                            min_m + self.injector.rng().random::<f32>() * (max_m - min_m),
                        ),
                    };
                }
            }
        }
    }
}

impl<L: ErrorType> ErrorType for FaultyLidar<L> {
    type Error = FaultyError<L::Error>;
}

impl<L: Lidar> Lidar for FaultyLidar<L> {
    fn geometry(&self) -> ScanGeometry {
        self.inner.geometry()
    }

    fn poll_scan(&mut self, scan: &mut LaserScan) -> Faulty<bool, L> {
        if self.buffer.take_due(scan) {
            return Ok(true);
        }
        // The scanner is polled during a silence as well: scans of that time are lost, not delayed.
        let is_new = self.inner.poll_scan(scan).map_err(FaultyError::Device)?;
        self.injector.check()?;
        if self.injector.is_silent() {
            self.buffer.clear();
            return Ok(false);
        }
        if !is_new || self.injector.triggers(Kind::Drop) {
            return Ok(false);
        }
        self.apply_faults(scan);
        Ok(self.buffer.push(scan, &mut self.injector))
    }
}
