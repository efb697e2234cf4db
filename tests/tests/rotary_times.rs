//! The times that a driver's scans give to their beams, against the times at which the simulated scanner measured them.

use drivers::lidar::{LidarConfig, LidarKind};
use drivers::rotary::{Event, Revolution, RevolutionClock, RevolutionTime, Sample};
use drivers::rplidar::{Model, RplidarConfig, ScanMode};
use drivers::{ld06, rplidar};
use hal::{LaserScan, Range};
use hil::ld06::Ld06Sensor;
use hil::rotary::{CircleSource, Sensor};
use hil::rplidar::RplidarSensor;

const MS: u64 = 1_000_000;

/// Every distance says when it was measured: 1 m, and 10 m for each second since the last whole one.
struct Stopwatch;

impl CircleSource for Stopwatch {
    fn range(&mut self, time_ns: u64, _angle_rad: f64) -> Range {
        Range::Hit(1.0 + 10.0 * (time_ns as f64 * 1e-9).fract() as f32)
    }
}

/// How much later than it was measured a beam seems to be, milliseconds: the least and the most of all beams of two seconds.
fn late_ms(
    mut sensor: impl Sensor,
    config: &LidarConfig,
    mut samples_of: impl FnMut(&[u8]) -> Vec<Sample>,
) -> [f64; 2] {
    let geometry = config.geometry();
    let mut revolution = Revolution::new(&geometry, config.place().mount);
    let mut clock = RevolutionClock::new(geometry.period_ns);
    let mut scan = LaserScan::empty(geometry);
    let mut late_ms = [f64::INFINITY, f64::NEG_INFINITY];
    let mut scans = 0;
    for now_ns in (0..2000 * MS).step_by(MS as usize / 2) {
        let mut messages = Vec::new();
        sensor.update(now_ns, &mut messages);
        for sample in messages.iter().flat_map(|message| samples_of(message)) {
            if !revolution.push(&sample, &mut scan.ranges) {
                continue;
            }
            if let RevolutionTime::Whole { end_ns } = clock.end_revolution(now_ns) {
                scan.time_ns = end_ns - geometry.period_ns;
                scans += 1;
                for beam_ms in beams_late_ms(&scan) {
                    late_ms = [late_ms[0].min(beam_ms), late_ms[1].max(beam_ms)];
                }
            }
        }
    }
    assert!(scans > 7, "{scans} scans");
    late_ms
}

fn beams_late_ms(scan: &LaserScan) -> impl Iterator<Item = f64> {
    let hits = scan.ranges.iter().enumerate();
    hits.filter_map(|(beam, range)| {
        let measured_s = (f64::from(range.hit_m()?) - 1.0) / 10.0;
        let stamped_s = scan.middle_ns() as f64 * 1e-9 + scan.geometry.after_middle_s(beam);
        let late_s = stamped_s - measured_s;
        Some(1e3 * (late_s - late_s.round()))
    })
}

fn mounts(config: &LidarConfig) -> Vec<LidarConfig> {
    let each = [(0.0, false), (180.0, false), (90.0, true), (-130.0, true)];
    let mounted = |(zero_deg, upside_down)| LidarConfig { zero_deg, upside_down, ..config.clone() };
    each.into_iter().map(mounted).collect()
}

#[test]
fn every_beam_of_an_ld06_has_its_time_however_it_is_mounted() {
    let ld06 = LidarConfig { kind: LidarKind::Ld06, ..LidarConfig::default() };
    for config in mounts(&ld06) {
        let mut decoder = ld06::Decoder::new(15);
        let found = late_ms(Ld06Sensor::new(Box::new(Stopwatch), 0), &config, |bytes| {
            let mut samples = Vec::new();
            bytes
                .iter()
                .for_each(|byte| decoder.push(*byte, |event| samples.extend(sample(&event))));
            samples
        });
        // A packet holds 2.7 ms, the seam is known two measurements later, and the computer reads every half millisecond.
        assert!(found[0] > 0.0 && found[1] < 4.0, "{config:?}: {found:?} ms");
    }
}

fn sample<E>(event: &Event<E>) -> Option<Sample> {
    match event {
        Event::Sample(sample) => Some(*sample),
        _ => None,
    }
}

#[test]
fn every_beam_of_an_rplidar_has_its_time_in_both_kinds_of_scan() {
    // A capsule holds 32 measurements and is kept back until the next one says how far it reaches: twice 8 ms. The measured
    // direction of the simulated scanner lies 7.5 degrees before the motor's, which is 3.8 ms less.
    let express = (ScanMode::Express, [0xa5, 0x82, 5, 0, 0, 0, 0, 0, 0x22].as_slice(), [7.0, 18.0]);
    // A measurement counts when six more have followed it, and the seam is known two measurements later, each 0.5 ms.
    let standard = (ScanMode::Standard, [0xa5, 0x20].as_slice(), [4.0, 7.0]);
    for (scan_mode, request, [least_ms, most_ms]) in [express, standard] {
        let rplidar = RplidarConfig { model: Model::A1, scan_mode, ..RplidarConfig::default() };
        let a1 = LidarConfig { kind: LidarKind::Rplidar, rplidar, ..LidarConfig::default() };
        for config in mounts(&a1) {
            let mut sensor = RplidarSensor::new(Model::A1, Box::new(Stopwatch), 0);
            let mut answer = Vec::new();
            sensor.receive(request, 0, &mut answer);
            let mut decoder = rplidar::Decoder::new(Model::A1.spec().range_m);
            answer.iter().flatten().for_each(|byte| decoder.push(*byte, |_| {}));
            let found = late_ms(sensor, &config, |bytes| {
                let mut samples = Vec::new();
                bytes
                    .iter()
                    .for_each(|byte| decoder.push(*byte, |event| samples.extend(sample(&event))));
                samples
            });
            let is_right = found[0] > least_ms && found[1] < most_ms;
            assert!(is_right, "{scan_mode:?} {config:?}: {found:?} ms");
        }
    }
}
