//! A simulated CANopen drive: NMT, an SDO server with an object dictionary, PDOs on SYNC,
//! heartbeats both ways, and the state machine of CiA 402 in profile velocity mode.

use std::collections::BTreeMap;
use std::f64::consts::TAU;

use drivers::can::{CanFrame, CanId};

use super::node::{MotorNode, NodeFaults, Periodic, Watchdog, elapsed_s, standard};
use super::wheel::{Drive, Wheel};

/// Encoder counts per rotation; velocities are in counts/s.
pub const COUNTS: f64 = 4096.0;

const PRE_OPERATIONAL: u8 = 0x7f;
const OPERATIONAL: u8 = 0x05;
const STOPPED: u8 = 0x04;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    SwitchOnDisabled,
    ReadyToSwitchOn,
    SwitchedOn,
    Enabled,
    QuickStop,
    Fault,
}

#[derive(Debug)]
pub struct Cia402Sim {
    node: u8,
    wheel: Wheel,
    faults: NodeFaults,
    watchdog: Watchdog,
    nmt: u8,
    state: State,
    controlword: u16,
    /// Values by index and sub-index, with their length in bytes.
    dictionary: BTreeMap<(u16, u8), (u32, u8)>,
    last_ns: u64,
    booted: bool,
    heartbeat: Option<Periodic>,
    synced: bool,
    answers: Vec<CanFrame>,
}

impl Cia402Sim {
    /// A drive with the defaults of its profile.
    #[must_use]
    pub fn new(node: u8) -> Self {
        let id = u32::from(node);
        let mut dictionary: BTreeMap<(u16, u8), (u32, u8)> = [
            ((0x1000, 0), (0x0002_0192, 4)),
            ((0x1001, 0), (0, 1)),
            ((0x1008, 0), (u32::from_le_bytes(*b"sim2"), 4)),
            ((0x1016, 0), (1, 1)),
            ((0x1016, 1), (0, 4)),
            ((0x1017, 0), (0, 2)),
            ((0x1018, 0), (4, 1)),
            ((0x1018, 1), (0, 4)),
            ((0x1018, 2), (0, 4)),
            ((0x1018, 3), (1, 4)),
            ((0x1018, 4), (1, 4)),
            ((0x6007, 0), (1, 2)),
            ((0x6040, 0), (0, 2)),
            ((0x6041, 0), (0, 2)),
            ((0x605e, 0), (2, 2)),
            ((0x6060, 0), (0, 1)),
            ((0x6061, 0), (0, 1)),
            ((0x6064, 0), (0, 4)),
            ((0x606c, 0), (0, 4)),
            ((0x6079, 0), (0, 4)),
            ((0x60ff, 0), (0, 4)),
        ]
        .into();
        // RPDO1 and the two TPDOs. By default they are mapped to the controlword and the
        // statusword.
        for (communication, mapping, cob_id, object) in [
            (0x1400, 0x1600, 0x200, 0x6040_0010),
            (0x1800, 0x1a00, 0x180, 0x6041_0010),
            (0x1801, 0x1a01, 0x280, 0x6041_0010),
        ] {
            dictionary.insert((communication, 0), (2, 1));
            dictionary.insert((communication, 1), (cob_id + id, 4));
            dictionary.insert((communication, 2), (255, 1));
            dictionary.insert((mapping, 0), (1, 1));
            dictionary.insert((mapping, 1), (object, 4));
            dictionary.insert((mapping, 2), (0, 4));
        }
        Self {
            node,
            wheel: Wheel::default(),
            faults: NodeFaults::default(),
            watchdog: Watchdog::default(),
            nmt: PRE_OPERATIONAL,
            state: State::SwitchOnDisabled,
            controlword: 0,
            dictionary,
            last_ns: 0,
            booted: false,
            heartbeat: None,
            synced: false,
            answers: Vec::new(),
        }
    }

    fn value(&self, index: u16, sub: u8) -> u32 {
        self.dictionary.get(&(index, sub)).map_or(0, |(value, _)| *value)
    }

    fn is_off(&self, pdo: u16) -> bool {
        self.value(pdo, 1) & 0x8000_0000 != 0
    }

    fn on_sdo(&mut self, data: &[u8; 8]) {
        let [command, i0, i1, sub, rest @ ..] = *data;
        let index = u16::from_le_bytes([i0, i1]);
        let known = self.dictionary.get(&(index, sub)).copied();
        let has_index = self.dictionary.keys().any(|(known, _)| *known == index);
        let answer = match (command >> 5, known) {
            (_, None) => Err(if has_index { 0x0609_0011 } else { 0x0602_0000 }),
            (2, Some((value, bytes))) => {
                let mut value = value.to_le_bytes();
                value.iter_mut().skip(usize::from(bytes)).for_each(|byte| *byte = 0);
                Ok([&[0x43 | (4 - bytes) << 2, i0, i1, sub][..], &value].concat())
            }
            (1, Some(_)) if command & 0x02 == 0 => Err(0x0504_0001),
            (1, Some((_, bytes))) => {
                let sent = 4 - (command >> 2 & 3);
                if command & 1 != 0 && sent != bytes {
                    Err(0x0607_0010)
                } else {
                    self.write(index, sub, u32::from_le_bytes(rest))
                        .map(|()| vec![0x60, i0, i1, sub, 0, 0, 0, 0])
                }
            }
            _ => Err(0x0504_0001),
        };
        let answer = answer
            .unwrap_or_else(|code: u32| [&[0x80, i0, i1, sub][..], &code.to_le_bytes()].concat());
        self.answers.push(standard(0x580 + u16::from(self.node), &answer));
    }

