//! Injects faults into an inertial measurement unit.

use hal::{ErrorType, Imu, ImuSample};
use rand::RngExt;

use super::error::{Faulty, FaultyError};
use super::injector::{Faults, Injector};
use super::kind::{Device, Kind};
use super::reorder_buffer::ReorderBuffer;

/// Full scale of common gyroscopes (2,000 degrees per second) and accelerometers (16 g), within which corrupt values are.
const FULL_RADPS: f64 = 35.0;
const FULL_MPS2: f64 = 157.0;

/// Wraps a unit and injects faults into its samples.
pub struct FaultyImu<I> {
    inner: I,
    injector: Injector,
    buffer: ReorderBuffer<ImuSample>,
}

const EMPTY: ImuSample = ImuSample { time_ns: 0, angular_radps: [0.0; 3], force_mps2: None };

impl<I: Imu> FaultyImu<I> {
    pub fn new(inner: I, faults: &Faults) -> Self {
        let injector = faults.for_device(Device::Imu);
        let buffer = ReorderBuffer::new(&injector, || EMPTY);
        Self { inner, injector, buffer }
    }

    pub fn inner(&self) -> &I {
        &self.inner
    }

    pub fn injector(&self) -> &Injector {
        &self.injector
    }

    fn apply_faults(&mut self, sample: &mut ImuSample) {
        if let Some(fault) = self.injector.active(Kind::Bias) {
            for radps in &mut sample.angular_radps {
                *radps += fault.amount();
            }
        }
        if self.injector.triggers(Kind::Corrupt) {
            let rng = self.injector.rng();
            for radps in &mut sample.angular_radps {
                *radps = rng.random_range(-FULL_RADPS..FULL_RADPS);
            }
            for mps2 in sample.force_mps2.iter_mut().flatten() {
                *mps2 = rng.random_range(-FULL_MPS2..FULL_MPS2);
            }
        }
    }
}

impl<I: ErrorType> ErrorType for FaultyImu<I> {
    type Error = FaultyError<I::Error>;
}

impl<I: Imu> Imu for FaultyImu<I> {
    fn poll_sample(&mut self) -> Faulty<Option<ImuSample>, I> {
        let mut due = EMPTY;
        if self.buffer.take_due(&mut due) {
            return Ok(Some(due));
        }
        // A lost sample is not the end of those that wait, which `None` would mean. The unit is polled during a silence as well:
        // samples of that time are lost, not delayed.
        loop {
            let new = self.inner.poll_sample().map_err(FaultyError::Device)?;
            self.injector.check()?;
            if self.injector.is_silent() {
                self.buffer.clear();
            }
            let Some(mut sample) = new else { return Ok(None) };
            if self.injector.is_silent() || self.injector.triggers(Kind::Drop) {
                continue;
            }
            self.apply_faults(&mut sample);
            if self.buffer.push(&mut sample, &mut self.injector) {
                return Ok(Some(sample));
            }
        }
    }
}
