//! The faults of one run, and the part of them that concerns one device.

use std::sync::Arc;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::error::{FaultyError, Symptom};
use super::kind::{Device, Kind};
use super::schedule::Fault;
use crate::{DeviceState, DeviceStatus};

/// Returns the nanoseconds since the start of the run. Called on every thread that has a wrapped
/// device, so it must neither block nor allocate.
pub type Now = Arc<dyn Fn() -> u64 + Send + Sync>;

/// After this time every driver has detected a silence. It is the longest time-out of our drivers
/// (the base's feedback, 100 ms).
const SILENCE_DETECTED_NS: u64 = 100_000_000;

/// The fault schedule of one run, for all devices.
#[derive(Clone)]
pub struct Faults {
    faults: Vec<Fault>,
    seed: u64,
    now: Now,
}

impl Faults {
    /// A schedule of these faults. `seed` determines all of their randomness.
    #[must_use]
    pub fn new(faults: Vec<Fault>, seed: u64, now: Now) -> Self {
        Self { faults, seed, now }
    }

    /// The injector of one device. Each device has a random stream of its own.
    #[must_use]
    pub fn for_device(&self, device: Device) -> Injector {
        let stream = device.name().bytes().fold(0, |stream, byte| (stream << 8) | u64::from(byte));
        Injector {
            device,
            faults: self.faults.iter().filter(|fault| fault.device == device).copied().collect(),
            rng: Pcg64Mcg::seed_from_u64(self.seed ^ stream),
            now: Arc::clone(&self.now),
        }
    }
}

/// Decides when the faults of one device occur.
pub struct Injector {
    device: Device,
    faults: Vec<Fault>,
    rng: Pcg64Mcg,
    now: Now,
}

impl Injector {
    /// The fault of this kind that is active now, if any.
    #[must_use]
    pub fn active(&self, kind: Kind) -> Option<Fault> {
        // Most runs have no faults; they do not need to read the time.
        if self.faults.is_empty() {
            return None;
        }
        let now_ns = (self.now)();
        self.faults.iter().find(|fault| fault.kind == kind && fault.is_active(now_ns)).copied()
    }

    /// Whether a fault that concerns a share of the readings concerns this one. Draws a random
    /// number if such a fault is active.
    pub fn triggers(&mut self, kind: Kind) -> bool {
        self.active(kind).is_some_and(|fault| self.draw(fault.amount()))
    }

    /// Returns true with the probability `share`.
    pub(super) fn draw(&mut self, share: f64) -> bool {
        self.rng.random::<f64>() < share
    }

    pub(super) fn rng(&mut self) -> &mut Pcg64Mcg {
        &mut self.rng
    }

    /// The largest amount of all faults of this kind, whether active or not; 0 when there is none.
    pub(super) fn max_amount(&self, kind: Kind) -> f64 {
        self.faults.iter().filter(|fault| fault.kind == kind).map(Fault::amount).fold(0.0, f64::max)
    }

    /// Whether the device sends nothing now.
    pub(super) fn is_silent(&self) -> bool {
        self.active(Kind::Unplug).or_else(|| self.active(Kind::Stall)).is_some()
    }

    /// What the device's driver would have detected by now.
    #[must_use]
    pub fn symptom(&self) -> Option<Symptom> {
        if self.active(Kind::Unplug).is_some() {
            return Some(Symptom::Unplugged);
        }
        let fault = self.active(Kind::Stall)?;
        let silent_ns = (self.now)().saturating_sub((fault.from_s * 1e9) as u64);
        (silent_ns > SILENCE_DETECTED_NS).then_some(Symptom::Silent)
    }

    /// Returns an error if the driver would report one.
    pub(super) fn check<E>(&self) -> Result<(), FaultyError<E>> {
        self.symptom().map_or(Ok(()), |symptom| Err(self.error(symptom)))
    }

    pub(super) fn error<E>(&self, symptom: Symptom) -> FaultyError<E> {
        FaultyError::Injected { device: self.device, symptom }
    }

    /// The status that the driver would report with these faults, given its actual `status`.
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
