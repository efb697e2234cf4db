//! The scanner without a transport.

use std::fmt::Write as _;

use drivers::scip::{Model, ModelSpec};

use super::ScanSource;
use super::encode::{block, field, line, number};

/// Its clock has 24 bits.
const HALF_CLOCK_MS: u32 = 1 << 23;

/// Internal state of health.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Health {
    #[default]
    Well,
    LaserOff,
    LaserBroken,
    MotorFault,
    /// All beams report errors.
    Blind,
}

/// A simulated scanner: bytes and times go in, bytes come out.
pub struct Sensor {
    model: Model,
    source: Box<dyn ScanSource>,
    pub health: Health,
    /// Rate error of its clock, parts per million.
    pub clock_ppm: f64,
    /// Every scan of this number has a time stamp that is half of the clock's range off; 0 means none.
    pub wrong_stamp_every: u32,
    in_scip_1: bool,
    in_time_mode: bool,
    laser_on: bool,
    stream: Option<Stream>,
    command: Vec<u8>,
    booted_ns: u64,
    rotation_begin_ns: u64,
    ranges_mm: Vec<u32>,
}

/// A scan request in progress.
#[derive(Debug, Clone)]
struct Stream {
    /// The echoed request up to the scan count.
    echo: String,
    /// The echoed request after the scan count.
    tail: String,
    layout: Layout,
    skip: u64,
    /// Number of scans to send; 0 means without end.
    scans: u32,
    sent: u32,
    rotations: u64,
}

#[derive(Debug, Clone, Copy)]
struct Layout {
    letter: u8,
    first: usize,
    last: usize,
    cluster: usize,
}

impl Sensor {
    /// Creates a scanner that was switched on and became ready at `now_ns`.
    #[must_use]
    pub fn new(model: Model, source: Box<dyn ScanSource>, now_ns: u64) -> Self {
        Self {
            model,
            source,
            health: Health::Well,
            clock_ppm: 0.0,
            wrong_stamp_every: 0,
            in_scip_1: model.spec().starts_in_scip_1,
            in_time_mode: false,
            laser_on: false,
            stream: None,
            command: Vec::new(),
            booted_ns: now_ns,
            rotation_begin_ns: now_ns,
            ranges_mm: vec![0; model.geometry(false).beams],
        }
    }

    /// Restarts the scanner. It ignores input and sends nothing before `ready_ns`.
    pub fn reboot(&mut self, ready_ns: u64) {
        self.in_scip_1 = self.model.spec().starts_in_scip_1;
        self.in_time_mode = false;
        self.laser_on = false;
        self.stream = None;
        self.command.clear();
        self.booted_ns = ready_ns;
        self.rotation_begin_ns = ready_ns;
    }

    #[must_use]
    pub fn is_streaming(&self) -> bool {
        self.stream.is_some()
    }

    /// End of the current rotation, when a scan is complete.
    #[must_use]
    pub fn rotation_end_ns(&self) -> u64 {
        self.rotation_begin_ns + self.model.geometry(false).period_ns
    }

    /// Processes bytes from the host and appends the answers to `out`.
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

