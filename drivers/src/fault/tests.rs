//! Injectors around devices that have one new reading per tick of 25 ms.

use std::convert::Infallible;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use hal::{
    Base, Camera, CameraModel, Clock, DriveCommand, Error, ErrorKind, ErrorType, Frame, Imu,
    ImuSample, LaserScan, Lidar, PixelFormat, Range, ScanGeometry, Twist2, VirtualClock,
    WheelFeedback,
};
use proptest::prelude::*;

use super::*;

const TICK_NS: u64 = 25_000_000;

type Time = Arc<AtomicU64>;

fn faults(texts: &[&str], seed: u64) -> (Faults, Time) {
    let time = Time::default();
    let now = Arc::clone(&time);
    let faults = texts.iter().map(|text| text.parse().unwrap()).collect();
    (Faults::new(faults, seed, Arc::new(move || now.load(Ordering::Relaxed))), time)
}

/// A camera, scanner, base and inertial measurement unit that has a new reading whenever the time has changed.
struct Device25ms {
    time: Time,
    last_ns: Option<u64>,
    commands: u32,
}

impl Device25ms {
    fn new(time: &Time) -> Self {
        Self { time: Arc::clone(time), last_ns: None, commands: 0 }
    }

    fn new_reading(&mut self) -> Option<u64> {
        let now_ns = self.time.load(Ordering::Relaxed);
        (self.last_ns.replace(now_ns) != Some(now_ns)).then_some(now_ns)
    }
}

impl ErrorType for Device25ms {
    type Error = Infallible;
}

impl Lidar for Device25ms {
    fn geometry(&self) -> ScanGeometry {
        ScanGeometry::UTM_30LX
    }

    fn poll_scan(&mut self, scan: &mut LaserScan) -> Result<bool, Infallible> {
        let Some(time_ns) = self.new_reading() else { return Ok(false) };
        scan.time_ns = time_ns;
        scan.geometry = self.geometry();
        scan.ranges.clear();
        scan.ranges.resize(scan.geometry.beams, Range::Hit(3.0));
        Ok(true)
    }
}

const SIZE: CameraModel = CameraModel {
    width: 8,
    height: 4,
    fx: 4.0,
    fy: 4.0,
    cx: 4.0,
    cy: 2.0,
    distortion: hal::Distortion::None,
};

impl Camera for Device25ms {
    fn model(&self) -> &CameraModel {
        &SIZE
    }

    fn poll_frame(&mut self, frame: &mut Frame) -> Result<bool, Infallible> {
        let Some(time_ns) = self.new_reading() else { return Ok(false) };
        *frame = Frame {
            time_ns,
            sequence: 0,
            width: 8,
            height: 4,
            format: PixelFormat::Rgb8,
            data: vec![9; 96],
        };
        Ok(true)
    }
}

impl Base for Device25ms {
    fn drive(&mut self, _: &DriveCommand) -> Result<(), Infallible> {
        self.commands += 1;
        Ok(())
    }

    fn stop(&mut self) -> Result<(), Infallible> {
        Ok(())
    }

    fn poll_feedback(&mut self) -> Result<Option<WheelFeedback>, Infallible> {
        Ok(self.new_reading().map(|time_ns| WheelFeedback { time_ns, ..WheelFeedback::default() }))
    }
}

const STILL: ImuSample =
    ImuSample { time_ns: 0, angular_radps: [0.0; 3], force_mps2: Some([0.0, 0.0, 9.8]) };

impl Imu for Device25ms {
    fn poll_sample(&mut self) -> Result<Option<ImuSample>, Infallible> {
        Ok(self.new_reading().map(|time_ns| ImuSample { time_ns, ..STILL }))
    }
}

/// The result of one poll: the tick in which the returned reading was taken, no reading, or an
/// error.
type Polled = Result<Option<u64>, ErrorKind>;

fn polled<E: Error>(result: Result<Option<u64>, E>) -> Polled {
    result.map(|time| time.map(|time_ns| time_ns / TICK_NS)).map_err(|error| error.kind())
}

