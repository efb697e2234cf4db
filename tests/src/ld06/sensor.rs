//! The scanner without a transport.

use std::ops::Range;

use super::encode::packet;
use crate::rotary::{CircleSource, Sensor, packet_mm};

/// Measurements per second.
pub const RATE_HZ: f64 = 4500.0;
/// Confidence of an ordinary echo, and of a point without one.
const CONFIDENCE: u8 = 200;
const POINTS: usize = 12;
/// Time in which the points of a packet are measured.
const PACKET_NS: u64 = (1e9 * POINTS as f64 / RATE_HZ) as u64;

/// A simulated LD06: times go in, packets come out.
pub struct Ld06Sensor {
    source: Box<dyn CircleSource>,
    /// Revolutions per second.
    pub rotation_hz: f64,
    /// Every point has no echo, as behind a cover.
    pub is_blind: bool,
    /// Confidence of its echoes.
    pub confidence: u8,
    /// Packets that begin between these clockwise angles, degrees, are not sent.
    pub missing_deg: Option<Range<f64>>,
    /// Clockwise angle of the next point, degrees.
    angle_deg: f64,
    /// Time of the first point of the next packet.
    begin_ns: u64,
    /// Whole revolutions so far.
    turns: u64,
}

impl Ld06Sensor {
    /// A scanner that was switched on at `now_ns`.
    #[must_use]
    pub fn new(source: Box<dyn CircleSource>, now_ns: u64) -> Self {
        Self {
            source,
            rotation_hz: 10.0,
            is_blind: false,
            confidence: CONFIDENCE,
            missing_deg: None,
            angle_deg: 90.0,
            begin_ns: now_ns,
            turns: 0,
        }
    }

    /// Number of whole revolutions so far.
    #[must_use]
    pub fn turns(&self) -> u64 {
        self.turns
    }

    fn next_packet(&mut self) -> Option<Vec<u8>> {
        let step_deg = 360.0 * self.rotation_hz / RATE_HZ;
        let start_deg = self.angle_deg;
        let mut points = [(0, 0); POINTS];
        for (index, point) in points.iter_mut().enumerate() {
            let clockwise_deg = start_deg + step_deg * index as f64;
            let time_ns = self.begin_ns + (1e9 * index as f64 / RATE_HZ) as u64;
            let range = self.source.range(time_ns, -clockwise_deg.to_radians());
            let distance_mm = if self.is_blind { 0 } else { packet_mm(range) };
            *point = (distance_mm, if distance_mm == 0 { 0 } else { self.confidence });
        }
        let end_deg = start_deg + step_deg * (POINTS - 1) as f64;
        self.angle_deg = start_deg + step_deg * POINTS as f64;
        if self.angle_deg >= 360.0 {
            self.angle_deg -= 360.0;
            self.turns += 1;
        }
        let milliseconds = (self.begin_ns / 1_000_000 % 30_000) as u16;
        self.begin_ns += PACKET_NS;
        let is_missing = self.missing_deg.as_ref().is_some_and(|part| part.contains(&start_deg));
        let angles =
            [start_deg, end_deg].map(|degrees| ((degrees * 100.0).round() as u32 % 36_000) as u16);
        (!is_missing)
            .then(|| packet((360.0 * self.rotation_hz) as u16, angles, &points, milliseconds))
    }
}

impl Sensor for Ld06Sensor {
    /// It has no input.
    fn receive(&mut self, _bytes: &[u8], _now_ns: u64, _out: &mut Vec<Vec<u8>>) {}

    fn update(&mut self, now_ns: u64, out: &mut Vec<Vec<u8>>) {
        // A packet is sent when the point after its last one is due.
        while self.begin_ns + PACKET_NS <= now_ns {
            out.extend(self.next_packet());
        }
    }

    fn reboot(&mut self, ready_ns: u64) {
        self.begin_ns = ready_ns;
        self.angle_deg = 90.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rotary::CircleRoom;

    #[test]
    fn a_second_has_375_packets_and_ten_revolutions() {
        let mut sensor = Ld06Sensor::new(Box::new(CircleRoom), 0);
        let mut out = Vec::new();
        sensor.update(999_999_999, &mut out);
        assert_eq!((out.len(), sensor.turns()), (375, 10));
        assert!(out.iter().all(|packet| packet.len() == 47));
    }
}
