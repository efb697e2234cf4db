//! The base driver on the kernel's SocketCAN, against simulated motor controllers at the other end of the bus. Meant for virtual
//! time: only there is a deadline in an emulated machine worth anything.

use std::error::Error;
use std::process::{Child, Command, Stdio};

use clap::ValueEnum;
use drivers::can::{DifferentialBase, Phase, Protocol, SocketBus};
use hal::{Base, Clock, DriveCommand, Twist2};
use monotonic_clock::MonotonicClock;
use monotonic_clock::monotonic_ns;
use rustix::process::{Pid, Signal, kill_process};

use super::check;
use crate::motor::rig::{config, node, step_nodes};
use crate::motor::{Drive, MotorNode, Outbox};

/// Where the two ends of the bus are.
#[derive(Debug, clap::Args)]
pub struct BaseProbe {
    /// The robot's interface.
    #[arg(long, default_value = "can0")]
    robot: String,
    /// The motors' interface.
    #[arg(long, default_value = "can1")]
    motors: String,
    /// What the controllers speak.
    #[arg(long, value_enum, default_values_t = [Spoken::Odrive, Spoken::Vesc, Spoken::Cia402])]
    protocol: Vec<Spoken>,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Spoken {
    Odrive,
    Vesc,
    Cia402,
}

impl Spoken {
    fn protocol(self) -> Protocol {
        match self {
            Self::Odrive => Protocol::Odrive,
            Self::Vesc => Protocol::Vesc,
            Self::Cia402 => Protocol::Cia402,
        }
    }

    fn name(self) -> String {
        format!("{self:?}").to_lowercase()
    }
}

const MS: u64 = 1_000_000;
const PATIENCE_NS: u64 = 20_000 * MS;
/// The watchdog's limit, and a turn of the host's loop.
const LIMIT_MS: f64 = 110.0;

/// Runs all checks.
///
/// # Errors
/// When the scene cannot be set up, or the base never drives.
pub fn run(probe: &BaseProbe) -> Result<(), Box<dyn Error>> {
    for spoken in &probe.protocol {
        a_host_that_gets(Signal::KILL, "killed", probe, *spoken)?;
        a_host_that_gets(Signal::STOP, "stopped", probe, *spoken)?;
    }
    let BaseProbe { robot, motors, .. } = probe;
    a_bus_that_fails(&Failure {
        promise: "an interface that goes down stops the wheels and is said",
        robot,
        motors,
        fail: &format!("ip link set {robot} down"),
        cure: &format!("ip link set {robot} up"),
    })?;
    // A pair that passes error frames on: the emulated controllers know no bus-off.
    shell("ip link add vxcan0 type vxcan peer name vxcan1 && ip link set vxcan0 up && ip link set vxcan1 up")?
        .wait()?;
    a_bus_that_fails(&Failure {
        promise: "a bus-off stops the wheels and is said",
        robot: "vxcan0",
        motors: "vxcan1",
        fail: "cansend vxcan1 20000040#0000000000000000",
        cure: "true",
    })
}

/// Two controllers on an interface.
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

    /// A millisecond passes.
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
            if monotonic_ns() - start_ns > PATIENCE_NS {
                let stages =
                    self.nodes.each_ref().map(|node| (node.is_powered(), *node.watchdog()));
                return Err(format!("waited in vain for {what}; {stages:?}").into());
            }
        }
        Ok((monotonic_ns() - start_ns) as f64 * 1e-6)
    }

    /// The longest that a controller waited since its last command before it let go, by its own clock.
    fn waited_ms(&self) -> f64 {
        let waited = self
            .nodes
            .iter()
            .map(|node| node.watchdog().expired_ns.saturating_sub(node.watchdog().fed_ns));
        waited.max().unwrap_or(0) as f64 * 1e-6
    }
}

/// The real driver in a process of its own, driving.
struct Host(Child);

