//! ODrive's CANSimple (ODrive, "CAN Protocol", firmware 0.6). Standard ids: node number times 32
//! plus a command. Little endian.
//!
//! The watchdog is configured by two parameters, whose endpoint numbers differ between firmware
//! versions. Therefore the driver reads the firmware version first, which must be the configured
//! one. `Set_Input_Vel` feeds the watchdog. The controller must be configured to send its encoder
//! estimates every 10 to 50 ms (`can.config.encoder_msg_rate_ms`) and its heartbeat at least every
//! 100 ms. For the battery's voltage and the temperatures it must also be configured to send
//! `Get_Bus_Voltage_Current` and `Get_Temperature` at least every second
//! (`can.config.bus_voltage_msg_rate_ms`, `can.config.temperature_msg_rate_ms`).

use std::f64::consts::TAU;

use super::{Due, MotorProblem, MotorProtocol, MotorStage, MotorStatus, Outbox, SetupRequest, put};
use crate::can::frame::{CanFrame, CanId};

/// The commands that this driver uses.
mod command {
    pub const VERSION: u16 = 0x00;
    pub const HEARTBEAT: u16 = 0x01;
    pub const WRITE_READ: u16 = 0x04;
    pub const READ_RESPONSE: u16 = 0x05;
    pub const AXIS_STATE: u16 = 0x07;
    pub const ENCODER: u16 = 0x09;
    pub const MODES: u16 = 0x0b;
    pub const VELOCITY: u16 = 0x0d;
    pub const TEMPERATURE: u16 = 0x15;
    pub const BUS_SUPPLY: u16 = 0x17;
    pub const CLEAR_ERRORS: u16 = 0x18;
}

const IDLE: u8 = 1;
const CLOSED_LOOP: u8 = 8;
const VELOCITY_CONTROL: u32 = 2;
const PASSTHROUGH: u32 = 1;
/// How often closed-loop control is requested, every 100 ms, before enabling fails.
const ENABLE_TRIES: u8 = 10;

/// The configuration of one ODrive axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OdriveNode {
    /// Node id of the axis, 0 to 62.
    pub node: u8,
    /// Required firmware version: major, minor, revision.
    pub firmware: [u8; 3],
    /// Endpoint of `axis0.config.enable_watchdog` in `flat_endpoints.json` of that firmware.
    pub enable_watchdog_endpoint: u16,
    /// Endpoint of `axis0.config.watchdog_timeout`.
    pub watchdog_timeout_endpoint: u16,
    /// Watchdog time to write.
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
    /// The axis is faulted or refused.
    Halted,
}

/// The state machine of one axis.
#[derive(Debug)]
pub struct Odrive {
    node: OdriveNode,
    status: MotorStatus,
    step: Step,
    request: SetupRequest,
    power: bool,
    idle_requested: bool,
    tries: u8,
    velocity_radps: f64,
}

