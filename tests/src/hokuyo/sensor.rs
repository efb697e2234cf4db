//! The device without wires.

use std::fmt::Write as _;

use drivers::scip::{Model, Sheet};

use super::ScanSource;
use super::encode::{block, field, line, number};

/// What is wrong inside.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Health {
    /// Nothing.
    #[default]
    Well,
    /// The laser is off and stays off.
    LaserOff,
    /// The laser cannot be switched on.
    LaserBroken,
    /// The motor does not turn.
    MotorFault,
    /// All beams are errors.
    Blind,
}

/// A scanner: bytes and times in, bytes out.
pub struct Sensor {
    model: Model,
    source: Box<dyn ScanSource>,
    /// How it is.
    pub health: Health,
    /// How much its clock runs fast, parts per million.
    pub clock_ppm: f64,
    speaks_scip_1: bool,
    compares_clocks: bool,
    laser_on: bool,
    stream: Option<Stream>,
    command: Vec<u8>,
    booted_ns: u64,
    turn_begin_ns: u64,
    ranges_mm: Vec<u32>,
}

/// A request under way.
#[derive(Debug, Clone)]
struct Stream {
    /// The request without the count of scans.
    echo: String,
    /// What follows the count.
    tail: String,
    layout: Layout,
    skip: u64,
    /// Scans to send; 0 for no end.
    scans: u32,
    sent: u32,
    turns: u64,
}

#[derive(Debug, Clone, Copy)]
struct Layout {
    letter: u8,
    first: usize,
    last: usize,
    cluster: usize,
}

impl Sensor {
    /// Switched on at `now_ns`, and done with starting.
    #[must_use]
    pub fn new(model: Model, source: Box<dyn ScanSource>, now_ns: u64) -> Self {
        Self {
            model,
            source,
            health: Health::Well,
            clock_ppm: 0.0,
            speaks_scip_1: model.sheet().starts_in_scip_1,
            compares_clocks: false,
            laser_on: false,
            stream: None,
            command: Vec::new(),
            booted_ns: now_ns,
            turn_begin_ns: now_ns,
            ranges_mm: vec![0; model.geometry(false).beams],
        }
    }

    /// Restarts; hears and says nothing before `ready_ns`.
    pub fn reboot(&mut self, ready_ns: u64) {
        self.speaks_scip_1 = self.model.sheet().starts_in_scip_1;
        (self.compares_clocks, self.laser_on, self.stream) = (false, false, None);
        self.command.clear();
        (self.booted_ns, self.turn_begin_ns) = (ready_ns, ready_ns);
    }

    /// Whether it sends scans.
    #[must_use]
    pub fn is_streaming(&self) -> bool {
        self.stream.is_some()
    }

    /// When the turn that is under way ends, and a scan with it.
    #[must_use]
    pub fn turn_end_ns(&self) -> u64 {
        self.turn_begin_ns + self.model.geometry(false).period_ns
    }

    /// Bytes from the host; answers are appended.
    pub fn receive(&mut self, bytes: &[u8], now_ns: u64, out: &mut Vec<u8>) {
        for &byte in bytes {
            match byte {
                _ if now_ns < self.booted_ns => {}
                b'\n' | b'\r' => {
                    let command = std::mem::take(&mut self.command);
                    self.answer(&String::from_utf8_lossy(&command), now_ns, out);
                }
                _ => self.command.push(byte),
            }
        }
    }

    /// Ends the turn that is over at `now_ns`, if one is; its scan is appended.
    pub fn turn(&mut self, now_ns: u64, out: &mut Vec<u8>) {
        let begun_ns = self.turn_begin_ns;
        if now_ns < self.turn_end_ns() {
            return;
        }
        self.turn_begin_ns = self.turn_end_ns();
        let Some(mut stream) = self.stream.take() else { return };
        stream.turns += 1;
        if stream.turns % (stream.skip + 1) != 0 {
            self.stream = Some(stream);
            return;
        }
        stream.sent += 1;
        let left = if stream.scans == 0 { 0 } else { stream.scans - stream.sent };
        _ = writeln!(Text(out), "{}{left:02}{}", stream.echo, stream.tail);
        match self.health {
            Health::MotorFault => line(out, b"70"),
            Health::LaserOff | Health::LaserBroken => line(out, b"10"),
            Health::Well | Health::Blind => {
                line(out, b"99");
                self.scan(begun_ns, stream.layout, out);
                if stream.scans == 0 || left > 0 {
                    self.stream = Some(stream);
                }
            }
        }
        out.push(b'\n');
    }

