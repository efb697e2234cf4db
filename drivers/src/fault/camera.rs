//! Injects faults into a camera.

use hal::{Camera, CameraModel, ErrorType, Frame};
use rand::RngExt;

use super::error::{Faulty, FaultyError};
use super::injector::{Faults, Injector};
use super::kind::{Device, Kind};
use super::reorder_buffer::ReorderBuffer;

/// Wraps a camera and injects faults into its frames.
pub struct FaultyCamera<C> {
    inner: C,
    injector: Injector,
    buffer: ReorderBuffer<Frame>,
}

impl<C: Camera> FaultyCamera<C> {
    pub fn new(inner: C, faults: &Faults) -> Self {
        let injector = faults.for_device(Device::Camera);
        let buffer = ReorderBuffer::new(&injector, Frame::empty);
        Self { inner, injector, buffer }
    }

    pub fn inner(&self) -> &C {
        &self.inner
    }

    pub fn injector(&self) -> &Injector {
        &self.injector
    }

    fn apply_faults(&mut self, frame: &mut Frame) {
        if self.injector.active(Kind::Black).is_some() {
            frame.data.fill(0);
        }
        if self.injector.active(Kind::White).is_some() {
            frame.data.fill(255);
        }
        if self.injector.active(Kind::Resize).is_some()
            && let Some(bytes) = frame.format.bytes(frame.width, frame.height / 2)
        {
            frame.height /= 2;
            frame.data.truncate(bytes);
        }
        if self.injector.triggers(Kind::Corrupt) {
            // As after a broken-off transfer, the bytes from some position on are random.
            let from = self.injector.rng().random_range(0..=frame.data.len());
            if let Some(rest) = frame.data.get_mut(from..) {
                self.injector.rng().fill(rest);
            }
        }
    }
}

impl<C: ErrorType> ErrorType for FaultyCamera<C> {
    type Error = FaultyError<C::Error>;
}

impl<C: Camera> Camera for FaultyCamera<C> {
    fn model(&self) -> &CameraModel {
        self.inner.model()
    }

    fn poll_frame(&mut self, frame: &mut Frame) -> Faulty<bool, C> {
        if self.buffer.take_due(frame) {
            return Ok(true);
        }
        // The camera is polled during a silence as well: frames of that time are lost, not delayed.
        let is_new = self.inner.poll_frame(frame).map_err(FaultyError::Device)?;
        self.injector.check()?;
        if self.injector.is_silent() {
            self.buffer.clear();
            return Ok(false);
        }
        if !is_new || self.injector.triggers(Kind::Drop) {
            return Ok(false);
        }
        self.apply_faults(frame);
        Ok(self.buffer.push(frame, &mut self.injector))
    }
}
