//! Injected faults of the disk: slow, full, or unplugged.

use std::io::{self, Write};
use std::path::Path;

use drivers::fault::{Device, Faults, Injector, Kind};
use hal::Clock;
use monotonic_clock::MonotonicClock;

use super::disk::{Disk, SegmentFile, Space};

/// A disk with injected faults.
pub struct FaultyDisk<D> {
    inner: D,
    faults: Faults,
    injector: Injector,
}

struct FaultyFile {
    inner: Box<dyn SegmentFile>,
    injector: Injector,
}

impl<D: Disk> FaultyDisk<D> {
    /// Wraps a disk.
    pub fn new(inner: D, faults: &Faults) -> Self {
        Self { inner, faults: faults.clone(), injector: faults.for_device(Device::Disk) }
    }
}

fn inject_faults(injector: &Injector) -> io::Result<()> {
    if let Some(fault) = injector.active(Kind::Slow) {
        let mut clock = MonotonicClock;
        clock.sleep_until_ns(clock.now_ns() + (fault.amount() * 1e6) as u64);
    }
    if injector.active(Kind::Unplug).is_some() {
        return Err(io::Error::other("the disk is unplugged (an injected fault)"));
    }
    if injector.active(Kind::Full).is_some() {
        return Err(io::Error::new(
            io::ErrorKind::StorageFull,
            "no space left on device (an injected fault)",
        ));
    }
    Ok(())
}

impl<D: Disk> Disk for FaultyDisk<D> {
    fn create(&mut self, path: &Path) -> io::Result<Box<dyn SegmentFile>> {
        inject_faults(&self.injector)?;
        let inner = self.inner.create(path)?;
        Ok(Box::new(FaultyFile { inner, injector: self.faults.for_device(Device::Disk) }))
    }

    fn remove(&mut self, path: &Path) -> io::Result<()> {
        self.inner.remove(path)
    }

    fn space(&self, path: &Path) -> io::Result<Space> {
        self.inner.space(path)
    }
}

impl Write for FaultyFile {
    fn write(&mut self, data: &[u8]) -> io::Result<usize> {
        inject_faults(&self.injector)?;
        self.inner.write(data)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.inner.flush()
    }
}

impl SegmentFile for FaultyFile {
    fn truncate(&mut self, len: u64) -> io::Result<()> {
        self.inner.truncate(len)
    }

    fn sync(&mut self) -> io::Result<()> {
        inject_faults(&self.injector)?;
        self.inner.sync()
    }
}
