//! Checks that need the kernel's own devices, run in the rig by `cargo xtask rig`. Each check
//! prints one row of its table.

mod base;
mod camera;
mod hid_gyroscope;
mod imu;
mod lidar;

use std::error::Error;
use std::fmt::Display;

use clap::Subcommand;

/// Check a driver against the kernel's devices. Only for the rig: the checks unplug devices.
#[derive(Debug, clap::Args)]
pub struct RigArgs {
    #[command(subcommand)]
    probe: Probe,
}

#[derive(Debug, Subcommand)]
enum Probe {
    /// Check the V4L2 driver against vivid.
    Camera(camera::CameraProbe),
    /// Check the Hokuyo driver on a USB serial port.
    Lidar(lidar::LidarProbe),
    /// Check the base driver on SocketCAN.
    Base(base::BaseProbe),
    /// Check the driver for inertial measurement units against a HID gyroscope.
    Imu,
}

/// Runs one probe. Failed checks are reported on standard output, not by an error of this function.
///
/// # Errors
/// Returns an error when the probe cannot be set up.
pub fn run(args: &RigArgs) -> Result<(), Box<dyn Error>> {
    match &args.probe {
        Probe::Camera(probe) => camera::run(probe),
        Probe::Lidar(probe) => lidar::run(probe),
        Probe::Base(probe) => base::run(probe),
        Probe::Imu => imu::run(),
    }
}

/// Prints one row of the rig's table.
fn check(claim: &str, figure: impl Display, passed: bool) {
    println!("CHECK\t{}\t{claim}\t{figure}", if passed { "pass" } else { "fail" });
}
