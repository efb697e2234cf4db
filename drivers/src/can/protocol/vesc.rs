//! VESC over CAN (Vedder, "VESC 6 CAN formats"). Extended ids: packet number times 256 plus controller id; big endian.
//!
//! *Watchdog.* A VESC lets go of the motor, or brakes, `timeout_msec` after the last command. There is no message to set or read
//! this one number: it stands in the application configuration, whose layout belongs to the firmware, except for its beginning,
//! which has been the same in all firmware since 3.100: signature, controller id, `timeout_msec`, `timeout_brake_current`. So
//! the driver reads the whole configuration (`COMM_GET_APPCONF`, some 500 bytes with a CRC), checks that the controller id in it
//! is the one it asked, and takes the two numbers. It does not write them: that would mean writing back a configuration that the
//! driver cannot name. A person sets them once, in VESC Tool under App Settings, General; the driver refuses to arm until they
//! are right, with a brake current above zero, since a wheel that rolls is not a stop.
//!
//! *Low speeds.* A speed below `s_pid_min_erpm` (900 by default) releases the motor. Set it to what the robot's slowest speed
//! needs; zero is sent as a brake current for this reason. A VESC has no state to arm: after its time-out it follows the next
//! command at once, which is why no old command may ever reach it.
//!
//! The controller must send STATUS and STATUS_5 every 10 to 50 ms.

use std::f64::consts::TAU;

use super::crc::crc16;
use super::{
    MotorProblem, MotorProtocol, MotorStage, MotorStatus, Outbox, Question, Unwrapped, put,
};
use crate::can::frame::{CanFrame, CanId};

/// `CAN_PACKET_ID` of the firmware's `datatypes.h`.
mod packet {
    pub const CURRENT: u32 = 1;
    pub const BRAKE: u32 = 2;
    pub const RPM: u32 = 3;
    pub const FILL: u32 = 5;
    pub const FILL_LONG: u32 = 6;
    pub const PROCESS: u32 = 7;
    pub const PROCESS_SHORT: u32 = 8;
    pub const STATUS: u32 = 9;
    pub const STATUS_5: u32 = 27;
}

const GET_APPCONF: u8 = 17;
const GET_VALUES_SELECTIVE: u8 = 50;
/// Bit of the fault code in `COMM_GET_VALUES_SELECTIVE`.
const FAULT_BIT: u32 = 1 << 15;
/// Faults are asked for ten times a second.
const FAULT_NS: u64 = 100_000_000;
/// Commutation steps per electrical turn.
const STEPS: f64 = 6.0;
/// The largest configuration so far has some 600 bytes.
const LONGEST: usize = 1024;

/// One VESC.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VescNode {
    /// Its controller id, 0 to 253.
    pub node: u8,
    /// The id that it answers to. Two VESCs that answer at the same time need two.
    pub host: u8,
    /// Pole pairs of the motor: ERPM per rpm.
    pub pole_pairs: f64,
    /// Current that holds the wheel at zero, A.
    pub brake_a: f64,
    /// The longest watchdog accepted, milliseconds.
    pub watchdog_ms: u32,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Step {
    Configuration,
    Feedback,
    Ready,
    Enabled,
    Halted,
}

/// The state machine of one VESC.
#[derive(Debug)]
pub struct Vesc {
    node: VescNode,
    status: MotorStatus,
    step: Step,
    question: Question,
    fault_asked_ns: u64,
    fault: Option<u8>,
    power: bool,
    /// Let go by [`MotorProtocol::disable`]; a fault or a lost bus does not let go, it brakes.
    released: bool,
    buffer: [u8; LONGEST],
    position: Unwrapped,
    position_ns: u64,
    velocity_radps: f64,
}

impl Vesc {
    /// A VESC that is not found yet.
    #[must_use]
    pub fn new(node: VescNode) -> Self {
        Self {
            node,
            status: MotorStatus::default(),
            step: Step::Configuration,
            question: Question::default(),
            fault_asked_ns: 0,
            fault: None,
            power: false,
            released: true,
            buffer: [0; LONGEST],
            position: Unwrapped::default(),
            position_ns: 0,
            velocity_radps: 0.0,
        }
    }

    fn frame(&self, packet: u32, payload: &[u8]) -> CanFrame {
        let mut data = [0; 8];
        for (byte, value) in data.iter_mut().zip(payload) {
            *byte = *value;
        }
        CanFrame::extended_short(packet << 8 | u32::from(self.node.node), data, payload.len())
    }