impl Odrive {
    /// The state machine of an axis that has not responded yet.
    #[must_use]
    pub fn new(node: OdriveNode) -> Self {
        Self {
            node,
            status: MotorStatus::default(),
            step: Step::Version,
            request: SetupRequest::default(),
            power: false,
            idle_requested: false,
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
        let [a, b, c, d] = first;
        let [e, f, g, h] = second;
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

    fn enter(&mut self, step: Step) {
        self.step = step;
        self.tries = 0;
        self.request.answered();
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
            self.enter(Step::Timeout);
        } else {
            self.halt(MotorStage::Refused, MotorProblem::Firmware { found });
        }
    }

    fn on_response(&mut self, data: &[u8]) {
        let Some((&[_, low, high, _], value)) = data.split_first_chunk::<4>() else {
            self.status.bad += 1;
            return;
        };
        let endpoint = u16::from_le_bytes([low, high]);
        let required_ms = f64::from(self.node.watchdog_ms);
        match (self.step, value) {
            (Step::Timeout, [a, b, c, d]) if endpoint == self.node.watchdog_timeout_endpoint => {
                let seconds = f32::from_le_bytes([*a, *b, *c, *d]);
                // The same 32 bits must be read back.
                if seconds.to_bits() == self.timeout_s().to_bits() {
                    self.enter(Step::Watchdog);
                } else {
                    let read_ms = f64::from(seconds) * 1e3;
                    self.halt(MotorStage::Refused, MotorProblem::Watchdog { read_ms, required_ms });
                }
            }
            (Step::Watchdog, [on, ..]) if endpoint == self.node.enable_watchdog_endpoint => {
                if *on == 1 {
                    self.status.watchdog_ms = Some(required_ms);
                    self.enter(Step::Feedback);
                } else {
                    self.halt(
                        MotorStage::Refused,
                        MotorProblem::Watchdog { read_ms: f64::NAN, required_ms },
                    );
                }
            }
            _ => {}
        }
    }

    fn on_heartbeat(&mut self, data: &[u8]) {
        // Seven or eight bytes, depending on the firmware.
        let [a, b, c, d, state, ..] = *data else {
            self.status.bad += 1;
            return;
        };
        let errors = u32::from_le_bytes([a, b, c, d]);
        match self.step {
            Step::ClosedLoop if errors == 0 && state == CLOSED_LOOP => {
                self.enter(Step::Enabled);
                self.status.stage = MotorStage::Enabled;
            }
            Step::ClosedLoop => self.status.problem = (errors != 0).then(|| fault(errors)),
            Step::Enabled if errors != 0 => self.halt(MotorStage::Faulted, fault(errors)),
            Step::Enabled if state != CLOSED_LOOP => {
                let problem = MotorProblem::Fault {
                    code: u32::from(state),
                    meaning: "it left closed-loop control without a command",
                };
                self.halt(MotorStage::Faulted, problem);
            }
            _ => {}
        }
    }

    fn on_encoder(&mut self, data: &[u8; 8], time_ns: u64) {
        let [a, b, c, d, e, f, g, h] = *data;
        let position = f32::from_le_bytes([a, b, c, d]);
        let velocity = f32::from_le_bytes([e, f, g, h]);
        if !(position.is_finite() && velocity.is_finite()) {
            self.status.bad += 1;
            return;
        }
        self.status.position_rad = f64::from(position) * TAU;
        self.status.velocity_radps = f64::from(velocity) * TAU;
        self.status.feedback_ns = time_ns;
        if self.step == Step::Feedback {
            let step = if self.power { Step::ClosedLoop } else { Step::Ready };
            self.enter(step);
            self.status.stage = if self.power { MotorStage::Enabling } else { MotorStage::Ready };
        }
    }

    /// Inverter and motor temperature, degrees Celsius.
    fn on_temperature(&mut self, data: &[u8; 8], time_ns: u64) {
        self.status.power.temperatures(two_floats(data), time_ns);
    }

    /// Voltage and current of the supply, V and A.
    fn on_supply(&mut self, data: &[u8; 8], time_ns: u64) {
        let [voltage_v, current_a] = two_floats(data);
        self.status.power.voltage(voltage_v, time_ns);
        self.status.power.current(current_a, time_ns);
    }

    /// Sends the requests of the current set-up step when they are due.
    fn send_requests(&mut self, now_ns: u64, out: &mut Outbox) {
        let request = match self.step {
            Step::Version => "firmware version",
            Step::Timeout => "watchdog time",
            Step::Watchdog => "watchdog",
            Step::Feedback => "encoder (can.config.encoder_msg_rate_ms must be set)",
            Step::ClosedLoop => "closed-loop control",
            Step::Ready | Step::Enabled | Step::Halted => return,
        };
        let due = self.request.due(now_ns);
        if due == Due::No {
            return;
        }
        if due == Due::Repeat && self.status.problem.is_none() {
            self.status.problem = Some(MotorProblem::NoResponse { request });
        }
        let node = &self.node;
        let timeout = node.watchdog_timeout_endpoint;
        let enable = node.enable_watchdog_endpoint;
        let frames = match self.step {
            // A remote frame of length 0, as sent by ODrive's own library (`ODriveCAN::request` of
            // ODriveArduino). The response has eight bytes.
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
            (command::READ_RESPONSE, _) => self.on_response(frame.data()),
            (command::TEMPERATURE, Some(data)) => self.on_temperature(data, time_ns),
            (command::BUS_SUPPLY, Some(data)) => self.on_supply(data, time_ns),
            (
                command::VERSION | command::ENCODER | command::TEMPERATURE | command::BUS_SUPPLY,
                None,
            ) => self.status.bad += 1,
            // Motor currents and other messages that the controller may be configured to send.
            _ => {}
        }
        true
    }

    fn tick(&mut self, now_ns: u64, out: &mut Outbox) {
        if self.step == Step::ClosedLoop && self.tries > ENABLE_TRIES {
            let unknown = MotorProblem::NoResponse { request: "closed-loop control" };
            self.halt(MotorStage::Faulted, self.status.problem.unwrap_or(unknown));
        }
        // The velocity is sent first, so that the watchdog has been fed when errors are cleared.
        if self.status.watchdog_ms.is_some() {
            let radps = if self.step == Step::Enabled { self.velocity_radps } else { 0.0 };
            let velocity = (radps / TAU) as f32;
            put(out, [self.pair(command::VELOCITY, velocity.to_le_bytes(), [0; 4])]);
        }
        if std::mem::take(&mut self.idle_requested) {
            put(out, [self.frame(command::AXIS_STATE, &u32::from(IDLE).to_le_bytes())]);
        }
        self.send_requests(now_ns, out);
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
        self.idle_requested = true;
        if matches!(self.status.stage, MotorStage::Enabled | MotorStage::Enabling) {
            self.enter(Step::Version);
            self.status.stage = MotorStage::SettingUp;
        }
    }

    fn finish(&mut self, out: &mut Outbox) {
        // The watchdog also runs while the axis is idle, and its error would stay until the next
        // start.
        put(out, [self.write(self.node.enable_watchdog_endpoint, [0; 4], 1)]);
    }

    fn restart(&mut self) {
        self.enter(Step::Version);
        self.power = false;
        self.status.stage = MotorStage::SettingUp;
        self.status.watchdog_ms = None;
    }

    fn status(&self) -> &MotorStatus {
        &self.status
    }
}

/// Two IEEE 754 numbers of 32 bits.
fn two_floats(data: &[u8; 8]) -> [f64; 2] {
    let [a, b, c, d, e, f, g, h] = *data;
    [[a, b, c, d], [e, f, g, h]].map(|bytes| f64::from(f32::from_le_bytes(bytes)))
}

/// The bits of `ODrive.Error` of firmware 0.6, the most specific first.
fn fault(errors: u32) -> MotorProblem {
    const MEANINGS: [(u32, &str); 20] = [
        (0x0100_0000, "its watchdog expired: no command arrived in time"),
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
        (0x0000_8000, "the motor rotates too fast"),
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

    fn deliver(motor: &mut Odrive, id: u16, data: &[u8]) -> bool {
        motor.receive(&CanFrame::new(CanId::Standard(id), data).expect("a valid frame"), 5)
    }

    #[test]
    fn the_watchdog_is_written_and_read_back_before_the_motor_is_ready() {
        let mut motor = Odrive::new(NODE);
        assert_eq!(sent(&mut motor, 0), ["060#R0"]);
        assert!(deliver(&mut motor, 0x060, &[2, 4, 4, 58, 0, 6, 10, 0]));
        assert_eq!(sent(&mut motor, 1), ["064#01C40000CDCCCC3D", "064#00C4000000000000"]);
        deliver(&mut motor, 0x065, &[0, 196, 0, 0, 0xcd, 0xcc, 0xcc, 0x3d]);
        assert_eq!(sent(&mut motor, 2), ["064#01C3000001", "064#00C3000000000000"]);
        assert_eq!(motor.status().watchdog_ms, None);
        deliver(&mut motor, 0x065, &[0, 195, 0, 0, 1]);
        assert_eq!(motor.status().watchdog_ms, Some(100.0));
        assert_eq!(motor.status().stage, MotorStage::SettingUp);
        deliver(&mut motor, 0x069, &[0; 8]);
        assert_eq!(motor.status().stage, MotorStage::Ready);
    }

    #[test]
    fn firmware_other_than_the_configured_one_is_refused() {
        let mut motor = Odrive::new(NODE);
        deliver(&mut motor, 0x060, &[2, 4, 4, 58, 0, 6, 9, 0]);
        assert_eq!(motor.status().problem, Some(MotorProblem::Firmware { found: [0, 6, 9] }));
        motor.enable();
        assert_eq!(motor.status().stage, MotorStage::Refused);
    }

    #[test]
    fn frames_of_other_nodes_are_not_accepted() {
        let mut motor = Odrive::new(NODE);
        assert!(!deliver(&mut motor, 0x080, &[2, 4, 4, 58, 0, 6, 10, 0]));
        assert!(!motor.receive(&CanFrame::extended_short(0x060, [0; 8], 8), 0));
    }

    #[test]
    fn supply_and_temperatures_are_those_of_the_protocols_messages() {
        let mut motor = Odrive::new(NODE);
        // Get_Bus_Voltage_Current (0x17): 24.0 V, 1.5 A. Get_Temperature (0x15): 45.0, 61.5 degrees.
        deliver(&mut motor, 0x077, &[0, 0, 0xc0, 0x41, 0, 0, 0xc0, 0x3f]);
        deliver(&mut motor, 0x075, &[0, 0, 0x34, 0x42, 0, 0, 0x76, 0x42]);
        let report = motor.status().power.report(5);
        assert_eq!(report.voltage_v, Some(24.0));
        assert_eq!(report.current_a, Some(1.5));
        assert_eq!(report.temperature_c, Some(61.5));
        deliver(&mut motor, 0x077, &[0; 4]);
        assert_eq!(motor.status().bad, 1);
        assert_eq!(motor.status().power.report(5).voltage_v, Some(24.0));
    }

    #[test]
    fn an_estimate_that_is_not_finite_is_not_feedback() {
        let mut motor = Odrive::new(NODE);
        let nan = f32::NAN.to_le_bytes();
        deliver(&mut motor, 0x069, &[nan, nan].concat());
        assert_eq!((motor.status().feedback_ns, motor.status().bad), (0, 1));
    }
}
