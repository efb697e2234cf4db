//! ODrive's CANSimple (ODrive, "CAN Protocol", firmware 0.6). Standard ids: node number times 32 plus a command; little endian.
//!
//! Its watchdog is a pair of parameters, reached by endpoint numbers that differ from firmware to firmware, so the firmware is
//! asked first and must be the configured one. `Set_Input_Vel` feeds the watchdog. The controller must send its encoder estimates
//! by itself every 10 to 50 ms (`can.config.encoder_msg_rate_ms`) and its heartbeat at least every 100 ms.

use std::f64::consts::TAU;

use super::{MotorProblem, MotorProtocol, MotorStage, MotorStatus, Outbox, Question, put};
use crate::can::frame::{CanFrame, CanId};

/// Commands used here.
mod command {
    pub const VERSION: u16 = 0x00;
    pub const HEARTBEAT: u16 = 0x01;
    pub const WRITE_READ: u16 = 0x04;
    pub const READ_ANSWER: u16 = 0x05;
    pub const AXIS_STATE: u16 = 0x07;
    pub const ENCODER: u16 = 0x09;
    pub const MODES: u16 = 0x0b;
    pub const VELOCITY: u16 = 0x0d;
    pub const CLEAR_ERRORS: u16 = 0x18;
}

const IDLE: u8 = 1;
const CLOSED_LOOP: u8 = 8;
const VELOCITY_CONTROL: u32 = 2;
const PASSTHROUGH: u32 = 1;
/// The controller has this many chances of 100 ms to reach closed loop.
const ENABLE_TRIES: u8 = 10;

/// One ODrive axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OdriveNode {
    /// Its node id, 0 to 62.
    pub node: u8,
    /// Its firmware: major, minor, revision.
    pub firmware: [u8; 3],
    /// Endpoint of `axis0.config.enable_watchdog` in `flat_endpoints.json` of that firmware.
    pub enable_watchdog_endpoint: u16,
    /// Endpoint of `axis0.config.watchdog_timeout`.
    pub watchdog_timeout_endpoint: u16,
    /// Watchdog to set, milliseconds.
    pub watchdog_ms: u32,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Step {
    Version,
    Timeout,
    Watchdog,
    Feedback,
    Ready,
    ClosedLoop,
    Enabled,
    /// Faulted or refused.
    Halted,
}

/// The state machine of one axis.
#[derive(Debug)]
pub struct Odrive {
    node: OdriveNode,
    status: MotorStatus,
    step: Step,
    question: Question,
    power: bool,
    idle_wanted: bool,
    tries: u8,
    velocity_radps: f64,
}

impl Odrive {
    /// An axis that is not found yet.
    #[must_use]
    pub fn new(node: OdriveNode) -> Self {
        Self {
            node,
            status: MotorStatus::default(),
            step: Step::Version,
            question: Question::default(),
            power: false,
            idle_wanted: false,
            tries: 0,
            velocity_radps: 0.0,
        }
    }

    fn frame(&self, command: u16, payload: &[u8]) -> CanFrame {
        let mut data = [0; 8];
        for (byte, value) in data.iter_mut().zip(payload) {
            *byte = *value;
        }
        CanFrame::standard_short(u16::from(self.node.node) << 5 | command, data, payload.len())
    }

    fn pair(&self, command: u16, first: [u8; 4], second: [u8; 4]) -> CanFrame {
        let ([a, b, c, d], [e, f, g, h]) = (first, second);
        self.frame(command, &[a, b, c, d, e, f, g, h])
    }

    fn read(&self, endpoint: u16) -> CanFrame {
        let [low, high] = endpoint.to_le_bytes();
        self.pair(command::WRITE_READ, [0, low, high, 0], [0; 4])
    }

    fn write(&self, endpoint: u16, value: [u8; 4], length: usize) -> CanFrame {
        let [low, high] = endpoint.to_le_bytes();
        let frame = self.pair(command::WRITE_READ, [1, low, high, 0], value);
        self.frame(command::WRITE_READ, frame.data().get(..4 + length).unwrap_or_default())
    }

    fn timeout_s(&self) -> f32 {
        self.node.watchdog_ms as f32 * 1e-3
    }

    fn next(&mut self, step: Step) {
        self.step = step;
        self.tries = 0;
        self.question.answered();
        self.status.problem = None;
    }

