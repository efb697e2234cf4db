//! Device simulators for a robot's computer: `cargo run -p hil -- hokuyo --help`.
//!
//! Each speaks the real device's protocol over what the real device is connected by, or over what stands in for it where the
//! kernel has no such thing.

use std::error::Error;
use std::process::ExitCode;

use clap::{Parser, Subcommand};

#[derive(Parser)]
#[command(version, about = "Simulated devices that speak the real ones' protocols")]
struct Arguments {
    #[command(subcommand)]
    device: Device,
}

#[derive(Subcommand)]
enum Device {
    /// A Hokuyo LiDAR on a pty or TCP.
    Hokuyo(hil::hokuyo::HokuyoArgs),
    /// A camera behind a Unix socket.
    Camera(hil::video::CameraArgs),
    /// Checks of drivers against the kernel's devices, for `cargo xtask rig`.
    RigProbe(hil::rig::RigArgs),
    /// Two simulated motor controllers on a CAN bus.
    Motor(hil::motor::MotorArgs),
    /// A simulated home behind all of these devices, for `firmware-host run`.
    World(hil::world::WorldArgs),
    /// An ssh server on loopback with keys of its own, as a robot has one.
    Sshd(hil::sshd::SshdArgs),
    /// The real base driver on a CAN bus, driving straight on.
    Base(hil::motor::BaseArgs),
}

fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run(arguments: &Arguments) -> Result<(), Box<dyn Error>> {
    match &arguments.device {
        Device::Hokuyo(arguments) => hil::hokuyo::run(arguments),
        Device::Camera(args) => hil::video::run(args),
        Device::RigProbe(args) => hil::rig::run(args),
        Device::World(args) => hil::world::run(args),
        Device::Motor(args) => hil::motor::run(args),
        Device::Sshd(args) => hil::sshd::run(args),
        Device::Base(args) => hil::motor::run_base(args),
    }
}
