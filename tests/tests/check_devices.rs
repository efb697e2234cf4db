//! `firmware-host check --devices` as an operator runs it, with simulated devices.
#![allow(clippy::unwrap_used, reason = "a test that cannot set up its fixture has failed")]

use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use drivers::can::{BaseConfig, Protocol};
use drivers::scip::Model;
use hal::Clock;
use hil::hokuyo::{Room, SimulatedHokuyo};
use hil::motor::Outbox;
use hil::motor::rig::{config, node, step_nodes};
use hil::motor::{Hub, MotorNode};
use hil::video::{MovingStripes, VideoFaults, serve, simulated};
use monotonic_clock::MonotonicClock;

const STEP_NS: u64 = 1_000_000;

/// The devices of a robot, and the folder of the file that names them.
struct Robot {
    folder: tempfile::TempDir,
    lidar: Option<SimulatedHokuyo>,
    running: Arc<AtomicBool>,
    camera: Option<JoinHandle<()>>,
    motors: Option<JoinHandle<bool>>,
    protocol: Protocol,
}

impl Robot {
    fn with(
        protocol: Protocol,
        model: Model,
        inject: impl Fn(&mut [Box<dyn MotorNode>; 2]),
    ) -> Self {
        let mut robot = Self::without_devices();
        robot.protocol = protocol;
        robot.lidar = Some(
            SimulatedHokuyo::on_pty(model, &robot.path("lidar"), Box::new(Room::new(model)))
                .unwrap(),
        );
        let path = robot.path("camera");
        let running = Arc::clone(&robot.running);
        robot.camera = Some(std::thread::spawn(move || {
            serve(&path, simulated(), &VideoFaults::default(), &mut MovingStripes, &running)
                .unwrap();
        }));
        let mut hub = Hub::bind(&robot.path("can")).unwrap();
        let running = Arc::clone(&robot.running);
        let mut nodes = [node(protocol, 1), node(protocol, 2)];
        inject(&mut nodes);
        robot.motors = Some(std::thread::spawn(move || run_motors(&mut hub, &mut nodes, &running)));
        robot
    }

