//! `hil world`: by hand, and for whole runs of `firmware-host run`.

use std::error::Error;
use std::io::{IsTerminal, Write, stdout};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use drivers::MonotonicClock;
use drivers::can::Protocol;
use drivers::clock::monotonic_ns;
use drivers::scip::Model;
use hal::{CameraModel, Clock, DepthMap};
use simulator::{OpenOptions, RobotOptions, World};

use super::Home;
use super::faults::Mischief;
use super::sight::{HomePicture, HomeScan};
use crate::hokuyo::SimulatedHokuyo;
use crate::motor::{Hub, rig};
use crate::video::{VideoFaults, serve, simulated};

/// The motors' own rhythm.
const STEP_NS: u64 = 2_000_000;

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
    /// Pictures a second.
    #[arg(long, default_value_t = 15.0)]
    fps: f64,
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
    std::fs::create_dir_all(&args.dir).map_err(|error| format!("{}: {error}", args.dir.display()))?;
    let dir = args.dir.canonicalize()?;
    let world = Arc::new(World::open(&args.scene, &OpenOptions::default())?);
    let options = RobotOptions { seed: args.seed, ..RobotOptions::default() };
    let (camera, t_base_camera) = (options.camera, options.t_base_camera);
    let base = drivers::can::BaseConfig { bus: socket(&dir, "can"), ..rig::config(args.protocol) };
    let home = Home::new(world, options, &base)?;
    let model = Model::Utm30lx;
    let lidar = SimulatedHokuyo::on_pty(model, &dir.join("lidar"), Box::new(HomeScan { home: home.clone(), model }))?;
    let hub = Hub::bind(&dir.join("can"))?;
    let running = Arc::new(AtomicBool::new(true));
    let stop = Arc::clone(&running);
    ctrlc::set_handler(move || stop.store(false, Ordering::Relaxed))?;
    let eyes = HomePicture {
        home: home.clone(),
        model: camera,
        t_base_camera,
        rgb: Vec::new(),
        depth: DepthMap::none(camera.width, camera.height),
    };
    let film = film(&dir.join("camera"), eyes, &running)?;
    let config = dir.join("robot.toml");
    std::fs::write(&config, configuration(&dir, args, &base, &camera)?)?;
    println!("{} is ready. In another terminal:\n", args.scene);
    println!("    firmware-host run --config {} --out {}", config.display(), dir.join("run").display());
    println!("    firmware-host health --watch --status {}\n", dir.join("status.json").display());
    turn(args, &home, &lidar, hub, &running)?;
    running.store(false, Ordering::Relaxed);
    film.join().map_err(|_| "the camera's thread has panicked")??;
    Ok(())
}

fn socket(dir: &Path, name: &str) -> String {
    format!("unix:{}", dir.join(name).display())
}

fn film(
    path: &Path,
    mut eyes: HomePicture,
    running: &Arc<AtomicBool>,
) -> std::io::Result<std::thread::JoinHandle<std::io::Result<()>>> {
    let (path, running) = (path.to_owned(), Arc::clone(running));
    std::thread::Builder::new()
        .name("simulated-camera".to_owned())
        .spawn(move || serve(&path, simulated(), &VideoFaults::default(), &mut eyes, &running))
}

/// Motors and time.
fn turn(
    args: &WorldArgs,
    home: &Home,
    lidar: &SimulatedHokuyo,
    mut hub: Hub,
    running: &AtomicBool,
) -> Result<(), Box<dyn Error>> {
    let mut wheels = [1, 2].map(|node| rig::node(args.protocol, node));
    let mut mischief = args.faults.map(Mischief::new);
    let mut clock = MonotonicClock;
    let start_ns = monotonic_ns();
    let (mut due_ns, mut shown_s) = (start_ns, 0.0);
    let mut out = Vec::new();
    while running.load(Ordering::Relaxed) {
        due_ns = (due_ns + STEP_NS).max(clock.now_ns());
        clock.sleep_until_ns(due_ns);
        rig::step_nodes(&mut wheels, &mut hub, due_ns, &mut out);
        home.pass(due_ns - start_ns, &mut wheels);
        let time_s = (due_ns - start_ns) as f64 * 1e-9;
        if let Some(mischief) = &mut mischief
            && let Some(words) = mischief.turn(time_s, lidar, &mut wheels)?
        {
            println!("\r{time_s:8.2} s  {words}\x1b[K");
        }
        if time_s - shown_s >= if stdout().is_terminal() { 0.2 } else { 10.0 } {
            shown_s = time_s;
            show(home, time_s)?;
        }
        if args.seconds.is_some_and(|seconds| time_s >= seconds) {
            break;
        }
    }
    let (touches, path_m) = home.score();
    let faults = mischief.map_or_else(String::new, |mischief| format!(", {} faults", mischief.count()));
    println!("\nworld: path_m={path_m:.2} touches={touches}{faults}");
    Ok(())
}

fn show(home: &Home, time_s: f64) -> std::io::Result<()> {
    let (pose, (touches, path_m)) = (home.pose(), home.score());
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

/// What `firmware-host run` is told of these devices.
fn configuration(
    dir: &Path,
    args: &WorldArgs,
    base: &drivers::can::BaseConfig,
    camera: &CameraModel,
) -> Result<String, Box<dyn Error>> {
    let mut text = format!(
        "# The simulated devices of `hil world --scene {}`.\n[run]\nstatus_file = {:?}\n\n\
         [devices.camera]\ndevice = {:?}\nwidth = {}\nheight = {}\nfps = {:?}\n\n\
         [devices.lens]\nfx = {:?}\nfy = {:?}\ncx = {:?}\ncy = {:?}\n\n[devices.lidar]\nport = {:?}\n\n",
        args.scene,
        dir.join("status.json"),
        socket(dir, "camera"),
        camera.width,
        camera.height,
        args.fps,
        camera.fx,
        camera.fy,
        camera.cx,
        camera.cy,
        dir.join("lidar"),
    );
    // The base's own tables go below `[devices.base]`.
    let base = toml::Table::try_from(base)?;
    let devices = toml::Table::from_iter([("base".to_owned(), toml::Value::Table(base))]);
    text += &toml::to_string(&toml::Table::from_iter([("devices".to_owned(), toml::Value::Table(devices))]))?;
    Ok(text)
}