/// Polls all four devices with the same fault once per tick. They must agree, because all of them
/// have this kind of fault.
fn poll_ticks(kind: &str, count: u64) -> Vec<Polled> {
    let (lidar_faults, lidar_time) = faults(&[&format!("lidar:{kind}")], 1);
    let (camera_faults, camera_time) = faults(&[&format!("camera:{kind}")], 1);
    let (base_faults, base_time) = faults(&[&format!("base:{kind}")], 1);
    let (imu_faults, imu_time) = faults(&[&format!("imu:{kind}")], 1);
    let mut lidar = FaultyLidar::new(Device25ms::new(&lidar_time), &lidar_faults);
    let mut camera = FaultyCamera::new(Device25ms::new(&camera_time), &camera_faults);
    let mut base = FaultyBase::new(Device25ms::new(&base_time), &base_faults);
    let mut imu = FaultyImu::new(Device25ms::new(&imu_time), &imu_faults);
    let mut scan = LaserScan::empty(ScanGeometry::UTM_30LX);
    let mut frame = Frame::empty();
    let mut results = Vec::new();
    for tick in 0..count {
        for time in [&lidar_time, &camera_time, &base_time, &imu_time] {
            time.store(tick * TICK_NS, Ordering::Relaxed);
        }
        let of_lidar = polled(lidar.poll_scan(&mut scan).map(|new| new.then_some(scan.time_ns)));
        let of_camera =
            polled(camera.poll_frame(&mut frame).map(|new| new.then_some(frame.time_ns)));
        let of_base = polled(base.poll_feedback().map(|wheel| wheel.map(|wheel| wheel.time_ns)));
        let of_imu = polled(imu.poll_sample().map(|sample| sample.map(|sample| sample.time_ns)));
        for of_other in [of_camera, of_base, of_imu] {
            assert_eq!(of_other, of_lidar, "tick {tick}");
        }
        results.push(of_lidar);
    }
    results
}

/// The result of a poll that returns the reading of this tick.
fn taken_at(tick: u64) -> Polled {
    Ok(Some(tick))
}

#[test]
fn delayed_readings_arrive_two_ticks_late_and_after_the_fault_the_newest_is_returned_again() {
    assert_eq!(
        poll_ticks("delay=2@0.025..0.125", 7),
        [taken_at(0), Ok(None), Ok(None), taken_at(1), taken_at(2), taken_at(5), taken_at(6)]
    );
}

#[test]
fn a_duplicated_reading_replaces_the_next_one() {
    assert_eq!(poll_ticks("duplicate", 5), [0, 0, 2, 2, 4].map(taken_at));
}

#[test]
fn a_reordered_reading_arrives_after_the_one_that_followed_it() {
    let results = poll_ticks("reorder", 6);
    assert_eq!(results, [None, Some(1), Some(0), None, Some(4), Some(3)].map(Ok));
}

#[test]
fn a_stalled_device_is_silent_and_after_100_ms_its_driver_reports_a_timeout() {
    let results = poll_ticks("stall@0.05..0.25", 11);
    assert_eq!(results[..2], [0, 1].map(taken_at));
    assert_eq!(results[2..7], [Ok(None); 5]);
    assert_eq!(results[7..10], [Err(ErrorKind::Timeout); 3]);
    assert_eq!(results[10], Ok(Some(10)), "readings taken during the stall are lost, not delayed");
}

#[test]
fn an_unplugged_device_is_disconnected_until_it_is_plugged_in_again() {
    let results = poll_ticks("unplug@0.05..0.1", 5);
    assert_eq!(
        results[1..],
        [Ok(Some(1)), Err(ErrorKind::Disconnected), Err(ErrorKind::Disconnected), Ok(Some(4))]
    );
}

#[test]
fn an_unplugged_base_can_neither_be_armed_nor_driven_nor_stopped() {
    let (faults, time) = faults(&["base:unplug@0..1", "base:drop@1..2"], 1);
    let mut base = FaultyBase::new(Device25ms::new(&time), &faults);
    let command = DriveCommand { twist: Twist2::ZERO, counter: 1, plan_age_ns: 0 };
    for kind in [base.arm().err(), base.drive(&command).err(), base.stop().err()]
        .map(|error| error.unwrap().kind())
    {
        assert_eq!(kind, ErrorKind::Disconnected);
    }
    time.store(1_500_000_000, Ordering::Relaxed);
    base.drive(&command).unwrap();
    assert_eq!(base.inner().commands, 0, "the command was dropped");
    time.store(2_500_000_000, Ordering::Relaxed);
    base.drive(&command).unwrap();
    assert_eq!(base.inner().commands, 1);
}

