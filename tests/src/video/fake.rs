//! A simulated camera in this process, in whose hands time and faults are.

use std::os::fd::OwnedFd;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use drivers::v4l2::node::{Capability, Control, Filled, FourCc, Interval, Layout, VideoNode};
use rustix::io::Errno;

use super::device::Device;
use super::queue::Shot;

/// The camera. Clones are the same camera.
#[derive(Debug, Clone, Default)]
pub struct FakeCamera(Arc<Mutex<Inner>>);

#[derive(Debug, Default)]
struct Inner {
    device: Device,
    unplugged: bool,
    /// Counts plugs and opens: a node of an earlier one is dead.
    session: u64,
    opened: u64,
    sequence: u32,
    memory: Vec<Vec<u8>>,
}

impl FakeCamera {
    /// A camera that is like `device`.
    #[must_use]
    pub fn new(device: Device) -> Self {
        Self(Arc::new(Mutex::new(Inner { device, ..Inner::default() })))
    }

    /// Opens it. Only one program at a time may have it.
    ///
    /// # Errors
    /// `ENOENT` while it is unplugged.
    pub fn open(&self) -> Result<Box<dyn VideoNode>, Errno> {
        let mut inner = self.lock();
        if inner.unplugged {
            return Err(Errno::NOENT);
        }
        inner.opened += 1;
        inner.session += 1;
        // Another open node would keep its buffers.
        if inner.device.queue.counts()[0] > 0 {
            return Err(Errno::BUSY);
        }
        Ok(Box::new(FakeNode { camera: self.clone(), session: inner.session, copies: Vec::new() }))
    }

    /// Pulls the plug.
    pub fn unplug(&self) {
        let mut inner = self.lock();
        inner.unplugged = true;
        inner.session += 1;
        inner.device.close();
    }

    /// Puts it back. The count of pictures begins anew.
    pub fn plug(&self) {
        let mut inner = self.lock();
        (inner.unplugged, inner.sequence) = (false, 0);
    }

    /// Streaming fails for good: the next look gets `EIO`.
    pub fn fail(&self) {
        self.lock().device.queue.fail();
    }

    /// A picture whose bytes are all `value`. Returns whether there was a buffer for it.
    pub fn shoot(&self, time_ns: u64, value: u8) -> bool {
        let size = self.lock().device.layout.size;
        self.shoot_bytes(Some(time_ns), &vec![value; size as usize], false)
    }

    /// A picture of any bytes and stamp.
    pub fn shoot_bytes(&self, time_ns: Option<u64>, bytes: &[u8], damaged: bool) -> bool {
        let mut guard = self.lock();
        let inner = &mut *guard;
        if inner.unplugged || !inner.device.queue.is_streaming() {
            return false;
        }
        let shot =
            Shot { bytes_used: bytes.len() as u32, sequence: inner.sequence, time_ns, damaged };
        inner.sequence = inner.sequence.wrapping_add(1);
        let Some(index) = inner.device.queue.fill(shot) else { return false };
        let length = bytes.len().min(inner.memory[index as usize].len());
        inner.memory[index as usize][..length].copy_from_slice(&bytes[..length]);
        true
    }

    /// Pictures that the camera counts and loses.
    pub fn lose(&self, count: u32) {
        let mut inner = self.lock();
        inner.sequence = inner.sequence.wrapping_add(count);
    }

    /// Changes what it is like.
    pub fn change(&self, change: impl FnOnce(&mut Device)) {
        change(&mut self.lock().device);
    }

    /// Calls that no correct program makes.
    #[must_use]
    pub fn misuses(&self) -> u64 {
        self.lock().device.queue.misuses()
    }

    /// How often it was opened.
    #[must_use]
    pub fn opened(&self) -> u64 {
        self.lock().opened
    }

    /// Whether somebody streams from it.
    #[must_use]
    pub fn is_streaming(&self) -> bool {
        self.lock().device.queue.is_streaming()
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        // Whoever has panicked with it has failed already.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// An open fake camera. It looks at its buffers only in copies that were taken when they were dequeued.
#[derive(Debug)]
struct FakeNode {
    camera: FakeCamera,
    session: u64,
    copies: Vec<Vec<u8>>,
}

impl FakeNode {
    fn with<T>(&self, call: impl FnOnce(&mut Inner) -> Result<T, Errno>) -> Result<T, Errno> {
        let mut inner = self.camera.lock();
        if inner.unplugged || inner.session != self.session {
            return Err(Errno::NODEV);
        }
        call(&mut inner)
    }
}

impl VideoNode for FakeNode {
    fn capability(&mut self) -> Result<Capability, Errno> {
        self.with(|inner| Ok(inner.device.capability()))
    }

    fn format(&mut self, index: u32) -> Result<FourCc, Errno> {
        self.with(|inner| inner.device.format(index))
    }

    fn set_layout(&mut self, asked: Layout) -> Result<Layout, Errno> {
        self.with(|inner| inner.device.set_layout(asked))
    }

    fn interval(&mut self, wish: Option<Interval>) -> Result<Interval, Errno> {
        self.with(|inner| Ok(inner.device.interval(wish)))
    }

    fn control(&mut self, id: u32) -> Result<Control, Errno> {
        self.with(|inner| inner.device.control(id))
    }

    fn control_value(&mut self, id: u32) -> Result<i32, Errno> {
        self.with(|inner| inner.device.control_value(id))
    }

    fn set_control(&mut self, id: u32, value: i32) -> Result<(), Errno> {
        self.with(|inner| inner.device.set_control(id, value))
    }

    fn allocate(&mut self, count: u32) -> Result<u32, Errno> {
        let (count, size) = self.with(|inner| {
            let (count, size) =
                (inner.device.queue.allocate(count)?, inner.device.layout.size as usize);
            inner.memory = vec![vec![0; size]; count as usize];
            Ok((count, size))
        })?;
        self.copies = vec![vec![0; size]; count as usize];
        Ok(count)
    }

    fn queue(&mut self, index: u32) -> Result<(), Errno> {
        self.with(|inner| inner.device.queue.queue(index))?;
        self.copies[index as usize].clear();
        Ok(())
    }

    fn dequeue(&mut self) -> Result<Filled, Errno> {
        let (index, shot, bytes) = self.with(|inner| {
            let (index, shot) = inner.device.queue.dequeue()?;
            Ok((index, shot, inner.memory[index as usize].clone()))
        })?;
        self.copies[index as usize] = bytes;
        let Shot { bytes_used, sequence, time_ns, damaged } = shot;
        Ok(Filled { index, bytes_used, sequence, time_ns, stamped_at_start: true, damaged })
    }

    fn start(&mut self) -> Result<(), Errno> {
        self.with(|inner| inner.device.queue.start())
    }

    fn stop(&mut self) -> Result<(), Errno> {
        self.with(|inner| {
            inner.device.queue.stop();
            Ok(())
        })
    }

    fn export(&mut self, _index: u32) -> Result<OwnedFd, Errno> {
        Err(Errno::NOTTY)
    }

    fn bytes(&self, index: u32) -> &[u8] {
        self.copies.get(index as usize).map_or(&[], Vec::as_slice)
    }
}

impl Drop for FakeNode {
    fn drop(&mut self) {
        _ = self.with(|inner| {
            inner.device.close();
            Ok(())
        });
    }
}
