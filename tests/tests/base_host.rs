//! The wheels stop when the host process is killed or stopped, after the distance that their controllers' reaction permits. A child
//! process runs the real driver over the Unix bus; simulated controllers in this process measure by their own clock.
#![allow(missing_docs, clippy::expect_used, clippy::panic)]

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use drivers::can::Protocol;
use hal::Clock;
use hil::motor::rig::{decay_after_watchdog_s, node, step_nodes};
use hil::motor::wheel::STANDING_RADPS;
use hil::motor::{Drive, Hub, MotorNode, Outbox};
use monotonic_clock::MonotonicClock;
use rustix::process::{Pid, Signal, kill_process};

const STEP_NS: u64 = 1_000_000;
const MS: u64 = 1_000_000;
/// Period of the host's control loop, with one frame each.
const FRAME_NS: u64 = 10 * MS;
/// The watchdog time that the driver requires of a controller, by default.
const WATCHDOG_NS: u64 = 100 * MS;
/// Speed of the wheels at the default of `hil base`, 0.2 m/s, and the radius of the wheels.
const SPEED_RADPS: f64 = 4.0;
const RADIUS_M: f64 = 0.05;

/// Two controllers with their own clock: one step takes a millisecond of it, and longer in real
/// time when the computer is busy.
struct Controllers {
    hub: Hub,
    nodes: [Box<dyn MotorNode>; 2],
    /// Positions of the wheels at their last commands.
    commanded_rad: [f64; 2],
    now_ns: u64,
    outbox: Outbox,
    clock: MonotonicClock,
    real_ns: u64,
    path: PathBuf,
    protocol: Protocol,
}

impl Controllers {
    fn new(folder: &Path, protocol: Protocol) -> Self {
        let path = folder.join("can");
        let clock = MonotonicClock;
        let hub = Hub::bind(&path).expect("a hub");
        let nodes = [node(protocol, 1), node(protocol, 2)];
        Self {
            hub,
            nodes,
            commanded_rad: [0.0; 2],
            outbox: Outbox::default(),
            now_ns: 0,
            real_ns: clock.now_ns(),
            clock,
            path,
            protocol,
        }
    }

    fn step(&mut self) {
        self.real_ns = self.clock.now_ns().max(self.real_ns + STEP_NS);
        self.clock.sleep_until_ns(self.real_ns);
        self.now_ns += STEP_NS;
        step_nodes(&mut self.nodes, &mut self.hub, self.now_ns, &mut self.outbox);
        for (node, commanded_rad) in self.nodes.iter().zip(&mut self.commanded_rad) {
            if node.watchdog().fed_ns == self.now_ns {
                *commanded_rad = node.wheel().position_rad();
            }
        }
    }

    /// Both wheels have reached the speed that is commanded at the end.
    fn are_driven(&self) -> bool {
        self.nodes.iter().all(|node| {
            let is_driven = matches!(node.wheel().drive(), Drive::Velocity(_));
            is_driven && node.wheel().velocity_radps() > 0.95 * SPEED_RADPS
        })
    }

    /// Steps until both wheels stand. Returns how far each has rolled since its last command, metres.
    fn rolled_m(&mut self) -> [f64; 2] {
        let begin_ns = self.now_ns;
        while self.nodes.iter().any(|node| node.wheel().velocity_radps().abs() > STANDING_RADPS) {
            self.step();
            assert!(self.now_ns - begin_ns < 10_000 * MS, "the wheels still roll after 10 s");
        }
        let mut rolled_m = [0.0; 2];
        for ((node, commanded_rad), rolled_m) in
            self.nodes.iter().zip(&self.commanded_rad).zip(&mut rolled_m)
        {
            *rolled_m = (node.wheel().position_rad() - commanded_rad) * RADIUS_M;
        }
        rolled_m
    }

    fn are_released(&self) -> bool {
        self.nodes
            .iter()
            .all(|node| !matches!(node.wheel().drive(), Drive::Velocity(speed) if speed != 0.0))
    }