    fn next(&mut self, step: Step) {
        self.step = step;
        self.question.answered();
        self.status.problem = None;
    }

    fn halt(&mut self, stage: MotorStage, problem: MotorProblem) {
        self.step = Step::Halted;
        self.power = false;
        self.status.stage = stage;
        self.status.problem = Some(problem);
    }

    fn command(&self) -> CanFrame {
        let moving = self.step == Step::Enabled && self.velocity_radps != 0.0;
        if moving {
            let erpm = self.velocity_radps / TAU * 60.0 * self.node.pole_pairs;
            self.frame(packet::RPM, &(erpm.round() as i32).to_be_bytes())
        } else if self.released {
            self.frame(packet::CURRENT, &[0; 4])
        } else {
            let milliamperes = (self.node.brake_a * 1e3).round() as i32;
            self.frame(packet::BRAKE, &milliamperes.to_be_bytes())
        }
    }

    fn fill(&mut self, at: usize, bytes: &[u8]) {
        match self.buffer.get_mut(at..at + bytes.len()) {
            Some(room) => room.copy_from_slice(bytes),
            None => self.status.bad += 1,
        }
    }

    /// The end of a long answer: from whom, to whom it goes, its length and its CRC.
    fn on_complete(&mut self, data: &[u8]) {
        let [from, _, l0, l1, c0, c1] = *data else { return };
        let length = usize::from(u16::from_be_bytes([l0, l1]));
        let Some(answer) = self.buffer.get(..length) else {
            self.status.bad += 1;
            return;
        };
        if from != self.node.node {
            return;
        }
        if crc16(answer.iter().copied()) != u16::from_be_bytes([c0, c1]) {
            self.status.bad += 1;
            return;
        }
        if let (
            [GET_APPCONF, _, _, _, _, id, t0, t1, t2, t3, a, b, c, d, ..],
            Step::Configuration,
        ) = (answer, self.step)
        {
            let milliseconds = u32::from_be_bytes([*t0, *t1, *t2, *t3]);
            let brake_a = f32::from_be_bytes([*a, *b, *c, *d]);
            self.on_configuration(*id, milliseconds, brake_a);
        }
    }

    fn on_configuration(&mut self, id: u8, milliseconds: u32, brake_a: f32) {
        let wanted_ms = f64::from(self.node.watchdog_ms);
        let problem = if id != self.node.node || !brake_a.is_finite() {
            // The firmware's layout is not the one that we know.
            Some(MotorProblem::Nonsense { question: "application configuration" })
        } else if milliseconds == 0 {
            Some(MotorProblem::Watchdog { read_ms: f64::NAN, wanted_ms })
        } else if milliseconds > self.node.watchdog_ms {
            Some(MotorProblem::Watchdog { read_ms: f64::from(milliseconds), wanted_ms })
        } else if brake_a <= 0.0 {
            Some(MotorProblem::CoastsOnTimeout)
        } else {
            None
        };
        match problem {
            Some(problem) => self.halt(MotorStage::Refused, problem),
            None => {
                self.status.watchdog_ms = Some(f64::from(milliseconds));
                self.fault = None;
                self.next(Step::Feedback);
            }
        }
    }

    fn on_fault(&mut self, code: u8) {
        self.fault = Some(code);
        if code != 0 && matches!(self.step, Step::Enabled | Step::Ready) {
            self.halt(MotorStage::Faulted, fault(code));
        }
        self.advance();
    }

    /// Feedback, and no fault: ready, or going.
    fn advance(&mut self) {
        if self.step != Step::Feedback || self.status.feedback_ns == 0 {
            return;
        }
        match self.fault {
            None => {}
            Some(0) => {
                self.next(if self.power { Step::Enabled } else { Step::Ready });
                self.status.stage =
                    if self.power { MotorStage::Enabled } else { MotorStage::Ready };
            }
            Some(code) => self.halt(MotorStage::Faulted, fault(code)),
        }
    }

    fn on_status(&mut self, data: &[u8], time_ns: u64) {
        let Some(erpm) = data.first_chunk::<4>() else {
            self.status.bad += 1;
            return;
        };
        let erpm = f64::from(i32::from_be_bytes(*erpm));
        self.status.velocity_radps = erpm / self.node.pole_pairs / 60.0 * TAU;
        self.status.feedback_ns = self.position_ns.min(time_ns);
        self.advance();
    }

