//! The home and its devices, running in their own threads.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use drivers::can::{BaseConfig, CanBus, Protocol, SocketBus};
use drivers::scip::Model;
use hal::{CameraModel, Clock, DepthMap};
use monotonic_clock::MonotonicClock;
use monotonic_clock::monotonic_ns;
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use simulator::laser::LaserModel;
use simulator::nuisance::Nuisances;
use simulator::odometry::OdometryNoise;
use simulator::{OpenOptions, RobotOptions, World};
use thread_priority::{
    RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id,
};

use super::cables::{Cable, Cables};
use super::imu::ImuServer;
use super::sensors::HomeCamera;
use super::{Home, ScannerModel, SimulatedScanner, output};
use crate::motor::{Hub, MemoryBus, MotorNode, Outbox, rig};
use crate::video::{Device, VideoFaults, serve, simulated};

/// Period of the simulated motors.
const STEP_NS: u64 = 2_000_000;
/// SCHED_FIFO priority of the simulated motors, below the safety loop's 40: a motor controller has a processor of its own,
/// and a busy computer must not make it silent.
const MOTOR_PRIORITY: u8 = 30;
/// Keeps the camera's random numbers apart from the wheels'.
const CAMERA_STREAM: u64 = 0x6361_6d65;
/// Interval at which an unplugged camera checks whether it is plugged in again.
const UNPLUGGED_NS: u64 = 20_000_000;

/// Options of the home and its devices.
#[derive(Debug, Clone)]
pub struct LiveOptions {
    /// Home: `builtin:apartment?seed=1`, or a scene file.
    pub scene: String,
    pub protocol: Protocol,
    pub lidar: ScannerModel,
    pub camera: CameraModel,
    /// Frames per second of the camera.
    pub fps: f64,
    /// Delay between exposure and timestamp of the camera's frames, milliseconds, at most 500.
    pub late_ms: u64,
    /// Errors of the wheels.
    pub odometry: OdometryNoise,
    /// Disturbances of the camera's images. Only the sensor's noise is simulated here.
    pub nuisances: Nuisances,
    /// Seed of the start pose, of the sensor noise and of the wheels' errors.
    pub seed: u64,
    /// Whether the robot has an inertial measurement unit.
    pub imu: bool,
    /// Devices that are reached through kernel drivers. The others are created in the folder.
    pub cables: Cables,
}

impl Default for LiveOptions {
    /// An apartment, ODrives, a UTM-30LX, the camera of "Embodied Depth Prediction", and the errors of
    /// an ordinary base.
    fn default() -> Self {
        Self {
            scene: "builtin:apartment?seed=1".to_owned(),
            protocol: Protocol::Odrive,
            lidar: ScannerModel::Hokuyo(Model::Utm30lx),
            camera: CameraModel::pinhole(640, 192, std::f64::consts::FRAC_PI_2),
            fps: 15.0,
            late_ms: 0,
            odometry: OdometryNoise::ORDINARY,
            nuisances: Nuisances::default(),
            seed: 1,
            imu: false,
            cables: Cables::default(),
        }
    }
}

