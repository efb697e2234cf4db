//! Behaviour of the drivers for rotating scanners when the scanner or its cable fails. The real drivers
//! run on the pty of simulated scanners, in real time.
#![allow(clippy::unwrap_used, reason = "a test that cannot set up its fixture has failed")]

mod scanner_bench;

use std::path::PathBuf;

use drivers::DeviceState;
use drivers::ld06::{self, Ld06Config};
use drivers::lidar::{AnyLidar, LidarConfig, LidarKind};
use drivers::rotary::{Mount, Place, RotaryLidar};
use drivers::rplidar::{self, Model, RplidarConfig, ScanMode};
use hal::{Clock, Error, ErrorKind, Range};
use hil::hokuyo::WireFaults;
use hil::ld06::{Ld06Sensor, SimulatedLd06};
use hil::rotary::{CircleRoom, CircleSource, Sensor, SimulatedRotary};
use hil::rplidar::{RplidarHealth, RplidarSensor, SimulatedRplidar};
use monotonic_clock::{MonotonicClock, monotonic_ns};
use scanner_bench::{Bench, MS, TIMEOUT_NS, stable_path};

type RotaryBench<S> = Bench<SimulatedRotary<S>, RotaryLidar>;

/// A wall around the scanner, whose distance tells the direction: 3 m ahead, and 1 cm more for every
/// degree counter-clockwise, from -180 to 180.
struct Compass;

impl CircleSource for Compass {
    fn range(&mut self, _time_ns: u64, angle_rad: f64) -> Range {
        let degrees = hal::wrap_angle(angle_rad).to_degrees();
        Range::Hit((3.0 + 0.01 * degrees) as f32)
    }
}

fn bench_of<S: Sensor>(
    device: SimulatedRotary<S>,
    lidar: RotaryLidar,
    folder: tempfile::TempDir,
) -> RotaryBench<S> {
    let monitor = lidar.monitor();
    Bench::new(device, lidar, monitor, folder)
}

fn place(path: PathBuf) -> Place {
    Place::new(drivers::Port::Serial(path))
}

fn ld06() -> RotaryBench<Ld06Sensor> {
    ld06_with(Box::new(CircleRoom), Mount::default(), |_| {})
}

fn ld06_with(
    source: Box<dyn CircleSource>,
    mount: Mount,
    prepare: impl Fn(&SimulatedLd06),
) -> RotaryBench<Ld06Sensor> {
    let (folder, path) = stable_path();
    let device = SimulatedLd06::on_pty(&path, Ld06Sensor::new(source, monotonic_ns())).unwrap();
    prepare(&device);
    let lidar = ld06::open(Place { mount, ..place(path) }, &Ld06Config::default()).unwrap();
    bench_of(device, lidar, folder)
}

fn rplidar(model: Model) -> RotaryBench<RplidarSensor> {
    let config = RplidarConfig { model, ..RplidarConfig::default() };
    rplidar_with(model, Box::new(CircleRoom), &config, |_| {})
}

fn rplidar_with(
    real: Model,
    source: Box<dyn CircleSource>,
    config: &RplidarConfig,
    prepare: impl Fn(&SimulatedRplidar),
) -> RotaryBench<RplidarSensor> {
    let (folder, path) = stable_path();
    let sensor = RplidarSensor::new(real, source, monotonic_ns());
    let device = SimulatedRplidar::on_pty(&path, sensor).unwrap();
    prepare(&device);
    let lidar = rplidar::open(place(path), config).unwrap();
    bench_of(device, lidar, folder)
}

impl RotaryBench<RplidarSensor> {
    fn until_reset(&mut self) {
        let deadline_ns = monotonic_ns() + TIMEOUT_NS;
        while self.device.with(|sensor| sensor.resets()) == 0 {
            assert!(monotonic_ns() < deadline_ns, "the driver does not restart the scanner");
            _ = self.poll();
        }
    }
}

impl<S: Sensor> RotaryBench<S> {
    fn wire(&self, wire: WireFaults) {
        self.device.set_wire(wire);
    }

    /// Every hit shows the direction in which it was measured, to a degree and a half.
    fn assert_true_directions(&self) {
        let mut hits = 0;
        for (angle_rad, distance_m) in self.scan.hits() {
            let shown_deg = f64::from(distance_m - 3.0) * 100.0;
            let off_deg = hal::wrap_angle(shown_deg.to_radians() - angle_rad).to_degrees();
            assert!(off_deg.abs() < 1.6, "{} shows {shown_deg}", angle_rad.to_degrees());
            hits += 1;
        }
        assert!(2 * hits > self.scan.ranges.len(), "{hits} hits");
    }

