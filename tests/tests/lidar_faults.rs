//! Behaviour of the LiDAR driver when the LiDAR or its cable fails. The real driver runs on the pty
//! or TCP port of a simulated scanner, in real time; time limits have a margin for busy computers.
#![allow(clippy::unwrap_used, reason = "a test that cannot set up its fixture has failed")]

mod scanner_bench;

use std::net::{Ipv4Addr, SocketAddr};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex};

use drivers::DeviceState;
use drivers::hokuyo::{HokuyoConfig, HokuyoLidar, Port};
use drivers::scip::Model;
use hal::{Clock, Error, ErrorKind, LaserScan, Lidar};
use hil::hokuyo::{Health, Room, ScanSource, SimulatedHokuyo, WireFaults};
use monotonic_clock::MonotonicClock;
use monotonic_clock::monotonic_ns;
use scanner_bench::{Bench, MS, TIMEOUT_NS, stable_path};

type HokuyoBench = Bench<SimulatedHokuyo, HokuyoLidar>;

fn bench(model: Model) -> HokuyoBench {
    bench_with(model, Box::new(Room::new(model)), |config| config, |_| {})
}

fn bench_with(
    model: Model,
    source: Box<dyn ScanSource>,
    configure: impl Fn(HokuyoConfig) -> HokuyoConfig,
    prepare: impl Fn(&SimulatedHokuyo),
) -> HokuyoBench {
    let (folder, path) = stable_path();
    let device = SimulatedHokuyo::on_pty(model, &path, source).unwrap();
    prepare(&device);
    let config = configure(HokuyoConfig { model, ..HokuyoConfig::new(Port::Serial(path)) });
    let lidar = HokuyoLidar::open(config).unwrap();
    let monitor = lidar.monitor();
    Bench::new(device, lidar, monitor, folder)
}

/// All ranges of a scan are equal and count the scans: 1001 mm for the first.
#[derive(Clone, Default)]
struct Counting {
    scans: Arc<AtomicU32>,
    begun_ns: Arc<Mutex<Vec<u64>>>,
}

impl ScanSource for Counting {
    fn ranges_mm(&mut self, time_ns: u64, out: &mut [u32]) {
        self.begun_ns.lock().unwrap().push(time_ns);
        out.fill(1001 + self.scans.fetch_add(1, Ordering::SeqCst));
    }
}

/// A bench whose driver returns a scan only after five good ones in a row.
fn counting_bench(source: &Counting) -> HokuyoBench {
    bench_with(
        Model::Utm30lx,
        Box::new(source.clone()),
        |config| HokuyoConfig { good_scans: 5, ..config },
        |_| {},
    )
}

fn count_of(scan: &LaserScan) -> u32 {
    (scan.ranges[0].hit_m().unwrap() * 1000.0).round() as u32 - 1000
}

#[test]
fn silence_for_more_than_two_periods_is_a_timeout_and_no_old_scan() {
    let mut bench = bench(Model::Utm30lx);
    bench.until_scan();
    bench.device.set_wire(WireFaults { is_stalled: true, ..WireFaults::default() });
    let stalled_ns = monotonic_ns();
    bench.until_error(ErrorKind::Timeout);
    // Two periods are 50 ms. The last scan may have arrived just before the stall.
    assert!(monotonic_ns() - stalled_ns < 50 * MS + 100 * MS);
    for _ in 0..20 {
        assert!(bench.poll().is_err(), "a scan from before the silence");
    }
    bench.device.set_wire(WireFaults::default());
    bench.until_scan();
}

#[test]
fn a_truncated_scan_is_dropped_and_the_next_one_is_taken() {
    let mut bench =
        bench_with(Model::Utm30lx, Box::new(Counting::default()), |config| config, |_| {});
    bench.until_scan();
    bench.device.set_wire(WireFaults { cut_share: 0.2, ..WireFaults::default() });
    let mut scans = 0;
    bench.until("scans between the cut ones", |polled| {
        scans += u32::from(matches!(polled, Ok(true)));
        scans > 20
    });
    assert!(bench.lidar.status().bad > 0);
    assert!(bench.scan.ranges.iter().all(|range| *range == bench.scan.ranges[0]));
}

