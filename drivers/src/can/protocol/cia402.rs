//! A CANopen drive (CiA 301, CiA 402) in profile velocity mode.
//!
//! The drive is configured by SDO before it is started. Every entry is written and read back: the
//! PDOs, the reaction to a missing host (a fault with a quick-stop ramp), and last the consumer
//! heartbeat time (0x1016), which is the drive's watchdog on the host. The host's heartbeat is sent
//! by the same tick as the velocities, so it cannot outlive the commands.
//!
//! Frames of one tick: the host's heartbeat (sent by one motor for all, once its watchdog is
//! confirmed), RPDO1 with controlword and target velocity, SYNC (also sent by one motor), and in
//! response to it the drive's TPDO1 (statusword, velocity) and TPDO2 (position).
//!
//! Once per second, the driver asks a drive that is set up for the voltage of its DC link (0x6079, in
//! mV). The object is optional: a drive that refuses it is not asked again. The profile has no
//! object for a temperature, and its current (0x6078) is a share of the motor's rated current, not
//! the supply's; a drive that is too hot reports that as an emergency.

use std::f64::consts::TAU;

use super::sdo::{self, Entry, Response};
use super::{
    Due, MotorProblem, MotorProtocol, MotorStage, MotorStatus, Outbox, SetupRequest,
    UnwrappedCounter, put,
};
use crate::can::frame::{CanFrame, CanId};

const NMT: u16 = 0x000;
const SYNC: u16 = 0x080;
const EMERGENCY: u16 = 0x080;
const TPDO1: u16 = 0x180;
const RPDO1: u16 = 0x200;
const TPDO2: u16 = 0x280;
const SDO_RESPONSE: u16 = 0x580;
const HEARTBEAT: u16 = 0x700;

const NMT_START: u8 = 0x01;
const NMT_PRE_OPERATIONAL: u8 = 0x80;
const OPERATIONAL: u8 = 5;
const BOOT_UP: u8 = 0;
/// Bit of a COB-ID that disables its PDO.
const PDO_DISABLED: u32 = 0x8000_0000;
/// The drive must get from fault to operation within this time.
const ENABLE_NS: u64 = 1_000_000_000;

/// The voltage of the DC link, mV (CiA 402-2), and how often it is read.
const DC_LINK_VOLTAGE: u16 = 0x6079;
const DC_LINK_NS: u64 = 1_000_000_000;

/// Number of entries that the set-up writes.
const ENTRIES: usize = 25;

/// The configuration of one drive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cia402Node {
    /// Node id of the drive, 1 to 127.
    pub node: u8,
    /// Node id of the host, whose heartbeat the drive monitors, 1 to 127.
    pub host: u8,
    /// Whether this motor also sends SYNC and the host's heartbeat. Exactly one motor of a bus
    /// does.
    pub leads: bool,
    /// Watchdog time to write.
    pub watchdog_ms: u16,
    /// Units of 0x606C and 0x60FF at one revolution of the shaft per second: 60 for rpm, the
    /// encoder's counts for counts/s.
    pub velocity_units: f64,
    /// Units of 0x6064 per revolution of the shaft.
    pub position_units: f64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Step {
    PreOperational,
    Write(usize),
    ReadBack(usize),
    Feedback,
    Ready,
    Powering,
    Enabled,
    Halted,
}

/// The state machine of one drive.
#[derive(Debug)]
pub struct Cia402 {
    node: Cia402Node,
    script: [Entry; ENTRIES],
    status: MotorStatus,
    step: Step,
    request: SetupRequest,
    power: bool,
    powering_since_ns: Option<u64>,
    statusword: u16,
    reset_edge: bool,
    emergency: u16,
    position: UnwrappedCounter,
    position_ns: u64,
    velocity_radps: f64,
    /// When the voltage is asked for next; `None` if the drive refuses it.
    voltage_due_ns: Option<u64>,
}