#[test]
fn feedback_with_a_wrong_checksum_is_an_error_and_no_reading() {
    let (faults, time) = faults(&["base:corrupt=0.5"], 7);
    let mut base = FaultyBase::new(Device25ms::new(&time), &faults);
    let mut bad = 0;
    for tick in 1..=1000 {
        time.store(tick * TICK_NS, Ordering::Relaxed);
        match base.poll_feedback() {
            Ok(wheel) => assert_eq!(wheel.unwrap().time_ns, tick * TICK_NS),
            Err(error) => {
                assert_eq!(error.kind(), ErrorKind::Corrupt);
                bad += 1;
            }
        }
    }
    // Five standard deviations of a binomial with 1000 draws of 0.5.
    assert!((421..=579).contains(&bad), "{bad}");
}

#[test]
fn wheel_feedback_has_the_injected_nan_jump_and_contact() {
    let (faults, time) =
        faults(&["base:nan@0..1", "base:jump=-2.5@1..2", "base:contact@1.5..2"], 1);
    let mut base = FaultyBase::new(Device25ms::new(&time), &faults);
    let [broken, jumped, touched, well] = [500, 1200, 1700, 2500].map(|time_ms| {
        time.store(time_ms * 1_000_000, Ordering::Relaxed);
        base.poll_feedback().unwrap().unwrap()
    });
    assert!(broken.odom.x_m.is_nan());
    assert_eq!((jumped.odom.x_m.to_bits(), jumped.contact), ((-2.5f64).to_bits(), false));
    assert!(touched.contact);
    assert_eq!(well, WheelFeedback { time_ns: 2_500_000_000, ..WheelFeedback::default() });
}

fn one_sample(text: &str) -> ImuSample {
    let (faults, time) = faults(&[text], 3);
    FaultyImu::new(Device25ms::new(&time), &faults).poll_sample().unwrap().unwrap()
}

#[test]
fn a_unit_with_a_bias_is_wrong_by_it_about_every_axis_and_a_corrupt_sample_is_random() {
    assert_eq!(one_sample("imu:bias=-0.25"), ImuSample { angular_radps: [-0.25; 3], ..STILL });
    assert_eq!(one_sample("imu:bias"), ImuSample { angular_radps: [0.1; 3], ..STILL });
    let corrupt = one_sample("imu:corrupt");
    assert!(corrupt.angular_radps.iter().all(|radps| *radps != 0.0 && radps.abs() <= 35.0));
    assert!(corrupt.force_mps2.unwrap().iter().all(|mps2| mps2.abs() <= 157.0));
}

/// A unit with five samples at once.
struct Burst(u64);

impl ErrorType for Burst {
    type Error = Infallible;
}

impl Imu for Burst {
    fn poll_sample(&mut self) -> Result<Option<ImuSample>, Infallible> {
        self.0 += 1;
        Ok((self.0 <= 5).then_some(ImuSample { time_ns: self.0, ..STILL }))
    }
}

#[test]
fn a_lost_sample_does_not_hide_those_that_wait_behind_it() {
    let (faults, _) = faults(&["imu:drop=0.5"], 1);
    let mut imu = FaultyImu::new(Burst(0), &faults);
    let mut times = Vec::new();
    while let Some(sample) = imu.poll_sample().unwrap() {
        times.push(sample.time_ns);
    }
    assert_eq!(imu.inner().0, 6, "all of them were taken");
    assert!((1..5).contains(&times.len()) && times.is_sorted(), "{times:?}");
}

fn one_scan(text: &str) -> LaserScan {
    let (faults, time) = faults(&[text], 3);
    let mut lidar = FaultyLidar::new(Device25ms::new(&time), &faults);
    let mut scan = LaserScan::empty(lidar.geometry());
    assert!(lidar.poll_scan(&mut scan).unwrap());
    scan
}

#[test]
fn the_given_share_of_beams_is_corrupted_and_stays_within_the_scanners_range() {
    assert_eq!(one_scan("lidar:blind").ranges, vec![Range::NoReturn; 1081]);
    assert_eq!(one_scan("lidar:error").ranges, vec![Range::Error; 1081]);
    for text in ["lidar:error=0.1", "lidar:ghost=0.1", "lidar:corrupt=0.1"] {
        let scan = one_scan(text);
        // Five standard deviations of a binomial with 1081 draws of 0.1.
        let changed = scan.ranges.iter().filter(|range| **range != Range::Hit(3.0)).count();
        assert!((60..=157).contains(&changed), "{text}: {changed}");
        assert!(scan.hits().all(|(_, range_m)| (0.1..=30.0).contains(&range_m)), "{text}");
    }
}

