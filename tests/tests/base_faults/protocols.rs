//! One motor's protocol and its simulated controller, without a base: what the base relies on.

use drivers::can::protocol::crc::crc16;
use drivers::can::protocol::vesc::{Vesc, VescNode};
use drivers::can::protocol::{MotorProblem, MotorProtocol, MotorStage, Outbox};
use drivers::can::protocol::{cia402, odrive};
use drivers::can::{CanFrame, CanId, Protocol};
use hil::motor::MotorNode;
use hil::motor::cia402::COUNTS;
use hil::motor::odrive::{ENABLE_WATCHDOG_ENDPOINT, FIRMWARE, WATCHDOG_TIMEOUT_ENDPOINT};
use hil::motor::rig::node;
use hil::motor::vesc::POLE_PAIRS;

use super::{ALL, MS, is_motion};

const HOST: u8 = 252;

fn vesc() -> Vesc {
    let pole_pairs = f64::from(POLE_PAIRS);
    Vesc::new(VescNode { node: 1, host: HOST, pole_pairs, brake_a: 5.0, watchdog_ms: 100 })
}

fn motor(protocol: Protocol) -> Box<dyn MotorProtocol> {
    match protocol {
        Protocol::Odrive => Box::new(odrive::Odrive::new(odrive::OdriveNode {
            node: 1,
            firmware: FIRMWARE,
            enable_watchdog_endpoint: ENABLE_WATCHDOG_ENDPOINT,
            watchdog_timeout_endpoint: WATCHDOG_TIMEOUT_ENDPOINT,
            watchdog_ms: 100,
        })),
        Protocol::Vesc => Box::new(vesc()),
        Protocol::Cia402 => Box::new(cia402::Cia402::new(cia402::Cia402Node {
            node: 1,
            host: 127,
            leads: true,
            watchdog_ms: 100,
            velocity_units: COUNTS,
            position_units: COUNTS,
        })),
    }
}

/// A motor's protocol and the controller that it talks to.
struct Pair {
    motor: Box<dyn MotorProtocol>,
    node: Box<dyn MotorNode>,
    now_ns: u64,
}

impl Pair {
    fn new(protocol: Protocol) -> Self {
        Self { motor: motor(protocol), node: node(protocol, 1), now_ns: 1_000 * MS }
    }

    /// Ten milliseconds in which the frames that `arrives` accepts reach the driver. Returns what
    /// the driver sent.
    fn tick_with(&mut self, arrives: impl Fn(&CanFrame) -> bool) -> Outbox {
        let mut frames = Vec::new();
        for _ in 0..10 {
            self.now_ns += MS;
            self.node.step(self.now_ns, &mut frames);
        }
        for frame in frames.iter().filter(|frame| arrives(frame)) {
            self.motor.receive(frame, self.now_ns);
        }
        let mut out = Outbox::new();
        self.motor.tick(self.now_ns, &mut out);
        out.iter().for_each(|frame| self.node.receive(frame, self.now_ns));
        out
    }

    fn reaches(&mut self, stage: MotorStage) {
        let is_there = (0..400).any(|_| {
            self.tick_with(|_| true);
            self.motor.status().stage == stage
        });
        assert!(is_there, "{stage:?} is not reached: {:?}", self.motor.status());
    }

    fn ready(protocol: Protocol) -> Self {
        let mut pair = Self::new(protocol);
        pair.reaches(MotorStage::Ready);
        pair
    }

    fn enabled(protocol: Protocol) -> Self {
        let mut pair = Self::ready(protocol);
        pair.motor.enable();
        pair.reaches(MotorStage::Enabled);
        pair
    }

    fn deliver(&mut self, id: CanId, data: &[u8]) {
        let frame = CanFrame::new(id, data).expect("a valid frame");
        assert!(self.motor.receive(&frame, self.now_ns), "{frame}");
    }
}

#[test]
fn a_velocity_that_was_set_too_early_is_not_sent_before_the_motor_is_enabled() {
    for protocol in ALL {
        let mut pair = Pair::new(protocol);
        pair.motor.set_velocity(5.0);
        for _ in 0..100 {
            assert!(!pair.tick_with(|_| true).iter().any(is_motion), "{protocol:?}");
        }
        assert_eq!(pair.motor.status().stage, MotorStage::Ready, "{protocol:?}");
    }
}

