//! VESC over CAN (Vedder, "VESC 6 CAN formats"). Extended ids: packet number times 256 plus
//! controller id; big endian.
//!
//! *Watchdog.* A VESC releases the motor, or brakes, `timeout_msec` after the last command. No
//! message sets or reads this single value. It is part of the application configuration, whose
//! layout depends on the firmware, except for its beginning, which has been the same in all
//! firmware since 3.100: signature, controller id, `timeout_msec`, `timeout_brake_current`.
//! Therefore the driver reads the whole configuration (`COMM_GET_APPCONF`, some 500 bytes with a
//! CRC), checks that it holds the id of the addressed controller, and reads these two values. It
//! does not write them, because it would have to write back a whole configuration whose layout it
//! does not know. The operator sets them once, in VESC Tool under App Settings, General. The driver
//! refuses to arm until the time is short enough and the brake current is above zero, since
//! coasting is not stopping.
//!
//! *Low speeds.* A speed below `s_pid_min_erpm` (900 by default) releases the motor. Set it
//! according to the robot's lowest speed. For this reason a velocity of zero is sent as a brake
//! current. A VESC has no armed state: after its time-out it follows the next command at once, so
//! no stale command may ever reach it.
//!
//! The controller must send STATUS and STATUS_5 every 10 to 50 ms. STATUS_5 holds the supply's
//! voltage; STATUS_4, if it is sent, holds its current and the temperatures.

use std::f64::consts::TAU;

use super::crc::crc16;
use super::{
    Due, MotorProblem, MotorProtocol, MotorStage, MotorStatus, Outbox, SetupRequest,
    UnwrappedCounter, put,
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
    pub const STATUS_4: u32 = 16;
    pub const STATUS_5: u32 = 27;
}

const GET_APPCONF: u8 = 17;
const GET_VALUES_SELECTIVE: u8 = 50;
/// Bit of the fault code in `COMM_GET_VALUES_SELECTIVE`.
const FAULT_BIT: u32 = 1 << 15;
/// The fault code is requested ten times per second.
const FAULT_NS: u64 = 100_000_000;
/// Commutation steps per electrical revolution.
const STEPS: f64 = 6.0;
/// Capacity for the longest response. The largest known configuration has some 600 bytes.
const MAX_RESPONSE_BYTES: usize = 1024;

/// The configuration of one VESC.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VescNode {
    /// Controller id of the VESC, 0 to 253.
    pub node: u8,
    /// The id to which the VESC sends its responses. Two VESCs that respond at the same time need
    /// different ids.
    pub host: u8,
    /// Pole pairs of the motor, which is the ratio of ERPM to rpm.
    pub pole_pairs: f64,
    /// Brake current at zero velocity, A.
    pub brake_a: f64,
    /// The longest accepted watchdog time.
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
    request: SetupRequest,
    fault_requested_ns: u64,
    fault: Option<u8>,
    power: bool,
    /// Whether [`MotorProtocol::disable`] released the motor. After a fault or a lost bus, the
    /// motor brakes instead.
    released: bool,
    buffer: [u8; MAX_RESPONSE_BYTES],
    position: UnwrappedCounter,
    position_ns: u64,
    velocity_radps: f64,
}

