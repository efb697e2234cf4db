//! A motor protocol for an invented controller, to copy when adding a real one. Its two messages:
//!
//! ```text
//! command  id 0x100 + node  [flags, watchdog ms, velocity in mrad/s as i32]
//! status   id 0x180 + node  [flags, watchdog ms, velocity in 0.01 rad/s as i16,
//!                            position in mrad as i32]
//! ```
//!
//! All numbers are little endian. Bit 0 of the flags is "powered", bit 1 of the status is "fault".
//! The controller sends its status every 10 ms, and repeats in it the watchdog time of the last
//! command.
//!
//! ```text
//! cargo run -p drivers --example new_motor_protocol
//! ```

use drivers::can::protocol::{
    Due, MotorProblem, MotorProtocol, MotorStage, MotorStatus, Outbox, SetupRequest,
    UnwrappedCounter,
};
use drivers::can::{CanFrame, CanId};

const COMMAND: u16 = 0x100;
const STATUS: u16 = 0x180;
const POWERED: u8 = 0x01;
const FAULT: u8 = 0x02;

#[derive(Debug)]
struct AcmeMotor {
    node: u8,
    watchdog_ms: u8,
    status: MotorStatus,
    setup: SetupRequest,
    position: UnwrappedCounter,
    velocity_radps: f64,
    power: bool,
}

impl AcmeMotor {
    fn new(node: u8, watchdog_ms: u8) -> Self {
        Self {
            node,
            watchdog_ms,
            status: MotorStatus::default(),
            setup: SetupRequest::default(),
            position: UnwrappedCounter::default(),
            velocity_radps: 0.0,
            power: false,
        }
    }

    fn encode_command(&self, radps: f64) -> CanFrame {
        let flags = if self.power { POWERED } else { 0 };
        let [v0, v1, v2, v3] = ((radps * 1e3).round() as i32).to_le_bytes();
        let data = [flags, self.watchdog_ms, v0, v1, v2, v3, 0, 0];
        CanFrame::standard_short(COMMAND + u16::from(self.node), data, 6)
    }

    fn on_status(&mut self, data: &[u8; 8], time_ns: u64) {
        let [flags, watchdog_ms, v0, v1, p0, p1, p2, p3] = *data;
        let count = self.position.update(i32::from_le_bytes([p0, p1, p2, p3]));
        self.status.position_rad = count as f64 * 1e-3;
        self.status.velocity_radps = f64::from(i16::from_le_bytes([v0, v1])) * 1e-2;
        self.status.feedback_ns = time_ns;
        self.setup.answered();

        // The controller confirms its watchdog in every status. Until it does, the motor is not
        // ready.
        if watchdog_ms != self.watchdog_ms {
            return;
        }
        self.status.watchdog_ms = Some(f64::from(watchdog_ms));
        self.status.problem = None;
        let powered = flags & POWERED != 0;
        let next = match self.status.stage {
            _ if flags & FAULT != 0 => MotorStage::Faulted,
            MotorStage::SettingUp => MotorStage::Ready,
            MotorStage::Enabling if powered => MotorStage::Enabled,
            // The controller removed power without a command.
            MotorStage::Enabled if !powered => MotorStage::Faulted,
            stage => stage,
        };
        if next == MotorStage::Faulted {
            self.power = false;
            let meaning = "see the controller's display";
            self.status.problem = Some(MotorProblem::Fault { code: u32::from(flags), meaning });
        }
        self.status.stage = next;
    }
}

impl MotorProtocol for AcmeMotor {
    fn receive(&mut self, frame: &CanFrame, time_ns: u64) -> bool {
        if frame.id() != CanId::Standard(STATUS + u16::from(self.node)) || frame.is_remote() {
            return false;
        }
        match frame.eight() {
            Some(data) => self.on_status(data, time_ns),
            None => self.status.bad += 1,
        }
        true
    }

    fn tick(&mut self, now_ns: u64, out: &mut Outbox) {
        if self.status.watchdog_ms.is_none() && self.setup.due(now_ns) == Due::Repeat {
            self.status.problem = Some(MotorProblem::NoResponse { request: "watchdog" });
        }
        let is_enabled = self.status.stage == MotorStage::Enabled;
        let radps = if is_enabled { self.velocity_radps } else { 0.0 };
        // The command also sets and feeds the watchdog, so it is sent in every tick. The outbox has
        // capacity for it, because the base passes an empty one.
        _ = out.push(self.encode_command(radps));
    }

    fn set_velocity(&mut self, radps: f64) {
        self.velocity_radps = radps;
    }

    fn enable(&mut self) {
        if matches!(self.status.stage, MotorStage::Ready | MotorStage::Faulted) {
            self.power = true;
            self.status.stage = MotorStage::Enabling;
        }
    }

    fn disable(&mut self) {
        self.restart();
    }

    fn restart(&mut self) {
        self.power = false;
        self.setup = SetupRequest::default();
        self.status.stage = MotorStage::SettingUp;
        self.status.watchdog_ms = None;
    }

    fn status(&self) -> &MotorStatus {
        &self.status
    }
}

/// Prints the frames of one tick as `candump` prints them.
fn print_tick(motor: &mut AcmeMotor, now_ns: u64) {
    let mut out = Outbox::new();
    motor.tick(now_ns, &mut out);
    for frame in &out {
        println!("{:?}: {frame}", motor.status().stage);
    }
}

fn main() {
    let mut motor = AcmeMotor::new(5, 100);
    // The controller has not responded yet: the command requests the watchdog time of 100 ms
    // (0x64).
    print_tick(&mut motor, 0);

    // The controller stands still at 1.5 rad and confirms the watchdog, so the motor becomes ready.
    motor.receive(&CanFrame::standard(0x185, [0, 100, 0, 0, 0xdc, 0x05, 0, 0]), 10_000_000);
    print_tick(&mut motor, 10_000_000);

    // After the request to enable, a status with the flag "powered" makes the motor follow
    // velocities.
    motor.enable();
    print_tick(&mut motor, 20_000_000);
    motor.receive(&CanFrame::standard(0x185, [POWERED, 100, 0, 0, 0xdc, 0x05, 0, 0]), 30_000_000);
    motor.set_velocity(2.0);
    print_tick(&mut motor, 30_000_000);

    // 20 ms later the controller reports 1.95 rad/s.
    let status = [POWERED, 100, 0xc3, 0x00, 0x03, 0x06, 0, 0];
    motor.receive(&CanFrame::standard(0x185, status), 50_000_000);
    let MotorStatus { position_rad, velocity_radps, .. } = motor.status();
    println!("moved by {position_rad:.3} rad, now at {velocity_radps:.2} rad/s");
}