    /// Ends the current rotation if it is over at `now_ns`, and appends its scan to `out`.
    pub fn update(&mut self, now_ns: u64, out: &mut Vec<u8>) {
        let begin_ns = self.rotation_begin_ns;
        if now_ns < self.rotation_end_ns() {
            return;
        }
        self.rotation_begin_ns = self.rotation_end_ns();
        let Some(mut stream) = self.stream.take() else { return };
        stream.rotations += 1;
        if stream.rotations % (stream.skip + 1) != 0 {
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
                let is_wrong =
                    self.wrong_stamp_every > 0 && stream.sent % self.wrong_stamp_every == 0;
                let stamp_ms = self.clock_ms(begin_ns) ^ if is_wrong { HALF_CLOCK_MS } else { 0 };
                self.scan(begin_ns, stamp_ms, stream.layout, out);
                if stream.scans == 0 || left > 0 {
                    self.stream = Some(stream);
                }
            }
        }
        out.push(b'\n');
    }

    fn scan(&mut self, begin_ns: u64, stamp_ms: u32, layout: Layout, out: &mut Vec<u8>) {
        let mut stamp = Vec::new();
        number(&mut stamp, stamp_ms, 4);
        line(out, &stamp);
        self.source.ranges_mm(begin_ns, &mut self.ranges_mm);
        let ModelSpec { first_step, codes, .. } = self.model.spec();
        let first = layout.first - usize::from(*first_step);
        let last = layout.last - usize::from(*first_step);
        let mut characters = Vec::new();
        for cluster in self.ranges_mm[first..=last].chunks(layout.cluster) {
            // The nearest range that is not an error code, if there is one.
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
        (passed_ms as u64 % u64::from(2 * HALF_CLOCK_MS)) as u32
    }

    fn answer(&mut self, command: &str, now_ns: u64, out: &mut Vec<u8>) {
        if command.is_empty() {
            return;
        }
        _ = writeln!(Text(out), "{command}");
        if self.in_scip_1 {
            let known = command == "SCIP2.0";
            self.in_scip_1 = !known;
            out.extend_from_slice(if known { b"0\n\n" } else { b"E\n\n" });
            return;
        }
        match command.get(..2).unwrap_or_default() {
            "TM" => self.time(command, now_ns, out),
            _ if self.in_time_mode => line(out, b"10"),
            "QT" => {
                self.stream = None;
                self.laser_on = false;
                line(out, b"00");
            }
            "RS" => {
                self.reboot(now_ns);
                self.in_scip_1 = false;
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
        match (command.as_bytes().get(2), self.in_time_mode) {
            (Some(b'0'), false) => {
                self.in_time_mode = true;
                self.laser_on = false;
                self.stream = None;
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
                self.in_time_mode = false;
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
        let sheet = self.model.spec();
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
        field(out, "SCSP", &self.model.spec().rpm.to_string());
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
                let begin_ns =
                    self.rotation_begin_ns.saturating_sub(self.model.geometry(false).period_ns);
                let begin_ns = begin_ns.max(self.booted_ns);
                self.scan(begin_ns, self.clock_ms(begin_ns), layout, out);
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
            rotations: 0,
        });
        line(out, b"00");
    }

    fn layout(&self, command: &str) -> Result<Layout, &'static [u8]> {
        let sheet = self.model.spec();
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

/// Formats text into a byte buffer.
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

    fn reply(sensor: &mut Sensor, command: &str) -> String {
        let mut out = Vec::new();
        sensor.receive(command.as_bytes(), 1, &mut out);
        String::from_utf8(out).unwrap()
    }

    fn sensor(model: Model) -> Sensor {
        Sensor::new(model, Box::new(Room::new(model)), 0)
    }

    #[test]
    fn answers_are_those_of_the_specification_with_its_checksums() {
        let mut sensor = sensor(Model::Utm30lx);
        assert_eq!(reply(&mut sensor, "QT\n"), "QT\n00P\n\n");
        assert!(reply(&mut sensor, "PP\n").contains("\nAFRT:540;0\n"));
        assert_eq!(reply(&mut sensor, "XX\n"), "XX\n0Ee\n\n");
        assert_eq!(reply(&mut sensor, "MD0000200001000\n"), "MD0000200001000\n04T\n\n");
    }

    #[test]
    fn the_urg_04lx_starts_in_scip_1() {
        let mut sensor = sensor(Model::Urg04lx);
        assert_eq!(reply(&mut sensor, "QT\n"), "QT\nE\n\n");
        assert_eq!(reply(&mut sensor, "SCIP2.0\n"), "SCIP2.0\n0\n\n");
        assert_eq!(reply(&mut sensor, "QT\n"), "QT\n00P\n\n");
    }

    #[test]
    fn the_requested_number_of_scans_is_sent_one_per_period() {
        let mut sensor = sensor(Model::Utm30lx);
        assert_eq!(reply(&mut sensor, "MD0000108001002\n"), "MD0000108001002\n00P\n\n");
        let mut scans = Vec::new();
        for ms in 0..200 {
            let mut out = Vec::new();
            sensor.update(ms * 1_000_000, &mut out);
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
