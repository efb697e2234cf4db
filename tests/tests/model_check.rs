//! A model check of restart authority over the real composition: safety loop, base driver and
//! simulated controllers. Every order of eight events is explored, and after each step of each of
//! them this holds:
//!
//! * A wheel is driven only if a person asked for it after the last event that needs a person.
//! * After such an event the robot moves no further than its wheels roll: far if a controller has
//!   released them, a few centimetres if none has.
//! * A realtime clock that is set stops nothing.
//!
//! The composition cannot be copied, so a state is reached again by repeating its events. Sequences
//! that end in the same abstract state (state machine, base, controllers, injected faults, authority)
//! are continued together. Timers are not part of it: every event is followed by 0.3 s, which is
//! longer than all of them but those of arming.
#![allow(missing_docs, clippy::expect_used, clippy::panic)]

use std::collections::HashSet;

use drivers::can::{BaseConfig, Protocol};
use hal::{Pose2, ScanGeometry};
use hil::motor::rig::config;
use hil::motor::wheel::{COAST_S, LAG_S, STANDING_RADPS};
use hil::motor::{Composition, Drive};
use runtime::event::FaultReason;
use runtime::safety::SafetyState;

const DEPTH: usize = 8;
const MS: u64 = 1_000_000;
/// After an event that needs a person, the wheels must not be driven for longer than this: 100 ms of
/// silence, and two control ticks.
const REACTION_NS: u64 = 130 * MS;
/// Steps after each event.
const STEPS: usize = 30;
const BOOT_NS: u64 = 200 * MS;
/// The speed that the planner asks for, m/s.
const PLAN_MPS: f64 = 0.2;
/// A wheel that is driven until the reaction, and loses its speed with this time constant then,
/// rolls as far, metres: 12.6 cm if it is released, and 3.2 cm if it is braked.
fn roll_out_m(decay_s: f64) -> f64 {
    PLAN_MPS * (1e-9 * REACTION_NS as f64 + decay_s)
}
/// By how much the realtime clock is set forward, as by a time server that is reached late.
const FORWARD_NS: u64 = 500 * MS;

/// A coarse scanner, because thousands of sequences are repeated.
const GEOMETRY: ScanGeometry = ScanGeometry {
    angle_min_rad: -2.0,
    angle_increment_rad: 0.25,
    beams: 17,
    range_min_m: 0.1,
    range_max_m: 30.0,
    period_ns: 25 * MS,
    clockwise: false,
};

#[derive(Debug, Clone, Copy, PartialEq)]
enum Event {
    /// The motors lose their power, or get it back and start.
    Power,
    /// The emergency stop is pressed or released.
    EmergencyStop,
    /// The safety board is unplugged or plugged in.
    Board,
    /// The scanner is unplugged or plugged in.
    Scanner,
    /// The program is stopped for three seconds.
    Pause,
    /// A wheel is blocked until the next event.
    Contact,
    /// The realtime clock is set forward by half a second.
    Clock,
    /// The program is started again, with `arm_at_start`.
    Restart,
    /// A person inspects the robot and arms it.
    Person,
    /// Time passes without another event.
    Wait,
}

const ALL: [Event; 10] = [
    Event::Power,
    Event::EmergencyStop,
    Event::Board,
    Event::Scanner,
    Event::Pause,
    Event::Contact,
    Event::Clock,
    Event::Restart,
    Event::Person,
    Event::Wait,
];

struct Model {
    protocol: Protocol,
    robot: Composition,
    is_powered: bool,
    scanner_is_silent: bool,
    /// A person asked for motion after the last event that needs a person.
    is_granted: bool,
    /// Time of the last event that needs a person.
    revoked_ns: u64,
    /// The robot's true pose when the event happened.
    revoked_at: Pose2,
    /// A wheel has rolled since then without being driven or braked.
    has_coasted: bool,
    /// The program was started after the last loss of a device. It cannot know then that a device
    /// that appears was lost before: its request to arm is newer than the loss.
    is_new: bool,
    /// The events so far.
    path: Vec<Event>,
}

impl Model {
    fn new(protocol: Protocol) -> Self {
        let config = BaseConfig { safety_board: true, ..config(protocol) };
        let mut robot = Composition::new(&config, GEOMETRY).expect("a sound configuration");
        robot.nodes.iter_mut().for_each(|node| node.faults().boot_ns = BOOT_NS);
        robot.plan.linear_mps = PLAN_MPS;
        robot.steps(100);
        let revoked_at = robot.pose();
        Self {
            protocol,
            robot,
            is_powered: true,
            scanner_is_silent: false,
            is_granted: false,
            revoked_ns: 0,
            revoked_at,
            has_coasted: false,
            path: Vec::new(),
            is_new: true,
        }
    }

    /// A device is lost, which needs a person, or comes back, which must not move the robot either.
    fn lose_or_return(&mut self, is_lost: bool) {
        if is_lost {
            self.is_new = false;
        }
        if !self.is_new {
            self.revoke();
        }
    }

    fn revoke(&mut self) {
        self.is_granted = false;
        self.revoked_ns = self.robot.now_ns();
        self.revoked_at = self.robot.pose();
        self.has_coasted = false;
    }

