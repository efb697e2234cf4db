//! Opens what the configuration says is connected. Devices need not be there yet: each driver waits for its own.

use anyhow::{Context, Result};
use drivers::DeviceStatus;
use drivers::can::{CanBus, DifferentialBase, Phase, open_bus};
use drivers::hokuyo::{HokuyoLidar, HokuyoMonitor};
use drivers::v4l2::V4l2Camera;

use super::safety_thread::{Watched, WatchedBase};
use crate::config::Config;

/// The base on whatever bus it is connected to.
pub type AnyBase = DifferentialBase<Box<dyn CanBus + Send>>;

/// What is connected.
pub struct Devices {
    /// The camera.
    pub camera: V4l2Camera,
    /// The scanner.
    pub lidar: HokuyoLidar,
    /// What the scanner's thread knows, for other threads.
    pub lidar_monitor: HokuyoMonitor,
    /// The base.
    pub base: AnyBase,
}

impl Devices {
    /// Starts the drivers.
    ///
    /// # Errors
    /// What a driver refuses in the configuration.
    pub fn open(config: &Config) -> Result<Self> {
        let devices = &config.devices;
        let model = devices.camera_model().map_err(anyhow::Error::msg).context("[devices.lens]")?;
        let lidar = HokuyoLidar::open(devices.lidar.clone()).context("[devices.lidar]")?;
        Ok(Self {
            camera: V4l2Camera::new(&devices.camera, model).context("[devices.camera]")?,
            lidar_monitor: lidar.monitor(),
            lidar,
            base: AnyBase::new(open_bus(&devices.base.bus), &devices.base).context("[devices.base]")?,
        })
    }
}

impl Watched for HokuyoLidar {
    fn status(&self) -> DeviceStatus {
        Self::status(self)
    }
}

impl Watched for AnyBase {
    fn status(&self) -> DeviceStatus {
        Self::status(self)
    }
}

impl WatchedBase for AnyBase {
    fn phase(&self) -> Phase {
        Self::phase(self)
    }
}
