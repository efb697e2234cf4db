//! Injects faults into a drive base.

use hal::{Base, DriveCommand, ErrorType, PowerReport, StopCause, WheelFeedback};

use super::error::{Faulty, FaultyError, Symptom};
use super::injector::{Faults, Injector};
use super::kind::{Device, Kind};
use super::reorder_buffer::ReorderBuffer;

/// Wraps a base and injects faults. A stop command is lost only while the base is unplugged; its
/// own watchdog stops it then.
pub struct FaultyBase<B> {
    inner: B,
    injector: Injector,
    buffer: ReorderBuffer<WheelFeedback>,
}

impl<B: Base> FaultyBase<B> {
    pub fn new(inner: B, faults: &Faults) -> Self {
        let injector = faults.for_device(Device::Base);
        let buffer = ReorderBuffer::new(&injector, WheelFeedback::default);
        Self { inner, injector, buffer }
    }

    pub fn inner(&self) -> &B {
        &self.inner
    }

    pub fn injector(&self) -> &Injector {
        &self.injector
    }

    /// Returns an error while the base is unplugged.
    fn check_connected(&self) -> Faulty<(), B> {
        match self.injector.active(Kind::Unplug) {
            Some(_) => Err(self.injector.error(Symptom::Unplugged)),
            None => Ok(()),
        }
    }

    fn apply_faults(&self, wheel: &mut WheelFeedback) {
        if self.injector.active(Kind::Nan).is_some() {
            wheel.odom.x_m = f64::NAN;
        }
        wheel.odom.x_m += self.injector.active(Kind::Jump).map_or(0.0, |fault| fault.amount());
        wheel.contact |= self.injector.active(Kind::Contact).is_some();
    }
}

impl<B: ErrorType> ErrorType for FaultyBase<B> {
    type Error = FaultyError<B::Error>;
}

impl<B: Base> Base for FaultyBase<B> {
    fn arm(&mut self) -> Faulty<bool, B> {
        self.check_connected()?;
        self.inner.arm().map_err(FaultyError::Device)
    }

    fn disarm(&mut self) {
        self.inner.disarm();
    }

    fn drive(&mut self, command: &DriveCommand) -> Faulty<(), B> {
        self.check_connected()?;
        if self.injector.triggers(Kind::Drop) {
            return Ok(());
        }
        self.inner.drive(command).map_err(FaultyError::Device)
    }

    fn stop_cause(&self) -> Option<StopCause> {
        self.inner.stop_cause()
    }

    fn power(&self) -> PowerReport {
        self.inner.power()
    }

    fn stop(&mut self) -> Faulty<(), B> {
        self.check_connected()?;
        self.inner.stop().map_err(FaultyError::Device)
    }

    fn finish(&mut self) {
        self.inner.finish();
    }

    fn poll_feedback(&mut self) -> Faulty<Option<WheelFeedback>, B> {
        let mut wheel = WheelFeedback::default();
        if self.buffer.take_due(&mut wheel) {
            return Ok(Some(wheel));
        }
        // The base is polled during a silence as well: readings of that time are lost, not delayed.
        let new = self.inner.poll_feedback().map_err(FaultyError::Device)?;
        self.injector.check()?;
        if self.injector.is_silent() {
            self.buffer.clear();
            return Ok(None);
        }
        let Some(mut wheel) = new else { return Ok(None) };
        if self.injector.triggers(Kind::Drop) {
            return Ok(None);
        }
        if self.injector.triggers(Kind::Corrupt) {
            return Err(self.injector.error(Symptom::Corrupt));
        }
        self.apply_faults(&mut wheel);
        Ok(self.buffer.push(&mut wheel, &mut self.injector).then_some(wheel))
    }
}