#[test]
fn a_scan_with_a_flipped_bit_is_never_returned() {
    let mut bench =
        bench_with(Model::Utm30lx, Box::new(Counting::default()), |config| config, |_| {});
    bench.until_scan();
    bench.device.set_wire(WireFaults { flip_share: 0.5, ..WireFaults::default() });
    let begin = count_of(&bench.scan);
    while count_of(&bench.scan) < begin + 100 {
        bench.until_scan();
        let first = bench.scan.ranges[0];
        assert!(bench.scan.ranges.iter().all(|range| *range == first), "a beam has changed");
    }
    let status = bench.lidar.status();
    assert!(status.bad > 20, "{status:?}");
}

#[test]
fn a_dropped_scan_is_reported_as_corrupt_exactly_once() {
    let mut bench = bench(Model::Utm30lx);
    bench.until_scan();
    bench.device.set_wire(WireFaults { flip_share: 0.3, ..WireFaults::default() });
    let monitor = bench.monitor.clone();
    let before = monitor.status().bad;
    let (mut known, mut reports) = (before, 0);
    let deadline_ns = monotonic_ns() + TIMEOUT_NS;
    while reports < 20 {
        assert!(monotonic_ns() < deadline_ns, "{reports} reports of {:?}", monitor.status());
        MonotonicClock.sleep_until_ns(monotonic_ns() + MS);
        let dropped = monitor.status().bad;
        let polled = bench.lidar.poll_scan(&mut bench.scan);
        // On a busy computer another scan or a silence may have come since, which is returned instead.
        assert!(dropped == known || !matches!(polled, Ok(false)), "scan {dropped} is not reported");
        reports += u64::from(polled.is_err_and(|error| error.kind() == ErrorKind::Corrupt));
        known = monitor.status().bad;
        assert!(reports <= known - before, "{reports} reports of {} dropped scans", known - before);
    }
}

#[test]
fn a_reboot_into_scip_1_is_recovered_automatically() {
    let mut bench = bench(Model::Urg04lx);
    bench.until_scan();
    bench.device.reboot(500 * MS);
    bench.until_error(ErrorKind::Timeout);
    bench.until_scan();
    assert_eq!(bench.lidar.status().reopened, 1);
}

#[test]
fn a_replugged_scanner_is_found_by_its_stable_path_without_a_restart() {
    let mut bench = bench(Model::Utm30lx);
    bench.until_scan();
    for times in 1..=3 {
        bench.device.unplug();
        bench.until_error(ErrorKind::Disconnected);
        for _ in 0..200 {
            assert!(bench.poll().is_err(), "the scanner is unplugged");
        }
        bench.device.plug_in().unwrap();
        bench.until_scan();
        assert_eq!(bench.lidar.status().reopened, times);
    }
}

#[test]
fn a_scanner_that_is_plugged_in_later_is_found() {
    let mut bench = bench_with(
        Model::Utm30lx,
        Box::new(Room::new(Model::Utm30lx)),
        |config| config,
        SimulatedHokuyo::unplug,
    );
    let problem = bench.until_problem("cannot be opened");
    assert!(problem.contains("is it plugged in?"), "{problem}");
    assert_eq!(bench.poll().unwrap_err().kind(), ErrorKind::Disconnected);
    bench.device.plug_in().unwrap();
    bench.until_scan();
}

#[test]
fn after_each_reconnect_the_configured_number_of_good_scans_precedes_the_first_returned_one() {
    let source = Counting::default();
    let mut bench = counting_bench(&source);
    bench.until_scan();
    assert!(count_of(&bench.scan) >= 5);
    bench.device.unplug();
    bench.until_error(ErrorKind::Disconnected);
    let before = source.scans.load(Ordering::SeqCst);
    bench.device.plug_in().unwrap();
    bench.until_scan();
    assert!(count_of(&bench.scan) >= before + 5, "{} of {before}", count_of(&bench.scan));
}

#[test]
fn after_a_silence_or_a_cover_the_good_scans_in_a_row_are_counted_again() {
    let source = Counting::default();
    let mut bench = counting_bench(&source);
    bench.until_scan();
    bench.device.set_wire(WireFaults { is_stalled: true, ..WireFaults::default() });
    bench.until_error(ErrorKind::Timeout);
    let before = source.scans.load(Ordering::SeqCst);
    bench.device.set_wire(WireFaults::default());
    assert_counted_again(&mut bench, before);
    bench.device.set_health(Health::Blind);
    bench.until_error(ErrorKind::Fault);
    let before = source.scans.load(Ordering::SeqCst);
    bench.device.set_health(Health::Well);
    assert_counted_again(&mut bench, before);
}

/// Asserts that the next returned scan is at least the fifth after the first `before` scans.
fn assert_counted_again(bench: &mut HokuyoBench, before: u32) {
    bench.until_scan();
    let first = count_of(&bench.scan);
    assert!(first >= before + 5, "scan {first} after {before}");
}

