//! Simulated cameras: on a strict model of the kernel's queue, in this process for tests and behind a Unix socket for whole
//! programs.

mod device;
mod fake;
mod picture;
mod queue;
mod server;
mod torture;

use std::error::Error;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use drivers::v4l2::node::FourCc;

pub use device::Device;
pub use fake::FakeCamera;
pub use picture::{MovingStripes, PictureSource};
pub use queue::{Queue, Shot};
pub use server::{VideoFaults, serve};
pub use torture::torture;

use crate::Seconds;

/// A simulated camera that a driver opens as `unix:/path`.
#[derive(Debug, clap::Args)]
pub struct CameraArgs {
    /// Where to listen: `unix:/path`, as in the driver's configuration.
    #[arg(long, default_value = "unix:/tmp/camera")]
    node: String,
    /// Unplugged from one second to another, such as 5..8.
    #[arg(long, value_parser = seconds)]
    unplug: Option<Seconds>,
    /// Silent from one second to another.
    #[arg(long, value_parser = seconds)]
    silent: Option<Seconds>,
    /// Share of pictures that are lost.
    #[arg(long, default_value_t = 0.0)]
    drop: f64,
}

/// Runs until it is interrupted.
///
/// # Errors
/// When the socket cannot be made.
pub fn run(args: &CameraArgs) -> Result<(), Box<dyn Error>> {
    let path = args.node.strip_prefix("unix:").ok_or("--node must be unix:/path")?;
    let path = PathBuf::from(path);
    let faults = VideoFaults {
        unplugged: args.unplug.clone(),
        silent: args.silent.clone(),
        drop_share: args.drop,
        ..VideoFaults::default()
    };
    let running = Arc::new(AtomicBool::new(true));
    let stop = running.clone();
    ctrlc::set_handler(move || stop.store(false, Ordering::Relaxed))?;
    println!("a camera at unix:{}; Ctrl-C unplugs it for good", path.display());
    serve(&path, simulated(), &faults, &mut MovingStripes, &running)?;
    Ok(())
}

/// The camera behind the socket: as a USB camera, but it has YUYV only, which is what picture sources give.
#[must_use]
pub fn simulated() -> Device {
    Device { formats: vec![FourCc::YUYV], ..Device::default() }
}

fn seconds(text: &str) -> Result<Seconds, String> {
    let parse =
        |number: &str| number.parse::<f64>().map_err(|error| format!("`{number}`: {error}"));
    let (from, to) = text.split_once("..").ok_or("write it as 5..8")?;
    Ok(parse(from)?..parse(to)?)
}