    fn on_position(&mut self, data: &[u8], time_ns: u64) {
        let Some(steps) = data.first_chunk::<4>() else {
            self.status.bad += 1;
            return;
        };
        let steps = self.position.update(i32::from_be_bytes(*steps));
        self.status.position_rad = steps as f64 / (STEPS * self.node.pole_pairs) * TAU;
        self.position_ns = time_ns;
    }

    fn on_answer(&mut self, kind: u32, data: &[u8]) {
        match (kind, data) {
            (packet::FILL, [at, bytes @ ..]) => self.fill(usize::from(*at), bytes),
            (packet::FILL_LONG, [a0, a1, bytes @ ..]) => {
                self.fill(usize::from(u16::from_be_bytes([*a0, *a1])), bytes);
            }
            (packet::PROCESS, data) => self.on_complete(data),
            (packet::PROCESS_SHORT, [from, _, GET_VALUES_SELECTIVE, m0, m1, m2, m3, code])
                if *from == self.node.node
                    && u32::from_be_bytes([*m0, *m1, *m2, *m3]) == FAULT_BIT =>
            {
                self.on_fault(*code);
            }
            _ => {}
        }
    }
}

impl MotorProtocol for Vesc {
    fn receive(&mut self, frame: &CanFrame, time_ns: u64) -> bool {
        let CanId::Extended(id) = frame.id() else { return false };
        let (kind, to) = (id >> 8, (id & 0xff) as u8);
        if frame.is_remote() {
            return false;
        }
        match kind {
            packet::STATUS if to == self.node.node => self.on_status(frame.data(), time_ns),
            packet::STATUS_5 if to == self.node.node => self.on_position(frame.data(), time_ns),
            // STATUS_2, _3, _4, _6 and PONG.
            14..=16 | 18 | 58 if to == self.node.node => {}
            packet::FILL..=packet::PROCESS_SHORT if to == self.node.host => {
                self.on_answer(kind, frame.data());
            }
            _ => return false,
        }
        true
    }

    fn tick(&mut self, now_ns: u64, out: &mut Outbox) {
        if self.status.watchdog_ms.is_some() {
            put(out, [self.command()]);
            if now_ns.saturating_sub(self.fault_asked_ns) >= FAULT_NS {
                self.fault_asked_ns = now_ns;
                let [m0, m1, m2, m3] = FAULT_BIT.to_be_bytes();
                let question = [self.node.host, 0, GET_VALUES_SELECTIVE, m0, m1, m2, m3];
                put(out, [self.frame(packet::PROCESS_SHORT, &question)]);
            }
        }
        let question = match self.step {
            Step::Configuration => "application configuration",
            Step::Feedback => "status (STATUS and STATUS_5 must be sent by itself)",
            _ => return,
        };
        let (now, again) = self.question.ask(now_ns);
        if now && again && self.status.problem.is_none() {
            self.status.problem = Some(MotorProblem::NoAnswer { question });
        }
        if now && self.step == Step::Configuration {
            put(out, [self.frame(packet::PROCESS_SHORT, &[self.node.host, 0, GET_APPCONF])]);
        }
    }

    fn set_velocity(&mut self, radps: f64) {
        self.velocity_radps = radps;
    }

    fn enable(&mut self) {
        if matches!(self.status.stage, MotorStage::Ready | MotorStage::Faulted) {
            self.restart();
            (self.power, self.released) = (true, false);
            self.status.stage = MotorStage::Enabling;
        }
    }

    fn disable(&mut self) {
        (self.power, self.released) = (false, true);
        if matches!(self.status.stage, MotorStage::Enabled | MotorStage::Enabling) {
            self.next(Step::Feedback);
            self.status.stage = MotorStage::SettingUp;
        }
    }

    fn restart(&mut self) {
        self.next(Step::Configuration);
        self.power = false;
        self.status.stage = MotorStage::SettingUp;
        self.status.watchdog_ms = None;
    }

    fn status(&self) -> &MotorStatus {
        &self.status
    }
}

