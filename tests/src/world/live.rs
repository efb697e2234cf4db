//! The home and its devices, running in threads of their own.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use drivers::MonotonicClock;
use drivers::can::{BaseConfig, Protocol};
use drivers::clock::monotonic_ns;
use drivers::scip::Model;
use hal::{CameraModel, Clock, DepthMap};
use simulator::{OpenOptions, RobotOptions, World};

use super::Home;
use super::sight::{HomePicture, HomeScan};
use crate::hokuyo::SimulatedHokuyo;
use crate::motor::{Hub, MotorNode, rig};
use crate::video::{Device, VideoFaults, serve, simulated};

/// The motors' own rhythm.
const STEP_NS: u64 = 2_000_000;
/// A camera without its plug is looked after so seldom.
const UNPLUGGED_NS: u64 = 20_000_000;

/// What home, and what devices.
#[derive(Debug, Clone)]
pub struct LiveOptions {
    /// `builtin:apartment?seed=1`, or a scene file.
    pub scene: String,
    /// What the motors speak.
    pub protocol: Protocol,
    /// The camera; a pinhole.
    pub camera: CameraModel,
    /// Pictures a second.
    pub fps: f64,
    /// Seed of the start pose and of the noise.
    pub seed: u64,
}

/// A robot in a home, behind sockets and a pty. Dropping it ends everything.
pub struct LiveWorld {
    home: Home,
    lidar: SimulatedHokuyo,
    wheels: Wheels,
    config: PathBuf,
    running: Arc<AtomicBool>,
    camera_on: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

type Wheels = Arc<Mutex<[Box<dyn MotorNode>; 2]>>;

impl LiveWorld {
    /// Begins to run: devices in `dir`, and a `robot.toml` there that names them.
    ///
    /// # Errors
    /// When the scene or the folder cannot be used.
    pub fn start(dir: &Path, options: &LiveOptions) -> Result<Self, Box<dyn Error>> {
        std::fs::create_dir_all(dir).map_err(|error| format!("{}: {error}", dir.display()))?;
        let dir = dir.canonicalize()?;
        let world = Arc::new(World::open(&options.scene, &OpenOptions::default())?);
        let robot = RobotOptions { seed: options.seed, ..RobotOptions::default() };
        let t_base_camera = robot.t_base_camera;
        let base = BaseConfig { bus: socket(&dir, "can"), ..rig::config(options.protocol) };
        let home = Home::new(world, robot, &base)?;
        let model = Model::Utm30lx;
        let view = Box::new(HomeScan { home: home.clone(), model });
        let mut live = Self {
            lidar: SimulatedHokuyo::on_pty(model, &dir.join("lidar"), view)?,
            wheels: Arc::new(Mutex::new([1, 2].map(|node| rig::node(options.protocol, node)))),
            config: dir.join("robot.toml"),
            running: Arc::new(AtomicBool::new(true)),
            camera_on: Arc::new(AtomicBool::new(true)),
            threads: Vec::new(),
            home: home.clone(),
        };
        let hub = Hub::bind(&dir.join("can"))?;
        let (wheels, running) = (Arc::clone(&live.wheels), Arc::clone(&live.running));
        let turning = move || turn(&home, &wheels, hub, &running);
        live.threads.push(std::thread::Builder::new().name("simulated-motors".to_owned()).spawn(turning)?);
        let eyes = HomePicture {
            home: live.home.clone(),
            model: options.camera,
            t_base_camera,
            rgb: Vec::new(),
            depth: DepthMap::none(options.camera.width, options.camera.height),
        };
        let (path, running, on) = (dir.join("camera"), Arc::clone(&live.running), Arc::clone(&live.camera_on));
        let filming = move || film(&path, eyes, &running, &on);
        live.threads.push(std::thread::Builder::new().name("simulated-camera".to_owned()).spawn(filming)?);
        std::fs::write(&live.config, configuration(&dir, options, &base)?)?;
        Ok(live)
    }

    /// The file for `firmware-host run --config`.
    #[must_use]
    pub fn config(&self) -> &Path {
        &self.config
    }

    /// Where the robot really is, and what it has touched.
    #[must_use]
    pub fn home(&self) -> &Home {
        &self.home
    }

    /// The scanner, to spoil it.
    #[must_use]
    pub fn lidar(&self) -> &SimulatedHokuyo {
        &self.lidar
    }

    /// The motors' controllers, to spoil them.
    pub fn wheels(&self) -> MutexGuard<'_, [Box<dyn MotorNode>; 2]> {
        self.wheels.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Pulls the camera's plug, or puts it back in.
    pub fn plug_camera(&self, on: bool) {
        self.camera_on.store(on, Ordering::Relaxed);
    }
}

impl Drop for LiveWorld {
    fn drop(&mut self) {
        self.running.store(false, Ordering::Relaxed);
        self.camera_on.store(false, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

fn turn(home: &Home, wheels: &Wheels, mut hub: Hub, running: &AtomicBool) {
    let mut clock = MonotonicClock;
    let start_ns = monotonic_ns();
    let mut due_ns = start_ns;
    let mut out = Vec::new();
    while running.load(Ordering::Relaxed) {
        due_ns = (due_ns + STEP_NS).max(clock.now_ns());
        clock.sleep_until_ns(due_ns);
        let mut wheels = wheels.lock().unwrap_or_else(PoisonError::into_inner);
        rig::step_nodes(&mut *wheels, &mut hub, due_ns, &mut out);
        home.pass(due_ns - start_ns, &mut wheels);
    }
}

fn film(path: &Path, mut eyes: HomePicture, running: &AtomicBool, on: &AtomicBool) {
    let mut clock = MonotonicClock;
    let size = (eyes.model.width as u32, eyes.model.height as u32);
    while running.load(Ordering::Relaxed) {
        let device = Device { sizes: vec![size], ..simulated() };
        if on.load(Ordering::Relaxed)
            && let Err(error) = serve(path, device, &VideoFaults::default(), &mut eyes, on)
        {
            eprintln!("the simulated camera cannot listen at {}: {error}", path.display());
            return;
        }
        clock.sleep_until_ns(clock.now_ns() + UNPLUGGED_NS);
    }
}

fn socket(dir: &Path, name: &str) -> String {
    format!("unix:{}", dir.join(name).display())
}

/// What `firmware-host run` is told of these devices.
fn configuration(dir: &Path, options: &LiveOptions, base: &BaseConfig) -> Result<String, Box<dyn Error>> {
    let camera = &options.camera;
    let mut text = format!(
        "# The simulated devices of {}.\n[camera]\nwidth = {}\nheight = {}\n\n[run]\nstatus_file = {:?}\n\n\
         [devices.camera]\ndevice = {:?}\nwidth = {}\nheight = {}\nfps = {:?}\n\n\
         [devices.lens]\nfx = {:?}\nfy = {:?}\ncx = {:?}\ncy = {:?}\n\n[devices.lidar]\nport = {:?}\n\n",
        options.scene,
        camera.width,
        camera.height,
        dir.join("status.json"),
        socket(dir, "camera"),
        camera.width,
        camera.height,
        options.fps,
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
