//! Opens what the configuration says is connected. Devices need not be there yet: each driver waits for its own.

use anyhow::{Context, Result};
use drivers::DeviceStatus;
use drivers::can::{CanBus, DifferentialBase, Phase, open_bus};
use drivers::hokuyo::{HokuyoLidar, HokuyoMonitor};
use drivers::v4l2::V4l2Camera;
use runtime::safety::SafetyLoop;

use super::safety_thread::{Watched, WatchedBase};
use crate::config::Config;

/// The base on whatever bus it is connected to.
pub type AnyBase = DifferentialBase<Box<dyn CanBus + Send>>;

/// Starts the camera's driver.
///
/// # Errors
/// What it refuses in the configuration.
pub fn open_camera(config: &Config) -> Result<V4l2Camera> {
    let devices = &config.devices;
    let model = devices.camera_model().map_err(anyhow::Error::msg).context("[devices.lens]")?;
    V4l2Camera::new(&devices.camera, model).context("[devices.camera]")
}

/// Starts the scanner's and the base's drivers; also what the scanner's thread knows, for other threads.
///
/// # Errors
/// What a driver refuses in the configuration.
pub fn open_scanner_and_base(config: &Config) -> Result<(SafetyLoop<AnyBase, HokuyoLidar>, HokuyoMonitor)> {
    let devices = &config.devices;
    let lidar = HokuyoLidar::open(devices.lidar.clone()).context("[devices.lidar]")?;
    let monitor = lidar.monitor();
    let base = AnyBase::new(open_bus(&devices.base.bus), &devices.base).context("[devices.base]")?;
    Ok((SafetyLoop::new(config.live_safety_config(), base, lidar), monitor))
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