    fn halt(&mut self, stage: MotorStage, problem: MotorProblem) {
        self.step = Step::Halted;
        self.power = false;
        self.status.stage = stage;
        self.status.problem = Some(problem);
    }

    fn on_version(&mut self, data: &[u8; 8]) {
        let [_, _, _, _, major, minor, revision, _] = *data;
        if self.step != Step::Version {
            return;
        }
        let found = [major, minor, revision];
        if found == self.node.firmware {
            self.next(Step::Timeout);
        } else {
            self.halt(MotorStage::Refused, MotorProblem::Firmware { found });
        }
    }

    fn on_answer(&mut self, data: &[u8]) {
        let Some((&[_, low, high, _], value)) = data.split_first_chunk::<4>() else {
            self.status.bad += 1;
            return;
        };
        let endpoint = u16::from_le_bytes([low, high]);
        let wanted_ms = f64::from(self.node.watchdog_ms);
        match (self.step, value) {
            (Step::Timeout, [a, b, c, d]) if endpoint == self.node.watchdog_timeout_endpoint => {
                let seconds = f32::from_le_bytes([*a, *b, *c, *d]);
                // The same 32 bits must come back.
                if seconds.to_bits() == self.timeout_s().to_bits() {
                    self.next(Step::Watchdog);
                } else {
                    let read_ms = f64::from(seconds) * 1e3;
                    self.halt(MotorStage::Refused, MotorProblem::Watchdog { read_ms, wanted_ms });
                }
            }
            (Step::Watchdog, [on, ..]) if endpoint == self.node.enable_watchdog_endpoint => {
                if *on == 1 {
                    self.status.watchdog_ms = Some(wanted_ms);
                    self.next(Step::Feedback);
                } else {
                    self.halt(
                        MotorStage::Refused,
                        MotorProblem::Watchdog { read_ms: f64::NAN, wanted_ms },
                    );
                }
            }
            _ => {}
        }
    }

    fn on_heartbeat(&mut self, data: &[u8]) {
        // Seven or eight bytes, as the firmware has it.
        let [a, b, c, d, state, ..] = *data else {
            self.status.bad += 1;
            return;
        };
        let errors = u32::from_le_bytes([a, b, c, d]);
        match self.step {
            Step::ClosedLoop if errors == 0 && state == CLOSED_LOOP => {
                self.next(Step::Enabled);
                self.status.stage = MotorStage::Enabled;
            }
            Step::ClosedLoop => self.status.problem = (errors != 0).then(|| fault(errors)),
            Step::Enabled if errors != 0 => self.halt(MotorStage::Faulted, fault(errors)),
            Step::Enabled if state != CLOSED_LOOP => {
                let problem = MotorProblem::Fault {
                    code: u32::from(state),
                    meaning: "it left closed-loop control by itself",
                };
                self.halt(MotorStage::Faulted, problem);
            }
            _ => {}
        }
    }

    fn on_encoder(&mut self, data: &[u8; 8], time_ns: u64) {
        let [a, b, c, d, e, f, g, h] = *data;
        let (position, velocity) =
            (f32::from_le_bytes([a, b, c, d]), f32::from_le_bytes([e, f, g, h]));
        if !(position.is_finite() && velocity.is_finite()) {
            self.status.bad += 1;
            return;
        }
        self.status.position_rad = f64::from(position) * TAU;
        self.status.velocity_radps = f64::from(velocity) * TAU;
        self.status.feedback_ns = time_ns;
        if self.step == Step::Feedback {
            let step = if self.power { Step::ClosedLoop } else { Step::Ready };
            self.next(step);
            self.status.stage = if self.power { MotorStage::Enabling } else { MotorStage::Ready };
        }
    }