/// A running robot in a home, reachable through sockets and a pty. Dropping it stops all threads.
pub struct LiveWorld {
    home: Home,
    lidar: SimulatedScanner,
    wheels: Wheels,
    config: PathBuf,
    running: Arc<AtomicBool>,
    worst_late_ns: Arc<AtomicU64>,
    camera_plugged: Arc<AtomicBool>,
    imu_plugged: Arc<AtomicBool>,
    can_plugged: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

type Wheels = Arc<Mutex<[Box<dyn MotorNode>; 2]>>;

impl LiveWorld {
    /// Starts the devices in `dir` and writes a `robot.toml` there that names them.
    ///
    /// # Errors
    /// Returns an error when the scene or the folder cannot be used.
    pub fn start(dir: &Path, options: &LiveOptions) -> Result<Self, Box<dyn Error>> {
        std::fs::create_dir_all(dir).map_err(|error| format!("{}: {error}", dir.display()))?;
        let dir = dir.canonicalize()?;
        let world = Arc::new(World::open(&options.scene, &OpenOptions::default())?);
        let model = options.lidar;
        let laser = LaserModel { geometry: model.geometry(), ..LaserModel::UTM_30LX };
        let robot = RobotOptions {
            seed: options.seed,
            laser,
            odometry: options.odometry,
            ..RobotOptions::default()
        };
        let t_base_camera = robot.t_base_camera;
        let Cables { camera_at, lidar_at, motors_at } = &options.cables;
        let base = BaseConfig {
            bus: robots_end(motors_at, socket(&dir, "can")),
            ..rig::config(options.protocol)
        };
        let home = Home::new(world, robot, &base)?;
        let start_ns = monotonic_ns();
        let mut live = Self {
            lidar: match lidar_at {
                Some(cable) => {
                    SimulatedScanner::start(model, &home, start_ns, Path::new(&cable.world), true)
                        .map_err(|error| format!("no serial port at {}: {error}", cable.world))?
                }
                None => SimulatedScanner::start(model, &home, start_ns, &dir.join("lidar"), false)?,
            },
            wheels: Arc::new(Mutex::new([1, 2].map(|node| rig::node(options.protocol, node)))),
            config: dir.join("robot.toml"),
            running: Arc::new(AtomicBool::new(true)),
            worst_late_ns: Arc::default(),
            camera_plugged: Arc::new(AtomicBool::new(true)),
            imu_plugged: Arc::new(AtomicBool::new(true)),
            can_plugged: Arc::new(AtomicBool::new(true)),
            threads: Vec::new(),
            home: home.clone(),
        };
        let plugged = Arc::clone(&live.can_plugged);
        let bus = match motors_at {
            Some(cable) => MotorBus::on_interface(&cable.world, plugged),
            None => MotorBus::on_hub(dir.join("can"), plugged)?,
        };
        if options.imu {
            let server = ImuServer {
                path: dir.join("imu"),
                imu: live.home.imu(),
                start_ns,
                plugged: Arc::clone(&live.imu_plugged),
            };
            let running = Arc::clone(&live.running);
            let thread = std::thread::Builder::new().name("simulated-imu".to_owned());
            live.threads.push(thread.spawn(move || server.run(&running))?);
        }
        let wheels = Arc::clone(&live.wheels);
        let running = Arc::clone(&live.running);
        let late_ns = Arc::clone(&live.worst_late_ns);
        let motors = std::thread::Builder::new().name("simulated-motors".to_owned());
        live.threads.push(
            motors.spawn(move || run_motors(&home, &wheels, bus, start_ns, &running, &late_ns))?,
        );
        let camera = HomeCamera {
            home: live.home.clone(),
            model: options.camera,
            t_base_camera,
            late_ns: options.late_ms * 1_000_000,
            nuisances: options.nuisances.clone(),
            rng: Pcg64Mcg::seed_from_u64(options.seed ^ CAMERA_STREAM),
            rgb: Vec::new(),
            depth: DepthMap::none(options.camera.width, options.camera.height),
        };
        let running = Arc::clone(&live.running);
        let on = Arc::clone(&live.camera_plugged);
        let filming: Box<dyn FnOnce() + Send> = match camera_at {
            Some(cable) => {
                let mut output = output::Output::start(&cable.world)?;
                let period_ns = (1e9 / options.fps) as u64;
                Box::new(move || output.film(camera, period_ns, &running, &on))
            }
            None => {
                let path = dir.join("camera");
                Box::new(move || serve_camera(&path, camera, &running, &on))
            }
        };
        live.threads
            .push(std::thread::Builder::new().name("simulated-camera".to_owned()).spawn(filming)?);
        let ends = [
            robots_end(camera_at, socket(&dir, "camera")),
            robots_end(lidar_at, dir.join("lidar").display().to_string()),
        ];
        std::fs::write(&live.config, configuration(&dir, options, &ends, &base)?)?;
        Ok(live)
    }

    /// Path of the file for `firmware-host run --config`.
    #[must_use]
    pub fn config(&self) -> &Path {
        &self.config
    }

    /// The home, with the robot's true pose and contacts.
    #[must_use]
    pub fn home(&self) -> &Home {
        &self.home
    }

    /// The scanner, for injecting faults.
    #[must_use]
    pub fn lidar(&self) -> &SimulatedScanner {
        &self.lidar
    }

    /// The motor controllers, for injecting faults.
    pub fn wheels(&self) -> MutexGuard<'_, [Box<dyn MotorNode>; 2]> {
        self.wheels.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Worst delay of the motors, nanoseconds. A busy computer delays the other devices as well.
    #[must_use]
    pub fn worst_late_ns(&self) -> u64 {
        self.worst_late_ns.load(Ordering::Relaxed)
    }

    /// Unplugs the camera, or plugs it in again.
    pub fn plug_camera(&self, on: bool) {
        self.camera_plugged.store(on, Ordering::Relaxed);
    }

    /// Unplugs the inertial measurement unit, or plugs it in again.
    pub fn plug_imu(&self, on: bool) {
        self.imu_plugged.store(on, Ordering::Relaxed);
    }

    /// Unplugs the robot's CAN adapter, or plugs it in again. The motors keep their power. An adapter that is reached through a
    /// kernel driver stays.
    pub fn plug_can(&self, on: bool) {
        self.can_plugged.store(on, Ordering::Relaxed);
    }

