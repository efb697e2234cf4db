//! `--fault` and `--fault-seed`: devices that are broken on purpose.

use std::str::FromStr;

use clap::Args;
use drivers::fault::{Fault, FaultTextError, Faults, Now, random_faults};

/// What is broken on purpose.
#[derive(Debug, Args, Clone, Default)]
pub struct FaultArgs {
    /// Break a device on purpose: DEVICE:KIND[=AMOUNT][@FROM..TO] in seconds since the start, such as lidar:stall@4..6 or
    /// camera:drop=0.1; `random`: by dice what a robot must survive. May be given again.
    #[arg(long = "fault", value_name = "TEXT")]
    pub texts: Vec<FaultText>,
    /// Seed of everything random in faults.
    #[arg(long, default_value_t = 1, requires = "texts")]
    pub fault_seed: u64,
}

/// One `--fault`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FaultText {
    /// A schedule by dice.
    Random,
    /// This one.
    One(Fault),
}

impl FromStr for FaultText {
    type Err = FaultTextError;

    fn from_str(text: &str) -> Result<Self, FaultTextError> {
        if text == "random" { Ok(Self::Random) } else { text.parse().map(Self::One) }
    }
}

/// A run's faults, as they are recorded.
#[derive(Debug, Clone, Default)]
pub struct FaultPlan {
    faults: Vec<Fault>,
    seed: u64,
}

impl FaultArgs {
    /// The faults of a run of this length, seconds.
    #[must_use]
    pub fn plan(&self, span_s: f64) -> FaultPlan {
        let mut faults = Vec::new();
        for text in &self.texts {
            match text {
                FaultText::Random => faults.extend(random_faults(self.fault_seed, span_s)),
                FaultText::One(fault) => faults.push(*fault),
            }
        }
        FaultPlan { faults, seed: self.fault_seed }
    }
}

impl FaultPlan {
    /// Their texts.
    #[must_use]
    pub fn texts(&self) -> Vec<String> {
        self.faults.iter().map(ToString::to_string).collect()
    }

    /// Their seed, where there are any.
    #[must_use]
    pub fn seed(&self) -> Option<u64> {
        (!self.faults.is_empty()).then_some(self.seed)
    }

    /// The faults in the run's time.
    #[must_use]
    pub fn at(self, now: Now) -> Faults {
        Faults::new(self.faults, self.seed, now)
    }
}