    /// Asks what this step needs to know.
    fn ask(&mut self, now_ns: u64, out: &mut Outbox) {
        let question = match self.step {
            Step::Version => "firmware version",
            Step::Timeout => "watchdog time",
            Step::Watchdog => "watchdog",
            Step::Feedback => "encoder (can.config.encoder_msg_rate_ms must be set)",
            Step::ClosedLoop => "closed-loop control",
            Step::Ready | Step::Enabled | Step::Halted => return,
        };
        let (now, again) = self.question.ask(now_ns);
        if !now {
            return;
        }
        if again && self.status.problem.is_none() {
            self.status.problem = Some(MotorProblem::NoAnswer { question });
        }
        let node = &self.node;
        let (timeout, enable) = (node.watchdog_timeout_endpoint, node.enable_watchdog_endpoint);
        let frames = match self.step {
            // Asks for no bytes, as ODrive's own library does (`ODriveCAN::request` of ODriveArduino). The answer has eight.
            Step::Version => [
                CanFrame::remote(
                    CanId::Standard((u16::from(node.node) << 5) | command::VERSION),
                    0,
                ),
                None,
                None,
            ],
            Step::Timeout => [
                Some(self.write(timeout, self.timeout_s().to_le_bytes(), 4)),
                Some(self.read(timeout)),
                None,
            ],
            Step::Watchdog => {
                [Some(self.write(enable, [1, 0, 0, 0], 1)), Some(self.read(enable)), None]
            }
            Step::ClosedLoop => {
                self.tries += 1;
                [
                    Some(self.frame(command::CLEAR_ERRORS, &[0])),
                    Some(self.pair(
                        command::MODES,
                        VELOCITY_CONTROL.to_le_bytes(),
                        PASSTHROUGH.to_le_bytes(),
                    )),
                    Some(self.frame(command::AXIS_STATE, &u32::from(CLOSED_LOOP).to_le_bytes())),
                ]
            }
            _ => [None; 3],
        };
        put(out, frames.into_iter().flatten());
    }
}

impl MotorProtocol for Odrive {
    fn receive(&mut self, frame: &CanFrame, time_ns: u64) -> bool {
        let CanId::Standard(id) = frame.id() else { return false };
        if id >> 5 != u16::from(self.node.node) || frame.is_remote() {
            return false;
        }
        let command = id & 0x1f;
        match (command, frame.eight()) {
            (command::VERSION, Some(data)) => self.on_version(data),
            (command::HEARTBEAT, _) => self.on_heartbeat(frame.data()),
            (command::ENCODER, Some(data)) => self.on_encoder(data, time_ns),
            (command::READ_ANSWER, _) => self.on_answer(frame.data()),
            (command::VERSION | command::ENCODER, None) => self.status.bad += 1,
            // Currents, temperatures and other messages that the controller may be told to send.
            _ => {}
        }
        true
    }

    fn tick(&mut self, now_ns: u64, out: &mut Outbox) {
        if self.step == Step::ClosedLoop && self.tries > ENABLE_TRIES {
            let unknown = MotorProblem::NoAnswer { question: "closed-loop control" };
            self.halt(MotorStage::Faulted, self.status.problem.unwrap_or(unknown));
        }
        // Fed first, so that the watchdog is fresh when errors are cleared.
        if self.status.watchdog_ms.is_some() {
            let radps = if self.step == Step::Enabled { self.velocity_radps } else { 0.0 };
            let velocity = (radps / TAU) as f32;
            put(out, [self.pair(command::VELOCITY, velocity.to_le_bytes(), [0; 4])]);
        }
        if std::mem::take(&mut self.idle_wanted) {
            put(out, [self.frame(command::AXIS_STATE, &u32::from(IDLE).to_le_bytes())]);
        }
        self.ask(now_ns, out);
    }

    fn set_velocity(&mut self, radps: f64) {
        self.velocity_radps = radps;
    }

    fn enable(&mut self) {
        if matches!(self.status.stage, MotorStage::Ready | MotorStage::Faulted) {
            self.restart();
            self.power = true;
            self.status.stage = MotorStage::Enabling;
        }
    }

    fn disable(&mut self) {
        self.power = false;
        self.idle_wanted = true;
        if matches!(self.status.stage, MotorStage::Enabled | MotorStage::Enabling) {
            self.next(Step::Version);
            self.status.stage = MotorStage::SettingUp;
        }
    }

    fn restart(&mut self) {
        self.next(Step::Version);
        self.power = false;
        self.status.stage = MotorStage::SettingUp;
        self.status.watchdog_ms = None;
    }

    fn status(&self) -> &MotorStatus {
        &self.status
    }
}

