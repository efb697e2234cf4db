//! The real safety loop and the real base driver on simulated controllers, in a square room and in
//! virtual time. Tests measure what happens between an event on the bus and the next motion of a
//! wheel.

use std::cell::{Cell, RefCell};
use std::convert::Infallible;
use std::rc::Rc;

use drivers::can::messages::SafetyInput;
use drivers::can::{BaseConfig, CanBus, CanError, DifferentialBase, Kinematics};
use hal::{Clock, ErrorType, LaserScan, Lidar, Pose2, Range, ScanGeometry, Twist2};
use runtime::safety::{Orders, Plan, Request, SafetyConfig, SafetyLoop, SafetyState};

use super::memory::MemoryBus;
use super::node::MotorNode;
use super::outbox::Outbox;
use super::rig::{TICK_NS, node, step_nodes};

/// Period of the simulated motors.
const STEP_NS: u64 = 1_000_000;
/// Interval of the safety board's frames.
const BOARD_NS: u64 = 20_000_000;
/// Half the width of the square room.
const HALF_M: f64 = 6.0;
/// A wheel that rotates faster than this moves, m/s at the rim.
const MOVING_MPS: f64 = 0.02;

/// The time that all parts share.
#[derive(Debug, Clone, Default)]
pub struct SharedClock(Rc<Cell<u64>>);

impl Clock for SharedClock {
    fn now_ns(&self) -> u64 {
        self.0.get()
    }

    fn sleep_until_ns(&mut self, deadline_ns: u64) {
        self.0.set(self.0.get().max(deadline_ns));
    }
}

/// A scanner in the room, at the robot's true pose.
#[derive(Debug, Clone)]
struct RoomScanner {
    clock: SharedClock,
    pose: Rc<Cell<Pose2>>,
    /// The scanner is unplugged.
    is_silent: Rc<Cell<bool>>,
    geometry: ScanGeometry,
    next_ns: u64,
}

impl ErrorType for RoomScanner {
    type Error = Infallible;
}

impl Lidar for RoomScanner {
    fn geometry(&self) -> ScanGeometry {
        self.geometry
    }

    fn poll_scan(&mut self, scan: &mut LaserScan) -> Result<bool, Infallible> {
        let now_ns = self.clock.now_ns();
        if now_ns < self.next_ns || self.is_silent.get() {
            return Ok(false);
        }
        self.next_ns = now_ns + self.geometry.period_ns;
        scan.time_ns = now_ns.saturating_sub(self.geometry.period_ns);
        scan.geometry = self.geometry;
        let pose = self.pose.get();
        scan.ranges.clear();
        scan.ranges.extend((0..self.geometry.beams).map(|beam| {
            let (sin, cos) = (self.geometry.angle_rad(beam) + pose.yaw_rad).sin_cos();
            let along_x = (HALF_M - pose.x_m * cos.signum()) / cos.abs().max(1e-9);
            let along_y = (HALF_M - pose.y_m * sin.signum()) / sin.abs().max(1e-9);
            Range::Hit(along_x.min(along_y) as f32)
        }));
        Ok(true)
    }
}

type Base = DifferentialBase<MemoryBus, SharedClock>;

/// Safety loop, base driver, two controllers, a scanner and a safety board.
pub struct Composition {
    control: SafetyLoop<Base, RoomScanner>,
    /// Node 1, mounted left, and node 2, mounted right.
    pub nodes: [Box<dyn MotorNode>; 2],
    /// The host's connection to the bus, for injecting faults.
    pub host: MemoryBus,
    motors: MemoryBus,
    board: MemoryBus,
    config: BaseConfig,
    geometry: ScanGeometry,
    low_battery_v: f64,
    /// The safety board is unplugged.
    pub board_is_silent: bool,
    /// The emergency stop of the safety board is pressed.
    pub pressed: bool,
    board_counter: u8,
    clock: SharedClock,
    pose: Rc<Cell<Pose2>>,
    scanner_is_silent: Rc<Cell<bool>>,
    kinematics: Kinematics,
    wheel_radius_m: f64,
    outbox: Outbox,
    /// The velocity that the planner asks for.
    pub plan: Twist2,
    events: RefCell<Vec<runtime::event::SafetyEvent>>,
}

