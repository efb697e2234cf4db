//! `hil world`: by hand, and for whole runs of `firmware-host run`.

use std::error::Error;
use std::io::{IsTerminal, Write, stdout};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use drivers::can::Protocol;
use drivers::scip::Model;
use hal::{CameraModel, Clock};
use monotonic_clock::MonotonicClock;

use super::cables::Cables;
use super::faults::Mischief;
use super::live::{LiveOptions, LiveWorld};

/// Time between two looks at what is to be said and done.
const LOOK_NS: u64 = 10_000_000;
/// Devices this late may pass for silent: two scans of 40 Hz.
const LATE_MS: u64 = 50;

/// A simulated home behind simulated devices, in real time, for `firmware-host run`.
#[derive(Debug, clap::Args)]
pub struct WorldArgs {
    /// `builtin:apartment?seed=1` (also `house`, `office`), or a scene file.
    #[arg(long, default_value = "builtin:apartment?seed=1")]
    scene: String,
    /// Folder for the devices' sockets and the robot.toml that names them. Made if missing.
    #[arg(long, value_name = "DIR")]
    dir: PathBuf,
    /// What the motors speak.
    #[arg(long, default_value = "odrive", value_parser = protocol)]
    protocol: Protocol,
    /// The scanner: urg-04lx, utm-30lx, ust-10lx or ust-20lx.
    #[arg(long, default_value = "utm-30lx")]
    lidar: Model,
    /// The camera's pictures, 90 degrees wide.
    #[arg(long, default_value = "640x192", value_name = "WIDTHxHEIGHT", value_parser = size)]
    picture: (usize, usize),
    /// Pictures a second.
    #[arg(long, default_value_t = 15.0)]
    fps: f64,
    /// How much later than they are taken pictures are stamped, milliseconds.
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u64).range(..=500))]
    late_ms: u64,
    /// Devices that are reached by the kernel's own drivers.
    #[command(flatten)]
    cables: Cables,
    /// Seed of the start pose and of the noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Devices fail at random, by this seed.
    #[arg(long)]
    faults: Option<u64>,
    /// Ends after so many seconds.
    #[arg(long)]
    seconds: Option<f64>,
}

fn size(text: &str) -> Result<(usize, usize), String> {
    let (width, height) = text.split_once('x').ok_or("write it as 640x192")?;
    let parse = |number: &str| match number.parse::<usize>() {
        // Two pixels share their colour.
        Ok(number @ 32..=4096) if number % 2 == 0 => Ok(number),
        _ => Err(format!("`{number}` is no even number of pixels from 32 to 4096")),
    };
    Ok((parse(width)?, parse(height)?))
}

fn protocol(text: &str) -> Result<Protocol, String> {
    match text {
        "odrive" => Ok(Protocol::Odrive),
        "vesc" => Ok(Protocol::Vesc),
        "cia402" => Ok(Protocol::Cia402),
        _ => Err(format!("`{text}` is none of odrive, vesc, cia402")),
    }
}

/// Runs until interrupted; then says how often the robot touched something.
///
/// # Errors
/// When the scene or the folder cannot be used.
pub fn run(args: &WorldArgs) -> Result<(), Box<dyn Error>> {
    let running = Arc::new(AtomicBool::new(true));
    let stop = Arc::clone(&running);
    ctrlc::set_handler(move || stop.store(false, Ordering::Relaxed))?;
    let world = LiveWorld::start(
        &args.dir,
        &LiveOptions {
            scene: args.scene.clone(),
            protocol: args.protocol,
            lidar: args.lidar,
            camera: CameraModel::pinhole(
                args.picture.0,
                args.picture.1,
                std::f64::consts::FRAC_PI_2,
            ),
            fps: args.fps,
            late_ms: args.late_ms,
            seed: args.seed,
            cables: args.cables.clone(),
        },
    )?;
    let dir = args.dir.display();
    println!("{} is ready. In other terminals:\n", args.scene);
    println!("    firmware-host run --config {} --out {dir}/run", world.config().display());
    println!("    firmware-host health --watch --status {dir}/status.json\n");
    let mut mischief = args.faults.map(Mischief::new);
    let mut clock = MonotonicClock;
    let (began, mut shown_s) = (Instant::now(), 0.0);
    while running.load(Ordering::Relaxed) {
        clock.sleep_until_ns(clock.now_ns() + LOOK_NS);
        let time_s = began.elapsed().as_secs_f64();
        if let Some(mischief) = &mut mischief
            && let Some(words) = mischief.turn(time_s, &world)?
        {
            println!("\r{time_s:8.2} s  {words}\x1b[K");
        }
        if time_s - shown_s >= if stdout().is_terminal() { 0.2 } else { 10.0 } {
            shown_s = time_s;
            show(&world, time_s)?;
        }
        if args.seconds.is_some_and(|seconds| time_s >= seconds) {
            break;
        }
    }
    let (touches, path_m) = world.home().score();
    let faults =
        mischief.map_or_else(String::new, |mischief| format!(" faults={}", mischief.count()));
    println!("\nworld: path_m={path_m:.2} touches={touches}{faults}");
    let late_ms = world.worst_late_ns() / 1_000_000;
    if late_ms >= LATE_MS {
        println!(
            "This computer was too busy: the devices themselves came up to {late_ms} ms late, as silent ones do."
        );
    }
    Ok(())
}

fn show(world: &LiveWorld, time_s: f64) -> std::io::Result<()> {
    let (pose, (touches, path_m)) = (world.home().pose(), world.home().score());
    let line = format!(
        "{time_s:8.1} s  at ({:.2}, {:.2}) m, {:.0} degrees; {path_m:.1} m driven, {touches} touches",
        pose.x_m,
        pose.y_m,
        pose.yaw_rad.to_degrees()
    );
    if stdout().is_terminal() {
        print!("\r\x1b[K{line}");
    } else {
        println!("{line}");
    }
    stdout().flush()
}
