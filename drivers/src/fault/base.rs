//! A base that misbehaves.

use hal::{Base, DriveCommand, ErrorType, WheelFeedback};

use super::belt::Belt;
use super::error::{Faulty, FaultyError, Symptom};
use super::injector::{Faults, Injector};
use super::schedule::{Device, Kind};

/// The wrapper. A stop is lost only where the base is not there: its own watchdog is what stops it then.
pub struct FaultyBase<B> {
    inner: B,
    injector: Injector,
    belt: Belt<WheelFeedback>,
}

impl<B: Base> FaultyBase<B> {
    /// Wraps a base.
    pub fn new(inner: B, faults: &Faults) -> Self {
        let injector = faults.of(Device::Base);
        let belt = Belt::new(&injector, WheelFeedback::default);
        Self { inner, injector, belt }
    }

    /// The base itself.
    pub fn inner(&self) -> &B {
        &self.inner
    }

    /// What goes wrong.
    pub fn injector(&self) -> &Injector {
        &self.injector
    }

    /// Refuses what cannot reach a base that is not there.
    fn reach(&self) -> Faulty<(), B> {
        match self.injector.on(Kind::Unplug) {
            Some(_) => Err(self.injector.error(Symptom::Unplugged)),
            None => Ok(()),
        }
    }

    fn spoil(&self, wheel: &mut WheelFeedback) {
        if self.injector.on(Kind::Nan).is_some() {
            wheel.odom.x_m = f64::NAN;
        }
        wheel.odom.x_m += self.injector.on(Kind::Jump).map_or(0.0, |fault| fault.amount());
        wheel.contact |= self.injector.on(Kind::Contact).is_some();
    }
}

impl<B: ErrorType> ErrorType for FaultyBase<B> {
    type Error = FaultyError<B::Error>;
}

impl<B: Base> Base for FaultyBase<B> {
    fn arm(&mut self) -> Faulty<bool, B> {
        self.reach()?;
        self.inner.arm().map_err(FaultyError::Device)
    }

    fn disarm(&mut self) {
        self.inner.disarm();
    }

    fn drive(&mut self, command: &DriveCommand) -> Faulty<(), B> {
        self.reach()?;
        if self.injector.strikes(Kind::Drop) {
            return Ok(());
        }
        self.inner.drive(command).map_err(FaultyError::Device)
    }

    fn stop(&mut self) -> Faulty<(), B> {
        self.reach()?;
        self.inner.stop().map_err(FaultyError::Device)
    }

    fn poll_feedback(&mut self) -> Faulty<Option<WheelFeedback>, B> {
        let mut wheel = WheelFeedback::default();
        if self.belt.due(&mut wheel) {
            return Ok(Some(wheel));
        }
        // Also asked while nobody hears it: what it has to say then is lost, not late.
        let new = self.inner.poll_feedback().map_err(FaultyError::Device)?;
        self.injector.check()?;
        if self.injector.is_silent() {
            self.belt.clear();
            return Ok(None);
        }
        let Some(mut wheel) = new else { return Ok(None) };
        if self.injector.strikes(Kind::Drop) {
            return Ok(None);
        }
        if self.injector.strikes(Kind::Corrupt) {
            return Err(self.injector.error(Symptom::Corrupt));
        }
        self.spoil(&mut wheel);
        Ok(self.belt.pass(&mut wheel, &mut self.injector).then_some(wheel))
    }
}
