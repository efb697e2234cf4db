//! Checks the base driver on the kernel's SocketCAN, with simulated motor controllers at the other
//! end of the bus. Meant for virtual time, because deadlines in an emulated machine are meaningful
//! only there.

use std::error::Error;
use std::process::{Child, Command, Stdio};

use drivers::can::{DifferentialBase, Phase, Protocol, SocketBus};
use hal::{Base, Clock, DriveCommand, Twist2};
use monotonic_clock::MonotonicClock;
use monotonic_clock::monotonic_ns;
use rustix::process::{Pid, Signal, kill_process};

use super::check;
use crate::motor::rig::{config, node, step_nodes};
use crate::motor::{Drive, MotorNode, Outbox, ProtocolArg};

/// CAN interfaces of the robot and of the motors.
#[derive(Debug, clap::Args)]
pub struct BaseProbe {
    /// CAN interface of the robot.
    #[arg(long, default_value = "can0")]
    robot: String,
    /// CAN interface of the simulated motor controllers.
    #[arg(long, default_value = "can1")]
    motors: String,
    /// Protocols of the controllers.
    #[arg(long, value_enum, default_values_t = [ProtocolArg::Odrive, ProtocolArg::Vesc, ProtocolArg::Cia402])]
    protocol: Vec<ProtocolArg>,
}

const MS: u64 = 1_000_000;
const TIMEOUT_NS: u64 = 20_000 * MS;
/// The watchdog's limit plus one tick of the host's loop.
const LIMIT_MS: f64 = 110.0;

/// Runs all checks.
///
/// # Errors
/// Returns an error when the probe cannot be set up or the base never drives.
pub fn run(probe: &BaseProbe) -> Result<(), Box<dyn Error>> {
    for protocol in &probe.protocol {
        check_host_signal(Signal::KILL, "killed", probe, *protocol)?;
        check_host_signal(Signal::STOP, "stopped", probe, *protocol)?;
    }
    let BaseProbe { robot, motors, .. } = probe;
    check_bus_failure(&BusFailure {
        claim: "an interface that goes down stops the wheels and is reported",
        robot,
        motors,
        fail: &format!("ip link set {robot} down"),
        cure: &format!("ip link set {robot} up"),
    })?;
    // A vxcan pair forwards error frames; the emulated controllers have no bus-off.
    shell("ip link add vxcan0 type vxcan peer name vxcan1 && ip link set vxcan0 up && ip link set vxcan1 up")?
        .wait()?;
    check_bus_failure(&BusFailure {
        claim: "a bus-off stops the wheels and is reported",
        robot: "vxcan0",
        motors: "vxcan1",
        fail: "cansend vxcan1 20000040#0000000000000000",
        cure: "true",
    })
}

/// Two simulated controllers on a CAN interface.
struct Controllers {
    bus: SocketBus,
    nodes: [Box<dyn MotorNode>; 2],
    outbox: Outbox,
}

impl Controllers {
    fn new(interface: &str, protocol: Protocol) -> Self {
        let mut nodes = [node(protocol, 1), node(protocol, 2)];
        nodes.iter_mut().for_each(|node| node.wheel_mut().lag_s = 0.002);
        Self { bus: SocketBus::new(interface), nodes, outbox: Outbox::default() }
    }

    /// Advances the controllers by one millisecond.
    fn step(&mut self) {
        let now_ns = monotonic_ns() + MS;
        MonotonicClock.sleep_until_ns(now_ns);
        step_nodes(&mut self.nodes, &mut self.bus, now_ns, &mut self.outbox);
    }

    fn are_driven(&self) -> bool {
        self.nodes
            .iter()
            .all(|node| matches!(node.wheel().drive(), Drive::Velocity(speed) if speed > 1.0))
    }

    fn are_released(&self) -> bool {
        self.nodes
            .iter()
            .all(|node| !matches!(node.wheel().drive(), Drive::Velocity(speed) if speed != 0.0))
    }

    fn until(
        &mut self,
        what: &str,
        mut done: impl FnMut(&mut Self) -> bool,
    ) -> Result<f64, Box<dyn Error>> {
        let start_ns = monotonic_ns();
        while !done(self) {
            self.step();
            if monotonic_ns() - start_ns > TIMEOUT_NS {
                let stages =
                    self.nodes.each_ref().map(|node| (node.is_powered(), *node.watchdog()));
                return Err(format!("timed out waiting for {what}; {stages:?}").into());
            }
        }
        Ok((monotonic_ns() - start_ns) as f64 * 1e-6)
    }

    /// Longest time between a controller's last command and its release of the wheel, by its own
    /// clock.
    fn waited_ms(&self) -> f64 {
        let waited = self
            .nodes
            .iter()
            .map(|node| node.watchdog().expired_ns.saturating_sub(node.watchdog().fed_ns));
        waited.max().unwrap_or(0) as f64 * 1e-6
    }
}

/// The real driver, driving, in a separate process.
struct Host(Child);