    fn write(&mut self, index: u16, sub: u8, value: u32) -> Result<(), u32> {
        match index {
            0x1000 | 0x1001 | 0x1008 | 0x1018 | 0x6041 | 0x6061 | 0x6064 | 0x606c | 0x6079 => {
                return Err(0x0601_0002);
            }
            // A PDO can be mapped only while it is off, and an entry changed only while the count
            // is zero.
            0x1600 if !self.is_off(0x1400) => return Err(0x0601_0000),
            0x1a00 | 0x1a01 if !self.is_off(index - 0x200) => return Err(0x0601_0000),
            0x1600 | 0x1a00 | 0x1a01 if sub > 0 && self.value(index, 0) != 0 => {
                return Err(0x0601_0000);
            }
            _ => {}
        }
        if (index, sub) == (0x1016, 1) && self.faults.forgets_watchdog {
            return Ok(());
        }
        if let Some((stored, bytes)) = self.dictionary.get_mut(&(index, sub)) {
            *stored =
                if *bytes == 4 { value } else { value & ((1 << (8 * u32::from(*bytes))) - 1) };
        }
        match (index, sub) {
            // The heartbeat consumer starts with the first heartbeat.
            (0x1016, 1) => self.watchdog.limit_ns = None,
            (0x1017, 0) => {
                self.heartbeat =
                    (value & 0xffff > 0).then(|| Periodic::milliseconds(u64::from(value & 0xffff)));
            }
            (0x6040, 0) => self.on_controlword(value as u16),
            (0x6060, 0) => {
                self.dictionary.insert((0x6061, 0), (value & 0xff, 1));
            }
            _ => {}
        }
        Ok(())
    }

    fn on_controlword(&mut self, word: u16) {
        use State::{Enabled, Fault, QuickStop, ReadyToSwitchOn, SwitchOnDisabled, SwitchedOn};
        let edge = word & !self.controlword & 0x80 != 0;
        self.controlword = word;
        self.dictionary.insert((0x6040, 0), (u32::from(word), 2));
        self.state = match (self.state, word & 0x0f) {
            (Fault, _) if edge && !self.faults.broken => {
                self.dictionary.insert((0x1001, 0), (0, 1));
                SwitchOnDisabled
            }
            (Fault, _) => Fault,
            (_, command) if command & 0x02 == 0 => SwitchOnDisabled,
            (Enabled, command) if command & 0x04 == 0 => QuickStop,
            (QuickStop, _) => QuickStop,
            (_, command) if command & 0x04 == 0 => SwitchOnDisabled,
            (_, command) if command & 0x07 == 0x06 => ReadyToSwitchOn,
            (ReadyToSwitchOn | SwitchedOn | Enabled, 0x07) => SwitchedOn,
            (SwitchedOn | Enabled, 0x0f) => Enabled,
            // Both transitions at once, which the standard allows.
            (ReadyToSwitchOn, 0x0f) => Enabled,
            (state, _) => state,
        };
    }

    fn statusword(&self) -> u16 {
        match self.state {
            State::SwitchOnDisabled => 0x0240,
            State::ReadyToSwitchOn => 0x0221,
            State::SwitchedOn => 0x0223,
            State::Enabled => 0x0237,
            State::QuickStop => 0x0217,
            State::Fault => 0x0218,
        }
    }

    fn fail(&mut self, code: u16) {
        if self.state != State::Fault {
            self.state = State::Fault;
            self.dictionary.insert((0x1001, 0), (0x11, 1));
            let [low, high] = code.to_le_bytes();
            self.answers
                .push(standard(0x080 + u16::from(self.node), &[low, high, 0x11, 0, 0, 0, 0, 0]));
        }
    }

    fn on_nmt(&mut self, command: u8) {
        match command {
            0x01 => self.nmt = OPERATIONAL,
            0x02 => self.nmt = STOPPED,
            0x80 => self.nmt = PRE_OPERATIONAL,
            0x81 | 0x82 => self.faults.reboot = true,
            _ => {}
        }
    }

    /// COB-ID and mapped objects of the PDO with these parameter indices, if it is on.
    fn mapped(&self, communication: u16, mapping: u16) -> Option<(u16, Vec<u32>)> {
        let cob_id = self.value(communication, 1);
        let count = self.value(mapping, 0) as u8;
        let objects = (1..=count).map(|sub| self.value(mapping, sub)).collect();
        (cob_id & 0x8000_0000 == 0).then_some(((cob_id & 0x7ff) as u16, objects))
    }

