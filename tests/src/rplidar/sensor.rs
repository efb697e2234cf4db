//! The scanner without a transport.

use std::ops::Range;

use drivers::rplidar::Model;

use super::encode::{cabin, capsule, head, node};
use crate::rotary::{CircleSource, Sensor, packet_mm};

/// Time that the scanner takes to start after a reset.
const BOOT_NS: u64 = 300_000_000;
/// Correction of the angles of an express scan, eighths of a degree: that of distant points.
const CORRECTION: u8 = 60;

/// Internal state of health.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum RplidarHealth {
    #[default]
    Well,
    /// In its protection stop: it reports an error and does not scan.
    Protection,
    /// Every measurement is without a distance.
    Blind,
}

/// A simulated scanner: bytes and times go in, messages come out.
pub struct RplidarSensor {
    model: Model,
    source: Box<dyn CircleSource>,
    pub health: RplidarHealth,
    /// Revolutions per second while the motor rotates.
    pub rotation_hz: f64,
    /// What begins between these clockwise angles, degrees, is not sent.
    pub missing_deg: Option<Range<f64>>,
    /// Whether it knows express scans.
    pub knows_express: bool,
    scan: Option<Scan>,
    motor_on: bool,
    /// Clockwise angle of the motor, degrees.
    angle_deg: f64,
    /// Time of the first measurement of the next message.
    begin_ns: u64,
    ready_ns: u64,
    input: Vec<u8>,
    resets: u32,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Scan {
    Nodes { is_first: bool },
    Legacy { is_first: bool },
    Dense { is_first: bool },
}

impl Scan {
    /// Measurements in one message.
    fn measurements(self) -> u32 {
        match self {
            Self::Nodes { .. } => 1,
            Self::Legacy { .. } => 32,
            Self::Dense { .. } => 40,
        }
    }
}

impl RplidarSensor {
    /// A scanner that was switched on and became ready at `now_ns`.
    #[must_use]
    pub fn new(model: Model, source: Box<dyn CircleSource>, now_ns: u64) -> Self {
        Self {
            model,
            source,
            health: RplidarHealth::Well,
            rotation_hz: model.spec().rotation_hz,
            missing_deg: None,
            knows_express: true,
            scan: None,
            motor_on: model == Model::A1,
            angle_deg: 30.0,
            begin_ns: now_ns,
            ready_ns: now_ns,
            input: Vec::new(),
            resets: 0,
        }
    }

    /// Whether it sends measurements, and whether its motor rotates. A pty has no DTR line, so the
    /// motor of an A1 always does.
    #[must_use]
    pub fn is_scanning(&self) -> (bool, bool) {
        (self.scan.is_some(), self.motor_on)
    }

    /// How often the host has restarted it.
    #[must_use]
    pub fn resets(&self) -> u32 {
        self.resets
    }

    fn answer(&mut self, command: u8, payload: &[u8], now_ns: u64, out: &mut Vec<Vec<u8>>) {
        match (command, payload) {
            (0x25, _) => self.scan = None,
            (0x40, _) => {
                self.resets += 1;
                self.reboot(now_ns + BOOT_NS);
            }
            (0x50, _) => {
                let mut answer = head(20, false, 0x04);
                answer.extend([self.model.spec().series * 16 + 8, 29, 1, 7]);
                answer.extend(0x10..0x20);
                out.push(answer);
            }
            (0x52, _) => {
                let mut answer = head(3, false, 0x06);
                let is_broken = self.health == RplidarHealth::Protection;
                answer.extend(if is_broken { [2, 0x02, 0x80] } else { [0, 0, 0] });
                out.push(answer);
            }
            (0x20, _) => {
                self.begin(Scan::Nodes { is_first: true }, head(5, true, 0x81), now_ns, out);
            }
            (0x82, [0, ..]) if self.knows_express => {
                self.begin(Scan::Legacy { is_first: true }, head(84, true, 0x82), now_ns, out);
            }
            (0x82, [1, ..]) if self.knows_express && self.model == Model::S2 => {
                self.begin(Scan::Dense { is_first: true }, head(84, true, 0x85), now_ns, out);
            }
            (0xf0 | 0xa8, [low, high]) => self.motor_on = *low > 0 || *high > 0,
            _ => {}
        }
    }

    fn begin(&mut self, scan: Scan, head: Vec<u8>, now_ns: u64, out: &mut Vec<Vec<u8>>) {
        if self.health != RplidarHealth::Protection {
            self.scan = Some(scan);
            self.begin_ns = now_ns;
            out.push(head);
        }
    }

    /// What the measurement of this number in the next message sees.
    fn distance_mm(&mut self, scan: Scan, index: u32, clockwise_deg: f64) -> u16 {
        let time_ns = self.begin_ns + self.lasts_ns(scan, index);
        let range = self.source.range(time_ns, -clockwise_deg.to_radians());
        if self.health == RplidarHealth::Blind { 0 } else { packet_mm(range) }
    }

    /// Time in which this number of measurements is made.
    fn lasts_ns(&self, scan: Scan, measurements: u32) -> u64 {
        (1e9 * f64::from(measurements) / self.rate_hz(scan)) as u64
    }