    /// The USB hub that all devices of the robot are connected to loses its power, or gets it back: camera, scanner, inertial
    /// unit and CAN adapter vanish or return at once.
    ///
    /// # Errors
    /// When there is no pty for the scanner.
    pub fn power_usb_hub(&self, on: bool) -> std::io::Result<()> {
        self.plug_camera(on);
        self.plug_imu(on);
        self.plug_can(on);
        if on {
            return self.lidar.plug_in();
        }
        self.lidar.unplug();
        Ok(())
    }
}

fn robots_end(cable: &Option<Cable>, else_here: String) -> String {
    cable.as_ref().map_or(else_here, |cable| cable.robot.clone())
}

impl Drop for LiveWorld {
    fn drop(&mut self) {
        self.running.store(false, Ordering::Relaxed);
        self.camera_plugged.store(false, Ordering::Relaxed);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

/// The motors' end of the CAN bus.
struct MotorBus {
    bus: Box<dyn CanBus + Send>,
    /// Path of the hub; `None` with an interface of the kernel.
    hub: Option<PathBuf>,
    /// Whether the robot's adapter has to be plugged in, and whether it is.
    plugged: Arc<AtomicBool>,
    is_plugged: bool,
}

impl MotorBus {
    fn on_interface(name: &str, plugged: Arc<AtomicBool>) -> Self {
        Self { bus: Box::new(SocketBus::new(name)), hub: None, plugged, is_plugged: true }
    }

    fn on_hub(path: PathBuf, plugged: Arc<AtomicBool>) -> std::io::Result<Self> {
        let bus = Box::new(Hub::bind(&path)?);
        Ok(Self { bus, hub: Some(path), plugged, is_plugged: true })
    }

    /// The bus on which the motors are now. Without the robot's adapter they are alone on it.
    fn now(&mut self) -> &mut Box<dyn CanBus + Send> {
        let plugged = self.plugged.load(Ordering::Relaxed);
        if let Some(path) = self.hub.as_ref().filter(|_| plugged != self.is_plugged) {
            self.is_plugged = plugged;
            self.bus = Box::new(MemoryBus::new(0));
            if plugged {
                match Hub::bind(path) {
                    Ok(hub) => self.bus = Box::new(hub),
                    Err(error) => eprintln!("the CAN adapter cannot return: {error}"),
                }
            }
        }
        &mut self.bus
    }
}

fn run_motors(
    home: &Home,
    wheels: &Wheels,
    mut bus: MotorBus,
    start_ns: u64,
    running: &AtomicBool,
    worst_late_ns: &AtomicU64,
) {
    keep_on_time();
    let mut clock = MonotonicClock;
    let mut due_ns = start_ns;
    let mut outbox = Outbox::default();
    while running.load(Ordering::Relaxed) {
        let planned_ns = due_ns + STEP_NS;
        due_ns = planned_ns.max(clock.now_ns());
        clock.sleep_until_ns(due_ns);
        worst_late_ns.fetch_max(clock.now_ns().saturating_sub(planned_ns), Ordering::Relaxed);
        let mut wheels = wheels.lock().unwrap_or_else(PoisonError::into_inner);
        rig::step_nodes(&mut *wheels, bus.now(), due_ns, &mut outbox);
        home.advance(due_ns - start_ns, &mut wheels);
    }
}

/// Requests real-time priority for this thread, and that the program's pages stay in memory. Users without the right to it go without.
fn keep_on_time() {
    let _ = rustix::mm::mlockall(rustix::mm::MlockAllFlags::CURRENT);
    if let Ok(priority) = ThreadPriorityValue::try_from(MOTOR_PRIORITY) {
        let fifo = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
        let priority = ThreadPriority::Crossplatform(priority);
        let _ = set_thread_priority_and_policy(thread_native_id(), priority, fifo);
    }
}

fn serve_camera(path: &Path, mut camera: HomeCamera, running: &AtomicBool, on: &AtomicBool) {
    let mut clock = MonotonicClock;
    let size = (camera.model.width as u32, camera.model.height as u32);
    while running.load(Ordering::Relaxed) {
        let device = Device { sizes: vec![size], ..simulated() };
        if on.load(Ordering::Relaxed)
            && let Err(error) = serve(path, device, &VideoFaults::default(), &mut camera, on)
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

/// The configuration of `firmware-host run` for these devices.
fn configuration(
    dir: &Path,
    options: &LiveOptions,
    [picture_node, scan_port]: &[String; 2],
    base: &BaseConfig,
) -> Result<String, Box<dyn Error>> {
    let camera = &options.camera;
    let mut text = format!(
        "# The simulated devices of {}.\n[camera]\nwidth = {}\nheight = {}\n\n[run]\nstatus_file = {:?}\ntask_file = {:?}\nstop_file = {:?}\n\n\
         [devices.camera]\ndevice = {picture_node:?}\nwidth = {}\nheight = {}\nfps = {:?}\n\n\
         [devices.lens]\nfx = {:?}\nfy = {:?}\ncx = {:?}\ncy = {:?}\n\n",
        options.scene,
        camera.width,
        camera.height,
        dir.join("status.json"),
        dir.join("task.json"),
        dir.join("last_stop.json"),
        camera.width,
        camera.height,
        options.fps,
        camera.fx,
        camera.fy,
        camera.cx,
        camera.cy,
    );
    text += &options.lidar.configuration(scan_port);
    if options.imu {
        text += &format!("[devices.imu]\ndevice = {:?}\n\n", socket(dir, "imu"));
    }
    // The tables of the base go below `[devices.base]`.
    let base = toml::Table::try_from(base)?;
    let devices = toml::Table::from_iter([("base".to_owned(), toml::Value::Table(base))]);
    text += &toml::to_string(&toml::Table::from_iter([(
        "devices".to_owned(),
        toml::Value::Table(devices),
    )]))?;
    Ok(text)
}
