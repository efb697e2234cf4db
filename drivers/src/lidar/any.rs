//! The driver of any supported scanner.

use hal::{ErrorKind, ErrorType, LaserScan, Lidar, ScanGeometry};

use super::{LidarConfig, LidarKind};
use crate::hokuyo::{HokuyoError, HokuyoLidar};
use crate::rotary::{RotaryError, RotaryLidar};
use crate::scanner::LidarMonitor;
use crate::{DeviceStatus, ld06, rplidar};

/// The driver of the configured scanner.
#[derive(Debug)]
pub struct AnyLidar {
    scanner: Scanner,
    /// Subtracted from every time stamp.
    latency_ns: u64,
}

#[derive(Debug)]
enum Scanner {
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
        let scanner = match config.kind {
            LidarKind::Hokuyo => Scanner::Hokuyo(HokuyoLidar::open(config.hokuyo())?),
            LidarKind::Rplidar => Scanner::Rotary(rplidar::open(config.place(), &config.rplidar)?),
            LidarKind::Ld06 => Scanner::Rotary(ld06::open(config.place(), &config.ld06)?),
        };
        Ok(Self { scanner, latency_ns: (config.latency_ms * 1e6) as u64 })
    }

    /// The scanner's state and counts. Takes no lock.
    #[must_use]
    pub fn status(&self) -> DeviceStatus {
        match &self.scanner {
            Scanner::Hokuyo(lidar) => lidar.status(),
            Scanner::Rotary(lidar) => lidar.status(),
        }
    }

    /// A handle with which other threads read the state, the identity and the last problem.
    #[must_use]
    pub fn monitor(&self) -> LidarMonitor {
        match &self.scanner {
            Scanner::Hokuyo(lidar) => lidar.monitor(),
            Scanner::Rotary(lidar) => lidar.monitor(),
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
        match &self.scanner {
            Scanner::Hokuyo(lidar) => lidar.geometry(),
            Scanner::Rotary(lidar) => lidar.geometry(),
        }
    }

    fn poll_scan(&mut self, scan: &mut LaserScan) -> Result<bool, Self::Error> {
        let is_new = match &mut self.scanner {
            Scanner::Hokuyo(lidar) => lidar.poll_scan(scan)?,
            Scanner::Rotary(lidar) => lidar.poll_scan(scan)?,
        };
        if is_new {
            scan.time_ns = scan.time_ns.saturating_sub(self.latency_ns);
        }
        Ok(is_new)
    }
}
