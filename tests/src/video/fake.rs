//! A simulated camera in this process, with time and faults under the control of the test.

use std::os::fd::OwnedFd;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use drivers::v4l2::node::{Capability, Control, Filled, FourCc, Interval, Layout, VideoNode};
use rustix::io::Errno;

use super::device::Device;
use super::queue::FrameInfo;

/// A simulated camera. Clones refer to the same camera.
#[derive(Debug, Clone, Default)]
pub struct FakeCamera(Arc<Mutex<Inner>>);

#[derive(Debug, Default)]
struct Inner {
    device: Device,
    unplugged: bool,
    /// Number of plug and open events. A node of an earlier session is dead.
    session: u64,
    opened: u64,
    sequence: u32,
    memory: Vec<Vec<u8>>,
}

impl FakeCamera {
    /// Creates a camera with these properties.
    #[must_use]
    pub fn new(device: Device) -> Self {
        Self(Arc::new(Mutex::new(Inner { device, ..Inner::default() })))
    }

    /// Opens the camera. Only one program at a time may use it.
    ///
    /// # Errors
    /// `ENOENT` while the camera is unplugged.
    pub fn open(&self) -> Result<Box<dyn VideoNode>, Errno> {
        let mut inner = self.lock();
        if inner.unplugged {
            return Err(Errno::NOENT);
        }
        inner.opened += 1;
        inner.session += 1;
        // Another node still holds its buffers.
        if inner.device.queue.counts()[0] > 0 {
            return Err(Errno::BUSY);
        }
        Ok(Box::new(FakeNode { camera: self.clone(), session: inner.session, copies: Vec::new() }))
    }

    /// Unplugs the camera.
    pub fn unplug(&self) {
        let mut inner = self.lock();
        inner.unplugged = true;
        inner.session += 1;
        inner.device.close();
    }

    /// Plugs the camera in again. Its frame counter restarts at 0.
    pub fn plug(&self) {
        let mut inner = self.lock();
        inner.unplugged = false;
        inner.sequence = 0;
    }

    /// Makes streaming fail permanently: the next dequeue returns `EIO`.
    pub fn fail(&self) {
        self.lock().device.queue.fail();
    }

    /// Delivers a frame whose bytes are all `value`. Returns whether there was a buffer for it.
    pub fn deliver(&self, time_ns: u64, value: u8) -> bool {
        let size = self.lock().device.layout.size;
        self.deliver_bytes(Some(time_ns), &vec![value; size as usize], false)
    }

    /// Delivers a frame with any bytes and timestamp. Returns whether there was a buffer for it.
    pub fn deliver_bytes(&self, time_ns: Option<u64>, bytes: &[u8], damaged: bool) -> bool {
        let mut guard = self.lock();
        let inner = &mut *guard;
        if inner.unplugged || !inner.device.queue.is_streaming() {
            return false;
        }
        let info = FrameInfo {
            bytes_used: bytes.len() as u32,
            sequence: inner.sequence,
            time_ns,
            damaged,
        };
        inner.sequence = inner.sequence.wrapping_add(1);
        let Some(index) = inner.device.queue.fill(info) else { return false };
        let length = bytes.len().min(inner.memory[index as usize].len());
        inner.memory[index as usize][..length].copy_from_slice(&bytes[..length]);
        true
    }

    /// Advances the frame counter by `count` without delivering frames.
    pub fn drop_frames(&self, count: u32) {
        let mut inner = self.lock();
        inner.sequence = inner.sequence.wrapping_add(count);
    }

    /// Changes the properties of the camera.
    pub fn change(&self, change: impl FnOnce(&mut Device)) {
        change(&mut self.lock().device);
    }

    /// Number of calls that no correct program makes.
    #[must_use]
    pub fn misuses(&self) -> u64 {
        self.lock().device.queue.misuses()
    }

    /// Number of times that the camera was opened.
    #[must_use]
    pub fn opened(&self) -> u64 {
        self.lock().opened
    }

    /// Whether a program streams from the camera.
    #[must_use]
    pub fn is_streaming(&self) -> bool {
        self.lock().device.queue.is_streaming()
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        // A test that panicked while it held the lock has already failed.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// An open fake camera. It reads buffers only from copies that were taken when they were dequeued.
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

    fn set_layout(&mut self, requested: Layout) -> Result<Layout, Errno> {
        self.with(|inner| inner.device.set_layout(requested))
    }

    fn interval(&mut self, requested: Option<Interval>) -> Result<Interval, Errno> {
        self.with(|inner| Ok(inner.device.interval(requested)))
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
            let count = inner.device.queue.allocate(count)?;
            let size = inner.device.layout.size as usize;
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
        let (index, info, bytes) = self.with(|inner| {
            let (index, info) = inner.device.queue.dequeue()?;
            Ok((index, info, inner.memory[index as usize].clone()))
        })?;
        self.copies[index as usize] = bytes;
        let FrameInfo { bytes_used, sequence, time_ns, damaged } = info;
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
