//! The kinds of faults, the devices that have them, and the amounts that they take.

/// The devices into which faults can be injected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Device {
    Camera,
    Lidar,
    Base,
    /// The inertial measurement unit.
    Imu,
    /// The clock that wakes the control loop.
    Clock,
    /// The disk to which the run is recorded.
    Disk,
}

/// The kind of a fault. Which devices have it is listed by [`kinds_of`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Kind {
    /// Readings arrive late by a number of readings.
    Delay,
    /// A share of the readings is lost. For the base, the same share of the commands is lost too.
    Drop,
    /// A share of the readings arrives twice.
    Duplicate,
    /// A share of the readings arrives after the reading that follows it.
    Reorder,
    /// A share is corrupt: the end of a frame or the beams of a scan hold random values; the base's
    /// feedback fails its checksum; all values of a sample are random.
    Corrupt,
    /// No reading arrives, which the driver reports after 100 ms. The base still receives commands.
    Stall,
    /// The device is absent.
    Unplug,
    /// Frames are black, as with a covered lens.
    Black,
    /// Frames are white, as when the sun shines into the lens.
    White,
    /// Frames have half their height, as if another process had changed the camera's mode.
    Resize,
    /// A share of the beams reports an error.
    Error,
    /// No beam has an echo.
    Blind,
    /// The beams within a number of degrees of the scanner's front report an error, as with dirt, tape or a hand on its window.
    Dirt,
    /// A share of the beams reports an obstacle at 0.15 m that does not exist.
    Ghost,
    /// The odometry is NaN, as with a broken encoder.
    Nan,
    /// The odometry is wrong along x by a number of metres, as after a reset or a wheel that lost
    /// contact.
    Jump,
    /// The base reports contact, as with a bumper switch that is stuck.
    Contact,
    /// The angular velocities about all axes are wrong by a number of rad/s, as after a change of temperature.
    Bias,
    /// Every tick of the control loop, or every write to the disk, is late by a number of
    /// milliseconds.
    Slow,
    /// The disk has no free space.
    Full,
}

/// The unit of a fault's amount.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Amount {
    None,
    Share,
    Readings,
    Metres,
    Degrees,
    RadiansPerSecond,
    Milliseconds,
}

/// A longer delay would be a silence. The limit also bounds the memory of a wrapper.
const MAX_DELAY: f64 = 50.0;
const MAX_SLOW_MS: f64 = 10_000.0;

impl Device {
    pub const ALL: [Self; 6] =
        [Self::Camera, Self::Lidar, Self::Base, Self::Imu, Self::Clock, Self::Disk];

    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Camera => "camera",
            Self::Lidar => "lidar",
            Self::Base => "base",
            Self::Imu => "imu",
            Self::Clock => "clock",
            Self::Disk => "disk",
        }
    }
}

/// The kinds of faults that can be injected into a device.
#[must_use]
pub fn kinds_of(device: Device) -> &'static [Kind] {
    use Kind::*;
    match device {
        Device::Camera => {
            &[Delay, Drop, Duplicate, Reorder, Corrupt, Stall, Unplug, Black, White, Resize]
        }
        Device::Lidar => {
            &[Delay, Drop, Duplicate, Reorder, Corrupt, Stall, Unplug, Error, Blind, Dirt, Ghost]
        }
        Device::Base => {
            &[Delay, Drop, Duplicate, Reorder, Corrupt, Stall, Unplug, Nan, Jump, Contact]
        }
        Device::Imu => &[Delay, Drop, Duplicate, Reorder, Corrupt, Stall, Unplug, Bias],
        Device::Clock => &[Slow],
        Device::Disk => &[Slow, Full, Unplug],
    }
}

impl Kind {
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
            Self::Dirt => "dirt",
            Self::Ghost => "ghost",
            Self::Nan => "nan",
            Self::Jump => "jump",
            Self::Contact => "contact",
            Self::Bias => "bias",
            Self::Slow => "slow",
            Self::Full => "full",
        }
    }

    pub(super) fn unit(self) -> Amount {
        match self {
            Self::Drop
            | Self::Duplicate
            | Self::Reorder
            | Self::Corrupt
            | Self::Error
            | Self::Ghost => Amount::Share,
            Self::Delay => Amount::Readings,
            Self::Jump => Amount::Metres,
            Self::Dirt => Amount::Degrees,
            Self::Bias => Amount::RadiansPerSecond,
            Self::Slow => Amount::Milliseconds,
            _ => Amount::None,
        }
    }
}

impl Amount {
    /// Which amounts are allowed, for an error text.
    pub(super) fn rule(self) -> &'static str {
        match self {
            Self::None => "no amount",
            Self::Share => "a share above 0 and up to 1",
            Self::Readings => "a whole number of readings from 1 to 50",
            Self::Metres => "a distance in metres other than 0",
            Self::Degrees => "degrees above 0 and up to 180",
            Self::RadiansPerSecond => "an angular velocity in rad/s other than 0",
            Self::Milliseconds => "milliseconds above 0 and up to 10000",
        }
    }

    pub(super) fn allows(self, amount: f64) -> bool {
        match self {
            Self::None => false,
            Self::Share => amount > 0.0 && amount <= 1.0,
            Self::Readings => amount.fract() == 0.0 && (1.0..=MAX_DELAY).contains(&amount),
            Self::Metres | Self::RadiansPerSecond => amount.is_finite() && amount != 0.0,
            Self::Degrees => amount > 0.0 && amount <= 180.0,
            Self::Milliseconds => amount > 0.0 && amount <= MAX_SLOW_MS,
        }
    }

    /// The amount when the text gives none: every reading, three readings, one metre, 45 degrees to each side, 0.1 rad/s, 50 ms.
    pub(super) fn default_amount(self) -> f64 {
        match self {
            Self::None | Self::Share | Self::Metres => 1.0,
            Self::Readings => 3.0,
            Self::Degrees => 45.0,
            Self::RadiansPerSecond => 0.1,
            Self::Milliseconds => 50.0,
        }
    }
}