impl Host {
    fn driving(
        controllers: &mut Controllers,
        probe: &BaseProbe,
        protocol: ProtocolArg,
    ) -> Result<Self, Box<dyn Error>> {
        let arguments = ["base", "--bus", &probe.robot, "--protocol", &protocol.name()];
        let host = Self(
            Command::new(std::env::current_exe()?).args(arguments).stdout(Stdio::null()).spawn()?,
        );
        controllers.until("a base that drives", |controllers| controllers.are_driven())?;
        Ok(host)
    }

    fn signal(&self, signal: Signal) -> Result<(), Box<dyn Error>> {
        Ok(kill_process(Pid::from_child(&self.0), signal)?)
    }
}

impl Drop for Host {
    fn drop(&mut self) {
        _ = self.0.kill();
        _ = self.0.wait();
    }
}

fn check_host_signal(
    signal: Signal,
    what: &str,
    probe: &BaseProbe,
    protocol: ProtocolArg,
) -> Result<(), Box<dyn Error>> {
    let mut controllers = Controllers::new(&probe.motors, protocol.into());
    let host = Host::driving(&mut controllers, probe, protocol)?;
    host.signal(signal)?;
    let released_ms =
        controllers.until("wheels at zero", |controllers| controllers.are_released())?;
    let waited_ms = controllers.waited_ms();
    let claim = format!(
        "{}: the wheels are released within the watchdog's 100 ms when the host is {what}",
        protocol.name()
    );
    let figure =
        format!("{released_ms:.0} ms after the signal, {waited_ms:.0} ms after the last command");
    check(&claim, figure, released_ms <= LIMIT_MS && waited_ms <= LIMIT_MS);
    if signal == Signal::STOP {
        host.signal(Signal::CONT)?;
        let mut steps = 0;
        let mut moved = 0;
        controllers.until("half a second", |controllers| {
            steps += 1;
            moved += u32::from(!controllers.are_released());
            steps == 500
        })?;
        let claim = format!("{}: a host that resumes stays stopped", protocol.name());
        check(&claim, format!("driven in {moved} of {steps} ms"), moved == 0);
    }
    Ok(())
}

/// A failure of the bus, with the commands that cause and end it.
struct BusFailure<'a> {
    claim: &'a str,
    robot: &'a str,
    motors: &'a str,
    fail: &'a str,
    cure: &'a str,
}

/// Runs the driver in this process, where its state can be read.
fn check_bus_failure(failure: &BusFailure<'_>) -> Result<(), Box<dyn Error>> {
    let mut controllers = Controllers::new(failure.motors, Protocol::Cia402);
    let base = DifferentialBase::new(SocketBus::new(failure.robot), &config(Protocol::Cia402))?;
    let mut driver = Driver { base, counter: 0, next_ns: 0 };
    controllers.until("a base that drives", |controllers| {
        driver.tick(true);
        controllers.are_driven()
    })?;
    // Runs concurrently, because the wheels keep rotating while the command runs.
    let mut failing = shell(failure.fail)?;
    let mut tripped_ns = 0;
    controllers.until("wheels at zero and a trip", |controllers| {
        driver.tick(false);
        if driver.base.phase() != Phase::Armed && tripped_ns == 0 {
            tripped_ns = monotonic_ns();
        }
        tripped_ns > 0 && controllers.are_released()
    })?;
    let after_trip_ms = (monotonic_ns() - tripped_ns) as f64 * 1e-6;
    let figure =
        format!("{after_trip_ms:.0} ms after the driver noticed: {}", driver.base.explain());
    check(failure.claim, figure, after_trip_ms <= LIMIT_MS);
    failing.wait()?;
    shell(failure.cure)?.wait()?;
    let mut steps = 0;
    let mut moved = 0;
    controllers.until("a second", |controllers| {
        driver.tick(false);
        steps += 1;
        moved += u32::from(!controllers.are_released());
        steps == 1000
    })?;
    check(
        "nothing moves after the bus recovers until the base is armed",
        format!("driven in {moved} of {steps} ms"),
        moved == 0,
    );
    let ms = controllers.until("a base that drives", |controllers| {
        driver.tick(true);
        controllers.are_driven()
    })?;
    check("after arming again, the base drives", format!("{ms:.0} ms later"), true);
    driver.base.disarm();
    Ok(())
}

fn shell(line: &str) -> std::io::Result<Child> {
    Command::new("sh").args(["-c", line]).spawn()
}

/// The base driver in a control loop of 100 Hz.
struct Driver {
    base: DifferentialBase<SocketBus>,
    counter: u32,
    next_ns: u64,
}

impl Driver {
    /// Runs a tick if it is due: reads feedback, arms if requested, sends a command.
    fn tick(&mut self, arm: bool) {
        let now_ns = monotonic_ns();
        if now_ns < self.next_ns {
            return;
        }
        self.next_ns = now_ns + 10 * MS;
        // The caller reads the phase of the base; errors are expected here.
        _ = self.base.poll_feedback();
        if arm {
            _ = self.base.arm();
        }
        self.counter += 1;
        let twist = Twist2 { linear_mps: 0.2, angular_radps: 0.0 };
        _ = self.base.drive(&DriveCommand { twist, counter: self.counter, plan_age_ns: 0 });
    }
}