#[test]
fn dirt_makes_errors_of_the_beams_within_its_angle_of_the_front_and_of_no_other() {
    let scan = one_scan("lidar:dirt=67");
    for (beam, range) in scan.ranges.iter().enumerate() {
        let is_in_front = scan.geometry.angle_rad(beam).abs() <= 67_f64.to_radians();
        let expected = if is_in_front { Range::Error } else { Range::Hit(3.0) };
        assert_eq!(*range, expected, "beam {beam}");
    }
}

fn one_frame(text: &str) -> Frame {
    let (faults, time) = faults(&[text], 3);
    let mut frame = Frame::empty();
    assert!(FaultyCamera::new(Device25ms::new(&time), &faults).poll_frame(&mut frame).unwrap());
    frame.view().unwrap();
    frame
}

#[test]
fn frames_are_black_white_halved_or_torn() {
    assert_eq!(one_frame("camera:black").data, [0; 96]);
    assert_eq!(one_frame("camera:white").data, [255; 96]);
    assert_eq!((one_frame("camera:resize").height, one_frame("camera:resize").data.len()), (2, 48));
    let torn = one_frame("camera:corrupt").data;
    let from = torn.iter().position(|byte| *byte != 9).unwrap();
    assert!(from > 0 && torn.len() == 96, "from byte {from}");
}

#[test]
fn a_slow_clock_wakes_the_loop_late_and_never_goes_back() {
    let (faults, time) = faults(&["clock:slow=30@0.1..0.2"], 1);
    let mut clock = FaultyClock::new(VirtualClock::default(), &faults);
    let woken_ms: Vec<u64> = (1..6)
        .map(|tick| {
            time.store(tick * 50_000_000, Ordering::Relaxed);
            clock.sleep_until_ns(tick * 50_000_000);
            clock.now_ns() / 1_000_000
        })
        .collect();
    assert_eq!(woken_ms, [50, 130, 180, 200, 250]);
}

fn dropped(device: Device, seed: u64) -> Vec<bool> {
    let (faults, _) = faults(&["lidar:drop=0.5", "camera:drop=0.5"], seed);
    let mut injector = faults.for_device(device);
    (0..64).map(|_| injector.triggers(Kind::Drop)).collect()
}

#[test]
fn the_same_seed_drops_the_same_readings_and_devices_are_independent() {
    assert_eq!(dropped(Device::Lidar, 1), dropped(Device::Lidar, 1));
    assert_ne!(dropped(Device::Lidar, 1), dropped(Device::Lidar, 2));
    assert_ne!(dropped(Device::Lidar, 1), dropped(Device::Camera, 1));
}

/// Every kind of fault of a device, as text.
fn every_fault(device: Device) -> Vec<String> {
    kinds_of(device).iter().map(|kind| format!("{}:{}@0..2", device.name(), kind.name())).collect()
}

#[test]
fn polling_a_wrapped_scanner_base_or_inertial_unit_does_not_allocate() {
    let texts =
        [every_fault(Device::Lidar), every_fault(Device::Base), every_fault(Device::Imu)].concat();
    for text in &texts {
        let (faults, time) = faults(&[text], 1);
        let mut lidar = FaultyLidar::new(Device25ms::new(&time), &faults);
        let mut base = FaultyBase::new(Device25ms::new(&time), &faults);
        let mut imu = FaultyImu::new(Device25ms::new(&time), &faults);
        let mut scan = LaserScan::empty(lidar.geometry());
        let mut copy = scan.clone();
        copy.ranges.reserve(scan.geometry.beams);
        let info = allocation_counter::measure(|| {
            for tick in 0..100 {
                time.store(tick * TICK_NS, Ordering::Relaxed);
                let _ = lidar.poll_scan(&mut scan);
                copy.clone_from(&scan);
                let _ = base.poll_feedback();
                let _ = imu.poll_sample();
                let _ =
                    base.drive(&DriveCommand { twist: Twist2::ZERO, counter: 1, plan_age_ns: 0 });
            }
        });
        assert_eq!(info.count_total, 0, "{text}");
    }
}