    /// The part of the beams that are errors.
    fn error_share(&self) -> f64 {
        let errors = self.scan.ranges.iter().filter(|range| **range == Range::Error).count();
        errors as f64 / self.scan.ranges.len() as f64
    }
}

/// What every scanner has to do: silence, noise, flipped bits, cut packets and a pulled plug.
fn survives_the_faults_of_its_cable<S: Sensor>(mut bench: RotaryBench<S>) {
    bench.until_scan();
    bench.wire(WireFaults { is_stalled: true, ..WireFaults::default() });
    bench.until_error(ErrorKind::Timeout);
    for _ in 0..20 {
        assert!(bench.poll().is_err(), "a scan from before the silence");
    }
    bench.wire(WireFaults::default());
    bench.until_scan();
    bench.wire(WireFaults { noise_bytes: 3000, ..WireFaults::default() });
    bench.until_scan();
    bench.device.unplug();
    bench.until_error(ErrorKind::Disconnected);
    for _ in 0..200 {
        assert!(bench.poll().is_err(), "the scanner is unplugged");
    }
    bench.device.plug_in().unwrap();
    bench.until_scan();
    assert!(bench.lidar.status().reopened >= 1);
    bench.device.reboot(3_000 * MS);
    bench.until_error(ErrorKind::Timeout);
    bench.until_scan();
}

#[test]
fn an_ld06_is_followed_through_silence_noise_a_pulled_plug_and_a_restart() {
    survives_the_faults_of_its_cable(ld06());
}

#[test]
fn an_rplidar_a1_is_followed_through_silence_noise_a_pulled_plug_and_a_restart() {
    survives_the_faults_of_its_cable(rplidar(Model::A1));
}

#[test]
fn an_rplidar_a2_is_followed_through_silence_noise_a_pulled_plug_and_a_restart() {
    survives_the_faults_of_its_cable(rplidar(Model::A2));
}

#[test]
fn beams_point_where_they_were_measured_although_the_scanners_rotate_clockwise() {
    let mut bench = ld06_with(Box::new(Compass), Mount::default(), |_| {});
    bench.until_scan();
    bench.assert_true_directions();
    for (model, scan_mode) in [
        (Model::A1, ScanMode::Express),
        (Model::A1, ScanMode::Standard),
        (Model::A2, ScanMode::Express),
        (Model::S2, ScanMode::Express),
    ] {
        let config = RplidarConfig { model, scan_mode, ..RplidarConfig::default() };
        let mut bench = rplidar_with(model, Box::new(Compass), &config, |_| {});
        bench.until_scan();
        bench.assert_true_directions();
    }
}

#[test]
fn an_ld06_that_is_mounted_backwards_is_turned_by_its_configuration() {
    let mount = Mount { zero_rad: std::f64::consts::PI, upside_down: false };
    let mut bench = ld06_with(Box::new(Compass), mount, |_| {});
    bench.until_scan();
    let (_, ahead_m) = bench.scan.hits().find(|(angle_rad, _)| angle_rad.abs() < 0.01).unwrap();
    assert!((f64::from(ahead_m) - 1.2).abs() < 0.02 || (f64::from(ahead_m) - 4.8).abs() < 0.02);
}

#[test]
fn a_packet_with_a_flipped_bit_or_a_cut_one_never_shows_a_wrong_distance() {
    fn never_wrong<S: Sensor>(mut bench: RotaryBench<S>) {
        bench.until_scan();
        for wire in [
            WireFaults { flip_share: 0.1, ..WireFaults::default() },
            WireFaults { cut_share: 0.1, ..WireFaults::default() },
        ] {
            let before = bench.lidar.status().bad;
            bench.wire(wire);
            let mut scans = 0;
            bench.until("scans between damaged packets", |polled| {
                scans += u32::from(matches!(polled, Ok(true)));
                scans > 10
            });
            for (angle_rad, distance_m) in bench.scan.hits() {
                let shown_deg = f64::from(distance_m - 3.0) * 100.0;
                let off_deg = hal::wrap_angle(shown_deg.to_radians() - angle_rad).to_degrees();
                assert!(off_deg.abs() < 1.6, "{angle_rad}");
            }
            assert!(bench.lidar.status().bad > before);
        }
    }
    never_wrong(ld06_with(Box::new(Compass), Mount::default(), |_| {}));
    let config = RplidarConfig { model: Model::A2, ..RplidarConfig::default() };
    never_wrong(rplidar_with(Model::A2, Box::new(Compass), &config, |_| {}));
}

