//! The scanner of a simulated robot: which one it is, and its faults.

use std::fmt;
use std::io;
use std::path::Path;
use std::str::FromStr;

use drivers::lidar::{LidarConfig, LidarKind};
use drivers::rplidar::RplidarConfig;
use drivers::{rplidar, scip};
use hal::{LaserScan, ScanGeometry};
use monotonic_clock::monotonic_ns;

use super::Home;
use super::sensors::HomeScanner;
use crate::hokuyo::{Health, SimulatedHokuyo, WireFaults};
use crate::ld06::{Ld06Sensor, SimulatedLd06};
use crate::rplidar::{RplidarHealth, RplidarSensor, SimulatedRplidar};

/// Rotation of an LD06 whose motor is stuck, revolutions per second.
const STUCK_HZ: f64 = 3.0;

/// Which scanner the robot has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ScannerModel {
    Hokuyo(scip::Model),
    Rplidar(rplidar::Model),
    Ld06,
}

impl ScannerModel {
    /// The configuration of the robot, apart from the port.
    #[must_use]
    pub fn config(self) -> LidarConfig {
        let any = LidarConfig::default();
        match self {
            Self::Hokuyo(model) => LidarConfig { model, ..any },
            Self::Rplidar(model) => LidarConfig {
                kind: LidarKind::Rplidar,
                rplidar: RplidarConfig { model, ..RplidarConfig::default() },
                ..any
            },
            Self::Ld06 => LidarConfig { kind: LidarKind::Ld06, ..any },
        }
    }

    /// The geometry of its scans.
    #[must_use]
    pub fn geometry(self) -> ScanGeometry {
        self.config().geometry()
    }

    /// The keys of the robot's configuration.
    pub(super) fn configuration(self, port: &str) -> String {
        match self {
            Self::Hokuyo(model) => {
                let model = model.to_string().to_lowercase();
                format!("[devices.lidar]\nport = {port:?}\nmodel = {model:?}\n\n")
            }
            Self::Rplidar(_) => {
                let timeout_s = 2.0 * self.config().longest_period_s();
                let model = self.to_string();
                let model = model.trim_start_matches("rplidar-");
                format!(
                    "[safety]\nscan_timeout_s = {timeout_s:.2}\n\n[devices.lidar]\nkind = \"rplidar\"\nport = {port:?}\n\n\
                     [devices.lidar.rplidar]\nmodel = {model:?}\n\n"
                )
            }
            Self::Ld06 => format!("[devices.lidar]\nkind = \"ld06\"\nport = {port:?}\n\n"),
        }
    }
}

impl fmt::Display for ScannerModel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Hokuyo(model) => f.write_str(&model.to_string().to_lowercase()),
            Self::Rplidar(model) => write!(f, "rplidar-{}", format!("{model:?}").to_lowercase()),
            Self::Ld06 => f.write_str("ld06"),
        }
    }
}

impl FromStr for ScannerModel {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let rplidars = rplidar::Model::ALL.map(Self::Rplidar);
        if let Some(found) =
            rplidars.into_iter().chain([Self::Ld06]).find(|it| it.to_string() == text)
        {
            return Ok(found);
        }
        text.parse().map(Self::Hokuyo).map_err(|_| {
            format!(
                "`{text}` is not one of urg-04lx, utm-30lx, ust-10lx, ust-20lx, rplidar-a1, rplidar-a2, rplidar-a3, rplidar-s2, ld06"
            )
        })
    }
}

/// A running simulated scanner.
pub enum SimulatedScanner {
    Hokuyo(SimulatedHokuyo),
    Rplidar(SimulatedRplidar),
    Ld06(SimulatedLd06),
}

impl SimulatedScanner {
    /// Starts a scanner that sees the home, on a pty at a path or on an existing serial port. The home's time began at `start_ns`
    /// of the monotonic clock.
    pub(super) fn start(
        model: ScannerModel,
        home: &Home,
        start_ns: u64,
        path: &Path,
        is_serial: bool,
    ) -> io::Result<Self> {
        let scan = LaserScan::empty(model.geometry());
        let view = Box::new(HomeScanner { lidar: home.lidar(), model, start_ns, scan });
        let now_ns = monotonic_ns();
        Ok(match (model, is_serial) {
            (ScannerModel::Hokuyo(model), false) => {
                Self::Hokuyo(SimulatedHokuyo::on_pty(model, path, view)?)
            }
            (ScannerModel::Hokuyo(model), true) => {
                Self::Hokuyo(SimulatedHokuyo::on_serial(model, path, view)?)
            }
            (ScannerModel::Rplidar(model), false) => Self::Rplidar(SimulatedRplidar::on_pty(
                path,
                RplidarSensor::new(model, view, now_ns),
            )?),
            (ScannerModel::Rplidar(model), true) => Self::Rplidar(SimulatedRplidar::on_serial(
                path,
                RplidarSensor::new(model, view, now_ns),
            )?),
            (ScannerModel::Ld06, false) => {
                Self::Ld06(SimulatedLd06::on_pty(path, Ld06Sensor::new(view, now_ns))?)
            }
            (ScannerModel::Ld06, true) => {
                Self::Ld06(SimulatedLd06::on_serial(path, Ld06Sensor::new(view, now_ns))?)
            }
        })
    }

    /// Unplugs the scanner: its path disappears.
    pub fn unplug(&self) {
        match self {
            Self::Hokuyo(device) => device.unplug(),
            Self::Rplidar(device) => device.unplug(),
            Self::Ld06(device) => device.unplug(),
        }
    }

    /// Plugs the scanner in again.
    ///
    /// # Errors
    /// When there is no pty for it.
    pub fn plug_in(&self) -> io::Result<()> {
        match self {
            Self::Hokuyo(device) => device.plug_in(),
            Self::Rplidar(device) => device.plug_in(),
            Self::Ld06(device) => device.plug_in(),
        }
    }

    /// Restarts the scanner. It is ready after `boot_ns`.
    pub fn reboot(&self, boot_ns: u64) {
        match self {
            Self::Hokuyo(device) => device.reboot(boot_ns),
            Self::Rplidar(device) => device.reboot(boot_ns),
            Self::Ld06(device) => device.reboot(boot_ns),
        }
    }

    /// Sets the faults of the transport.
    pub fn set_wire(&self, wire: WireFaults) {
        match self {
            Self::Hokuyo(device) => device.set_wire(wire),
            Self::Rplidar(device) => device.set_wire(wire),
            Self::Ld06(device) => device.set_wire(wire),
        }
    }

    /// Breaks the motor, or repairs it.
    pub fn break_motor(&self, broken: bool) {
        match self {
            Self::Hokuyo(device) => {
                device.set_health(if broken { Health::MotorFault } else { Health::Well });
            }
            Self::Rplidar(device) => device.with(|sensor| {
                sensor.health =
                    if broken { RplidarHealth::Protection } else { RplidarHealth::Well };
            }),
            Self::Ld06(device) => {
                device.with(|sensor| sensor.rotation_hz = if broken { STUCK_HZ } else { 10.0 });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_scanner_is_named_as_it_is_written_and_an_unknown_one_is_refused_with_the_names() {
        for name in ["utm-30lx", "rplidar-a1", "rplidar-s2", "ld06"] {
            assert_eq!(name.parse::<ScannerModel>().unwrap().to_string(), name);
        }
        let error = "rplidar-a9".parse::<ScannerModel>().unwrap_err();
        assert!(error.contains("`rplidar-a9`") && error.contains("rplidar-a3"), "{error}");
    }
}