    fn on_rpdo(&mut self, data: &[u8]) {
        let Some((_, objects)) = self.mapped(0x1400, 0x1600) else { return };
        let mut rest = data;
        for object in objects {
            let index = (object >> 16) as u16;
            let sub = (object >> 8) as u8;
            let bytes = (object & 0xff) as usize / 8;
            let Some((value, behind)) = rest.split_at_checked(bytes) else { return };
            let mut word = [0; 4];
            word.iter_mut().zip(value).for_each(|(byte, value)| *byte = *value);
            let _ = self.write(index, sub, u32::from_le_bytes(word));
            rest = behind;
        }
    }

    fn send_tpdo(&mut self, communication: u16, mapping: u16, out: &mut Vec<CanFrame>) {
        let Some((cob_id, objects)) = self.mapped(communication, mapping) else { return };
        let payload: Vec<u8> = objects
            .iter()
            .flat_map(|object| {
                let value = self.value((object >> 16) as u16, (object >> 8) as u8);
                value
                    .to_le_bytes()
                    .into_iter()
                    .take((object & 0xff) as usize / 8)
                    .collect::<Vec<_>>()
            })
            .collect();
        out.push(standard(cob_id, &payload));
    }
}

impl MotorNode for Cia402Sim {
    fn receive(&mut self, frame: &CanFrame, now_ns: u64) {
        let CanId::Standard(id) = frame.id() else { return };
        let node = u16::from(self.node);
        let consumer = self.value(0x1016, 1);
        match (id, frame.data()) {
            (0x000, [command, to]) if *to == 0 || *to == self.node => self.on_nmt(*command),
            (0x080, _) => self.synced = true,
            (id, data) if id == 0x200 + node && self.nmt == OPERATIONAL => self.on_rpdo(data),
            (id, _) if id == 0x600 + node && self.nmt != STOPPED => {
                if let Some(data) = frame.eight() {
                    self.on_sdo(data);
                }
            }
            (id, [_])
                if consumer & 0xffff != 0 && u32::from(id) == 0x700 + (consumer >> 16 & 0x7f) =>
            {
                self.watchdog.limit_ns = Some(u64::from(consumer & 0xffff) * 1_000_000);
                self.watchdog.feed(now_ns);
            }
            _ => {}
        }
    }

    fn step(&mut self, now_ns: u64, out: &mut Vec<CanFrame>) {
        if self.faults.reboot {
            let faults = NodeFaults { reboot: false, ..self.faults };
            *self = Self {
                wheel: self.wheel.clone(),
                last_ns: self.last_ns,
                faults,
                ..Self::new(self.node)
            };
        }
        if self.watchdog.expires(now_ns) {
            self.fail(0x8130);
        }
        if self.faults.broken {
            self.fail(0x3210);
        }
        let target = self.value(0x60ff, 0) as i32;
        self.wheel.set_drive(match self.state {
            State::Enabled if self.value(0x6060, 0) == 3 => {
                Drive::Velocity(f64::from(target) / COUNTS * TAU)
            }
            // Objects 0x605E and 0x605A at 2 select the quick-stop ramp.
            State::Fault | State::QuickStop if self.value(0x605e, 0) == 2 => Drive::Brake,
            _ => Drive::Coast,
        });
        self.wheel.step(elapsed_s(&mut self.last_ns, now_ns));
        let (velocity, position) = self.wheel.measured();
        self.dictionary.insert((0x606c, 0), (to_counts(velocity), 4));
        self.dictionary.insert((0x6064, 0), (to_counts(position), 4));
        let millivolts = (1e3 * self.faults.supply.voltage_v) as u32;
        self.dictionary.insert((0x6079, 0), (millivolts, 4));
        self.dictionary.insert((0x6041, 0), (u32::from(self.statusword()), 2));
        let synced = std::mem::take(&mut self.synced);
        if self.faults.silent {
            self.answers.clear();
            return;
        }
        let heartbeat = 0x700 + u16::from(self.node);
        if !std::mem::replace(&mut self.booted, true) {
            out.push(standard(heartbeat, &[0]));
        }
        out.append(&mut self.answers);
        if synced && self.nmt == OPERATIONAL {
            // Position first: the driver uses the older of both for the age of its feedback.
            for (communication, mapping) in [(0x1801, 0x1a01), (0x1800, 0x1a00)] {
                if (1..=240).contains(&self.value(communication, 2)) {
                    self.send_tpdo(communication, mapping, out);
                }
            }
        }
        if self.heartbeat.as_mut().is_some_and(|heartbeat| heartbeat.is_due(now_ns)) {
            out.push(standard(heartbeat, &[self.nmt]));
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
        self.state == State::Enabled
    }
}

fn to_counts(radians: f64) -> u32 {
    (radians / TAU * COUNTS).round() as i64 as i32 as u32
}