impl Vesc {
    /// The state machine of a VESC that has not responded yet.
    #[must_use]
    pub fn new(node: VescNode) -> Self {
        Self {
            node,
            status: MotorStatus::default(),
            step: Step::Configuration,
            request: SetupRequest::default(),
            fault_requested_ns: 0,
            fault: None,
            power: false,
            released: true,
            buffer: [0; MAX_RESPONSE_BYTES],
            position: UnwrappedCounter::default(),
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

    fn enter(&mut self, step: Step) {
        self.step = step;
        self.request.answered();
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

    /// Stores a fragment of a long response.
    fn store_fragment(&mut self, at: usize, bytes: &[u8]) {
        match self.buffer.get_mut(at..at + bytes.len()) {
            Some(place) => place.copy_from_slice(bytes),
            None => self.status.bad += 1,
        }
    }

    /// Processes the end of a long response: sender, command, length and CRC.
    fn on_complete(&mut self, data: &[u8]) {
        let [from, _, l0, l1, c0, c1] = *data else { return };
        let length = usize::from(u16::from_be_bytes([l0, l1]));
        let Some(response) = self.buffer.get(..length) else {
            self.status.bad += 1;
            return;
        };
        if from != self.node.node {
            return;
        }
        if crc16(response.iter().copied()) != u16::from_be_bytes([c0, c1]) {
            self.status.bad += 1;
            return;
        }
        if let (
            [GET_APPCONF, _, _, _, _, id, t0, t1, t2, t3, a, b, c, d, ..],
            Step::Configuration,
        ) = (response, self.step)
        {
            let milliseconds = u32::from_be_bytes([*t0, *t1, *t2, *t3]);
            let brake_a = f32::from_be_bytes([*a, *b, *c, *d]);
            self.on_configuration(*id, milliseconds, brake_a);
        }
    }

    fn on_configuration(&mut self, id: u8, milliseconds: u32, brake_a: f32) {
        let required_ms = f64::from(self.node.watchdog_ms);
        let problem = if id != self.node.node || !brake_a.is_finite() {
            // The firmware has another layout than the known one.
            Some(MotorProblem::Mismatch { request: "application configuration" })
        } else if milliseconds == 0 {
            Some(MotorProblem::Watchdog { read_ms: f64::NAN, required_ms })
        } else if milliseconds > self.node.watchdog_ms {
            Some(MotorProblem::Watchdog { read_ms: f64::from(milliseconds), required_ms })
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
                self.enter(Step::Feedback);
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

    /// Leaves the feedback step when there is feedback and the fault code is known.
    fn advance(&mut self) {
        if self.step != Step::Feedback || self.status.feedback_ns == 0 {
            return;
        }
        match self.fault {
            None => {}
            Some(0) => {
                self.enter(if self.power { Step::Enabled } else { Step::Ready });
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
        let Some((steps, rest)) = data.split_first_chunk::<4>() else {
            self.status.bad += 1;
            return;
        };
        if let Some([decivolts]) = sixteen_bits(rest) {
            self.status.power.voltage(decivolts / 10.0, time_ns);
        }
        let steps = self.position.update(i32::from_be_bytes(*steps));
        self.status.position_rad = steps as f64 / (STEPS * self.node.pole_pairs) * TAU;
        self.position_ns = time_ns;
    }

    /// Temperatures of inverter and motor and the supply's current, each in tenths.
    fn on_temperatures(&mut self, data: &[u8], time_ns: u64) {
        let Some([inverter, motor, current]) = sixteen_bits(data) else {
            self.status.bad += 1;
            return;
        };
        self.status.power.temperatures([inverter / 10.0, motor / 10.0], time_ns);
        self.status.power.current(current / 10.0, time_ns);
    }

    fn on_response(&mut self, kind: u32, data: &[u8]) {
        match (kind, data) {
            (packet::FILL, [at, bytes @ ..]) => self.store_fragment(usize::from(*at), bytes),
            (packet::FILL_LONG, [a0, a1, bytes @ ..]) => {
                self.store_fragment(usize::from(u16::from_be_bytes([*a0, *a1])), bytes);
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
        let kind = id >> 8;
        let to = (id & 0xff) as u8;
        if frame.is_remote() {
            return false;
        }
        match kind {
            packet::STATUS if to == self.node.node => self.on_status(frame.data(), time_ns),
            packet::STATUS_5 if to == self.node.node => self.on_position(frame.data(), time_ns),
            packet::STATUS_4 if to == self.node.node => self.on_temperatures(frame.data(), time_ns),
            // STATUS_2, _3, _6 and PONG.
            14 | 15 | 18 | 58 if to == self.node.node => {}
            packet::FILL..=packet::PROCESS_SHORT if to == self.node.host => {
                self.on_response(kind, frame.data());
            }
            _ => return false,
        }
        true
    }

    fn tick(&mut self, now_ns: u64, out: &mut Outbox) {
        if self.status.watchdog_ms.is_some() {
            put(out, [self.command()]);
            if now_ns.saturating_sub(self.fault_requested_ns) >= FAULT_NS {
                self.fault_requested_ns = now_ns;
                let [m0, m1, m2, m3] = FAULT_BIT.to_be_bytes();
                let request = [self.node.host, 0, GET_VALUES_SELECTIVE, m0, m1, m2, m3];
                put(out, [self.frame(packet::PROCESS_SHORT, &request)]);
            }
        }
        let request = match self.step {
            Step::Configuration => "application configuration",
            Step::Feedback => {
                "status (the controller must be configured to send STATUS and STATUS_5)"
            }
            _ => return,
        };
        let due = self.request.due(now_ns);
        if due == Due::Repeat && self.status.problem.is_none() {
            self.status.problem = Some(MotorProblem::NoResponse { request });
        }
        if due != Due::No && self.step == Step::Configuration {
            put(out, [self.frame(packet::PROCESS_SHORT, &[self.node.host, 0, GET_APPCONF])]);
        }
    }

    fn set_velocity(&mut self, radps: f64) {
        self.velocity_radps = radps;
    }

    fn enable(&mut self) {
        if matches!(self.status.stage, MotorStage::Ready | MotorStage::Faulted) {
            self.restart();
            self.power = true;
            self.released = false;
            self.status.stage = MotorStage::Enabling;
        }
    }

    fn disable(&mut self) {
        self.power = false;
        self.released = true;
        if matches!(self.status.stage, MotorStage::Enabled | MotorStage::Enabling) {
            self.enter(Step::Feedback);
            self.status.stage = MotorStage::SettingUp;
        }
    }

    fn restart(&mut self) {
        self.enter(Step::Configuration);
        self.power = false;
        self.status.stage = MotorStage::SettingUp;
        self.status.watchdog_ms = None;
    }

    fn status(&self) -> &MotorStatus {
        &self.status
    }
}

/// Signed numbers of 16 bits at the beginning of a message; `None` if it is shorter.
fn sixteen_bits<const N: usize>(data: &[u8]) -> Option<[f64; N]> {
    let mut numbers = [0.0; N];
    let mut pairs = data.chunks_exact(2);
    for number in &mut numbers {
        let pair = pairs.next()?.first_chunk::<2>()?;
        *number = f64::from(i16::from_be_bytes(*pair));
    }
    Some(numbers)
}

/// The codes of `mc_fault_code` in the firmware's `datatypes.h`.
fn fault(code: u8) -> MotorProblem {
    let meaning = match code {
        1 => "its supply voltage is too high",
        2 => "its supply voltage is too low",
        3 => "its gate driver failed",
        4 => "its motor current is too high",
        5 => "its inverter is too hot",
        6 => "its motor is too hot",
        10 => "its own watchdog restarted it",
        11..=15 => "its encoder failed",
        _ => "a fault without a known meaning",
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

    /// Delivers an application configuration in fragments, as a controller sends it.
    fn configuration(
        motor: &mut Vesc,
        id: u8,
        milliseconds: u32,
        brake_a: f32,
        with_wrong_crc: bool,
    ) {
        let mut bytes = vec![17, 0x1d, 0, 0, 1, id];
        bytes.extend(milliseconds.to_be_bytes());
        bytes.extend(brake_a.to_be_bytes());
        bytes.extend((0..300).map(|k| k as u8));
        let crc = crc16(bytes.iter().copied());
        if with_wrong_crc {
            bytes[7] ^= 1;
        }
        let mut at = 0;
        for piece in bytes.chunks(6) {
            let payload = [&(at as u16).to_be_bytes()[..], piece].concat();
            deliver(motor, 6 << 8 | 254, &payload, 0);
            at += piece.len();
        }
        let length = (at as u16).to_be_bytes();
        let crc = crc.to_be_bytes();
        let end = [10, 1, length[0], length[1], crc[0], crc[1]];
        deliver(motor, 7 << 8 | 254, &end, 0);
    }

    fn deliver(motor: &mut Vesc, id: u32, data: &[u8], time_ns: u64) {
        let frame = CanFrame::new(CanId::Extended(id), data).expect("a valid frame");
        assert!(motor.receive(&frame, time_ns));
    }

    #[test]
    fn supply_and_temperatures_are_those_of_status_4_and_status_5() {
        let mut motor = Vesc::new(NODE);
        // STATUS_4: 41.0 and 58.5 degrees, 3.2 A, 100 degrees of position. STATUS_5: 1000 steps, 23.6 V.
        deliver(&mut motor, 16 << 8 | 10, &[0x01, 0x9a, 0x02, 0x49, 0x00, 0x20, 0x13, 0x88], 7);
        deliver(&mut motor, 27 << 8 | 10, &[0x00, 0x00, 0x03, 0xe8, 0x00, 0xec, 0, 0], 7);
        let report = motor.status().power.report(7);
        assert_eq!(report.temperature_c, Some(58.5));
        assert_eq!(report.current_a, Some(3.2));
        assert_eq!(report.voltage_v, Some(23.6));
    }

    #[test]
    fn the_watchdog_time_is_read_from_the_configuration() {
        let mut motor = Vesc::new(NODE);
        assert_eq!(sent(&mut motor, 0), ["0000080A#FE0011"]);
        configuration(&mut motor, 10, 80, 3.0, false);
        assert_eq!(motor.status().watchdog_ms, Some(80.0));
        // From now on the watchdog is fed, with zero current until the motor is enabled.
        assert_eq!(sent(&mut motor, 1), ["0000010A#00000000"]);
    }

    /// The problem for which a VESC with this configuration is refused.
    fn refusal(id: u8, milliseconds: u32, brake_a: f32) -> Option<MotorProblem> {
        let mut motor = Vesc::new(NODE);
        configuration(&mut motor, id, milliseconds, brake_a, false);
        assert_eq!(motor.status().stage, MotorStage::Refused);
        motor.status().problem
    }

    #[test]
    fn a_watchdog_that_is_too_long_or_off_or_without_brake_is_refused() {
        assert_eq!(
            refusal(10, 1000, 3.0),
            Some(MotorProblem::Watchdog { read_ms: 1000.0, required_ms: 100.0 })
        );
        assert_eq!(refusal(10, 80, 0.0), Some(MotorProblem::CoastsOnTimeout));
        assert_eq!(
            refusal(11, 80, 3.0),
            Some(MotorProblem::Mismatch { request: "application configuration" })
        );
        assert!(matches!(
            refusal(10, 0, 3.0),
            Some(MotorProblem::Watchdog { read_ms, .. }) if read_ms.is_nan()
        ));
    }

    #[test]
    fn a_configuration_with_a_wrong_crc_is_requested_again() {
        let mut motor = Vesc::new(NODE);
        configuration(&mut motor, 10, 80, 3.0, true);
        assert_eq!((motor.status().watchdog_ms, motor.status().bad), (None, 1));
        assert_eq!(sent(&mut motor, 0), ["0000080A#FE0011"]);
    }

    #[test]
    fn zero_velocity_is_sent_as_a_brake_current() {
        let mut motor = Vesc::new(NODE);
        configuration(&mut motor, 10, 80, 3.0, false);
        motor.step = Step::Enabled;
        motor.released = false;
        motor.fault_requested_ns = 1;
        motor.set_velocity(TAU);
        assert_eq!(sent(&mut motor, 2), ["0000030A#000001A4"]);
        motor.set_velocity(0.0);
        assert_eq!(sent(&mut motor, 3), ["0000020A#00001388"]);
    }
}
