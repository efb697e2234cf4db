//! The `hil rplidar` and `hil ld06` commands.

use std::error::Error;
use std::path::PathBuf;

use clap::Args;
use drivers::rplidar::Model;
use hal::Clock;
use monotonic_clock::MonotonicClock;
use monotonic_clock::monotonic_ns;

use super::{CircleRoom, Sensor, SimulatedRotary};
use crate::ld06::Ld06Sensor;
use crate::rplidar::RplidarSensor;

/// Where a simulated scanner is connected, and for how long.
#[derive(Debug, Clone, Args)]
pub struct RotaryArgs {
    /// Create a pty and a symbolic link to it at this path, as udev creates /dev/serial/by-id/...
    #[arg(long, required_unless_present = "serial")]
    pty: Option<PathBuf>,
    /// Use this serial port instead; its other end is connected to the host.
    #[arg(long, conflicts_with = "pty")]
    serial: Option<PathBuf>,
    /// Revolutions per second, if they differ from those of the model.
    #[arg(long)]
    rotation_hz: Option<f64>,
    /// End after this time, seconds; without it, when interrupted.
    #[arg(long)]
    seconds: Option<f64>,
}

/// Runs an RPLIDAR of this model, or an LD06 without one, in a room of 6 x 4 m in which a person walks
/// around it.
///
/// # Errors
/// Returns an error when the pty or the port cannot be opened.
pub fn run(args: &RotaryArgs, rplidar: Option<Model>) -> Result<(), Box<dyn Error>> {
    let room = Box::new(CircleRoom);
    match rplidar {
        Some(model) => {
            let mut sensor = RplidarSensor::new(model, room, monotonic_ns());
            sensor.rotation_hz = args.rotation_hz.unwrap_or(sensor.rotation_hz);
            play(args, model.spec().name, sensor)
        }
        None => {
            let mut sensor = Ld06Sensor::new(room, monotonic_ns());
            sensor.rotation_hz = args.rotation_hz.unwrap_or(sensor.rotation_hz);
            play(args, "LD06", sensor)
        }
    }
}

fn play<S: Sensor>(args: &RotaryArgs, name: &str, sensor: S) -> Result<(), Box<dyn Error>> {
    let (device, path) = match (&args.pty, &args.serial) {
        (Some(link), _) => (
            SimulatedRotary::on_pty(link, sensor).map_err(|error| {
                let link = link.display();
                format!("cannot create a pty at {link}: {error}; does another file exist there?")
            })?,
            link,
        ),
        (None, Some(port)) => (
            SimulatedRotary::on_serial(port, sensor).map_err(|error| {
                format!("cannot open the serial port {}: {error}", port.display())
            })?,
            port,
        ),
        (None, None) => return Err("give --pty or --serial".into()),
    };
    println!("{name} on {}", path.display());
    let begin_ns = monotonic_ns();
    let mut clock = MonotonicClock;
    loop {
        let now_ns = monotonic_ns();
        let passed_s = now_ns.saturating_sub(begin_ns) as f64 * 1e-9;
        if args.seconds.is_some_and(|seconds| passed_s >= seconds) {
            drop(device);
            return Ok(());
        }
        clock.sleep_until_ns(now_ns + 100_000_000);
    }
}
