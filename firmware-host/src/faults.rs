//! `--fault` and `--fault-seed`: faults that are injected into the devices of a run.

use std::str::FromStr;

use clap::Args;
use drivers::fault::{Fault, FaultTextError, Faults, Now, random_faults};

use crate::cli::values::whole_number;

/// The options that inject faults.
#[derive(Debug, Args, Clone, Default)]
pub struct FaultArgs {
    /// Inject a fault: DEVICE:KIND[=AMOUNT][@FROM..TO], times in seconds since the start, such as
    /// lidar:stall@4..6 or camera:drop=0.1. May be repeated.
    ///
    /// The value `random` injects a random schedule of faults that a robot must survive. A value that is not
    /// a fault, such as `--fault list`, is answered with all devices and kinds.
    #[arg(long = "fault", value_name = "FAULT")]
    pub texts: Vec<FaultText>,
    /// Seed of all random choices in faults.
    #[arg(long, value_name = "N", default_value_t = 1, requires = "texts", allow_negative_numbers = true, value_parser = whole_number(0..=u64::MAX))]
    pub fault_seed: u64,
}

/// The value of one `--fault` option.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FaultText {
    /// A random schedule, `--fault random`.
    Random,
    /// One given fault.
    One(Fault),
}

impl FromStr for FaultText {
    type Err = FaultTextError;

    fn from_str(text: &str) -> Result<Self, FaultTextError> {
        if text == "random" { Ok(Self::Random) } else { text.parse().map(Self::One) }
    }
}

/// All faults of a run, as they are recorded in its header.
#[derive(Debug, Clone, Default)]
pub struct FaultPlan {
    faults: Vec<Fault>,
    seed: u64,
}

impl FaultArgs {
    /// The faults of a run of `span_s` seconds. Random schedules are spread over that time.
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
    /// The faults in the notation of `--fault`.
    #[must_use]
    pub fn texts(&self) -> Vec<String> {
        self.faults.iter().map(ToString::to_string).collect()
    }

    /// The seed of the faults; `None` if there are no faults.
    #[must_use]
    pub fn seed(&self) -> Option<u64> {
        (!self.faults.is_empty()).then_some(self.seed)
    }

    /// The injector of these faults. `now` is the clock that their times refer to.
    #[must_use]
    pub fn at(self, now: Now) -> Faults {
        Faults::new(self.faults, self.seed, now)
    }
}
