//! The `hil world` command, for manual use and for whole runs of `firmware-host run`.

use std::error::Error;
use std::io::{IsTerminal, Write, stdout};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use drivers::can::Protocol;
use hal::{CameraModel, Clock};
use monotonic_clock::MonotonicClock;
use signal_hook::consts::{SIGUSR1, SIGUSR2};
use signal_hook::flag;
use simulator::nuisance::Nuisances;
use simulator::odometry::OdometryNoise;

use super::ScannerModel;
use super::cables::Cables;
use super::faults::RandomFaults;
use super::hands::ControlPipe;
use super::live::{LiveOptions, LiveWorld};

/// Name of the pipe for what people do to the robot.
const CONTROL: &str = "control";
/// Interval of fault updates and output.
const POLL_NS: u64 = 10_000_000;
/// A motor controller needs this long to start after its power is back.
const BOOT_NS: u64 = 300_000_000;
/// Devices that are this late may be reported as silent: two scan periods at 40 Hz.
const LATE_MS: u64 = 50;

/// Simulate a home with all devices, in real time, for `firmware-host run`.
///
/// SIGUSR1 cuts the power of the motors and SIGUSR2 restores it, as an emergency stop in their supply does. Lines that are written to
/// DIR/control do to the robot what a person could do: `carry X Y DEGREES` in the scene's frame, `push FORWARD LEFT` by metres, and
/// `spin SECONDS` while the wheels have no grip.
#[derive(Debug, clap::Args)]
pub struct WorldArgs {
    /// Home: `builtin:apartment?seed=1` (also `house`, `office`), or a scene file.
    #[arg(long, default_value = "builtin:apartment?seed=1")]
    scene: String,
    /// Folder for the devices' sockets and for the robot.toml that names them. Created if missing.
    #[arg(long, value_name = "DIR")]
    dir: PathBuf,
    /// Protocol of the motor controllers: odrive, vesc or cia402.
    #[arg(long, default_value = "odrive", value_parser = protocol)]
    protocol: Protocol,
    /// Model of the scanner: urg-04lx, utm-30lx, ust-10lx, ust-20lx, rplidar-a1, rplidar-a2,
    /// rplidar-a3, rplidar-s2 or ld06.
    #[arg(long, default_value = "utm-30lx")]
    lidar: ScannerModel,
    /// Size of the camera's frames; the field of view is 90 degrees wide.
    #[arg(
        long,
        alias = "picture",
        default_value = "640x192",
        value_name = "WIDTHxHEIGHT",
        value_parser = size
    )]
    frame_size: (usize, usize),
    /// Frames per second of the camera.
    #[arg(long, default_value_t = 15.0)]
    fps: f64,
    /// Delay between exposure and timestamp of the camera's frames, milliseconds.
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u64).range(..=500))]
    late_ms: u64,
    #[command(flatten)]
    cables: Cables,
    /// Seed of the start pose, of the sensor noise and of the wheels' errors.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Give the robot an inertial measurement unit, a BMI160.
    #[arg(long)]
    imu: bool,
    /// Exact wheels and images without noise, as no real robot has.
    #[arg(long)]
    perfect: bool,
    /// Inject random device faults with this seed.
    #[arg(long)]
    faults: Option<u64>,
    /// End after this time, seconds.
    #[arg(long)]
    seconds: Option<f64>,
}

fn size(text: &str) -> Result<(usize, usize), String> {
    let (width, height) = text.split_once('x').ok_or("write it as 640x192")?;
    Ok((parse_pixels(width)?, parse_pixels(height)?))
}

fn parse_pixels(number: &str) -> Result<usize, String> {
    match number.parse::<usize>() {
        // YUV 4:2:2 shares the colour of two pixels, so sizes must be even.
        Ok(number @ 32..=4096) if number % 2 == 0 => Ok(number),
        _ => Err(format!("`{number}` is not an even number of pixels from 32 to 4096")),
    }
}

fn protocol(text: &str) -> Result<Protocol, String> {
    match text {
        "odrive" => Ok(Protocol::Odrive),
        "vesc" => Ok(Protocol::Vesc),
        "cia402" => Ok(Protocol::Cia402),
        _ => Err(format!("`{text}` is not one of odrive, vesc, cia402")),
    }
}

