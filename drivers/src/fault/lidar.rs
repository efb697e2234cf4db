//! A scanner that misbehaves.

use hal::{ErrorType, LaserScan, Lidar, Range, ScanGeometry};
use rand::RngExt;

use super::belt::Belt;
use super::error::{Faulty, FaultyError};
use super::injector::{Faults, Injector};
use super::schedule::{Device, Kind};

/// Where ghosts stand, metres: inside of every stop zone.
const GHOST_M: f32 = 0.15;

/// The wrapper.
pub struct FaultyLidar<L> {
    inner: L,
    injector: Injector,
    belt: Belt<LaserScan>,
}

impl<L: Lidar> FaultyLidar<L> {
    /// Wraps a scanner.
    pub fn new(inner: L, faults: &Faults) -> Self {
        let injector = faults.of(Device::Lidar);
        let geometry = inner.geometry();
        let belt = Belt::new(&injector, || LaserScan::empty(geometry));
        Self { inner, injector, belt }
    }

    /// The scanner itself.
    pub fn inner(&self) -> &L {
        &self.inner
    }

    /// What goes wrong.
    pub fn injector(&self) -> &Injector {
        &self.injector
    }

    fn spoil(&mut self, scan: &mut LaserScan) {
        if self.injector.on(Kind::Blind).is_some() {
            scan.ranges.fill(Range::NoReturn);
        }
        let (min_m, max_m) = (scan.geometry.range_min_m, scan.geometry.range_max_m);
        for kind in [Kind::Error, Kind::Ghost, Kind::Corrupt] {
            let Some(fault) = self.injector.on(kind) else { continue };
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
        if self.belt.due(scan) {
            return Ok(true);
        }
        // Also asked while nobody hears it: what it has to say then is lost, not late.
        let is_new = self.inner.poll_scan(scan).map_err(FaultyError::Device)?;
        self.injector.check()?;
        if self.injector.is_silent() {
            self.belt.clear();
            return Ok(false);
        }
        if !is_new || self.injector.strikes(Kind::Drop) {
            return Ok(false);
        }
        self.spoil(scan);
        Ok(self.belt.pass(scan, &mut self.injector))
    }
}