#[test]
fn the_status_shows_the_injected_fault() {
    let (faults, time) = faults(&["lidar:unplug@0..1", "lidar:stall@1..2"], 1);
    let lidar = FaultyLidar::new(Device25ms::new(&time), &faults);
    let states = [0, 1050, 1200, 2000].map(|time_ms| {
        time.store(time_ms * 1_000_000, Ordering::Relaxed);
        let working = crate::DeviceStatus {
            state: crate::DeviceState::Working,
            ..crate::DeviceStatus::default()
        };
        lidar.injector().status(working).state.to_string()
    });
    assert_eq!(states, ["disconnected", "working", "silent", "working"]);
}

#[test]
fn a_text_that_is_no_fault_is_refused_with_the_possible_ones() {
    for (text, answer) in [
        ("stall", "DEVICE:KIND[=AMOUNT][@FROM..TO]"),
        ("laser:stall", "there is no device `laser`; there are camera: delay"),
        ("lidar:black", "`lidar` has no fault `black`; it has delay, drop"),
        ("lidar:stall=3", "`stall=3`: `stall` takes no amount"),
        ("camera:drop=1.5", "a share above 0 and up to 1"),
        ("camera:drop=nan", "a share above 0 and up to 1"),
        ("camera:delay=1.5", "a whole number of readings from 1 to 50"),
        ("base:jump=inf", "a distance in metres"),
        ("lidar:dirt=200", "degrees above 0 and up to 180"),
        ("lidar:dirt=nan", "degrees above 0 and up to 180"),
        ("disk:slow=-1", "milliseconds"),
        ("imu:bias=0", "an angular velocity in rad/s other than 0"),
        ("lidar:stall@6..4", "`@6..4` is not a time window"),
        ("lidar:stall@4", "@4..6, @4.. or @..6"),
        ("lidar:stall@nan..4", "is not a time window"),
    ] {
        let refusal = text.parse::<Fault>().unwrap_err().to_string();
        assert!(refusal.contains(answer), "{text}: {refusal}");
    }
    let refusal = "x".parse::<Fault>().unwrap_err().to_string();
    assert!(refusal.contains("disk: slow, full, unplug"));
}

fn any_fault() -> impl Strategy<Value = String> {
    let kinds: Vec<(Device, Kind)> = Device::ALL
        .into_iter()
        .flat_map(|device| kinds_of(device).iter().map(move |kind| (device, *kind)))
        .collect();
    let window = prop_oneof![Just(String::new()), (1u32..99).prop_map(|from| format!("@{from}.."))];
    let ended = (0u32..99, 1u32..99).prop_map(|(from, long)| format!("@{from}.5..{}", from + long));
    (prop::sample::select(kinds), prop_oneof![window, ended])
        .prop_map(|((device, kind), when)| format!("{}:{}{when}", device.name(), kind.name()))
}

proptest! {
    #[test]
    fn a_parsed_fault_prints_as_its_text(text in any_fault()) {
        prop_assert_eq!(text.parse::<Fault>().unwrap().to_string(), text);
    }

    #[test]
    fn a_random_schedule_is_repeatable_and_survives_its_text(
        seed in any::<u64>(),
        span_s in 0.0..500.0f64,
    ) {
        let faults = random_faults(seed, span_s);
        prop_assert_eq!(&faults, &random_faults(seed, span_s));
        for fault in &faults {
            prop_assert!(fault.from_s < span_s);
            prop_assert!(fault.from_s >= 0.5);
            prop_assert!(fault.to_s - fault.from_s < 3.05);
            prop_assert_eq!(&fault.to_string().parse::<Fault>().unwrap(), fault);
        }
        let fewest = (span_s / 9.0).floor() - 1.0;
        prop_assert!(faults.len() as f64 >= fewest, "{} in {} s", faults.len(), span_s);
    }

    #[test]
    fn no_text_makes_the_parser_panic(text in "[a-z:=@.0-9-]{0,30}") {
        let _ = text.parse::<Fault>();
    }
}

#[test]
fn amounts_are_printed_and_the_default_ones_are_as_documented() {
    for text in
        ["camera:delay=5@5..10", "lidar:corrupt=0.01", "base:jump=-3@4..", "disk:slow=250@30.5..40"]
    {
        assert_eq!(text.parse::<Fault>().unwrap().to_string(), text);
    }
    assert_eq!(
        ["lidar:drop", "camera:delay", "base:jump", "lidar:dirt", "imu:bias", "clock:slow"]
            .map(|text| text.parse::<Fault>().unwrap().amount().to_string()),
        ["1", "3", "1", "45", "0.1", "50"]
    );
}
