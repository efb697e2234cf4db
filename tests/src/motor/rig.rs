//! A base driver and its two simulated motor controllers on a bus in memory, in virtual time.

use drivers::can::{BaseConfig, CanBus, CanError, DifferentialBase, Phase, Protocol};
use hal::{Base, Clock, DriveCommand, Twist2, VirtualClock, WheelFeedback};

use super::cia402::{COUNTS, Cia402Sim};
use super::memory::MemoryBus;
use super::node::MotorNode;
use super::odrive::{ENABLE_WATCHDOG_ENDPOINT, FIRMWARE, OdriveSim, WATCHDOG_TIMEOUT_ENDPOINT};
use super::outbox::Outbox;
use super::power::Supplied;
use super::vesc::{POLE_PAIRS, VescSim};
use super::wheel::{COAST_S, LAG_S};

/// Period of the control loop.
pub const TICK_NS: u64 = 10_000_000;
/// Period of the simulated motors.
const STEP_NS: u64 = 1_000_000;

/// A configuration for the simulated nodes 1 (left) and 2 (right).
#[must_use]
pub fn config(protocol: Protocol) -> BaseConfig {
    let mut config = BaseConfig { protocol, ..BaseConfig::default() };
    config.odrive.firmware = FIRMWARE;
    config.odrive.enable_watchdog_endpoint = ENABLE_WATCHDOG_ENDPOINT;
    config.odrive.watchdog_timeout_endpoint = WATCHDOG_TIMEOUT_ENDPOINT;
    config.vesc.pole_pairs = POLE_PAIRS;
    config.cia402.velocity_units = COUNTS;
    config.cia402.position_units = COUNTS;
    config
}

/// Time constant with which a wheel loses its speed after the watchdog of its controller has expired, seconds: an ODrive releases the
/// motor, a VESC brakes with `timeout_brake_current`, and a CiA 402 drive follows its quick-stop ramp. With the speed v, the wheel then
/// rolls v times this time.
#[must_use]
pub fn decay_after_watchdog_s(protocol: Protocol) -> f64 {
    match protocol {
        Protocol::Odrive => COAST_S,
        Protocol::Vesc | Protocol::Cia402 => LAG_S,
    }
}

/// Creates a simulated controller with this protocol.
#[must_use]
pub fn node(protocol: Protocol, node: u8) -> Box<dyn MotorNode> {
    match protocol {
        Protocol::Odrive => Box::new(Supplied::new(OdriveSim::new(node))),
        Protocol::Vesc => Box::new(Supplied::new(VescSim::new(node))),
        Protocol::Cia402 => Box::new(Supplied::new(Cia402Sim::new(node))),
    }
}

/// Delivers the received frames to the nodes, advances them to `now_ns` and sends their frames.
pub fn step_nodes(
    nodes: &mut [Box<dyn MotorNode>],
    bus: &mut impl CanBus,
    now_ns: u64,
    outbox: &mut Outbox,
) {
    while let Some(received) = bus.receive(now_ns) {
        if let drivers::can::BusEvent::Frame(frame) = received.event {
            nodes.iter_mut().for_each(|node| node.receive(&frame, now_ns));
        }
    }
    let mut outgoing = Vec::new();
    nodes.iter_mut().for_each(|node| node.step(now_ns, &mut outgoing));
    outbox.send(&outgoing, bus);
}

/// The base driver, its motor controllers and the bus.
pub struct Rig {
    pub base: DifferentialBase<MemoryBus, VirtualClock>,
    /// Node 1, mounted left, and node 2, mounted right.
    pub nodes: [Box<dyn MotorNode>; 2],
    /// The host's connection, for injecting faults.
    pub host: MemoryBus,
    /// The motors' connection, for injecting faults.
    pub motors: MemoryBus,
    pub now_ns: u64,
    /// Counter of the next command.
    pub counter: u32,
    /// The newest feedback, or the error instead of it.
    pub feedback: Result<Option<WheelFeedback>, CanError>,
    outbox: Outbox,
}

impl Rig {
    /// Creates a base with this configuration.
    ///
    /// # Errors
    /// Returns an error when the configuration is refused.
    pub fn new(config: &BaseConfig) -> Result<Self, CanError> {
        let host = MemoryBus::new(1);
        let motors = host.connect();
        // The start time is not zero because 0 means never.
        let now_ns = 1_000_000_000;
        host.set_now(now_ns);
        let base = DifferentialBase::with_clock(
            host.clone(),
            config,
            VirtualClock::starting_at_ns(now_ns),
        )?;
        let nodes = [node(config.protocol, 1), node(config.protocol, 2)];
        Ok(Self {
            base,
            nodes,
            host,
            motors,
            now_ns,
            counter: 0,
            feedback: Ok(None),
            outbox: Outbox::default(),
        })
    }

    /// Advances the motors and the base's clock without running the control loop.
    pub fn advance(&mut self, nanoseconds: u64) {
        let end_ns = self.now_ns + nanoseconds;
        while self.now_ns < end_ns {
            self.now_ns += STEP_NS;
            self.host.set_now(self.now_ns);
            self.base.clock_mut().sleep_until_ns(self.now_ns);
            step_nodes(&mut self.nodes, &mut self.motors, self.now_ns, &mut self.outbox);
        }
    }

    /// Runs one tick of a control loop that only reads feedback.
    pub fn poll(&mut self) {
        self.advance(TICK_NS);
        self.feedback = self.base.poll_feedback();
    }

    /// Runs one tick of a control loop that drives, as the safety thread does.
    ///
    /// # Errors
    /// Returns an error when the base refuses the command.
    pub fn drive(&mut self, linear_mps: f64, angular_radps: f64) -> Result<(), CanError> {
        self.poll();
        self.counter += 1;
        let twist = Twist2 { linear_mps, angular_radps };
        self.base.drive(&DriveCommand { twist, counter: self.counter, plan_age_ns: 0 })
    }

    /// Polls until the motors are set up. Returns false when that takes more than `ticks`.
    #[must_use]
    pub fn is_ready_after(&mut self, ticks: usize) -> bool {
        use drivers::can::protocol::MotorStage::Ready;
        (0..ticks).any(|_| {
            self.poll();
            self.base.motors().iter().all(|motor| motor.stage == Ready)
        })
    }

    /// Sets up and arms the base, and waits until it is armed.
    ///
    /// # Errors
    /// Returns the reason when the base cannot be armed.
    pub fn arm(&mut self) -> Result<(), CanError> {
        let _ = self.is_ready_after(200);
        self.base.arm()?;
        for _ in 0..300 {
            self.poll();
            match self.base.phase() {
                Phase::Armed => return Ok(()),
                Phase::Tripped(trip) => return Err(CanError::Tripped(trip)),
                _ => {}
            }
        }
        Err(CanError::NotArmed)
    }

    /// True velocities of the wheels of node 1 and 2, rad/s.
    #[must_use]
    pub fn wheels_radps(&self) -> [f64; 2] {
        self.nodes.each_ref().map(|node| node.wheel().velocity_radps())
    }
}