    fn scan(&mut self, begun_ns: u64, layout: Layout, out: &mut Vec<u8>) {
        let mut stamp = Vec::new();
        number(&mut stamp, self.clock_ms(begun_ns), 4);
        line(out, &stamp);
        self.source.ranges_mm(begun_ns, &mut self.ranges_mm);
        let Sheet { first_step, codes, .. } = self.model.sheet();
        let first = layout.first - usize::from(*first_step);
        let last = layout.last - usize::from(*first_step);
        let mut characters = Vec::new();
        for cluster in self.ranges_mm[first..=last].chunks(layout.cluster) {
            // The nearest that is no code, if there is one.
            let nearest = cluster
                .iter()
                .filter(|range| **range >= codes.dmin_mm)
                .min()
                .unwrap_or(&cluster[0]);
            let value = if self.health == Health::Blind { 5 } else { *nearest };
            match layout.letter {
                b'S' => number(&mut characters, value.min(4095), 2),
                b'E' => {
                    number(&mut characters, value, 3);
                    number(&mut characters, 4_000_000 / value.max(400), 3);
                }
                _ => number(&mut characters, value, 3),
            }
        }
        block(out, &characters);
    }

    fn clock_ms(&self, at_ns: u64) -> u32 {
        let passed_ms =
            at_ns.saturating_sub(self.booted_ns) as f64 * 1e-6 * (1.0 + self.clock_ppm * 1e-6);
        (passed_ms as u64 % (1 << 24)) as u32
    }

    fn answer(&mut self, command: &str, now_ns: u64, out: &mut Vec<u8>) {
        if command.is_empty() {
            return;
        }
        _ = writeln!(Text(out), "{command}");
        if self.speaks_scip_1 {
            let known = command == "SCIP2.0";
            self.speaks_scip_1 = !known;
            out.extend_from_slice(if known { b"0\n\n" } else { b"E\n\n" });
            return;
        }
        match command.get(..2).unwrap_or_default() {
            "TM" => self.time(command, now_ns, out),
            _ if self.compares_clocks => line(out, b"10"),
            "QT" => {
                (self.stream, self.laser_on) = (None, false);
                line(out, b"00");
            }
            "RS" => {
                self.reboot(now_ns);
                self.speaks_scip_1 = false;
                line(out, b"00");
            }
            "BM" => self.switch_on(out),
            "VV" => self.version(out),
            "PP" => self.parameters(out),
            "II" => self.state(now_ns, out),
            "%S" => {
                line(out, b"00");
                line(
                    out,
                    if self.stream.is_some() {
                        b"004"
                    } else if self.laser_on {
                        b"003"
                    } else {
                        b"000"
                    },
                );
            }
            "MD" | "MS" | "ME" | "GD" | "GS" | "GE" => self.measure(command, out),
            _ => line(out, b"0E"),
        }
        out.push(b'\n');
    }

    fn time(&mut self, command: &str, now_ns: u64, out: &mut Vec<u8>) {
        match (command.as_bytes().get(2), self.compares_clocks) {
            (Some(b'0'), false) => {
                (self.compares_clocks, self.laser_on, self.stream) = (true, false, None);
                line(out, b"00");
            }
            (Some(b'0'), true) => line(out, b"02"),
            (Some(b'1'), true) => {
                line(out, b"00");
                let mut time = Vec::new();
                number(&mut time, self.clock_ms(now_ns), 4);
                line(out, &time);
            }
            (Some(b'1'), false) => line(out, b"04"),
            (Some(b'2'), true) => {
                self.compares_clocks = false;
                line(out, b"00");
            }
            (Some(b'2'), false) => line(out, b"03"),
            _ => line(out, b"01"),
        }
    }

    fn switch_on(&mut self, out: &mut Vec<u8>) {
        let status: &[u8] = match self.health {
            Health::LaserBroken => b"01",
            _ if self.laser_on => b"02",
            _ => b"00",
        };
        self.laser_on = self.health != Health::LaserBroken;
        line(out, status);
    }

    fn version(&self, out: &mut Vec<u8>) {
        line(out, b"00");
        field(out, "VEND", "Hokuyo Automatic Co., Ltd.");
        field(out, "PROD", &format!("SOKUIKI Sensor {}", self.model));
        field(out, "FIRM", "1.18.01 (16/Apr./2013)");
        field(out, "PROT", "SCIP 2.0");
        field(out, "SERI", "H1000484");
    }

    fn parameters(&self, out: &mut Vec<u8>) {
        let sheet = self.model.sheet();
        line(out, b"00");
        field(out, "MODL", &format!("{}(Hokuyo Automatic Co., Ltd.)", sheet.name));
        let numbers = [
            ("DMIN", sheet.codes.dmin_mm),
            ("DMAX", sheet.codes.dmax_mm),
            ("ARES", sheet.steps_per_turn.into()),
            ("AMIN", sheet.first_step.into()),
            ("AMAX", sheet.last_step.into()),
            ("AFRT", sheet.front_step.into()),
            ("SCAN", sheet.rpm.into()),
        ];
        numbers.iter().for_each(|(key, number)| field(out, key, &number.to_string()));
    }