/// The entries to write, in this order. The watchdog is last: reading it back confirms it.
fn script(node: &Cia402Node) -> [Entry; ENTRIES] {
    let id = u32::from(node.node);
    let watchdog = u32::from(node.host) << 16 | u32::from(node.watchdog_ms);
    [
        // RPDO1: controlword, target velocity; effective at once.
        Entry::u32(0x1400, 1, PDO_DISABLED | (u32::from(RPDO1) + id)),
        Entry::u8(0x1600, 0, 0),
        Entry::u32(0x1600, 1, 0x6040_0010),
        Entry::u32(0x1600, 2, 0x60ff_0020),
        Entry::u8(0x1600, 0, 2),
        Entry::u8(0x1400, 2, 255),
        Entry::u32(0x1400, 1, u32::from(RPDO1) + id),
        // TPDO1: statusword, velocity; on every SYNC.
        Entry::u32(0x1800, 1, PDO_DISABLED | (u32::from(TPDO1) + id)),
        Entry::u8(0x1a00, 0, 0),
        Entry::u32(0x1a00, 1, 0x6041_0010),
        Entry::u32(0x1a00, 2, 0x606c_0020),
        Entry::u8(0x1a00, 0, 2),
        Entry::u8(0x1800, 2, 1),
        Entry::u32(0x1800, 1, u32::from(TPDO1) + id),
        // TPDO2: position; on every SYNC.
        Entry::u32(0x1801, 1, PDO_DISABLED | (u32::from(TPDO2) + id)),
        Entry::u8(0x1a01, 0, 0),
        Entry::u32(0x1a01, 1, 0x6064_0020),
        Entry::u8(0x1a01, 0, 1),
        Entry::u8(0x1801, 2, 1),
        Entry::u32(0x1801, 1, u32::from(TPDO2) + id),
        // Selects profile velocity mode.
        Entry::u8(0x6060, 0, 3),
        // When the host's heartbeat is missing: a fault (0x6007), and on a fault the quick-stop
        // ramp (0x605E), never coasting.
        Entry::u16(0x6007, 0, 1),
        Entry::u16(0x605e, 0, 2),
        // The drive's own heartbeat, every 100 ms, shows when it reboots.
        Entry::u16(0x1017, 0, 100),
        Entry::u32(0x1016, 1, watchdog),
    ]
}

