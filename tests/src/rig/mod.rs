//! Checks that need the kernel's own devices: run in the rig by `cargo xtask rig`. Each prints a row of its table.

mod base;
mod camera;
mod lidar;

use std::error::Error;
use std::fmt::Display;

use clap::Subcommand;

/// Checks of a driver against the kernel. Made for the rig: they pull plugs.
#[derive(Debug, clap::Args)]
pub struct RigArgs {
    #[command(subcommand)]
    probe: Probe,
}

#[derive(Debug, Subcommand)]
enum Probe {
    /// The V4L2 driver against vivid.
    Camera(camera::CameraProbe),
    /// The Hokuyo driver on a USB serial port.
    Lidar(lidar::LidarProbe),
    /// The base driver on SocketCAN.
    Base(base::BaseProbe),
}

/// Runs one probe; its checks fail on the output, not by this function's error.
///
/// # Errors
/// When the scene cannot be set up.
pub fn run(args: &RigArgs) -> Result<(), Box<dyn Error>> {
    match &args.probe {
        Probe::Camera(probe) => camera::run(probe),
        Probe::Lidar(probe) => lidar::run(probe),
        Probe::Base(probe) => base::run(probe),
    }
}

/// One row of the rig's table.
fn check(promise: &str, figure: impl Display, passed: bool) {
    println!("CHECK\t{}\t{promise}\t{figure}", if passed { "pass" } else { "fail" });
}