/// `mc_fault_code` of the firmware's `datatypes.h`.
fn fault(code: u8) -> MotorProblem {
    let meaning = match code {
        1 => "its supply voltage is too high",
        2 => "its supply voltage is too low",
        3 => "its gate driver failed",
        4 => "its motor current is too high",
        5 => "its inverter is too hot",
        6 => "its motor is too hot",
        10 => "it has restarted by its own watchdog",
        11..=15 => "its encoder failed",
        _ => "a fault of its own",
    };
    MotorProblem::Fault { code: u32::from(code), meaning }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NODE: VescNode =
        VescNode { node: 10, host: 254, pole_pairs: 7.0, brake_a: 5.0, watchdog_ms: 100 };

    fn sent(motor: &mut Vesc, now_ns: u64) -> Vec<String> {
        let mut out = Outbox::new();
        motor.tick(now_ns, &mut out);
        out.iter().map(ToString::to_string).collect()
    }

    /// An application configuration as a controller sends it, in pieces.
    fn configuration(motor: &mut Vesc, id: u8, milliseconds: u32, brake_a: f32, spoil: bool) {
        let mut bytes = vec![17, 0x1d, 0, 0, 1, id];
        bytes.extend(milliseconds.to_be_bytes());
        bytes.extend(brake_a.to_be_bytes());
        bytes.extend((0..300).map(|k| k as u8));
        let crc = crc16(bytes.iter().copied());
        if spoil {
            bytes[7] ^= 1;
        }
        let mut at = 0;
        for piece in bytes.chunks(6) {
            let payload = [&(at as u16).to_be_bytes()[..], piece].concat();
            let frame = CanFrame::new(CanId::Extended(6 << 8 | 254), &payload).expect("sound");
            assert!(motor.receive(&frame, 0));
            at += piece.len();
        }
        let (length, crc) = ((at as u16).to_be_bytes(), crc.to_be_bytes());
        let end = [10, 1, length[0], length[1], crc[0], crc[1]];
        assert!(
            motor.receive(&CanFrame::new(CanId::Extended(7 << 8 | 254), &end).expect("sound"), 0)
        );
    }

    #[test]
    fn the_watchdog_is_read_out_of_the_configuration() {
        let mut motor = Vesc::new(NODE);
        assert_eq!(sent(&mut motor, 0), ["0000080A#FE0011"]);
        configuration(&mut motor, 10, 80, 3.0, false);
        assert_eq!(motor.status().watchdog_ms, Some(80.0));
        // From now on it is fed, with no current until it is enabled.
        assert_eq!(sent(&mut motor, 1), ["0000010A#00000000"]);
    }

    #[test]
    fn a_watchdog_too_long_or_off_or_without_brake_is_refused() {
        let refusal = |id, milliseconds, brake_a| {
            let mut motor = Vesc::new(NODE);
            configuration(&mut motor, id, milliseconds, brake_a, false);
            (motor.status().stage, motor.status().problem)
        };
        let refused = |problem| (MotorStage::Refused, Some(problem));
        assert_eq!(
            refusal(10, 1000, 3.0),
            refused(MotorProblem::Watchdog { read_ms: 1000.0, wanted_ms: 100.0 })
        );
        assert_eq!(refusal(10, 80, 0.0), refused(MotorProblem::CoastsOnTimeout));
        assert_eq!(
            refusal(11, 80, 3.0),
            refused(MotorProblem::Nonsense { question: "application configuration" })
        );
        assert!(matches!(
            refusal(10, 0, 3.0),
            (MotorStage::Refused, Some(MotorProblem::Watchdog { .. }))
        ));
    }

    #[test]
    fn a_configuration_that_fails_its_crc_is_asked_for_again() {
        let mut motor = Vesc::new(NODE);
        configuration(&mut motor, 10, 80, 3.0, true);
        assert_eq!((motor.status().watchdog_ms, motor.status().bad), (None, 1));
        assert_eq!(sent(&mut motor, 0), ["0000080A#FE0011"]);
    }

    #[test]
    fn zero_is_a_brake_and_never_a_speed() {
        let mut motor = Vesc::new(NODE);
        configuration(&mut motor, 10, 80, 3.0, false);
        (motor.step, motor.released) = (Step::Enabled, false);
        motor.fault_asked_ns = 1;
        motor.set_velocity(TAU);
        assert_eq!(sent(&mut motor, 2), ["0000030A#000001A4"]);
        motor.set_velocity(0.0);
        assert_eq!(sent(&mut motor, 3), ["0000020A#00001388"]);
    }
}