impl Cia402 {
    /// The state machine of a drive that has not responded yet.
    #[must_use]
    pub fn new(node: Cia402Node) -> Self {
        Self {
            node,
            script: script(&node),
            status: MotorStatus::default(),
            step: Step::PreOperational,
            request: SetupRequest::default(),
            power: false,
            powering_since_ns: None,
            statusword: 0,
            reset_edge: false,
            emergency: 0,
            position: UnwrappedCounter::default(),
            position_ns: 0,
            velocity_radps: 0.0,
            voltage_due_ns: Some(DC_LINK_NS),
        }
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

    fn on_response(&mut self, data: &[u8; 8], time_ns: u64) {
        match sdo::decode(data) {
            Some(Response::Value { index: DC_LINK_VOLTAGE, value, .. }) => {
                self.status.power.voltage(f64::from(value) / 1e3, time_ns);
            }
            Some(Response::Abort { index: DC_LINK_VOLTAGE, .. }) => self.voltage_due_ns = None,
            _ => self.on_set_up(data),
        }
    }

    fn on_set_up(&mut self, data: &[u8; 8]) {
        let (Step::Write(at) | Step::ReadBack(at)) = self.step else { return };
        let Some(response) = sdo::decode(data) else { return };
        let Some(entry) = self.script.get(at).copied() else { return };
        match (self.step, response) {
            (_, Response::Abort { index, sub, code }) if entry.is_at(index, sub) => {
                self.halt(MotorStage::Refused, MotorProblem::Parameter { index, sub, code });
            }
            (Step::Write(_), Response::Written { index, sub }) if entry.is_at(index, sub) => {
                self.enter(Step::ReadBack(at));
            }
            (Step::ReadBack(_), Response::Value { index, sub, value })
                if entry.is_at(index, sub) =>
            {
                self.on_read_back(at, &entry, value);
            }
            _ => {}
        }
    }

    fn on_read_back(&mut self, at: usize, entry: &Entry, value: u32) {
        let is_watchdog = entry.index == 0x1016;
        if value != entry.value {
            let watches_us = value >> 16 == entry.value >> 16 && value & 0xffff != 0;
            let read_ms = if watches_us { f64::from(value & 0xffff) } else { f64::NAN };
            let problem = match is_watchdog {
                true => MotorProblem::Watchdog {
                    read_ms,
                    required_ms: f64::from(self.node.watchdog_ms),
                },
                false => {
                    MotorProblem::Parameter { index: entry.index, sub: entry.sub, code: value }
                }
            };
            self.halt(MotorStage::Refused, problem);
        } else if is_watchdog {
            self.status.watchdog_ms = Some(f64::from(self.node.watchdog_ms));
            self.enter(Step::Feedback);
        } else {
            self.enter(Step::Write(at + 1));
        }
    }

    fn on_state(&mut self, data: &[u8], time_ns: u64) {
        let [s0, s1, a, b, c, d] = *data else {
            self.status.bad += 1;
            return;
        };
        self.statusword = u16::from_le_bytes([s0, s1]);
        let velocity = f64::from(i32::from_le_bytes([a, b, c, d]));
        self.status.velocity_radps = velocity / self.node.velocity_units * TAU;
        self.fresh(time_ns);
        let state = State::of(self.statusword);
        match self.step {
            Step::Powering if state == State::Enabled => {
                self.enter(Step::Enabled);
                self.status.stage = MotorStage::Enabled;
            }
            Step::Enabled if state != State::Enabled => {
                self.halt(MotorStage::Faulted, self.fault());
            }
            _ => {}
        }
    }

    fn on_position(&mut self, data: &[u8], time_ns: u64) {
        let Some(count) = data.first_chunk::<4>() else {
            self.status.bad += 1;
            return;
        };
        let count = self.position.update(i32::from_le_bytes(*count));
        self.status.position_rad = count as f64 / self.node.position_units * TAU;
        self.position_ns = time_ns;
    }

    /// Updates the age of the feedback, which is that of its older half.
    fn fresh(&mut self, time_ns: u64) {
        self.status.feedback_ns = self.position_ns.min(time_ns);
        if self.step == Step::Feedback && self.status.feedback_ns > 0 {
            self.enter(if self.power { Step::Powering } else { Step::Ready });
            self.powering_since_ns = None;
            self.status.stage = if self.power { MotorStage::Enabling } else { MotorStage::Ready };
        }
    }

    fn on_heartbeat(&mut self, state: u8) {
        let reboots = state & 0x7f == BOOT_UP;
        let stopped =
            state & 0x7f != OPERATIONAL && matches!(self.step, Step::Powering | Step::Enabled);
        if stopped {
            self.halt(MotorStage::Faulted, self.fault());
        }
        if reboots {
            // A drive that restarted has lost its configuration and sends nothing before it is
            // configured again. It is not enabled by that.
            self.restart();
        }
    }

    fn fault(&self) -> MotorProblem {
        let meaning = match (self.emergency, State::of(self.statusword)) {
            // CiA 301, table 26.
            (0x8130, _) => "it missed the host's heartbeat: no command arrived in time",
            (0x2000..=0x2fff, _) => "its current is out of limits",
            (0x3000..=0x3fff, _) => "its voltage is out of limits",
            (0x4000..=0x4fff, _) => "it is too hot",
            (0x7000..=0x7fff, _) => "one of its modules failed, such as the encoder",
            (0x8000..=0x8fff, _) => "its monitoring tripped",
            (0, State::Fault) => "it is in the fault state without an emergency code",
            _ => "it left operation without a command",
        };
        MotorProblem::Fault { code: u32::from(self.emergency), meaning }
    }

    /// Asks a drive that is set up for its voltage when that is due.
    fn ask_for_voltage(&mut self, now_ns: u64, out: &mut Outbox) {
        let is_set_up = matches!(self.step, Step::Ready | Step::Enabled);
        if is_set_up && self.voltage_due_ns.is_some_and(|due_ns| now_ns >= due_ns) {
            self.voltage_due_ns = Some(now_ns + DC_LINK_NS);
            put(out, [Entry::u32(DC_LINK_VOLTAGE, 0, 0).upload(self.node.node)]);
        }
    }

    fn send_request(&mut self, now_ns: u64, out: &mut Outbox) {
        let request = match self.step {
            Step::PreOperational | Step::Write(_) | Step::ReadBack(_) => "object dictionary",
            Step::Feedback => "process data (statusword and velocity in TPDO1, position in TPDO2)",
            _ => return,
        };
        let due = self.request.due(now_ns);
        if due == Due::No {
            return;
        }
        if due == Due::Repeat && self.status.problem.is_none() {
            self.status.problem = Some(MotorProblem::NoResponse { request });
        }
        let node = self.node.node;
        let frame = match self.step {
            Step::PreOperational => Some(nmt(NMT_PRE_OPERATIONAL, node)),
            Step::Write(at) => self.script.get(at).map(|entry| entry.download(node)),
            Step::ReadBack(at) => self.script.get(at).map(|entry| entry.upload(node)),
            _ => Some(nmt(NMT_START, node)),
        };
        put(out, frame);
        if self.step == Step::PreOperational {
            // NMT commands have no response; the response to the first SDO shows whether the drive
            // is there.
            self.enter(Step::Write(0));
        }
    }

    /// The controlword that brings the drive one state closer to the desired state (CiA 402-2,
    /// figure 3).
    fn controlword(&mut self) -> u16 {
        if !self.power {
            return 0x06;
        }
        match State::of(self.statusword) {
            State::Fault => {
                // The rising edge of bit 7 resets a fault, not its level.
                self.reset_edge = !self.reset_edge;
                if self.reset_edge { 0x80 } else { 0x00 }
            }
            State::SwitchOnDisabled => 0x06,
            State::ReadyToSwitchOn => 0x07,
            State::SwitchedOn | State::Enabled => 0x0f,
            State::QuickStop | State::Other => 0x00,
        }
    }
}

impl MotorProtocol for Cia402 {
    fn receive(&mut self, frame: &CanFrame, time_ns: u64) -> bool {
        let CanId::Standard(id) = frame.id() else { return false };
        if frame.is_remote() || id & 0x7f != u16::from(self.node.node) {
            return false;
        }
        match (id & 0x780, frame.data()) {
            (TPDO1, data) => self.on_state(data, time_ns),
            (TPDO2, data) => self.on_position(data, time_ns),
            (HEARTBEAT, [state]) => self.on_heartbeat(*state),
            (EMERGENCY, [low, high, ..]) => self.emergency = u16::from_le_bytes([*low, *high]),
            (SDO_RESPONSE, _) => match frame.eight() {
                Some(data) => self.on_response(data, time_ns),
                None => self.status.bad += 1,
            },
            _ => return false,
        }
        true
    }