#[test]
fn a_missing_sector_is_errors_and_not_free() {
    fn has_errors_between<S: Sensor>(bench: &mut RotaryBench<S>, from_deg: f64, to_deg: f64) {
        // The scan in which the sector went missing may be partly old.
        bench.until_scan();
        bench.until_scan();
        let mut beams = 0;
        for (beam, range) in bench.scan.ranges.iter().enumerate() {
            let clockwise_deg =
                (-bench.scan.geometry.angle_rad(beam)).to_degrees().rem_euclid(360.0);
            if (from_deg..to_deg).contains(&clockwise_deg) {
                assert_eq!(*range, Range::Error, "{clockwise_deg} degrees");
                beams += 1;
            }
        }
        assert!(beams > 20);
    }
    let mut bench = ld06();
    bench.until_scan();
    bench.device.with(|sensor| sensor.missing_deg = Some(100.0..180.0));
    has_errors_between(&mut bench, 110.0, 179.0);
    let mut bench = rplidar(Model::A1);
    bench.until_scan();
    bench.device.with(|sensor| sensor.missing_deg = Some(100.0..180.0));
    // The scanner corrects directions by up to eight degrees.
    has_errors_between(&mut bench, 117.0, 172.0);
}

#[test]
fn a_scan_without_any_echo_is_a_fault_and_not_free_space() {
    let mut bench = ld06();
    bench.until_scan();
    bench.device.with(|sensor| sensor.is_blind = true);
    bench.until_error(ErrorKind::Fault);
    let problem = bench.until_problem("400 without echo");
    assert!(problem.contains("clean"), "{problem}");
    bench.device.with(|sensor| sensor.is_blind = false);
    bench.until_scan();
    let mut bench = rplidar(Model::A1);
    bench.until_scan();
    bench.device.with(|sensor| sensor.health = RplidarHealth::Blind);
    bench.until_error(ErrorKind::Fault);
    bench.device.with(|sensor| sensor.health = RplidarHealth::Well);
    bench.until_scan();
}

#[test]
fn echoes_of_low_confidence_are_errors() {
    let mut bench = ld06();
    bench.until_scan();
    bench.device.with(|sensor| sensor.confidence = 14);
    bench.until_problem("errors");
    assert!(bench.poll().is_err());
}

#[test]
fn a_motor_that_slows_down_is_a_fault_with_its_rate_and_drives_again_at_full_speed() {
    let mut bench = ld06();
    bench.until_scan();
    bench.device.with(|sensor| sensor.rotation_hz = 7.0);
    bench.until_error(ErrorKind::Fault);
    bench.until_problem("instead of 10.0");
    // The rate is the mean of four revolutions, and settles after them.
    bench.until_problem("rotates 7.");
    bench.device.with(|sensor| sensor.rotation_hz = 10.0);
    bench.until_scan();
    let mut bench = rplidar(Model::A2);
    bench.until_scan();
    bench.device.with(|sensor| sensor.rotation_hz = 4.0);
    bench.until_problem("instead of 10.0");
    bench.device.with(|sensor| sensor.rotation_hz = 10.0);
    bench.until_scan();
}

#[test]
fn another_device_on_the_port_is_named() {
    // An RPLIDAR driver at an LD06, and the other way round.
    let (_folder, path) = stable_path();
    let sensor = Ld06Sensor::new(Box::new(CircleRoom), monotonic_ns());
    let device = SimulatedLd06::on_pty(&path, sensor).unwrap();
    let lidar = rplidar::open(place(path), &RplidarConfig::default()).unwrap();
    let mut bench = bench_of(device, lidar, tempfile::tempdir().unwrap());
    let problem = bench.until_problem("nothing that a RPLIDAR A1 sends");
    assert!(problem.contains("correct `kind`, `port`"), "{problem}");
    assert!(bench.poll().is_err());
    let (_folder, path) = stable_path();
    let sensor = RplidarSensor::new(Model::A1, Box::new(CircleRoom), monotonic_ns());
    let device = SimulatedRplidar::on_pty(&path, sensor).unwrap();
    let lidar = ld06::open(place(path), &Ld06Config::default()).unwrap();
    let mut bench = bench_of(device, lidar, tempfile::tempdir().unwrap());
    let problem = bench.until_problem("the LD06 or LD19 sends nothing");
    assert!(problem.contains("has power"), "{problem}");
}

