//! A random fault schedule.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::schedule::Fault;

/// The faults that a robot must survive without an operator. A base that is unplugged or silent, a
/// bumper that stays pressed, and a full disk are not among them.
const SURVIVABLE: [&str; 24] = [
    "camera:stall",
    "camera:unplug",
    "camera:drop=0.3",
    "camera:delay=2",
    "camera:duplicate=0.3",
    "camera:reorder=0.3",
    "camera:corrupt=0.3",
    "camera:black",
    "camera:white",
    "lidar:stall",
    "lidar:unplug",
    "lidar:drop=0.3",
    "lidar:delay=1",
    "lidar:duplicate=0.3",
    "lidar:reorder=0.2",
    "lidar:corrupt=0.01",
    "lidar:error=0.1",
    "lidar:blind",
    "lidar:ghost=0.002",
    "base:drop=0.2",
    "base:duplicate=0.3",
    "base:corrupt=0.2",
    "base:nan",
    "clock:slow=100",
];
/// Start of the first fault, in tenths of a second: early enough that a short run has one too.
const FIRST_DS: std::ops::RangeInclusive<u32> = 5..=40;
/// Time from the start of one fault to the start of the next, in tenths of a second.
const SPACING_DS: std::ops::RangeInclusive<u32> = 30..=90;
/// Duration of a fault, in tenths of a second.
const DURATION_DS: std::ops::RangeInclusive<u32> = 5..=30;

/// Random faults of all devices over `span_s` seconds, one about every 6 s.
#[must_use]
pub fn random_faults(seed: u64, span_s: f64) -> Vec<Fault> {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let mut faults = Vec::new();
    let mut time_ds = rng.random_range(FIRST_DS);
    loop {
        let from_s = f64::from(time_ds) / 10.0;
        if from_s >= span_s {
            return faults;
        }
        let to_s = f64::from(time_ds + rng.random_range(DURATION_DS)) / 10.0;
        let text = SURVIVABLE.get(rng.random_range(0..SURVIVABLE.len()));
        // All of them can be parsed, which a test checks.
        if let Some(mut fault) = text.and_then(|text| text.parse::<Fault>().ok()) {
            fault.from_s = from_s;
            fault.to_s = to_s;
            faults.push(fault);
        }
        time_ds += rng.random_range(SPACING_DS);
    }
}