#[test]
fn good_scans_with_bad_ones_between_them_are_not_good_scans_in_a_row() {
    let mut bench = bench_with(
        Model::Utm30lx,
        Box::new(Room::new(Model::Utm30lx)),
        |config| HokuyoConfig { good_scans: 100, ..config },
        |_| {},
    );
    let monitor = bench.monitor.clone();
    bench.until("the first good scan", |_| monitor.status().good > 0);
    // Of 100 scans in a row, one is damaged almost surely.
    bench.device.set_wire(WireFaults { flip_share: 0.3, ..WireFaults::default() });
    bench.until("many good scans", |polled| {
        assert!(!matches!(polled, Ok(true)), "a scan before 100 good ones in a row");
        monitor.status().good > 120
    });
}

#[test]
fn a_scanner_whose_clock_jumped_is_set_up_again() {
    let mut bench = bench(Model::Utm30lx);
    bench.until_scan();
    // Its clock is suddenly far in the future.
    bench.device.set_clock_ppm(100e6);
    bench.until_problem("timestamps jumped");
    bench.device.set_clock_ppm(0.0);
    bench.until_scan();
}

#[test]
fn single_wrong_time_stamps_are_bad_scans_and_the_scanner_is_not_set_up_again() {
    let mut bench = bench(Model::Utm30lx);
    bench.until_scan();
    // Two of three are right: three wrong ones in a row mean a restart.
    bench.device.set_wrong_stamp_every(3);
    let monitor = bench.monitor.clone();
    bench.until("ten wrong time stamps", |_| monitor.status().bad >= 10);
    bench.until_scan();
    let status = monitor.status();
    assert!(status.good > 10 && status.reopened == 0, "{status:?}");
}

#[test]
fn a_laser_that_cannot_be_switched_on_is_a_hardware_fault() {
    let mut bench = bench_with(
        Model::Utm30lx,
        Box::new(Room::new(Model::Utm30lx)),
        |config| config,
        |device| device.set_health(Health::LaserBroken),
    );
    let problem = bench.until_problem("hardware fault, status 01");
    assert!(problem.contains("Laser malfunction"), "{problem}");
    assert_eq!(bench.poll().unwrap_err().kind(), ErrorKind::Fault);
}

#[test]
fn a_configuration_out_of_range_starts_no_driver() {
    let config = HokuyoConfig::new(Port::Serial("/dev/null".into()));
    let error = HokuyoLidar::open(HokuyoConfig { good_scans: 0, ..config }).unwrap_err();
    assert!(error.to_string().contains("good_scans"), "{error}");
}

#[test]
fn a_scan_of_nothing_but_errors_is_a_fault_and_not_free_space() {
    let mut bench = bench(Model::Utm30lx);
    bench.until_scan();
    bench.device.set_health(Health::Blind);
    bench.until_error(ErrorKind::Fault);
    for _ in 0..50 {
        assert!(bench.poll().is_err());
    }
    let problem = bench.until_problem("1081 errors");
    assert!(problem.contains("clean"), "{problem}");
    bench.device.set_health(Health::Well);
    bench.until_scan();
}

#[test]
fn noise_before_the_first_answer_is_skipped() {
    bench_with(Model::Utm30lx, Box::new(Room::new(Model::Utm30lx)), |config| config, send_noise)
        .until_scan();
}

fn send_noise(device: &SimulatedHokuyo) {
    device.set_wire(WireFaults { noise_bytes: 3000, ..WireFaults::default() });
}

#[test]
fn a_wrong_baud_rate_is_named() {
    let model = Model::Utm30lx;
    let mut bench = bench_with(
        model,
        Box::new(Room::new(model)),
        |config| config,
        |device| device.set_baud(19_200),
    );
    let problem = bench.until_problem("wrong baud rate (115200)");
    assert!(problem.contains("19200"), "{problem}");
    assert!(bench.poll().is_err());
}

#[test]
fn the_right_baud_rate_is_set_on_the_port() {
    let model = Model::Utm30lx;
    let mut bench = bench_with(
        model,
        Box::new(Room::new(model)),
        |config| HokuyoConfig { baud: 750_000, ..config },
        |device| device.set_baud(750_000),
    );
    bench.until_scan();
}