impl Composition {
    /// A robot with this base that is not armed yet.
    ///
    /// # Errors
    /// When the configuration of the base is refused.
    pub fn new(config: &BaseConfig, geometry: ScanGeometry) -> Result<Self, CanError> {
        let clock = SharedClock(Rc::new(Cell::new(1_000_000_000)));
        let host = MemoryBus::new(1);
        host.set_now(clock.now_ns());
        let pose = Rc::new(Cell::new(Pose2::IDENTITY));
        let scanner_is_silent = Rc::new(Cell::new(false));
        let scanner = RoomScanner {
            clock: clock.clone(),
            pose: Rc::clone(&pose),
            is_silent: Rc::clone(&scanner_is_silent),
            geometry,
            next_ns: 0,
        };
        Ok(Self {
            control: program(&host, config, scanner, 0.0)?,
            nodes: [node(config.protocol, 1), node(config.protocol, 2)],
            motors: host.connect(),
            board: host.connect(),
            host,
            config: config.clone(),
            geometry,
            low_battery_v: 0.0,
            board_is_silent: false,
            pressed: false,
            board_counter: 0,
            clock,
            pose,
            scanner_is_silent,
            kinematics: Kinematics { track_m: config.track_m },
            wheel_radius_m: config.wheel_radius_m,
            outbox: Outbox::default(),
            plan: Twist2 { linear_mps: 0.2, angular_radps: 0.0 },
            events: RefCell::default(),
        })
    }