impl Host {
    fn driving(
        controllers: &mut Controllers,
        probe: &BaseProbe,
        spoken: Spoken,
    ) -> Result<Self, Box<dyn Error>> {
        let arguments = ["base", "--bus", &probe.robot, "--protocol", &spoken.name()];
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

fn a_host_that_gets(
    signal: Signal,
    what: &str,
    probe: &BaseProbe,
    spoken: Spoken,
) -> Result<(), Box<dyn Error>> {
    let mut controllers = Controllers::new(&probe.motors, spoken.protocol());
    let host = Host::driving(&mut controllers, probe, spoken)?;
    host.signal(signal)?;
    let released_ms =
        controllers.until("wheels at zero", |controllers| controllers.are_released())?;
    let waited_ms = controllers.waited_ms();
    let promise = format!(
        "{}: the wheels are released within the watchdog's 100 ms when the host is {what}",
        spoken.name()
    );
    let figure =
        format!("{released_ms:.0} ms after the signal, {waited_ms:.0} ms after the last command");
    check(&promise, figure, released_ms <= LIMIT_MS && waited_ms <= LIMIT_MS);
    if signal == Signal::STOP {
        host.signal(Signal::CONT)?;
        let (mut steps, mut moved) = (0, 0);
        controllers.until("half a second", |controllers| {
            steps += 1;
            moved += u32::from(!controllers.are_released());
            steps == 500
        })?;
        let promise = format!("{}: a host that wakes up stays stopped", spoken.name());
        check(&promise, format!("driven in {moved} of {steps} ms"), moved == 0);
    }
    Ok(())
}

/// A way in which the bus fails, and is well again.
struct Failure<'a> {
    promise: &'a str,
    robot: &'a str,
    motors: &'a str,
    fail: &'a str,
    cure: &'a str,
}

/// The driver is in this process, so that it can be asked.
fn a_bus_that_fails(failure: &Failure<'_>) -> Result<(), Box<dyn Error>> {
    let mut controllers = Controllers::new(failure.motors, Protocol::Cia402);
    let base = DifferentialBase::new(SocketBus::new(failure.robot), &config(Protocol::Cia402))?;
    let mut driver = Driver { base, counter: 0, next_ns: 0 };
    controllers.until("a base that drives", |controllers| {
        driver.turn(true);
        controllers.are_driven()
    })?;
    // Beside, as the wheels go on turning while it is being done.
    let mut failing = shell(failure.fail)?;
    let mut tripped_ns = 0;
    controllers.until("wheels at zero and a trip", |controllers| {
        driver.turn(false);
        if driver.base.phase() != Phase::Armed && tripped_ns == 0 {
            tripped_ns = monotonic_ns();
        }
        tripped_ns > 0 && controllers.are_released()
    })?;
    let after_trip_ms = (monotonic_ns() - tripped_ns) as f64 * 1e-6;
    let figure =
        format!("{after_trip_ms:.0} ms after the driver noticed: {}", driver.base.explain());
    check(failure.promise, figure, after_trip_ms <= LIMIT_MS);
    failing.wait()?;
    shell(failure.cure)?.wait()?;
    let (mut steps, mut moved) = (0, 0);
    controllers.until("a second", |controllers| {
        driver.turn(false);
        steps += 1;
        moved += u32::from(!controllers.are_released());
        steps == 1000
    })?;
    check(
        "nothing moves when the bus is well again until somebody arms",
        format!("driven in {moved} of {steps} ms"),
        moved == 0,
    );
    let ms = controllers.until("a base that drives", |controllers| {
        driver.turn(true);
        controllers.are_driven()
    })?;
    check("armed again it drives", format!("{ms:.0} ms later"), true);
    driver.base.disarm();
    Ok(())
}

fn shell(line: &str) -> std::io::Result<Child> {
    Command::new("sh").args(["-c", line]).spawn()
}

/// The base driver in a loop of 100 Hz.
struct Driver {
    base: DifferentialBase<SocketBus>,
    counter: u32,
    next_ns: u64,
}

impl Driver {
    /// A turn, when it is time for one: feedback, perhaps arming, a command.
    fn turn(&mut self, arm: bool) {
        let now_ns = monotonic_ns();
        if now_ns < self.next_ns {
            return;
        }
        self.next_ns = now_ns + 10 * MS;
        // What the base thinks is asked of it below; here its errors are expected.
        _ = self.base.poll_feedback();
        if arm {
            _ = self.base.arm();
        }
        self.counter += 1;
        let twist = Twist2 { linear_mps: 0.2, angular_radps: 0.0 };
        _ = self.base.drive(&DriveCommand { twist, counter: self.counter, plan_age_ns: 0 });
    }
}
