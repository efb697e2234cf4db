//! A fault and its time window, with the text format `DEVICE:KIND[=AMOUNT][@FROM..TO]`.

use std::fmt;
use std::str::FromStr;

use super::error::FaultTextError;
use super::kind::{Device, Kind, kinds_of};

/// One fault of one device, with the time window in which it is active.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fault {
    pub device: Device,
    pub kind: Kind,
    amount: Option<f64>,
    /// Start of the window, seconds since the start of the run.
    pub from_s: f64,
    /// End of the window, seconds since the start of the run; infinity for the end of the run.
    pub to_s: f64,
}

impl Fault {
    /// The amount: a share, a number of readings, metres, degrees, rad/s or milliseconds, depending on the kind.
    #[must_use]
    pub fn amount(&self) -> f64 {
        self.amount.unwrap_or_else(|| self.kind.unit().default_amount())
    }

    /// Whether the fault is active at this time since the start of the run.
    #[must_use]
    pub fn is_active(&self, time_ns: u64) -> bool {
        (self.from_s..self.to_s).contains(&(time_ns as f64 * 1e-9))
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.device.name(), self.kind.name())?;
        if let Some(amount) = self.amount {
            write!(f, "={amount}")?;
        }
        match (self.from_s, self.to_s.is_finite()) {
            (0.0, false) => Ok(()),
            (from_s, false) => write!(f, "@{from_s}.."),
            (from_s, true) => write!(f, "@{from_s}..{}", self.to_s),
        }
    }
}

impl FromStr for Fault {
    type Err = FaultTextError;

    fn from_str(text: &str) -> Result<Self, FaultTextError> {
        let (what, when) =
            text.split_once('@').map_or((text, None), |(what, when)| (what, Some(when)));
        let (device, what) =
            what.split_once(':').ok_or_else(|| FaultTextError::Form { text: text.to_owned() })?;
        let (kind, amount) =
            what.split_once('=').map_or((what, None), |(kind, amount)| (kind, Some(amount)));
        let device = Device::ALL
            .into_iter()
            .find(|known| known.name() == device)
            .ok_or_else(|| FaultTextError::Device { name: device.to_owned() })?;
        let kind = kinds_of(device)
            .iter()
            .copied()
            .find(|known| known.name() == kind)
            .ok_or_else(|| FaultTextError::Kind { device, name: kind.to_owned() })?;
        let amount = amount.map(|amount| parse_amount(kind, amount)).transpose()?;
        let (from_s, to_s) = when.map_or(Ok((0.0, f64::INFINITY)), parse_window)?;
        Ok(Self { device, kind, amount, from_s, to_s })
    }
}

fn parse_amount(kind: Kind, text: &str) -> Result<f64, FaultTextError> {
    match text.parse() {
        Ok(amount) if kind.unit().allows(amount) => Ok(amount),
        _ => Err(FaultTextError::Amount { kind, text: text.to_owned(), rule: kind.unit().rule() }),
    }
}

fn parse_window(text: &str) -> Result<(f64, f64), FaultTextError> {
    let window = text.split_once("..").and_then(|(from, to)| {
        let from_s = parse_seconds(from, 0.0)?;
        let to_s = parse_seconds(to, f64::INFINITY)?;
        // The comparisons also refuse NaN.
        (from_s >= 0.0 && from_s < to_s).then_some((from_s, to_s))
    });
    window.ok_or_else(|| FaultTextError::Window { text: text.to_owned() })
}

fn parse_seconds(text: &str, absent: f64) -> Option<f64> {
    if text.is_empty() { Some(absent) } else { text.parse().ok() }
}