#[test]
fn another_model_than_configured_is_refused_by_name() {
    let mut bench = bench_with(
        Model::Urg04lx,
        Box::new(Room::new(Model::Urg04lx)),
        |config| HokuyoConfig { model: Model::Utm30lx, ..config },
        |_| {},
    );
    let problem = bench.until_problem("URG-04LX");
    assert!(problem.contains("configured is UTM-30LX"), "{problem}");
    assert_eq!(bench.poll().unwrap_err().kind(), ErrorKind::Fault);
}

#[test]
fn a_motor_fault_a_broken_laser_and_a_laser_that_is_off_are_named() {
    let mut bench = bench(Model::Utm30lx);
    bench.until_scan();
    for (health, expected) in [
        (Health::MotorFault, "Motor malfunction"),
        (Health::LaserOff, "laser is off"),
        (Health::LaserBroken, "Laser malfunction"),
    ] {
        bench.device.set_health(health);
        bench.until_error(ErrorKind::Fault);
        bench.until_problem(expected);
        bench.device.set_health(Health::Well);
        bench.until_scan();
    }
}

#[test]
fn beams_of_an_upside_down_scanner_are_mirrored() {
    /// Range increases with the sensor's step.
    struct OneSide;
    impl ScanSource for OneSide {
        fn ranges_mm(&mut self, _: u64, out: &mut [u32]) {
            for (step, range) in out.iter_mut().enumerate() {
                *range = 500 + step as u32;
            }
        }
    }
    for model in [Model::Utm30lx, Model::Urg04lx] {
        let upright = model.geometry(false);
        let mut bench = bench_with(
            model,
            Box::new(OneSide),
            |config| HokuyoConfig { upside_down: true, ..config },
            |_| {},
        );
        bench.until_scan();
        for (angle_rad, distance_m) in bench.scan.hits() {
            let step = ((-angle_rad - upright.angle_min_rad) / upright.angle_increment_rad).round();
            assert_eq!(
                f64::from(distance_m),
                f64::from((500.0 + step as f32) / 1000.0),
                "at {angle_rad}"
            );
        }
    }
}

#[test]
fn scans_are_stamped_with_their_begin_although_the_clocks_differ() {
    let source = Counting::default();
    let mut bench = bench_with(
        Model::Utm30lx,
        Box::new(source.clone()),
        |config| config,
        |device| device.set_clock_ppm(400.0),
    );
    let mut worst_ns = Vec::new();
    for _ in 0..120 {
        bench.until_scan();
        let begun_ns = source.begun_ns.lock().unwrap()[count_of(&bench.scan) as usize - 1];
        worst_ns.push(bench.scan.time_ns.abs_diff(begun_ns));
    }
    worst_ns.sort_unstable();
    // The median, because a busy computer delays single requests for the time.
    assert!(worst_ns[60] < 5 * MS, "{} ms", worst_ns[60] / MS);
}

#[test]
fn ethernet_models_are_read_over_tcp_and_reconnected_when_the_connection_was_closed() {
    let model = Model::Ust10lx;
    let any = SocketAddr::from((Ipv4Addr::LOCALHOST, 0));
    let device = SimulatedHokuyo::on_tcp(model, any, Box::new(Room::new(model))).unwrap();
    let port = format!("tcp:{}", device.address().unwrap()).parse().unwrap();
    let lidar = HokuyoLidar::open(HokuyoConfig { model, ..HokuyoConfig::new(port) }).unwrap();
    let monitor = lidar.monitor();
    let mut bench = Bench::new(device, lidar, monitor, tempfile::tempdir().unwrap());
    bench.until_scan();
    bench.device.unplug();
    bench.until_error(ErrorKind::Disconnected);
    bench.device.plug_in().unwrap();
    bench.until_scan();
    let identity = bench.lidar.monitor().identity().unwrap();
    assert_eq!((identity.model.as_str(), identity.serial.as_str()), ("UST-10LX", "H1000484"));
}

#[test]
fn the_safety_thread_allocates_nothing_when_it_polls() {
    let mut bench = bench(Model::Utm30lx);
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
fn a_dropped_driver_switches_the_scanner_off() {
    let mut bench = bench(Model::Utm30lx);
    bench.until_scan();
    assert_eq!(bench.lidar.status().state, DeviceState::Working);
    let Bench { device, lidar, folder: _folder, .. } = bench;
    drop(lidar);
    let deadline_ns = monotonic_ns() + TIMEOUT_NS;
    while device.scans().1 {
        assert!(monotonic_ns() < deadline_ns, "the scanner keeps streaming");
        MonotonicClock.sleep_until_ns(monotonic_ns() + MS);
    }
}
