//! Faults of the transport, and plans of faults over time.

use std::fmt;
use std::str::FromStr;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// Faults of the transport.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct WireFaults {
    /// Fraction of messages with one flipped bit.
    pub flip_share: f64,
    /// Fraction of messages that are truncated at a random byte.
    pub cut_share: f64,
    /// Number of noise bytes before the next message, once.
    pub noise_bytes: usize,
    /// No bytes pass in either direction.
    pub is_stalled: bool,
}

impl WireFaults {
    /// Applies the faults to one message.
    pub fn corrupt(&mut self, message: &mut Vec<u8>, rng: &mut Pcg64Mcg) {
        if message.is_empty() {
            return;
        }
        if rng.random::<f64>() < self.flip_share {
            let place = rng.random_range(0..message.len());
            message[place] ^= 1 << rng.random_range(0..8);
        }
        if rng.random::<f64>() < self.cut_share {
            message.truncate(rng.random_range(0..message.len()));
        }
        let noise: Vec<u8> =
            (0..std::mem::take(&mut self.noise_bytes)).map(|_| rng.random()).collect();
        message.splice(0..0, noise);
        if self.is_stalled {
            message.clear();
        }
    }
}

/// A random generator for faults.
#[must_use]
pub fn seeded(seed: u64) -> Pcg64Mcg {
    Pcg64Mcg::seed_from_u64(seed)
}

/// A kind of fault with a begin and an end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EventKind {
    /// No bytes pass in either direction.
    Stall,
    /// The scanner is unplugged, and plugged in again at the end.
    Unplug,
    /// The scanner restarts and is ready at the end.
    Reboot,
    /// Noise bytes before a message.
    Noise,
    /// All beams report errors.
    Blind,
    Motor,
    Laser,
}

/// A fault at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Event {
    pub kind: EventKind,
    /// Begin, seconds after the start.
    pub begin_s: f64,
    /// End, seconds after the start.
    pub end_s: f64,
}

/// Faults as written on the command line:
/// `stall@5+0.5,unplug@10+2,reboot@15+1,flip=0.01,cut=0.01,drift=200`.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FaultPlan {
    /// Faults with a begin and an end.
    pub events: Vec<Event>,
    /// Faults of the transport during the whole run.
    pub wire: WireFaults,
    /// Rate error of the scanner's clock, parts per million.
    pub drift_ppm: f64,
}

impl FromStr for FaultPlan {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let mut plan = Self::default();
        for part in text.split(',').filter(|part| !part.is_empty()) {
            plan.add(part).ok_or_else(|| {
                format!(
                    "`{part}` is not a fault; write KIND@BEGIN+DURATION (seconds) with stall, unplug, reboot, noise, blind, motor or \
                     laser, or flip=FRACTION, cut=FRACTION, drift=PPM"
                )
            })?;
        }
        Ok(plan)
    }
}

impl FaultPlan {
    fn add(&mut self, part: &str) -> Option<()> {
        if let Some((name, value)) = part.split_once('=') {
            let value: f64 = value.parse().ok().filter(|value: &f64| value.is_finite())?;
            match name {
                "flip" => self.wire.flip_share = value,
                "cut" => self.wire.cut_share = value,
                "drift" => self.drift_ppm = value,
                _ => return None,
            }
            return Some(());
        }
        let (name, when) = part.split_once('@')?;
        let kind = *EventKind::ALL.iter().find(|kind| kind.to_string() == name)?;
        let (begin, length) = when.split_once('+').unwrap_or((when, "1"));
        let begin_s: f64 = begin.parse().ok()?;
        let length_s: f64 = length.parse().ok()?;
        self.events.push(Event { kind, begin_s, end_s: begin_s + length_s });
        Some(())
    }
}

impl EventKind {
    const ALL: [Self; 7] = [
        Self::Stall,
        Self::Unplug,
        Self::Reboot,
        Self::Noise,
        Self::Blind,
        Self::Motor,
        Self::Laser,
    ];
}

impl fmt::Display for EventKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Stall => "stall",
            Self::Unplug => "unplug",
            Self::Reboot => "reboot",
            Self::Noise => "noise",
            Self::Blind => "blind",
            Self::Motor => "motor",
            Self::Laser => "laser",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_plan_is_parsed_and_an_invalid_part_is_named() {
        let plan: FaultPlan = "stall@5+0.5,reboot@10,flip=0.01,drift=-200".parse().unwrap();
        assert_eq!(plan.events[0], Event { kind: EventKind::Stall, begin_s: 5.0, end_s: 5.5 });
        assert_eq!(plan.events[1], Event { kind: EventKind::Reboot, begin_s: 10.0, end_s: 11.0 });
        assert_eq!((plan.wire.flip_share, plan.drift_ppm), (0.01, -200.0));
        assert!("stall@,x".parse::<FaultPlan>().unwrap_err().contains("`stall@`"));
    }

    #[test]
    fn a_flip_changes_one_bit_and_a_cut_shortens_the_message() {
        let mut rng = seeded(1);
        let sound = vec![b'0'; 100];
        let mut flipped = sound.clone();
        WireFaults { flip_share: 1.0, ..WireFaults::default() }.corrupt(&mut flipped, &mut rng);
        assert_eq!(flipped.iter().map(|byte| (byte ^ b'0').count_ones()).sum::<u32>(), 1);
        let mut cut = sound;
        WireFaults { cut_share: 1.0, ..WireFaults::default() }.corrupt(&mut cut, &mut rng);
        assert!(cut.len() < 100);
    }
}
