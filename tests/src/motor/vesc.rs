//! A simulated VESC: status messages 1, 4 and 5, commands, its application configuration, and its
//! time-out with a brake current.

use std::f64::consts::TAU;

use drivers::can::{CanFrame, CanId};

use super::node::{MotorNode, NodeFaults, Periodic, Watchdog, elapsed_s, extended};
use super::wheel::{Drive, Wheel};

/// Pole pairs of the simulated motor.
pub const POLE_PAIRS: u8 = 7;
/// `s_pid_min_erpm`: slower speeds release the motor. It is set to a low value, as on robots.
const LOWEST_ERPM: i32 = 10;

#[derive(Debug)]
pub struct VescSim {
    node: u8,
    wheel: Wheel,
    faults: NodeFaults,
    watchdog: Watchdog,
    /// `timeout_msec` of its configuration.
    pub timeout_ms: u32,
    /// `timeout_brake_current` of its configuration, A.
    pub timeout_brake_a: f32,
    command: Drive,
    last_ns: u64,
    status: Periodic,
    answers: Vec<CanFrame>,
}

impl VescSim {
    /// A VESC with the time-out that the driver requires.
    #[must_use]
    pub fn new(node: u8) -> Self {
        Self {
            node,
            wheel: Wheel::default(),
            faults: NodeFaults::default(),
            watchdog: Watchdog::default(),
            timeout_ms: 100,
            timeout_brake_a: 5.0,
            command: Drive::Coast,
            last_ns: 0,
            status: Periodic::milliseconds(10),
            answers: Vec::new(),
        }
    }

    fn fault_code(&self) -> u8 {
        if self.faults.broken { 3 } else { 0 }
    }

    /// `confgenerator_serialize_appconf`; only its first fields have a meaning here.
    fn configuration(&self) -> Vec<u8> {
        let milliseconds = if self.faults.forgets_watchdog { 1000 } else { self.timeout_ms };
        let mut bytes = vec![17];
        bytes.extend(486_554_156u32.to_be_bytes());
        bytes.push(self.node);
        bytes.extend(milliseconds.to_be_bytes());
        bytes.extend(self.timeout_brake_a.to_be_bytes());
        bytes.extend((0..480u16).map(|k| (k * 7) as u8));
        bytes
    }

    /// `comm_can_send_buffer` for more than 6 bytes.
    fn send_long(&mut self, to: u8, bytes: &[u8]) {
        let to = u32::from(to);
        let mut at = 0;
        while at < bytes.len() {
            let (kind, capacity) = if at <= 255 { (5, 7) } else { (6, 6) };
            let chunk = &bytes[at..bytes.len().min(at + capacity)];
            let offset =
                if at <= 255 { vec![at as u8] } else { (at as u16).to_be_bytes().to_vec() };
            self.answers.push(extended(kind << 8 | to, &[offset, chunk.to_vec()].concat()));
            at += chunk.len();
        }
        let length = (bytes.len() as u16).to_be_bytes();
        let crc = crc16(bytes).to_be_bytes();
        self.answers
            .push(extended(7 << 8 | to, &[self.node, 1, length[0], length[1], crc[0], crc[1]]));
    }
}

/// The table-free form of the firmware's `crc16`.
fn crc16(bytes: &[u8]) -> u16 {
    let mut crc = 0u16;
    for byte in bytes {
        crc = crc.rotate_left(8) ^ u16::from(*byte);
        crc ^= (crc & 0xff) >> 4;
        crc ^= crc << 12;
        crc ^= (crc & 0xff) << 5;
    }
    crc
}

impl MotorNode for VescSim {
    fn receive(&mut self, frame: &CanFrame, now_ns: u64) {
        let CanId::Extended(id) = frame.id() else { return };
        if id & 0xff != u32::from(self.node) {
            return;
        }
        match (id >> 8, frame.data()) {
            (3, [a, b, c, d]) => {
                let erpm = i32::from_be_bytes([*a, *b, *c, *d]);
                let velocity = f64::from(erpm) / f64::from(POLE_PAIRS) / 60.0 * TAU;
                self.command =
                    if erpm.abs() < LOWEST_ERPM { Drive::Coast } else { Drive::Velocity(velocity) };
                self.watchdog.feed(now_ns);
            }
            (1 | 2, [a, b, c, d]) => {
                let brakes = i32::from_be_bytes([*a, *b, *c, *d]) != 0 && id >> 8 == 2;
                self.command = if brakes { Drive::Brake } else { Drive::Coast };
                self.watchdog.feed(now_ns);
            }
            (8, [from, 0, 17]) => self.send_long(*from, &self.configuration()),
            (8, [from, 0, 50, 0, 0, 0x80, 0]) => {
                let answer = [self.node, 1, 50, 0, 0, 0x80, 0, self.fault_code()];
                self.answers.push(extended(8 << 8 | u32::from(*from), &answer));
            }
            _ => {}
        }
    }

    fn step(&mut self, now_ns: u64, out: &mut Vec<CanFrame>) {
        if std::mem::take(&mut self.faults.reboot) {
            self.command = Drive::Coast;
        }
        self.watchdog.limit_ns =
            (self.timeout_ms > 0).then_some(u64::from(self.timeout_ms) * 1_000_000);
        if self.watchdog.expires(now_ns) {
            self.command = if self.timeout_brake_a > 0.0 { Drive::Brake } else { Drive::Coast };
        }
        self.wheel.set_drive(if self.faults.broken { Drive::Coast } else { self.command });
        self.wheel.step(elapsed_s(&mut self.last_ns, now_ns));
        if self.faults.silent {
            self.answers.clear();
            return;
        }
        out.append(&mut self.answers);
        if self.status.is_due(now_ns) {
            let (velocity, position) = self.wheel.measured();
            let rotations_per_s = velocity / TAU;
            let erpm = (rotations_per_s * 60.0 * f64::from(POLE_PAIRS)).round() as i32;
            let steps = (position / TAU * 6.0 * f64::from(POLE_PAIRS)).floor() as i32;
            let node = u32::from(self.node);
            let supply = self.faults.supply;
            let voltage = tenths(supply.voltage_v);
            let status_5 = [&steps.to_be_bytes()[..], &voltage, &[0, 0]].concat();
            out.push(extended(27 << 8 | node, &status_5));
            let status_4 =
                [supply.inverter_c, supply.motor_c, supply.current_a, 0.0].map(tenths).concat();
            out.push(extended(16 << 8 | node, &status_4));
            let status = [&erpm.to_be_bytes()[..], &[0, 0, 0, 0]].concat();
            out.push(extended(9 << 8 | node, &status));
        }
    }

    fn wheel(&self) -> &Wheel {
        &self.wheel
    }

    fn wheel_mut(&mut self) -> &mut Wheel {
        &mut self.wheel
    }

    fn faults(&mut self) -> &mut NodeFaults {
        &mut self.faults
    }

    fn watchdog(&self) -> &Watchdog {
        &self.watchdog
    }

    fn is_powered(&self) -> bool {
        matches!(self.command, Drive::Velocity(_))
    }
}

fn tenths(value: f64) -> [u8; 2] {
    ((10.0 * value).round() as i16).to_be_bytes()
}
