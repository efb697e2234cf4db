//! Command-line device simulators for a robot's computer: `cargo run -p hil -- hokuyo --help`.
//!
//! Each simulator implements the protocol of the real device. It uses the device's own transport,
//! or a substitute where the kernel has no virtual device.

use std::error::Error;
use std::process::ExitCode;

use clap::{Parser, Subcommand};

#[derive(Parser)]
#[command(version, about = "Simulated devices that implement the protocols of the real ones")]
struct Arguments {
    #[command(subcommand)]
    device: Device,
}

#[derive(Subcommand)]
enum Device {
    /// Simulate a Hokuyo LiDAR on a pty, a serial port or TCP.
    Hokuyo(hil::hokuyo::HokuyoArgs),
    /// Simulate a Slamtec RPLIDAR on a pty or a serial port.
    Rplidar {
        /// Model: a1, a2, a3 or s2.
        #[arg(long, default_value = "a1", value_parser = rplidar_model)]
        model: drivers::rplidar::Model,
        #[command(flatten)]
        args: hil::rotary::RotaryArgs,
    },
    /// Simulate an LDROBOT LD06 or LD19 on a pty or a serial port.
    Ld06(hil::rotary::RotaryArgs),
    /// Simulate a camera behind a Unix socket.
    Camera(hil::video::CameraArgs),
    /// Check drivers against the kernel's devices; used by `cargo xtask rig`.
    RigProbe(hil::rig::RigArgs),
    /// Simulate two motor controllers on a CAN bus.
    Motor(hil::motor::MotorArgs),
    /// Simulate a home with all of these devices, for `firmware-host run`.
    World(hil::world::WorldArgs),
    /// Start an ssh server on loopback with its own keys, in place of a robot's.
    Sshd(hil::sshd::SshdArgs),
    /// Run the real base driver on a CAN bus and drive straight ahead.
    Base(hil::motor::BaseArgs),
}

fn rplidar_model(text: &str) -> Result<drivers::rplidar::Model, String> {
    use drivers::rplidar::Model;
    match text {
        "a1" => Ok(Model::A1),
        "a2" => Ok(Model::A2),
        "a3" => Ok(Model::A3),
        "s2" => Ok(Model::S2),
        _ => Err(format!("`{text}` is not one of a1, a2, a3, s2")),
    }
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
        Device::Rplidar { model, args } => hil::rotary::run(args, Some(*model)),
        Device::Ld06(args) => hil::rotary::run(args, None),
        Device::Camera(args) => hil::video::run(args),
        Device::RigProbe(args) => hil::rig::run(args),
        Device::World(args) => hil::world::run(args),
        Device::Motor(args) => hil::motor::run(args),
        Device::Sshd(args) => hil::sshd::run(args),
        Device::Base(args) => hil::motor::run_base(args),
    }
}