/// `ODrive.Error` of firmware 0.6, the most telling bit first.
fn fault(errors: u32) -> MotorProblem {
    const MEANINGS: [(u32, &str); 20] = [
        (0x0100_0000, "its watchdog expired: no command came in time"),
        (0x0200_0000, "an emergency stop was requested"),
        (0x0400_0000, "the motor spun out: check the encoder"),
        (0x0000_0020, "its gate driver failed"),
        (0x0000_0100, "its supply voltage is too high"),
        (0x0000_0200, "its supply voltage is too low"),
        (0x0000_0400, "its supply current is too high"),
        (0x0000_0800, "it feeds too much current back into the supply"),
        (0x0000_1000, "its motor current is too high"),
        (0x0000_2000, "its motor is too hot"),
        (0x0000_4000, "its inverter is too hot"),
        (0x0000_8000, "the motor turns too fast"),
        (0x0001_0000, "the motor is out of its position limits"),
        (0x0800_0000, "its brake resistor is disarmed"),
        (0x1000_0000, "a thermistor is disconnected"),
        (0x4000_0000, "its calibration failed"),
        (0x0000_0008, "it has no encoder estimate"),
        (0x0000_0010, "it is not configured"),
        (0x0000_0001, "it is starting"),
        (0x0000_0004, "it missed its own timing"),
    ];
    let meaning = MEANINGS
        .iter()
        .find(|(bit, _)| errors & bit != 0)
        .map_or("an error of its own", |(_, meaning)| meaning);
    MotorProblem::Fault { code: errors, meaning }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NODE: OdriveNode = OdriveNode {
        node: 3,
        firmware: [0, 6, 10],
        enable_watchdog_endpoint: 195,
        watchdog_timeout_endpoint: 196,
        watchdog_ms: 100,
    };

    fn sent(motor: &mut Odrive, now_ns: u64) -> Vec<String> {
        let mut out = Outbox::new();
        motor.tick(now_ns, &mut out);
        out.iter().map(ToString::to_string).collect()
    }

    fn hears(motor: &mut Odrive, id: u16, data: &[u8]) -> bool {
        motor.receive(&CanFrame::new(CanId::Standard(id), data).expect("sound"), 5)
    }

    #[test]
    fn the_watchdog_is_written_and_read_back_before_the_motor_is_ready() {
        let mut motor = Odrive::new(NODE);
        assert_eq!(sent(&mut motor, 0), ["060#R0"]);
        assert!(hears(&mut motor, 0x060, &[2, 4, 4, 58, 0, 6, 10, 0]));
        assert_eq!(sent(&mut motor, 1), ["064#01C40000CDCCCC3D", "064#00C4000000000000"]);
        hears(&mut motor, 0x065, &[0, 196, 0, 0, 0xcd, 0xcc, 0xcc, 0x3d]);
        assert_eq!(sent(&mut motor, 2), ["064#01C3000001", "064#00C3000000000000"]);
        assert_eq!(motor.status().watchdog_ms, None);
        hears(&mut motor, 0x065, &[0, 195, 0, 0, 1]);
        assert_eq!(motor.status().watchdog_ms, Some(100.0));
        assert_eq!(motor.status().stage, MotorStage::SettingUp);
        hears(&mut motor, 0x069, &[0; 8]);
        assert_eq!(motor.status().stage, MotorStage::Ready);
    }

    #[test]
    fn other_firmware_is_refused() {
        let mut motor = Odrive::new(NODE);
        hears(&mut motor, 0x060, &[2, 4, 4, 58, 0, 6, 9, 0]);
        assert_eq!(motor.status().problem, Some(MotorProblem::Firmware { found: [0, 6, 9] }));
        motor.enable();
        assert_eq!(motor.status().stage, MotorStage::Refused);
    }

    #[test]
    fn frames_of_other_nodes_are_not_ours() {
        let mut motor = Odrive::new(NODE);
        assert!(!hears(&mut motor, 0x080, &[2, 4, 4, 58, 0, 6, 10, 0]));
        assert!(!motor.receive(&CanFrame::extended_short(0x060, [0; 8], 8), 0));
    }

    #[test]
    fn an_estimate_that_is_not_finite_is_not_feedback() {
        let mut motor = Odrive::new(NODE);
        let nan = f32::NAN.to_le_bytes();
        hears(&mut motor, 0x069, &[nan, nan].concat());
        assert_eq!((motor.status().feedback_ns, motor.status().bad), (0, 1));
    }
}