    fn tick(&mut self, now_ns: u64, out: &mut Outbox) {
        // The heartbeat is not sent before the drive's watchdog is confirmed: a drive that still
        // follows the last command of a program that ended must miss the heartbeat.
        if self.node.leads && self.status.watchdog_ms.is_some() {
            let id = HEARTBEAT + u16::from(self.node.host);
            put(out, [CanFrame::standard_short(id, [OPERATIONAL, 0, 0, 0, 0, 0, 0, 0], 1)]);
        }
        if self.step == Step::Powering {
            let since = *self.powering_since_ns.get_or_insert(now_ns);
            if now_ns.saturating_sub(since) > ENABLE_NS {
                self.halt(MotorStage::Faulted, self.fault());
            }
        }
        if self.status.watchdog_ms.is_some() {
            let radps = if self.step == Step::Enabled { self.velocity_radps } else { 0.0 };
            let [a, b, c, d] =
                ((radps / TAU * self.node.velocity_units).round() as i32).to_le_bytes();
            let [w0, w1] = self.controlword().to_le_bytes();
            put(
                out,
                [CanFrame::standard_short(
                    RPDO1 + u16::from(self.node.node),
                    [w0, w1, a, b, c, d, 0, 0],
                    6,
                )],
            );
        }
        self.send_request(now_ns, out);
        self.ask_for_voltage(now_ns, out);
        if self.node.leads {
            put(out, [CanFrame::standard_short(SYNC, [0; 8], 0)]);
        }
    }

    fn set_velocity(&mut self, radps: f64) {
        self.velocity_radps = radps;
    }

    fn enable(&mut self) {
        if matches!(self.status.stage, MotorStage::Ready | MotorStage::Faulted) {
            // After a fault, which may have been a reboot, the whole set-up is repeated. Otherwise
            // only the watchdog is confirmed again.
            let from = if self.status.stage == MotorStage::Faulted {
                Step::PreOperational
            } else {
                Step::Write(ENTRIES - 1)
            };
            self.restart();
            self.enter(from);
            self.power = true;
            self.status.stage = MotorStage::Enabling;
        }
    }

    fn disable(&mut self) {
        self.power = false;
        if matches!(self.status.stage, MotorStage::Enabled | MotorStage::Enabling) {
            self.enter(Step::Feedback);
            self.status.stage = MotorStage::SettingUp;
        }
    }

    fn finish(&mut self, out: &mut Outbox) {
        // Without this request, the end of the host's heartbeat would be a fault of the drive.
        put(out, [Entry::u32(0x1016, 1, 0).download(self.node.node)]);
    }

    fn restart(&mut self) {
        self.enter(Step::PreOperational);
        self.power = false;
        self.emergency = 0;
        self.status.stage = MotorStage::SettingUp;
        self.status.watchdog_ms = None;
    }

    fn status(&self) -> &MotorStatus {
        &self.status
    }
}

/// A network management command to one node (CiA 301, 7.2.8).
fn nmt(command: u8, node: u8) -> CanFrame {
    CanFrame::standard_short(NMT, [command, node, 0, 0, 0, 0, 0, 0], 2)
}

/// The state of a drive (CiA 402-2, figure 3).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    SwitchOnDisabled,
    ReadyToSwitchOn,
    SwitchedOn,
    Enabled,
    QuickStop,
    Fault,
    Other,
}