    fn apply(&mut self, event: Event) {
        self.path.push(event);
        self.robot.nodes[0].wheel_mut().blocked = event == Event::Contact;
        match event {
            Event::Power => {
                self.is_powered = !self.is_powered;
                for node in &mut self.robot.nodes {
                    node.faults().unpowered = !self.is_powered;
                }
                self.lose_or_return(!self.is_powered);
            }
            Event::EmergencyStop => {
                self.robot.pressed = !self.robot.pressed;
                // A board that is unplugged cannot report the emergency stop. It reports it when it is plugged in
                // again.
                if !self.robot.board_is_silent {
                    self.lose_or_return(self.robot.pressed);
                }
            }
            Event::Board => {
                self.robot.board_is_silent = !self.robot.board_is_silent;
                let is_pressed_now = !self.robot.board_is_silent && self.robot.pressed;
                self.lose_or_return(self.robot.board_is_silent || is_pressed_now);
            }
            Event::Scanner => {
                self.scanner_is_silent = !self.scanner_is_silent;
                self.robot.silence_scanner(self.scanner_is_silent);
            }
            Event::Pause => {
                let before = self.robot.pose();
                self.robot.pause(3000 * MS);
                self.revoke();
                // The watchdogs of the controllers stop the wheels during the pause.
                self.revoked_at = before;
                self.has_coasted = self.protocol == Protocol::Odrive;
            }
            Event::Contact => {}
            Event::Clock => {
                let before = self.robot.has_authority();
                self.robot.set_realtime_forward(FORWARD_NS);
                self.robot.step(None);
                let path = &self.path;
                assert_eq!(self.robot.has_authority(), before, "the clock was set after {path:?}");
            }
            Event::Restart => {
                // As in `run`, the robot is not armed at the start after a stop that needs a person.
                let held =
                    matches!(self.robot.state(), SafetyState::Fault(why) if why.needs_person());
                self.robot.restart_program().expect("the same configuration");
                self.is_new = true;
                if !held && self.is_granted {
                    self.robot.step(Some(runtime::safety::Request::Arm));
                }
            }
            Event::Person => {
                self.is_granted = true;
                self.robot.person_arms();
            }
            Event::Wait => self.run(100),
        }
        self.run(STEPS);
    }

    /// Runs steps, and checks the invariant after each.
    fn run(&mut self, steps: usize) {
        for _ in 0..steps {
            self.robot.step(None);
            let given_up = SafetyState::Fault(FaultReason::RepeatedContact);
            if self.robot.state() == given_up && self.is_granted {
                self.revoke();
            }
            let reacts = self.robot.now_ns() < self.revoked_ns + REACTION_NS;
            assert!(
                self.is_granted || reacts || !self.robot.is_driven(),
                "after {:?} a wheel is driven in {:?} without a request to arm; {}",
                self.path,
                self.robot.state(),
                self.robot.base().explain()
            );
            self.has_coasted |= self.robot.nodes.iter().any(|node| {
                let wheel = node.wheel();
                wheel.drive() == Drive::Coast && wheel.velocity_radps().abs() > STANDING_RADPS
            });
            let limit_m = roll_out_m(if self.has_coasted { COAST_S } else { LAG_S });
            let moved_m = self.robot.pose().distance_m(&self.revoked_at);
            assert!(
                self.is_granted || moved_m <= limit_m,
                "the robot moved by {moved_m:.3} m, and not by {limit_m:.3} m at most, after {:?}",
                self.path
            );
        }
    }

    /// The abstract state, as the key of visited states.
    fn key(&self) -> String {
        let robot = &self.robot;
        let state = match robot.state() {
            SafetyState::Fault(why) => format!("{why:?}"),
            state => state.name().to_owned(),
        };
        let motors = robot.base().motors().map(|motor| motor.stage);
        let nodes = robot.nodes.each_ref().map(|node| node.is_powered());
        format!(
            "{state} {:?} {motors:?} {nodes:?} {} {} {} {} {} {} {}",
            robot.base().phase(),
            robot.pressed,
            robot.board_is_silent,
            self.is_powered,
            self.scanner_is_silent,
            robot.has_authority(),
            self.is_granted,
            self.is_new,
        )
    }
}

/// Explores all orders of events up to the depth. Returns the number of states, and of repetitions.
fn explore(protocol: Protocol) -> (usize, usize) {
    let mut known = HashSet::new();
    let mut frontier: Vec<Vec<Event>> = vec![Vec::new()];
    let mut repetitions = 0;
    let mut has_driven = false;
    for _ in 0..DEPTH {
        let mut next = Vec::new();
        for path in &frontier {
            for event in ALL {
                let mut model = Model::new(protocol);
                path.iter().chain([&event]).for_each(|event| model.apply(*event));
                repetitions += 1;
                has_driven |= model.robot.is_driven();
                if known.insert(model.key()) {
                    next.push([&path[..], &[event]].concat());
                }
            }
        }
        frontier = next;
    }
    assert!(has_driven, "the robot never drove, so nothing was checked");
    (known.len(), repetitions)
}

fn check(protocol: Protocol) {
    let (states, repetitions) = explore(protocol);
    println!("{protocol:?}: {states} states, {repetitions} sequences");
    assert!(states > 100, "{protocol:?}: only {states} states");
}

#[test]
fn with_odrives_no_order_of_eight_events_moves_a_wheel_without_a_request() {
    check(Protocol::Odrive);
}

#[test]
fn with_vescs_no_order_of_eight_events_moves_a_wheel_without_a_request() {
    check(Protocol::Vesc);
}

#[test]
fn with_cia_402_drives_no_order_of_eight_events_moves_a_wheel_without_a_request() {
    check(Protocol::Cia402);
}
