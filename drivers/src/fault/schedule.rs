//! What goes wrong, and when, as text: `DEVICE:KIND[=AMOUNT][@FROM..TO]`.

use std::fmt;
use std::str::FromStr;

use super::error::FaultTextError;

/// What can be wrapped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Device {
    /// The camera.
    Camera,
    /// The scanner.
    Lidar,
    /// The wheels.
    Base,
    /// Whatever wakes the loop.
    Clock,
    /// The recording's disk.
    Disk,
}

/// How something goes wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Kind {
    /// Readings come so many readings late.
    Delay,
    /// A share of the readings is lost; of the base's commands, too.
    Drop,
    /// A share of the readings comes twice.
    Duplicate,
    /// A share of the readings comes after the one that follows it.
    Reorder,
    /// A share is wrong: rows of a picture or beams of a scan hold nonsense; the base's feedback fails its checksum.
    Corrupt,
    /// Nothing comes, and after 100 ms the driver says so. The base still hears commands.
    Stall,
    /// The device is not there.
    Unplug,
    /// Pictures are black: the lens is covered.
    Black,
    /// Pictures are white: the sun shines in.
    White,
    /// Pictures have half their height: somebody changed the mode.
    Resize,
    /// A share of the beams are errors.
    Error,
    /// No beam comes back.
    Blind,
    /// A share of the beams reports something 0.15 m away that is not there.
    Ghost,
    /// Odometry is NaN: a broken encoder.
    Nan,
    /// Odometry is off along x by so many metres: a reset, or a lost wheel.
    Jump,
    /// The base reports a touch: a bumper switch that is stuck.
    Contact,
    /// Every turn of the loop, or every write to the disk, comes so many milliseconds late.
    Slow,
    /// The disk has no room.
    Full,
}

/// What a kind's amount means.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Amount {
    None,
    Share,
    Readings,
    Metres,
    Milliseconds,
}

/// More late readings than this are silence; also bounds a wrapper's memory.
const MAX_LATE: f64 = 50.0;
const MAX_SLOW_MS: f64 = 10_000.0;

impl Device {
    /// Every device.
    pub const ALL: [Self; 5] = [Self::Camera, Self::Lidar, Self::Base, Self::Clock, Self::Disk];

    /// Its name in a fault's text.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Camera => "camera",
            Self::Lidar => "lidar",
            Self::Base => "base",
            Self::Clock => "clock",
            Self::Disk => "disk",
        }
    }
}

/// What can go wrong with a device.
#[must_use]
pub fn kinds_of(device: Device) -> &'static [Kind] {
    use Kind::*;
    match device {
        Device::Camera => {
            &[Delay, Drop, Duplicate, Reorder, Corrupt, Stall, Unplug, Black, White, Resize]
        }
        Device::Lidar => {
            &[Delay, Drop, Duplicate, Reorder, Corrupt, Stall, Unplug, Error, Blind, Ghost]
        }
        Device::Base => {
            &[Delay, Drop, Duplicate, Reorder, Corrupt, Stall, Unplug, Nan, Jump, Contact]
        }
        Device::Clock => &[Slow],
        Device::Disk => &[Slow, Full, Unplug],
    }
}

impl Kind {
    /// Its name in a fault's text.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Delay => "delay",
            Self::Drop => "drop",
            Self::Duplicate => "duplicate",
            Self::Reorder => "reorder",
            Self::Corrupt => "corrupt",
            Self::Stall => "stall",
            Self::Unplug => "unplug",
            Self::Black => "black",
            Self::White => "white",
            Self::Resize => "resize",
            Self::Error => "error",
            Self::Blind => "blind",
            Self::Ghost => "ghost",
            Self::Nan => "nan",
            Self::Jump => "jump",
            Self::Contact => "contact",
            Self::Slow => "slow",
            Self::Full => "full",
        }
    }

    fn unit(self) -> Amount {
        match self {
            Self::Drop
            | Self::Duplicate
            | Self::Reorder
            | Self::Corrupt
            | Self::Error
            | Self::Ghost => Amount::Share,
            Self::Delay => Amount::Readings,
            Self::Jump => Amount::Metres,
            Self::Slow => Amount::Milliseconds,
            _ => Amount::None,
        }
    }
}

impl Amount {
    /// What an amount must be, in words.
    pub(super) fn rule(self) -> &'static str {
        match self {
            Self::None => "no amount",
            Self::Share => "a share above 0 and up to 1",
            Self::Readings => "a whole number of readings from 1 to 50",
            Self::Metres => "a distance in metres other than 0",
            Self::Milliseconds => "milliseconds above 0 and up to 10000",
        }
    }

    fn allows(self, amount: f64) -> bool {
        match self {
            Self::None => false,
            Self::Share => amount > 0.0 && amount <= 1.0,
            Self::Readings => amount.fract() == 0.0 && (1.0..=MAX_LATE).contains(&amount),
            Self::Metres => amount.is_finite() && amount != 0.0,
            Self::Milliseconds => amount > 0.0 && amount <= MAX_SLOW_MS,
        }
    }

    /// Where the text gives none: all of them, three readings, a metre, 50 ms.
    fn usual(self) -> f64 {
        match self {
            Self::None | Self::Share | Self::Metres => 1.0,
            Self::Readings => 3.0,
            Self::Milliseconds => 50.0,
        }
    }
}

/// One thing that goes wrong.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fault {
    /// With which device.
    pub device: Device,
    /// How.
    pub kind: Kind,
    amount: Option<f64>,
    /// From this time on, seconds since the start of the run.
    pub from_s: f64,
    /// Up to this time, seconds; infinity: to the end.
    pub to_s: f64,
}

impl Fault {
    /// How much: a share, a number of readings, metres or milliseconds, by the kind.
    #[must_use]
    pub fn amount(&self) -> f64 {
        self.amount.unwrap_or_else(|| self.kind.unit().usual())
    }

    /// Whether it is on at this time since the start of the run.
    #[must_use]
    pub fn is_on(&self, time_ns: u64) -> bool {
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
    let refused =
        || FaultTextError::Amount { kind, text: text.to_owned(), rule: kind.unit().rule() };
    text.parse().ok().filter(|amount| kind.unit().allows(*amount)).ok_or_else(refused)
}

fn parse_window(text: &str) -> Result<(f64, f64), FaultTextError> {
    let refused = || FaultTextError::Window { text: text.to_owned() };
    let (from, to) = text.split_once("..").ok_or_else(refused)?;
    let seconds = |text: &str, absent: f64| {
        if text.is_empty() { Ok(absent) } else { text.parse().map_err(|_| refused()) }
    };
    let (from_s, to_s): (f64, f64) = (seconds(from, 0.0)?, seconds(to, f64::INFINITY)?);
    // Also refuses NaN.
    if from_s >= 0.0 && from_s < to_s { Ok((from_s, to_s)) } else { Err(refused()) }
}
