//! A camera that misbehaves.

use hal::{Camera, CameraModel, ErrorType, Frame};
use rand::RngExt;

use super::belt::Belt;
use super::error::{Faulty, FaultyError};
use super::injector::{Faults, Injector};
use super::schedule::{Device, Kind};

/// The wrapper.
pub struct FaultyCamera<C> {
    inner: C,
    injector: Injector,
    belt: Belt<Frame>,
}

impl<C: Camera> FaultyCamera<C> {
    /// Wraps a camera.
    pub fn new(inner: C, faults: &Faults) -> Self {
        let injector = faults.of(Device::Camera);
        let belt = Belt::new(&injector, Frame::empty);
        Self { inner, injector, belt }
    }

    /// The camera itself.
    pub fn inner(&self) -> &C {
        &self.inner
    }

    /// What goes wrong.
    pub fn injector(&self) -> &Injector {
        &self.injector
    }

    fn spoil(&mut self, frame: &mut Frame) {
        if self.injector.on(Kind::Black).is_some() {
            frame.data.fill(0);
        }
        if self.injector.on(Kind::White).is_some() {
            frame.data.fill(255);
        }
        if self.injector.on(Kind::Resize).is_some()
            && let Some(bytes) = frame.format.bytes(frame.width, frame.height / 2)
        {
            frame.height /= 2;
            frame.data.truncate(bytes);
        }
        if self.injector.strikes(Kind::Corrupt) {
            // As where a transfer broke off: from some byte on, nonsense.
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
        if self.belt.due(frame) {
            return Ok(true);
        }
        // Also asked while nobody hears it: what it has to say then is lost, not late.
        let is_new = self.inner.poll_frame(frame).map_err(FaultyError::Device)?;
        self.injector.check()?;
        if self.injector.is_silent() {
            self.belt.clear();
            return Ok(false);
        }
        if !is_new || self.injector.strikes(Kind::Drop) {
            return Ok(false);
        }
        self.spoil(frame);
        Ok(self.belt.pass(frame, &mut self.injector))
    }
}