    /// The next message of a scan.
    fn message(&mut self, scan: Scan, step_deg: f64) -> Vec<u8> {
        let start_deg = self.angle_deg;
        match scan {
            Scan::Nodes { .. } => {
                let is_start = start_deg < step_deg;
                let distance_mm = self.distance_mm(scan, 0, start_deg);
                node(is_start, start_deg, distance_mm)
            }
            Scan::Legacy { is_first } => {
                // The correction is subtracted, so the measured direction lies before the motor's.
                let correction_deg = f64::from(CORRECTION) / 8.0;
                let mut body = Vec::new();
                for pair in 0..16 {
                    body.extend(cabin([0, 1].map(|index| {
                        let index = 2 * pair + index;
                        let motor_deg = start_deg + step_deg * f64::from(index);
                        (self.distance_mm(scan, index, motor_deg - correction_deg), CORRECTION)
                    })));
                }
                capsule(is_first, start_deg, &body)
            }
            Scan::Dense { is_first } => {
                let body: Vec<u8> = (0..40)
                    .flat_map(|index| {
                        let clockwise_deg = start_deg + step_deg * f64::from(index);
                        self.distance_mm(scan, index, clockwise_deg).to_le_bytes()
                    })
                    .collect();
                capsule(is_first, start_deg, &body)
            }
        }
    }

    fn rate_hz(&self, scan: Scan) -> f64 {
        match scan {
            Scan::Nodes { .. } => self.model.spec().rate_hz.1,
            Scan::Legacy { .. } => 4000.0,
            Scan::Dense { .. } => 32_000.0,
        }
    }
}

impl Sensor for RplidarSensor {
    fn receive(&mut self, bytes: &[u8], now_ns: u64, out: &mut Vec<Vec<u8>>) {
        if now_ns < self.ready_ns {
            return;
        }
        self.input.extend(bytes);
        while let Some(at) = self.input.iter().position(|byte| *byte == 0xa5) {
            self.input.drain(..at);
            let Some(command) = self.input.get(1).copied() else { return };
            let mut length = 2;
            if command >= 0x80 {
                let Some(payload) = self.input.get(2) else { return };
                length = 4 + usize::from(*payload);
            }
            if self.input.len() < length {
                return;
            }
            let request: Vec<u8> = self.input.drain(..length).collect();
            let sum = request.iter().fold(0, |sum, byte| sum ^ byte);
            if command < 0x80 || sum == 0 {
                self.answer(command, request.get(3..length - 1).unwrap_or_default(), now_ns, out);
            }
        }
        self.input.clear();
    }

    fn update(&mut self, now_ns: u64, out: &mut Vec<Vec<u8>>) {
        if self.health == RplidarHealth::Protection {
            self.scan = None;
        }
        let Some(scan) = self.scan.filter(|_| self.motor_on) else {
            self.begin_ns = self.begin_ns.max(now_ns);
            return;
        };
        let mut scan = scan;
        let count = scan.measurements();
        let lasts_ns = self.lasts_ns(scan, count);
        // A message is sent when the measurement after its last one is due.
        while self.begin_ns + lasts_ns <= now_ns {
            let step_deg = 360.0 * self.rotation_hz / self.rate_hz(scan);
            let start_deg = self.angle_deg;
            let message = self.message(scan, step_deg);
            self.angle_deg = (start_deg + step_deg * f64::from(count)) % 360.0;
            self.begin_ns += lasts_ns;
            if self.missing_deg.as_ref().is_none_or(|part| !part.contains(&start_deg)) {
                out.push(message);
            }
            scan = match scan {
                Scan::Nodes { .. } => Scan::Nodes { is_first: false },
                Scan::Legacy { .. } => Scan::Legacy { is_first: false },
                Scan::Dense { .. } => Scan::Dense { is_first: false },
            };
        }
        self.scan = Some(scan);
    }

    fn reboot(&mut self, ready_ns: u64) {
        self.scan = None;
        self.motor_on = self.model == Model::A1;
        self.input.clear();
        self.ready_ns = ready_ns;
        self.begin_ns = ready_ns;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rotary::CircleRoom;

    fn answers(sensor: &mut RplidarSensor, request: &[u8]) -> Vec<Vec<u8>> {
        let mut out = Vec::new();
        sensor.receive(request, 1, &mut out);
        out
    }

    #[test]
    fn questions_are_answered_and_a_request_with_a_wrong_checksum_is_not() {
        let mut sensor = RplidarSensor::new(Model::A2, Box::new(CircleRoom), 0);
        let info = answers(&mut sensor, &[0xa5, 0x50]);
        assert_eq!((info[0].len(), info[0][7]), (27, 0x28));
        assert_eq!(answers(&mut sensor, &[0xa5, 0x52])[0][7..], [0, 0, 0]);
        assert!(answers(&mut sensor, &[0xa5, 0x82, 5, 0, 0, 0, 0, 0, 0x23]).is_empty());
        assert_eq!(sensor.is_scanning(), (false, false));
        assert_eq!(answers(&mut sensor, &[0xa5, 0x82, 5, 0, 0, 0, 0, 0, 0x22]).len(), 1);
        answers(&mut sensor, &[0xa5, 0xf0, 2, 0x94, 2, 0xc1]);
        assert_eq!(sensor.is_scanning(), (true, true));
    }

    #[test]
    fn an_express_scan_of_a_second_has_125_capsules() {
        let mut sensor = RplidarSensor::new(Model::A1, Box::new(CircleRoom), 0);
        answers(&mut sensor, &[0xa5, 0x82, 5, 0, 0, 0, 0, 0, 0x22]);
        let mut out = Vec::new();
        // The request came at 1 ns.
        sensor.update(1_000_000_001, &mut out);
        assert_eq!(out.len(), 125);
        assert!(out.iter().all(|message| message.len() == 84));
    }
}