impl State {
    /// Decodes a statusword (CiA 402-2, table 30).
    fn of(statusword: u16) -> Self {
        match (statusword & 0x4f, statusword & 0x6f) {
            (0x40, _) => Self::SwitchOnDisabled,
            (0x08, _) => Self::Fault,
            (_, 0x21) => Self::ReadyToSwitchOn,
            (_, 0x23) => Self::SwitchedOn,
            (_, 0x27) => Self::Enabled,
            (_, 0x07) => Self::QuickStop,
            _ => Self::Other,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NODE: Cia402Node = Cia402Node {
        node: 5,
        host: 127,
        leads: true,
        watchdog_ms: 100,
        velocity_units: 4096.0,
        position_units: 4096.0,
    };

    fn sent(motor: &mut Cia402, now_ns: u64) -> Vec<String> {
        let mut out = Outbox::new();
        motor.tick(now_ns, &mut out);
        out.iter().map(ToString::to_string).collect()
    }

    #[test]
    fn every_tick_sends_one_sync_and_the_hosts_heartbeat_once_the_watchdog_is_confirmed() {
        let mut motor = Cia402::new(NODE);
        assert_eq!(sent(&mut motor, 0), ["000#8005", "080#"]);
        assert_eq!(sent(&mut motor, 1), ["605#2300140105020080", "080#"]);
        motor.status.watchdog_ms = Some(100.0);
        motor.step = Step::Ready;
        assert_eq!(sent(&mut motor, 2), ["77F#05", "205#060000000000", "080#"]);
    }

    #[test]
    fn a_watchdog_that_reads_back_differently_is_refused() {
        let mut motor = Cia402::new(NODE);
        motor.step = Step::ReadBack(ENTRIES - 1);
        let response = CanFrame::standard(0x585, [0x43, 0x16, 0x10, 1, 0xf4, 0x01, 0x7f, 0]);
        assert!(motor.receive(&response, 0));
        let problem = MotorProblem::Watchdog { read_ms: 500.0, required_ms: 100.0 };
        assert_eq!(
            (motor.status.stage, motor.status.problem),
            (MotorStage::Refused, Some(problem))
        );
    }

    #[test]
    fn the_voltage_of_the_dc_link_is_read_once_per_second_from_a_drive_that_has_it() {
        let mut motor = Cia402::new(NODE);
        motor.step = Step::Ready;
        assert_eq!(sent(&mut motor, 0), ["080#"]);
        assert_eq!(sent(&mut motor, 1_000_000_000), ["605#4079600000000000", "080#"]);
        assert_eq!(sent(&mut motor, 1_990_000_000), ["080#"]);
        // 23,900 mV in four bytes.
        let answer = CanFrame::standard(0x585, [0x43, 0x79, 0x60, 0, 0x5c, 0x5d, 0, 0]);
        assert!(motor.receive(&answer, 1_001_000_000));
        assert_eq!(motor.status.power.report(1_001_000_000).voltage_v, Some(23.9));
        // Object does not exist (CiA 301, abort code 0602 0000).
        let abort = CanFrame::standard(0x585, [0x80, 0x79, 0x60, 0, 0, 0, 0x02, 0x06]);
        assert!(motor.receive(&abort, 1_002_000_000));
        assert_eq!(sent(&mut motor, 9_000_000_000), ["080#"]);
        assert_eq!(motor.status.stage, MotorStage::SettingUp, "a refused voltage is no fault");
    }

    #[test]
    fn the_states_of_the_standard_are_distinguished() {
        let states =
            [0x0250, 0x0231, 0x0233, 0x0237, 0x0217, 0x0218, 0x021f, 0x0000].map(State::of);
        use State::*;
        assert_eq!(
            states,
            [
                SwitchOnDisabled,
                ReadyToSwitchOn,
                SwitchedOn,
                Enabled,
                QuickStop,
                Fault,
                Other,
                Other
            ]
        );
    }

    #[test]
    fn a_position_counter_that_wraps_is_continued() {
        let mut motor = Cia402::new(NODE);
        for count in [i32::MAX - 10, i32::MIN + 10] {
            let data = count.to_le_bytes();
            motor.receive(&CanFrame::new(CanId::Standard(0x285), &data).expect("sound"), 1);
        }
        assert!((motor.status.position_rad - 21.0 / 4096.0 * TAU).abs() < 1e-9);
    }
}