/// Runs until interrupted, then prints how often the robot touched an obstacle.
///
/// # Errors
/// Returns an error when the scene or the folder cannot be used.
pub fn run(args: &WorldArgs) -> Result<(), Box<dyn Error>> {
    let running = Arc::new(AtomicBool::new(true));
    let stop = Arc::clone(&running);
    ctrlc::set_handler(move || stop.store(false, Ordering::Relaxed))?;
    let supply = MotorSupply::new()?;
    let world = LiveWorld::start(
        &args.dir,
        &LiveOptions {
            scene: args.scene.clone(),
            protocol: args.protocol,
            lidar: args.lidar,
            camera: CameraModel::pinhole(
                args.frame_size.0,
                args.frame_size.1,
                std::f64::consts::FRAC_PI_2,
            ),
            fps: args.fps,
            late_ms: args.late_ms,
            odometry: if args.perfect { OdometryNoise::NONE } else { OdometryNoise::ORDINARY },
            nuisances: if args.perfect { Nuisances::none() } else { Nuisances::default() },
            seed: args.seed,
            imu: args.imu,
            cables: args.cables.clone(),
        },
    )?;
    let mut pipe = ControlPipe::listen(&args.dir.join(CONTROL))?;
    let dir = args.dir.display();
    println!("{} is ready. In other terminals:\n", args.scene);
    println!("    firmware-host run --config {} --out {dir}/run", world.config().display());
    println!("    firmware-host health --watch --status {dir}/status.json");
    println!("    firmware-host return --task-file {dir}/task.json");
    println!(
        "    echo 'push 0 0.2' > {dir}/{CONTROL}    # also: carry X Y DEGREES, spin SECONDS\n"
    );
    let mut random_faults = args.faults.map(RandomFaults::new);
    let mut clock = MonotonicClock;
    let began = Instant::now();
    let mut shown_s = 0.0;
    while running.load(Ordering::Relaxed) {
        clock.sleep_until_ns(clock.now_ns() + POLL_NS);
        let time_s = began.elapsed().as_secs_f64();
        if let Some(message) = supply.update(&world) {
            println!("\r{time_s:8.2} s  {message}\x1b[K");
        }
        while let Some(order) = pipe.next_line() {
            let message = match order.and_then(|what| world.home().handle(&what).map(|()| what)) {
                Ok(what) => what.to_string(),
                Err(refusal) => refusal,
            };
            println!("\r{time_s:8.2} s  {message}\x1b[K");
        }
        if let Some(random_faults) = &mut random_faults
            && let Some(message) = random_faults.update(time_s, &world)?
        {
            println!("\r{time_s:8.2} s  {message}\x1b[K");
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
    let faults = random_faults
        .map_or_else(String::new, |random_faults| format!(" faults={}", random_faults.count()));
    println!("\nworld: path_m={path_m:.2} touches={touches}{faults}");
    let late_ms = world.worst_late_ns() / 1_000_000;
    if late_ms >= LATE_MS {
        println!(
            "This computer was too busy: the simulated devices were up to {late_ms} ms late, which the robot may report as silence."
        );
    }
    Ok(())
}

/// The supply of the motors, which signals cut and restore.
struct MotorSupply {
    cut: Arc<AtomicBool>,
    restore: Arc<AtomicBool>,
}

impl MotorSupply {
    fn new() -> std::io::Result<Self> {
        let supply = Self { cut: Arc::default(), restore: Arc::default() };
        flag::register(SIGUSR1, Arc::clone(&supply.cut))?;
        flag::register(SIGUSR2, Arc::clone(&supply.restore))?;
        Ok(supply)
    }

    /// Does what the newest signals ask for. Returns a message if there was one.
    fn update(&self, world: &LiveWorld) -> Option<&'static str> {
        let is_cut = self.cut.swap(false, Ordering::Relaxed);
        let is_restored = self.restore.swap(false, Ordering::Relaxed);
        if !is_cut && !is_restored {
            return None;
        }
        for node in world.wheels().iter_mut() {
            node.faults().boot_ns = BOOT_NS;
            node.faults().unpowered = is_cut;
        }
        Some(if is_cut { "the motors have no power" } else { "the motors have power again" })
    }
}

fn show(world: &LiveWorld, time_s: f64) -> std::io::Result<()> {
    let pose = world.home().pose();
    let (touches, path_m) = world.home().score();
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