    /// Starts a host that drives. When the computer is so busy that a loop of 10 ms is delayed by
    /// 100 ms, the base stops itself before the test begins; then another host is started.
    fn host(&mut self) -> Child {
        let protocol = format!("{:?}", self.protocol).to_lowercase();
        for _ in 0..10 {
            let mut child = Command::new(env!("CARGO_BIN_EXE_hil"))
                .args([
                    "base",
                    "--bus",
                    &format!("unix:{}", self.path.display()),
                    "--protocol",
                    &protocol,
                ])
                .stdout(Stdio::null())
                .spawn()
                .expect("a host");
            if (0..6000).any(|_| {
                self.step();
                self.are_driven()
            }) {
                return child;
            }
            child.kill().expect("it ends");
            child.wait().expect("it ended");
        }
        panic!("no host reached the driving state");
    }

    /// Steps until both wheels are released. Returns for each the time after its last command, by
    /// its own clock.
    fn waited_ns(&mut self) -> [u64; 2] {
        let begin_ns = self.now_ns;
        while !self.are_released() {
            self.step();
            assert!(self.now_ns - begin_ns < 5_000 * MS, "the wheels are still driven after 5 s");
        }
        self.nodes.each_ref().map(|node| node.watchdog().expired_ns - node.watchdog().fed_ns)
    }
}

fn process(child: &Child) -> Pid {
    Pid::from_child(child)
}

/// The bounds of the distance after the last command, metres: the speed times the watchdog's time, at most one frame more, and then
/// the speed times the time constant of braking or coasting. The lower bound shows that the simulated wheels do coast. Five percent
/// are left for wheels that have not quite reached their speed or do not quite stand.
fn roll_out_m(protocol: Protocol) -> [f64; 2] {
    let speed_mps = SPEED_RADPS * RADIUS_M;
    let decay_m = speed_mps * decay_after_watchdog_s(protocol);
    let watchdog_m = speed_mps * WATCHDOG_NS as f64 * 1e-9;
    let frame_m = speed_mps * FRAME_NS as f64 * 1e-9;
    [0.9 * decay_m, 1.05 * (watchdog_m + frame_m + decay_m)]
}

fn check_host_signal(signal: Signal, protocol: Protocol) {
    let folder = tempfile::tempdir().expect("a folder");
    let mut controllers = Controllers::new(folder.path(), protocol);
    let mut child = controllers.host();
    kill_process(process(&child), signal).expect("the signal");
    let waited_ns = controllers.waited_ns();
    for waited_ns in waited_ns {
        assert!(waited_ns <= WATCHDOG_NS + FRAME_NS, "{protocol:?}: released after {waited_ns} ns");
    }
    let rolled_m = controllers.rolled_m();
    println!("{protocol:?}: {rolled_m:?} m after the last command");
    for rolled_m in rolled_m {
        let [least_m, most_m] = roll_out_m(protocol);
        assert!((least_m..most_m).contains(&rolled_m), "{protocol:?}: {rolled_m} m, not {most_m}");
    }
    if signal == Signal::STOP {
        // It resumes, detects that it is late, and stays stopped.
        kill_process(process(&child), Signal::CONT).expect("the signal");
        for _ in 0..500 {
            controllers.step();
            assert!(controllers.are_released(), "{protocol:?}: moved after it resumed");
        }
    }
    child.kill().expect("it ends");
    child.wait().expect("it ended");
}

#[test]
fn the_wheels_stop_within_the_watchdog_when_the_host_is_killed_odrive() {
    check_host_signal(Signal::KILL, Protocol::Odrive);
}

#[test]
fn the_wheels_stop_within_the_watchdog_when_the_host_is_killed_vesc() {
    check_host_signal(Signal::KILL, Protocol::Vesc);
}

#[test]
fn the_wheels_stop_within_the_watchdog_when_the_host_is_killed_cia402() {
    check_host_signal(Signal::KILL, Protocol::Cia402);
}

#[test]
fn the_wheels_stop_within_the_watchdog_when_the_host_is_stopped_and_stay_stopped_when_it_resumes_odrive()
 {
    check_host_signal(Signal::STOP, Protocol::Odrive);
}

#[test]
fn the_wheels_stop_within_the_watchdog_when_the_host_is_stopped_and_stay_stopped_when_it_resumes_vesc()
 {
    check_host_signal(Signal::STOP, Protocol::Vesc);
}

#[test]
fn the_wheels_stop_within_the_watchdog_when_the_host_is_stopped_and_stay_stopped_when_it_resumes_cia402()
 {
    check_host_signal(Signal::STOP, Protocol::Cia402);
}