    fn without_devices() -> Self {
        let running = Arc::new(AtomicBool::new(true));
        let folder = tempfile::tempdir().unwrap();
        Self {
            folder,
            lidar: None,
            running,
            camera: None,
            motors: None,
            protocol: Protocol::Odrive,
        }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn check(&self) -> (Output, String) {
        let base = BaseConfig {
            bus: format!("unix:{}", self.path("can").display()),
            ..config(self.protocol)
        };
        let base =
            toml::Table::from_iter([("base".to_owned(), toml::Value::try_from(base).unwrap())]);
        let base = toml::Table::from_iter([("devices".to_owned(), toml::Value::Table(base))]);
        let file = self.path("robot.toml");
        let text = format!(
            "[run]\nstatus_file = {:?}\n[devices.camera]\ndevice = \"unix:{}\"\n[devices.lidar]\nport = {:?}\n{}",
            self.path("status.json"),
            self.path("camera").display(),
            self.path("lidar"),
            toml::to_string(&base).unwrap()
        );
        std::fs::write(&file, text).unwrap();
        check(&file)
    }

    /// Stops the motors and returns whether a wheel was powered or rotated at any time.
    fn has_moved(&mut self) -> bool {
        self.running.store(false, Ordering::Relaxed);
        self.motors.take().unwrap().join().unwrap()
    }
}

impl Drop for Robot {
    fn drop(&mut self) {
        self.running.store(false, Ordering::Relaxed);
        _ = self.camera.take().map(JoinHandle::join);
        _ = self.motors.take().map(JoinHandle::join);
    }
}

fn run_motors(hub: &mut Hub, nodes: &mut [Box<dyn MotorNode>; 2], running: &AtomicBool) -> bool {
    let mut clock = MonotonicClock;
    let mut has_moved = false;
    let mut outbox = Outbox::default();
    while running.load(Ordering::Relaxed) {
        let now_ns = clock.now_ns() + STEP_NS;
        clock.sleep_until_ns(now_ns);
        step_nodes(nodes, hub, now_ns, &mut outbox);
        has_moved |=
            nodes.iter().any(|node| node.is_powered() || node.wheel().velocity_radps() != 0.0);
    }
    has_moved
}

fn check(file: &Path) -> (Output, String) {
    let program = assert_cmd::cargo::cargo_bin("firmware-host");
    assert!(program.is_file(), "build it first: cargo build -p firmware-host");
    let output =
        Command::new(program).args(["check", "--devices", "--config"]).arg(file).output().unwrap();
    let text = [&output.stdout, &output.stderr]
        .map(|bytes| String::from_utf8_lossy(bytes).into_owned())
        .concat();
    (output, text)
}

fn check_lists_the_devices_and_moves_nothing(protocol: Protocol) {
    let mut robot = Robot::with(protocol, Model::Utm30lx, |_| {});
    let (output, text) = robot.check();
    assert_eq!(output.status.code(), Some(0), "{text}");
    for part in [
        "YUYV 640x480",
        "frames per second",
        "UTM-30LX, serial",
        "firmware",
        "left (node 1) watchdog 100 ms",
    ] {
        assert!(text.contains(part), "{part} in {text}");
    }
    assert_eq!(text.matches("working").count(), 3, "{text}");
    assert!(!robot.has_moved());
}

#[test]
fn check_prints_a_table_of_working_devices_and_moves_nothing_odrive() {
    check_lists_the_devices_and_moves_nothing(Protocol::Odrive);
}

#[test]
fn check_prints_a_table_of_working_devices_and_moves_nothing_vesc() {
    check_lists_the_devices_and_moves_nothing(Protocol::Vesc);
}

#[test]
fn check_prints_a_table_of_working_devices_and_moves_nothing_cia402() {
    check_lists_the_devices_and_moves_nothing(Protocol::Cia402);
}

#[test]
fn missing_devices_are_reported_with_alternatives_and_a_failing_exit_code() {
    let robot = Robot::without_devices();
    let (output, text) = robot.check();
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert_eq!(text.matches("disconnected").count(), 3, "{text}");
    for part in [
        "! camera: no camera at",
        "! LiDAR: ",
        "is it plugged in?",
        "/dev/serial/by-id",
        "! base: ",
    ] {
        assert!(text.contains(part), "{part} in {text}");
    }
}

#[test]
fn another_scanner_and_a_motor_without_a_watchdog_are_reported_with_advice() {
    let mut robot = Robot::with(Protocol::Odrive, Model::Urg04lx, |nodes| {
        nodes[1].faults().forgets_watchdog = true;
    });
    let (output, text) = robot.check();
    assert_eq!(output.status.code(), Some(1), "{text}");
    for part in [
        "correct `model` or `port`",
        "right (node 2) watchdog not confirmed",
        "the right motor",
        "its watchdog is",
    ] {
        assert!(text.contains(part), "{part} in {text}");
    }
    assert!(!robot.has_moved());
}

#[test]
fn a_missing_can_interface_is_reported_with_the_existing_ones() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("robot.toml");
    let base = "[devices.base]\nbus = \"can97\"\nprotocol = \"vesc\"\n";
    let camera = "[devices.camera]\ndevice = \"/dev/v4l/by-id/none\"\n";
    std::fs::write(
        &file,
        format!("[run]\nstatus_file = {:?}\n{camera}{base}", folder.path().join("s")),
    )
    .unwrap();
    let (output, text) = check(&file);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("there is no interface can97"), "{text}");
    assert!(
        text.contains("! camera: no such device") || text.contains("! camera: available:"),
        "{text}"
    );
}

#[test]
fn devices_of_a_running_robot_are_not_touched() {
    let mut robot = Robot::with(Protocol::Cia402, Model::Utm30lx, |_| {});
    let now =
        std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap().as_secs_f64();
    // The time is a minute from now, so that a slow computer does not consider the file old.
    let status = serde_json::json!({ "written_unix_s": now + 60.0, "pid": 4711 });
    std::fs::write(robot.path("status.json"), status.to_string()).unwrap();
    let (output, text) = robot.check();
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("pid 4711") && text.contains("systemctl stop embodied-depth"), "{text}");
    assert!(!robot.has_moved());
}
