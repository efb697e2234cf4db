//! The driver of any supported scanner.

use hal::{ErrorKind, ErrorType, LaserScan, Lidar, ScanGeometry};

use super::{LidarConfig, LidarKind};
use crate::hokuyo::{HokuyoError, HokuyoLidar};
use crate::rotary::{RotaryError, RotaryLidar};
use crate::scanner::LidarMonitor;
use crate::{DeviceStatus, ld06, rplidar};

/// The driver of the configured scanner.
#[derive(Debug)]
pub enum AnyLidar {
    Hokuyo(HokuyoLidar),
    Rotary(RotaryLidar),
}

/// The error of the configured scanner's driver.
#[derive(Debug, thiserror::Error)]
pub enum AnyLidarError {
    #[error(transparent)]
    Hokuyo(#[from] HokuyoError),
    #[error(transparent)]
    Rotary(#[from] RotaryError),
}

impl AnyLidar {
    /// Starts the driver. The scanner may be connected later.
    ///
    /// # Errors
    /// When the configuration is invalid, or the system cannot create a thread or descriptor.
    pub fn open(config: &LidarConfig) -> Result<Self, AnyLidarError> {
        config.validate()?;
        Ok(match config.kind {
            LidarKind::Hokuyo => Self::Hokuyo(HokuyoLidar::open(config.hokuyo())?),
            LidarKind::Rplidar => Self::Rotary(rplidar::open(config.place(), &config.rplidar)?),
            LidarKind::Ld06 => Self::Rotary(ld06::open(config.place(), &config.ld06)?),
        })
    }

    /// The scanner's state and counts. Takes no lock.
    #[must_use]
    pub fn status(&self) -> DeviceStatus {
        match self {
            Self::Hokuyo(lidar) => lidar.status(),
            Self::Rotary(lidar) => lidar.status(),
        }
    }

    /// A handle with which other threads read the state, the identity and the last problem.
    #[must_use]
    pub fn monitor(&self) -> LidarMonitor {
        match self {
            Self::Hokuyo(lidar) => lidar.monitor(),
            Self::Rotary(lidar) => lidar.monitor(),
        }
    }
}

impl hal::Error for AnyLidarError {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::Hokuyo(error) => error.kind(),
            Self::Rotary(error) => error.kind(),
        }
    }
}

impl ErrorType for AnyLidar {
    type Error = AnyLidarError;
}

impl Lidar for AnyLidar {
    fn geometry(&self) -> ScanGeometry {
        match self {
            Self::Hokuyo(lidar) => lidar.geometry(),
            Self::Rotary(lidar) => lidar.geometry(),
        }
    }

    fn poll_scan(&mut self, scan: &mut LaserScan) -> Result<bool, Self::Error> {
        Ok(match self {
            Self::Hokuyo(lidar) => lidar.poll_scan(scan)?,
            Self::Rotary(lidar) => lidar.poll_scan(scan)?,
        })
    }
}