    fn state(&self, now_ns: u64, out: &mut Vec<u8>) {
        line(out, b"00");
        let laser = self.laser_on
            && matches!(self.health, Health::Well | Health::Blind | Health::MotorFault);
        field(out, "MODL", &format!("{}(Hokuyo Automatic Co., Ltd.)", self.model));
        field(out, "LASR", if laser { "ON" } else { "OFF" });
        field(out, "SCSP", &self.model.sheet().rpm.to_string());
        field(out, "MESM", if self.stream.is_some() { "Measuring by Normal Mode" } else { "Idle" });
        field(out, "SBPS", "USB Full Speed");
        field(out, "TIME", &format!("{:06X}", self.clock_ms(now_ns)));
        let status = match self.health {
            Health::Well | Health::Blind => "Sensor works well.",
            Health::LaserOff => "Laser is off.",
            Health::LaserBroken => "Laser malfunction.",
            Health::MotorFault => "Motor malfunction.",
        };
        field(out, "STAT", status);
    }

    fn measure(&mut self, command: &str, out: &mut Vec<u8>) {
        let continuous = command.starts_with('M');
        let layout = match self.layout(command) {
            Ok(layout) => layout,
            Err(status) => return line(out, status),
        };
        if !continuous {
            if self.laser_on && matches!(self.health, Health::Well | Health::Blind) {
                line(out, b"00");
                let begun_ns =
                    self.turn_begin_ns.saturating_sub(self.model.geometry(false).period_ns);
                self.scan(begun_ns.max(self.booted_ns), layout, out);
            } else {
                line(out, b"10");
            }
            return;
        }
        let (Some(skip), Some(scans)) = (digits(command, 12..13), digits(command, 13..15)) else {
            return line(out, b"06");
        };
        self.laser_on = true;
        self.stream = Some(Stream {
            echo: command[..13].to_owned(),
            tail: command[15..].to_owned(),
            layout,
            skip: skip as u64,
            scans: scans as u32,
            sent: 0,
            turns: 0,
        });
        line(out, b"00");
    }

    fn layout(&self, command: &str) -> Result<Layout, &'static [u8]> {
        let sheet = self.model.sheet();
        let first = digits(command, 2..6).ok_or(&b"01"[..])?;
        let last = digits(command, 6..10).ok_or(&b"02"[..])?;
        let cluster = digits(command, 10..12).ok_or(&b"03"[..])?.max(1);
        if last < first {
            return Err(b"05");
        }
        if first < usize::from(sheet.first_step) || last > usize::from(sheet.last_step) {
            return Err(b"04");
        }
        Ok(Layout { letter: command.as_bytes()[1], first, last, cluster })
    }
}

fn digits(command: &str, place: std::ops::Range<usize>) -> Option<usize> {
    command.get(place).filter(|text| text.bytes().all(|byte| byte.is_ascii_digit()))?.parse().ok()
}

/// Text into bytes.
struct Text<'a>(&'a mut Vec<u8>);

impl std::fmt::Write for Text<'_> {
    fn write_str(&mut self, text: &str) -> std::fmt::Result {
        self.0.extend_from_slice(text.as_bytes());
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::Room;
    use super::*;

    fn said(sensor: &mut Sensor, command: &str) -> String {
        let mut out = Vec::new();
        sensor.receive(command.as_bytes(), 1, &mut out);
        String::from_utf8(out).unwrap()
    }

    fn sensor(model: Model) -> Sensor {
        Sensor::new(model, Box::new(Room::new(model)), 0)
    }

    #[test]
    fn the_answers_of_the_specification_come_with_its_checksums() {
        let mut sensor = sensor(Model::Utm30lx);
        assert_eq!(said(&mut sensor, "QT\n"), "QT\n00P\n\n");
        assert!(said(&mut sensor, "PP\n").contains("\nAFRT:540;0\n"));
        assert_eq!(said(&mut sensor, "XX\n"), "XX\n0Ee\n\n");
        assert_eq!(said(&mut sensor, "MD0000200001000\n"), "MD0000200001000\n04T\n\n");
    }

    #[test]
    fn the_urg_04lx_starts_in_scip_1() {
        let mut sensor = sensor(Model::Urg04lx);
        assert_eq!(said(&mut sensor, "QT\n"), "QT\nE\n\n");
        assert_eq!(said(&mut sensor, "SCIP2.0\n"), "SCIP2.0\n0\n\n");
        assert_eq!(said(&mut sensor, "QT\n"), "QT\n00P\n\n");
    }

    #[test]
    fn as_many_scans_come_as_were_asked_for_one_a_period() {
        let mut sensor = sensor(Model::Utm30lx);
        assert_eq!(said(&mut sensor, "MD0000108001002\n"), "MD0000108001002\n00P\n\n");
        let mut scans = Vec::new();
        for ms in 0..200 {
            let mut out = Vec::new();
            sensor.turn(ms * 1_000_000, &mut out);
            if !out.is_empty() {
                scans.push((ms, String::from_utf8(out).unwrap()));
            }
        }
        let [(25, first), (50, second)] = &scans[..] else { panic!("{} scans", scans.len()) };
        assert!(first.starts_with("MD0000108001001\n99b\n00000\n"));
        assert!(second.starts_with("MD0000108001000\n99b\n") && second.ends_with("\n\n"));
        assert!(!sensor.is_streaming());
    }
}
