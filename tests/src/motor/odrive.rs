//! A simulated ODrive axis, firmware 0.6.10 (ODrive, "CAN Protocol").
//!
//! Its watchdog is fed by `Set_Input_Vel` only, also runs while the axis is idle, and disarms the
//! axis when it expires. The wheel then coasts, as with a real ODrive.

use std::f64::consts::TAU;

use drivers::can::{CanFrame, CanId};

use super::node::{MotorNode, NodeFaults, Periodic, Watchdog, elapsed_s, standard};
use super::wheel::{Drive, Wheel};

/// Endpoint of `axis0.config.enable_watchdog` of the simulated firmware. Real numbers come from
/// `flat_endpoints.json`.
pub const ENABLE_WATCHDOG_ENDPOINT: u16 = 195;
/// Endpoint of `axis0.config.watchdog_timeout`.
pub const WATCHDOG_TIMEOUT_ENDPOINT: u16 = 196;
/// Its answer to `Get_Version`.
pub const FIRMWARE: [u8; 3] = [0, 6, 10];

const WATCHDOG_EXPIRED: u32 = 0x0100_0000;
const DRV_FAULT: u32 = 0x0000_0020;
const IDLE: u8 = 1;
const CLOSED_LOOP: u8 = 8;

#[derive(Debug)]
pub struct OdriveSim {
    node: u16,
    wheel: Wheel,
    faults: NodeFaults,
    watchdog: Watchdog,
    timeout_s: f32,
    watchdog_on: bool,
    errors: u32,
    state: u8,
    velocity_mode: bool,
    input_turns_per_s: f32,
    last_ns: u64,
    encoder: Periodic,
    heartbeat: Periodic,
    report: Periodic,
    answers: Vec<CanFrame>,
}

impl OdriveSim {
    /// An axis with the factory setting: watchdog off.
    #[must_use]
    pub fn new(node: u8) -> Self {
        Self {
            node: u16::from(node) << 5,
            wheel: Wheel::default(),
            faults: NodeFaults::default(),
            watchdog: Watchdog::default(),
            timeout_s: 0.0,
            watchdog_on: false,
            errors: 0,
            state: IDLE,
            velocity_mode: false,
            input_turns_per_s: 0.0,
            last_ns: 0,
            encoder: Periodic::milliseconds(10),
            heartbeat: Periodic::milliseconds(100),
            report: Periodic::milliseconds(1000),
            answers: Vec::new(),
        }
    }

    fn on_parameter(&mut self, data: &[u8], now_ns: u64) {
        let [opcode, low, high, _, value @ ..] = data else { return };
        let endpoint = u16::from_le_bytes([*low, *high]);
        match (opcode, endpoint, value) {
            (1, ENABLE_WATCHDOG_ENDPOINT, [on, ..]) => {
                self.watchdog_on = *on != 0;
                self.watchdog.feed(now_ns);
            }
            (1, WATCHDOG_TIMEOUT_ENDPOINT, [a, b, c, d]) if !self.faults.forgets_watchdog => {
                self.timeout_s = f32::from_le_bytes([*a, *b, *c, *d]);
            }
            (0, ENABLE_WATCHDOG_ENDPOINT, _) => {
                self.answer(endpoint, &[u8::from(self.watchdog_on)]);
            }
            (0, WATCHDOG_TIMEOUT_ENDPOINT, _) => {
                self.answer(endpoint, &self.timeout_s.to_le_bytes());
            }
            _ => {}
        }
        let on = self.watchdog_on && self.timeout_s > 0.0;
        self.watchdog.limit_ns = on.then_some((f64::from(self.timeout_s) * 1e9) as u64);
    }

    fn answer(&mut self, endpoint: u16, value: &[u8]) {
        let [low, high] = endpoint.to_le_bytes();
        self.answers.push(standard(self.node | 0x05, &[&[0, low, high, 0], value].concat()));
    }

    fn disarm(&mut self, error: u32) {
        self.errors |= error;
        self.state = IDLE;
    }
}

impl MotorNode for OdriveSim {
    fn receive(&mut self, frame: &CanFrame, now_ns: u64) {
        let CanId::Standard(id) = frame.id() else { return };
        if id & !0x1f != self.node {
            return;
        }
        match (id & 0x1f, frame.data()) {
            (0x00, _) if frame.is_remote() => {
                let [major, minor, revision] = FIRMWARE;
                self.answers.push(standard(id, &[2, 4, 4, 58, major, minor, revision, 0]));
            }
            (0x02, _) => self.disarm(0x0200_0000),
            (0x04, data) => self.on_parameter(data, now_ns),
            (0x07, [state, 0, 0, 0, ..]) => match *state {
                CLOSED_LOOP if self.errors == 0 && self.velocity_mode => self.state = CLOSED_LOOP,
                IDLE => self.state = IDLE,
                _ => {}
            },
            (0x0b, [mode, 0, 0, 0, input, 0, 0, 0]) => {
                self.velocity_mode = (*mode, *input) == (2, 1);
            }
            (0x0d, [a, b, c, d, ..]) => {
                self.input_turns_per_s = f32::from_le_bytes([*a, *b, *c, *d]);
                self.watchdog.feed(now_ns);
            }
            (0x18, _) => self.errors = 0,
            _ => {}
        }
    }

    fn step(&mut self, now_ns: u64, out: &mut Vec<CanFrame>) {
        if self.faults.reboot {
            let node = (self.node >> 5) as u8;
            let faults = NodeFaults { reboot: false, ..self.faults };
            *self = Self {
                wheel: self.wheel.clone(),
                last_ns: self.last_ns,
                faults,
                ..Self::new(node)
            };
        }
        if self.watchdog.expires(now_ns) {
            self.disarm(WATCHDOG_EXPIRED);
        }
        if self.faults.broken {
            self.disarm(DRV_FAULT);
        }
        let driven = self.state == CLOSED_LOOP;
        let velocity = f64::from(self.input_turns_per_s) * TAU;
        self.wheel.set_drive(if driven { Drive::Velocity(velocity) } else { Drive::Coast });
        self.wheel.step(elapsed_s(&mut self.last_ns, now_ns));
        if self.faults.silent {
            self.answers.clear();
            return;
        }
        out.append(&mut self.answers);
        if self.encoder.is_due(now_ns) {
            let (velocity, position) = self.wheel.measured();
            let rotations = [position, velocity].map(|value| ((value / TAU) as f32).to_le_bytes());
            out.push(standard(self.node | 0x09, &rotations.concat()));
        }
        if self.report.is_due(now_ns) {
            let supply = self.faults.supply;
            for (command, values) in [
                (0x15, [supply.inverter_c, supply.motor_c]),
                (0x17, [supply.voltage_v, supply.current_a]),
            ] {
                let bytes = values.map(|value| (value as f32).to_le_bytes());
                out.push(standard(self.node | command, &bytes.concat()));
            }
        }
        if self.heartbeat.is_due(now_ns) {
            out.push(standard(
                self.node | 0x01,
                &[&self.errors.to_le_bytes()[..], &[self.state, 0, 0, 0]].concat(),
            ));
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
        self.state == CLOSED_LOOP
    }
}
