//! Simulated cameras on a strict model of the kernel's buffer queue: in this process for tests, and
//! behind a Unix socket for whole programs.

mod device;
mod events;
mod fake;
mod queue;
mod server;
mod source;

use std::error::Error;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use drivers::v4l2::node::FourCc;

pub use device::Device;
pub use events::check_events;
pub use fake::FakeCamera;
pub use queue::{FrameInfo, Queue};
pub use server::{VideoFaults, serve};
pub use source::{ImageSource, MovingStripes};

use crate::Seconds;

/// Simulate a camera that a driver opens as `unix:/path`.
#[derive(Debug, clap::Args)]
pub struct CameraArgs {
    /// Address to listen at: `unix:/path`, as in the driver's configuration.
    #[arg(long, default_value = "unix:/tmp/camera")]
    node: String,
    /// Time interval in which the camera is unplugged, seconds, such as 5..8.
    #[arg(long, value_parser = seconds)]
    unplug: Option<Seconds>,
    /// Time interval in which the camera sends no frames, seconds.
    #[arg(long, value_parser = seconds)]
    silent: Option<Seconds>,
    /// Fraction of frames that are lost, 0 to 1.
    #[arg(long, default_value_t = 0.0)]
    drop: f64,
}

/// Runs until interrupted.
///
/// # Errors
/// Returns an error when the socket cannot be created.
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
    println!("simulated camera at unix:{}; end with Ctrl-C", path.display());
    serve(&path, simulated(), &faults, &mut MovingStripes, &running)?;
    Ok(())
}

/// The camera behind the socket: a USB camera with YUYV only, the format of [`ImageSource`].
#[must_use]
pub fn simulated() -> Device {
    Device { formats: vec![FourCc::YUYV], ..Device::default() }
}

fn seconds(text: &str) -> Result<Seconds, String> {
    let (from, to) = text.split_once("..").ok_or("write it as 5..8")?;
    Ok(parse_second(from)?..parse_second(to)?)
}

fn parse_second(number: &str) -> Result<f64, String> {
    number.parse::<f64>().map_err(|error| format!("`{number}`: {error}"))
}