    /// Ends the program without a shutdown and starts it again. No request to arm has been given to
    /// the new one.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn restart_program(&mut self) -> Result<(), CanError> {
        let scanner = RoomScanner {
            clock: self.clock.clone(),
            pose: Rc::clone(&self.pose),
            is_silent: Rc::clone(&self.scanner_is_silent),
            geometry: self.geometry,
            next_ns: 0,
        };
        self.control = program(&self.host, &self.config, scanner, self.low_battery_v)?;
        Ok(())
    }

    /// The program is started again with a limit of the battery's voltage.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn limit_voltage(&mut self, low_battery_v: f64) -> Result<(), CanError> {
        self.low_battery_v = low_battery_v;
        self.restart_program()
    }

    /// Whether a request to arm is in force.
    #[must_use]
    pub fn has_authority(&self) -> bool {
        self.control.has_authority()
    }

    /// Advances the world without the safety loop: the program is stopped.
    pub fn pause(&mut self, nanoseconds: u64) {
        let end_ns = self.clock.now_ns() + nanoseconds;
        while self.clock.now_ns() < end_ns {
            let now_ns = self.clock.now_ns() + STEP_NS;
            self.clock.sleep_until_ns(now_ns);
            self.host.set_now(now_ns);
            if self.config.safety_board && !self.board_is_silent && now_ns.is_multiple_of(BOARD_NS)
            {
                self.send_board(self.pressed);
            }
            step_nodes(&mut self.nodes, &mut self.motors, now_ns, &mut self.outbox);
            let rims = self
                .nodes
                .each_ref()
                .map(|node| node.wheel().velocity_radps() * self.wheel_radius_m);
            let motion = self.kinematics.twist(rims).integrate(STEP_NS as f64 * 1e-9);
            self.pose.set(self.pose.get().compose(&motion));
        }
    }

    /// The realtime clock is set forward while frames wait to be read, in the middle of a tick.
    pub fn set_realtime_forward(&mut self, nanoseconds: u64) {
        self.pause(TICK_NS / 2);
        self.host.set_realtime_forward(nanoseconds);
    }

    /// Sends one frame of the safety board.
    pub fn send_board(&mut self, estop: bool) {
        self.board_counter = (self.board_counter + 1) % 16;
        let input = SafetyInput { counter: self.board_counter, estop, ..SafetyInput::default() };
        let _ = self.board.send(&input.encode());
    }

    /// One step of the safety loop, with an operator's request.
    pub fn step(&mut self, request: Option<Request>) {
        self.pause(TICK_NS);
        let now_ns = self.clock.now_ns();
        let plan = Some(Plan { twist: self.plan, time_ns: now_ns });
        let step = self.control.step(now_ns, &Orders { plan, request, ..Orders::default() });
        self.events.borrow_mut().extend(step.output.event);
    }

    /// Runs `count` steps without requests.
    pub fn steps(&mut self, count: usize) {
        (0..count).for_each(|_| self.step(None));
    }

    /// Arms the robot, as a person does after inspecting it.
    pub fn person_arms(&mut self) {
        self.step(Some(Request::ClearFault));
        self.steps(3);
        self.step(Some(Request::Arm));
    }

    /// Unplugs the scanner, or plugs it in.
    pub fn silence_scanner(&mut self, is_silent: bool) {
        self.scanner_is_silent.set(is_silent);
    }

    /// Whether a wheel moves or is about to: a controller follows a velocity other than zero.
    #[must_use]
    pub fn is_driven(&self) -> bool {
        self.nodes.iter().any(|node| {
            let drive = node.wheel().drive();
            node.is_powered()
                && matches!(drive, super::Drive::Velocity(radps) if radps.abs() * self.wheel_radius_m > MOVING_MPS)
        })
    }

    /// Distance driven in this number of steps, metres.
    pub fn drives_m(&mut self, steps: usize) -> f64 {
        let before = self.pose.get();
        self.steps(steps);
        self.pose.get().distance_m(&before)
    }

    /// The robot's true pose.
    #[must_use]
    pub fn pose(&self) -> Pose2 {
        self.pose.get()
    }

    /// The state of the safety plane.
    #[must_use]
    pub fn state(&self) -> SafetyState {
        self.control.plane().state()
    }

    /// The base, to read its state.
    #[must_use]
    pub fn base(&self) -> &Base {
        self.control.base()
    }

    /// Returns the events since the last call.
    #[must_use]
    pub fn take_events(&self) -> Vec<runtime::event::SafetyEvent> {
        self.events.take()
    }

    /// The time, monotonic nanoseconds.
    #[must_use]
    pub fn now_ns(&self) -> u64 {
        self.clock.now_ns()
    }

    /// Ends the program: releases the motors and closes the devices. Returns the controllers.
    pub fn end(mut self) -> [Box<dyn MotorNode>; 2] {
        self.step(Some(Request::Disarm));
        self.steps(70);
        let _ = self.control.shut_down();
        let mut world = World { nodes: self.nodes, motors: self.motors, outbox: self.outbox };
        for _ in 0..500 {
            let now_ns = self.clock.now_ns() + STEP_NS;
            self.clock.sleep_until_ns(now_ns);
            self.host.set_now(now_ns);
            step_nodes(&mut world.nodes, &mut world.motors, now_ns, &mut world.outbox);
        }
        world.nodes
    }
}

/// The safety loop of a program that has just started.
fn program(
    host: &MemoryBus,
    config: &BaseConfig,
    scanner: RoomScanner,
    low_battery_v: f64,
) -> Result<SafetyLoop<Base, RoomScanner>, CanError> {
    let safety = SafetyConfig {
        period_s: TICK_NS as f64 * 1e-9,
        reaction_s: 0.05,
        brake_mps2: 1.0,
        good_scans: 3,
        feedback_timeout_s: 0.1,
        plan_timeout_s: 0.5,
        low_battery_v,
        scan_timeout_s: 2e-9 * scanner.geometry.period_ns as f64,
        ..SafetyConfig::default()
    };
    let base = DifferentialBase::with_clock(host.clone(), config, scanner.clock.clone())?;
    Ok(SafetyLoop::new(safety, base, scanner))
}

/// The parts that are left without the program: the controllers and their connection to the bus.
struct World {
    nodes: [Box<dyn MotorNode>; 2],
    motors: MemoryBus,
    outbox: Outbox,
}
