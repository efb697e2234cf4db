//! One device's share of a run's faults.

use std::sync::Arc;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::error::{FaultyError, Symptom};
use super::schedule::{Device, Fault, Kind};
use crate::{DeviceState, DeviceStatus};

/// Nanoseconds since the start of the run. Called on every thread that has a wrapped device; must neither wait nor allocate.
pub type Now = Arc<dyn Fn() -> u64 + Send + Sync>;

/// A driver has noticed silence after this time: the longest of ours (feedback of the base, 100 ms).
const NOTICED_NS: u64 = 100_000_000;

/// All that goes wrong in a run.
#[derive(Clone)]
pub struct Faults {
    faults: Vec<Fault>,
    seed: u64,
    now: Now,
}

impl Faults {
    /// These faults; everything random in them comes from `seed`.
    #[must_use]
    pub fn new(faults: Vec<Fault>, seed: u64, now: Now) -> Self {
        Self { faults, seed, now }
    }

    /// The part of one device. Devices draw apart from each other.
    #[must_use]
    pub fn of(&self, device: Device) -> Injector {
        let stream = device.name().bytes().fold(0, |stream, byte| (stream << 8) | u64::from(byte));
        Injector {
            device,
            faults: self.faults.iter().filter(|fault| fault.device == device).copied().collect(),
            rng: Pcg64Mcg::seed_from_u64(self.seed ^ stream),
            now: Arc::clone(&self.now),
        }
    }
}

/// One device's faults.
pub struct Injector {
    device: Device,
    faults: Vec<Fault>,
    rng: Pcg64Mcg,
    now: Now,
}

impl Injector {
    /// The fault of this kind that is on now.
    #[must_use]
    pub fn on(&self, kind: Kind) -> Option<Fault> {
        // Most runs have none, and then nobody needs to know the time.
        if self.faults.is_empty() {
            return None;
        }
        let now_ns = (self.now)();
        self.faults.iter().find(|fault| fault.kind == kind && fault.is_on(now_ns)).copied()
    }

    /// Whether a fault that meets a share of the readings meets this one.
    pub fn strikes(&mut self, kind: Kind) -> bool {
        self.on(kind).is_some_and(|fault| self.draw(fault.amount()))
    }

    /// True with this probability.
    pub(super) fn draw(&mut self, share: f64) -> bool {
        self.rng.random::<f64>() < share
    }

    pub(super) fn rng(&mut self) -> &mut Pcg64Mcg {
        &mut self.rng
    }

    /// The most that a fault of this kind ever amounts to; 0 when there is none.
    pub(super) fn most(&self, kind: Kind) -> f64 {
        self.faults.iter().filter(|fault| fault.kind == kind).map(Fault::amount).fold(0.0, f64::max)
    }

    /// Whether the device says nothing now.
    pub(super) fn is_silent(&self) -> bool {
        self.on(Kind::Unplug).or_else(|| self.on(Kind::Stall)).is_some()
    }

    /// What its driver would have noticed by now.
    #[must_use]
    pub fn symptom(&self) -> Option<Symptom> {
        if self.on(Kind::Unplug).is_some() {
            return Some(Symptom::Unplugged);
        }
        let fault = self.on(Kind::Stall)?;
        let silent_ns = (self.now)().saturating_sub((fault.from_s * 1e9) as u64);
        (silent_ns > NOTICED_NS).then_some(Symptom::Silent)
    }

    /// An error if the driver would report one.
    pub(super) fn check<E>(&self) -> Result<(), FaultyError<E>> {
        self.symptom().map_or(Ok(()), |symptom| Err(self.error(symptom)))
    }

    pub(super) fn error<E>(&self, symptom: Symptom) -> FaultyError<E> {
        FaultyError::Injected { device: self.device, symptom }
    }

    /// What the driver says of the device, as it would with these faults.
    #[must_use]
    pub fn status(&self, status: DeviceStatus) -> DeviceStatus {
        let state = match self.symptom() {
            Some(Symptom::Unplugged) => DeviceState::Disconnected,
            Some(Symptom::Silent) => DeviceState::Silent,
            Some(Symptom::Corrupt) | None => status.state,
        };
        DeviceStatus { state, ..status }
    }
}
