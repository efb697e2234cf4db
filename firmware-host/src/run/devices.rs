//! Opens the devices of the configuration. They need not be connected yet: each driver waits for its device.

use anyhow::{Context, Result};
use drivers::can::{CanBus, DifferentialBase, Phase, open_bus};
use drivers::fault::{Faults, FaultyBase, FaultyCamera, FaultyImu, FaultyLidar};
use drivers::iio::IioImu;
use drivers::lidar::AnyLidar;
use drivers::stop_line::{StopLine, StopLineMonitor};
use drivers::v4l2::V4l2Camera;
use drivers::{DeviceStatus, LidarMonitor};
use runtime::safety::SafetyLoop;

use super::safety_thread::{Opened, Watched, WatchedBase};
use crate::config::Config;

/// The base on a bus of any kind.
pub type AnyBase = DifferentialBase<Box<dyn CanBus + Send>>;

/// The safety loop's devices, as the rest of the program sees them.
#[derive(Debug, Clone)]
pub struct Monitors {
    pub lidar: LidarMonitor,
    /// The emergency stop on an input line of the computer, if there is one.
    pub stop_line: Option<StopLineMonitor>,
}

/// The safety loop with the devices that it owns.
pub type Control = SafetyLoop<FaultyBase<AnyBase>, FaultyLidar<AnyLidar>>;

/// Starts the camera's driver.
///
/// # Errors
/// The driver refuses the configuration.
pub fn open_camera(config: &Config, faults: &Faults) -> Result<FaultyCamera<V4l2Camera>> {
    let devices = &config.devices;
    let model = devices.camera_model().map_err(anyhow::Error::msg).context("[devices.lens]")?;
    let camera = V4l2Camera::new(&devices.camera, model).context("[devices.camera]")?;
    Ok(FaultyCamera::new(camera, faults))
}

/// Starts the driver of the inertial measurement unit, if the robot has one.
///
/// # Errors
/// The driver refuses the configuration.
pub fn open_imu(config: &Config, faults: &Faults) -> Result<Option<FaultyImu<IioImu>>> {
    let imu = IioImu::open(&config.devices.imu).context("[devices.imu]")?;
    Ok(imu.map(|imu| FaultyImu::new(imu, faults)))
}

/// Starts the drivers of the scanner, the base and the emergency stop's line.
///
/// # Errors
/// A driver refuses the configuration.
pub fn open_for_safety(
    config: &Config,
    faults: &Faults,
) -> Result<Opened<FaultyBase<AnyBase>, FaultyLidar<AnyLidar>, Monitors>> {
    let (control, lidar) = open_scanner_and_base(config, faults)?;
    let stop_line =
        StopLine::start(&config.devices.emergency_stop).context("[devices.emergency_stop]")?;
    let rest = Monitors { lidar, stop_line: stop_line.as_ref().map(StopLine::monitor) };
    Ok(Opened { control, stop_line, rest })
}

/// Starts the drivers of the scanner and the base. Also returns a handle to the scanner's state, for other threads.
///
/// # Errors
/// A driver refuses the configuration.
pub fn open_scanner_and_base(config: &Config, faults: &Faults) -> Result<(Control, LidarMonitor)> {
    let devices = &config.devices;
    let lidar = AnyLidar::open(&devices.lidar).context("[devices.lidar]")?;
    let monitor = lidar.monitor();
    let base =
        AnyBase::new(open_bus(&devices.base.bus), &devices.base).context("[devices.base]")?;
    let (base, lidar) = (FaultyBase::new(base, faults), FaultyLidar::new(lidar, faults));
    Ok((SafetyLoop::new(config.live_safety_config(), base, lidar), monitor))
}

impl Watched for FaultyLidar<AnyLidar> {
    fn status(&self) -> DeviceStatus {
        self.injector().status(self.inner().status())
    }
}

impl Watched for FaultyBase<AnyBase> {
    fn status(&self) -> DeviceStatus {
        self.injector().status(self.inner().status())
    }
}

impl WatchedBase for FaultyBase<AnyBase> {
    fn phase(&self) -> Phase {
        self.inner().phase()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    #[test]
    fn the_safety_loop_of_a_real_robot_is_made_for_its_brakes_and_not_for_simulated_ones() {
        let mut config = Config::default();
        config.run.brake_mps2 = 0.7;
        // The drivers wait for absent devices, so opening them succeeds.
        config.devices.lidar.port = "/nonexistent/lidar".parse().unwrap();
        config.devices.base.bus = "unix:/nonexistent/can".to_owned();
        config.devices.base.protocol = drivers::can::Protocol::Vesc;
        let faults = Faults::new(Vec::new(), 1, Arc::new(|| 0));
        let (control, _) = open_scanner_and_base(&config, &faults).unwrap();
        assert_eq!(*control.plane().config(), config.live_safety_config());
        assert!((control.plane().config().brake_mps2 - 0.7).abs() < 1e-12);
    }
}