#[test]
fn a_motor_that_is_set_up_again_has_no_confirmed_watchdog_until_its_controller_answers() {
    for protocol in ALL {
        let mut pair = Pair::enabled(protocol);
        pair.motor.restart();
        assert_eq!(pair.motor.status().watchdog_ms, None, "{protocol:?}");
        pair.reaches(MotorStage::Ready);
        assert!(pair.motor.status().watchdog_ms.is_some(), "{protocol:?}");
    }
}

#[test]
fn an_error_of_an_odrive_is_a_fault_even_while_it_still_reports_closed_loop_control() {
    let mut pair = Pair::enabled(Protocol::Odrive);
    // Heartbeat: its motor current is too high, closed-loop control.
    pair.deliver(CanId::Standard(0x021), &[0, 0x10, 0, 0, 8, 0, 0, 0]);
    assert_eq!(pair.motor.status().stage, MotorStage::Faulted);
}

#[test]
fn feedback_of_which_one_half_is_missing_is_not_new() {
    // STATUS_5 of a VESC and TPDO2 of a CiA 402 drive hold the position.
    let halves = [
        (Protocol::Vesc, CanId::Extended(27 << 8 | 1)),
        (Protocol::Vesc, CanId::Extended(9 << 8 | 1)),
        (Protocol::Cia402, CanId::Standard(0x281)),
        (Protocol::Cia402, CanId::Standard(0x181)),
    ];
    for (protocol, half) in halves {
        let mut pair = Pair::ready(protocol);
        let before_ns = pair.now_ns;
        (0..30).for_each(|_| drop(pair.tick_with(|frame| frame.id() != half)));
        let newest_ns = pair.motor.status().feedback_ns;
        assert!(newest_ns <= before_ns, "{protocol:?} without {half}");
        pair.tick_with(|_| true);
        pair.tick_with(|_| true);
        assert!(pair.motor.status().feedback_ns > before_ns, "{protocol:?} with {half}");
    }
}

#[test]
fn a_drive_that_restarted_is_configured_again_and_one_that_left_operation_is_faulted() {
    let heartbeat = CanId::Standard(0x701);
    let mut restarted = Pair::ready(Protocol::Cia402);
    // Boot-up (CiA 301, 7.2.8.3.3).
    restarted.deliver(heartbeat, &[0]);
    let status = restarted.motor.status();
    assert_eq!((status.stage, status.watchdog_ms), (MotorStage::SettingUp, None));
    for state in [4, 0x7f] {
        // Stopped, pre-operational.
        let mut left = Pair::enabled(Protocol::Cia402);
        left.deliver(heartbeat, &[state]);
        assert_eq!(left.motor.status().stage, MotorStage::Faulted, "state {state}");
    }
}

#[test]
fn the_fault_code_of_another_vesc_is_not_that_of_this_one() {
    let mut pair = Pair::enabled(Protocol::Vesc);
    let answers = CanId::Extended(8 << 8 | u32::from(HOST));
    pair.deliver(answers, &[99, 0, 50, 0, 0, 0x80, 0, 3]);
    assert_eq!(pair.motor.status().stage, MotorStage::Enabled);
    pair.deliver(answers, &[1, 0, 50, 0, 0, 0x80, 0, 3]);
    assert_eq!(pair.motor.status().stage, MotorStage::Faulted);
}

#[test]
fn a_vesc_whose_brake_current_is_no_number_is_refused() {
    for brake_a in [f32::NAN, f32::INFINITY] {
        let mut motor = vesc();
        let bytes = [
            &[17, 0, 0, 0, 0, 1][..],
            &80_u32.to_be_bytes(),
            &brake_a.to_be_bytes(),
            // The configuration goes on after the part that the driver reads.
            &[0; 10],
        ]
        .concat();
        for (at, piece) in bytes.chunks(6).enumerate() {
            deliver(6, &[&(6 * at as u16).to_be_bytes()[..], piece].concat(), &mut motor);
        }
        let [c0, c1] = crc16(bytes.iter().copied()).to_be_bytes();
        deliver(7, &[1, 0, 0, bytes.len() as u8, c0, c1], &mut motor);
        let problem = MotorProblem::Mismatch { request: "application configuration" };
        assert_eq!(motor.status().stage, MotorStage::Refused, "{brake_a}");
        assert_eq!((motor.status().problem, motor.status().watchdog_ms), (Some(problem), None));
    }
}

fn deliver(kind: u32, data: &[u8], motor: &mut Vesc) {
    let id = CanId::Extended(kind << 8 | u32::from(HOST));
    assert!(motor.receive(&CanFrame::new(id, data).expect("a valid frame"), 0));
}