#[test]
fn a_wrong_bit_rate_is_named() {
    let mut bench = ld06_with(Box::new(CircleRoom), Mount::default(), |device| {
        device.set_baud(115_200);
    });
    let problem = bench.until_problem("230400 bit/s");
    assert!(problem.contains("another bit rate"), "{problem}");
}

#[test]
fn another_model_than_configured_is_refused_by_its_number() {
    let config = RplidarConfig { model: Model::A1, ..RplidarConfig::default() };
    let mut bench = rplidar_with(Model::A3, Box::new(CircleRoom), &config, |_| {});
    let problem = bench.until_problem("0x38");
    assert!(problem.contains("configured is RPLIDAR A1"), "{problem}");
    assert_eq!(bench.poll().unwrap_err().kind(), ErrorKind::Fault);
}

#[test]
fn a_protection_stop_is_a_fault_with_its_code_and_the_driver_restarts_the_scanner() {
    let mut bench = rplidar(Model::A2);
    bench.until_scan();
    bench.device.with(|sensor| sensor.health = RplidarHealth::Protection);
    let problem = bench.until_problem("error, code 0x8002");
    assert!(problem.contains("power-cycle"), "{problem}");
    bench.until_reset();
    bench.device.with(|sensor| sensor.health = RplidarHealth::Well);
    bench.until_scan();
}

#[test]
fn firmware_without_express_scans_is_read_by_standard_scans() {
    let config = RplidarConfig { scan_mode: ScanMode::Standard, ..RplidarConfig::default() };
    let mut bench = rplidar_with(Model::A1, Box::new(Compass), &config, |device| {
        device.with(|sensor| sensor.knows_express = false);
    });
    bench.until_scan();
    bench.assert_true_directions();
    assert!(bench.error_share() < 0.05, "{}", bench.error_share());
}

#[test]
fn the_first_returned_scan_is_whole_and_few_beams_of_any_scan_are_unmeasured() {
    let mut bench = ld06();
    for _ in 0..5 {
        bench.until_scan();
        assert!(bench.error_share() < 0.02, "{}", bench.error_share());
    }
}

#[test]
fn a_configured_latency_is_subtracted_from_every_time_stamp() {
    let (folder, path) = stable_path();
    let sensor = Ld06Sensor::new(Box::new(CircleRoom), monotonic_ns());
    let device = SimulatedLd06::on_pty(&path, sensor).unwrap();
    let config = LidarConfig {
        kind: LidarKind::Ld06,
        port: drivers::Port::Serial(path),
        latency_ms: 150.0,
        ..LidarConfig::default()
    };
    let lidar = AnyLidar::open(&config).unwrap();
    let monitor = lidar.monitor();
    let mut bench = Bench::new(device, lidar, monitor, folder);
    for _ in 0..3 {
        bench.until_scan();
        // A scan is known at its end at the earliest.
        let scan = &bench.scan;
        let ended_ns = scan.time_ns + scan.geometry.period_ns;
        assert!(monotonic_ns() >= ended_ns + 150 * MS, "{ended_ns}");
    }
}

#[test]
fn the_scanner_reports_its_model_serial_number_and_firmware() {
    let mut bench = rplidar(Model::A1);
    bench.until_scan();
    let identity = bench.lidar.monitor().identity().unwrap();
    assert_eq!(identity.model, "RPLIDAR A1 (model number 0x18)");
    assert_eq!(identity.firmware, "1.29");
    assert!(identity.serial.starts_with("101112"), "{}", identity.serial);
}

#[test]
fn the_safety_thread_allocates_nothing_when_it_polls() {
    let mut bench = ld06();
    bench.until_scan();
    for plugged in [true, false] {
        if !plugged {
            bench.device.unplug();
        }
        let counted = allocation_counter::measure(|| {
            for _ in 0..100 {
                _ = bench.poll();
            }
        });
        assert_eq!(counted.count_total, 0);
    }
}

#[test]
fn a_dropped_driver_stops_scan_and_motor() {
    let mut bench = rplidar(Model::A2);
    bench.until_scan();
    assert_eq!(bench.lidar.status().state, DeviceState::Working);
    assert_eq!(bench.device.with(|sensor| sensor.is_scanning()), (true, true));
    let Bench { device, lidar, folder: _folder, .. } = bench;
    drop(lidar);
    let deadline_ns = monotonic_ns() + TIMEOUT_NS;
    while device.with(|sensor| sensor.is_scanning()) != (false, false) {
        assert!(monotonic_ns() < deadline_ns, "the scanner keeps rotating");
        MonotonicClock.sleep_until_ns(monotonic_ns() + MS);
    }
}
