//! Injectors over devices that count their readings, one a turn of 25 ms.

use std::convert::Infallible;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use hal::{
    Base, Camera, CameraModel, Clock, DriveCommand, Error, ErrorKind, ErrorType, Frame, LaserScan,
    Lidar, PixelFormat, Range, ScanGeometry, Twist2, VirtualClock, WheelFeedback,
};
use proptest::prelude::*;

use super::*;

const TURN_NS: u64 = 25_000_000;

type Time = Arc<AtomicU64>;

fn faults(texts: &[&str], seed: u64) -> (Faults, Time) {
    let time = Time::default();
    let now = Arc::clone(&time);
    let faults = texts.iter().map(|text| text.parse().unwrap()).collect();
    (Faults::new(faults, seed, Arc::new(move || now.load(Ordering::Relaxed))), time)
}

/// Has a new reading at every new time.
struct Device25ms {
    time: Time,
    last_ns: Option<u64>,
    moved: u32,
}

impl Device25ms {
    fn new(time: &Time) -> Self {
        Self { time: Arc::clone(time), last_ns: None, moved: 0 }
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
        (scan.time_ns, scan.geometry) = (time_ns, self.geometry());
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
        self.moved += 1;
        Ok(())
    }

    fn stop(&mut self) -> Result<(), Infallible> {
        Ok(())
    }

    fn poll_feedback(&mut self) -> Result<Option<WheelFeedback>, Infallible> {
        Ok(self.new_reading().map(|time_ns| WheelFeedback { time_ns, ..WheelFeedback::default() }))
    }
}

/// What a device says in one turn: the turn of the reading, nothing, or an error.
type Said = Result<Option<u64>, ErrorKind>;

fn said<E: Error>(result: Result<Option<u64>, E>) -> Said {
    result.map(|time| time.map(|time_ns| time_ns / TURN_NS)).map_err(|error| error.kind())
}

/// The turns of a device with faults, by the turn of the reading that each hands out. All three must say the same, for what
/// all of them know.
fn turns(kind: &str, count: u64) -> Vec<Said> {
    let (lidar_faults, lidar_time) = faults(&[&format!("lidar:{kind}")], 1);
    let (camera_faults, camera_time) = faults(&[&format!("camera:{kind}")], 1);
    let (base_faults, base_time) = faults(&[&format!("base:{kind}")], 1);
    let mut lidar = FaultyLidar::new(Device25ms::new(&lidar_time), &lidar_faults);
    let mut camera = FaultyCamera::new(Device25ms::new(&camera_time), &camera_faults);
    let mut base = FaultyBase::new(Device25ms::new(&base_time), &base_faults);
    let (mut scan, mut frame) = (LaserScan::empty(ScanGeometry::UTM_30LX), Frame::empty());
    let mut turn = |number: u64| {
        for time in [&lidar_time, &camera_time, &base_time] {
            time.store(number * TURN_NS, Ordering::Relaxed);
        }
        let of_lidar = said(lidar.poll_scan(&mut scan).map(|new| new.then_some(scan.time_ns)));
        let of_camera = said(camera.poll_frame(&mut frame).map(|new| new.then_some(frame.time_ns)));
        let of_base = said(base.poll_feedback().map(|wheel| wheel.map(|wheel| wheel.time_ns)));
        assert_eq!((&of_lidar, &of_lidar), (&of_camera, &of_base), "turn {number}");
        of_lidar
    };
    (0..count).map(&mut turn).collect()
}

#[test]
fn late_readings_come_later_by_their_number_and_the_newest_counts_again_when_it_is_over() {
    let now = |turn| Ok(Some(turn));
    assert_eq!(
        turns("delay=2@0.025..0.125", 7),
        [now(0), Ok(None), Ok(None), now(1), now(2), now(5), now(6)]
    );
}

#[test]
fn a_reading_comes_twice_instead_of_the_next_one() {
    assert_eq!(turns("duplicate", 5), [0, 0, 2, 2, 4].map(|turn| Ok(Some(turn))));
}

#[test]
fn a_reading_comes_after_the_one_that_followed_it() {
    let said = turns("reorder", 6);
    assert_eq!(said, [None, Some(1), Some(0), None, Some(4), Some(3)].map(Ok));
}

#[test]
fn a_device_that_stalls_is_silent_and_after_100_ms_its_driver_says_so() {
    let said = turns("stall@0.05..0.25", 11);
    assert_eq!(said[..2], [0, 1].map(|turn| Ok(Some(turn))));
    assert_eq!(said[2..7], [Ok(None); 5]);
    assert_eq!(said[7..10], [Err(ErrorKind::Timeout); 3]);
    assert_eq!(said[10], Ok(Some(10)), "what it measured meanwhile is lost, not late");
}

#[test]
fn a_device_that_is_unplugged_is_disconnected_and_comes_back() {
    let said = turns("unplug@0.05..0.1", 5);
    assert_eq!(
        said[1..],
        [Ok(Some(1)), Err(ErrorKind::Disconnected), Err(ErrorKind::Disconnected), Ok(Some(4))]
    );
}

#[test]
fn a_base_that_is_not_there_can_neither_be_driven_nor_armed_nor_stopped() {
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
    assert_eq!(base.inner().moved, 0, "the command was lost on its way");
    time.store(2_500_000_000, Ordering::Relaxed);
    base.drive(&command).unwrap();
    assert_eq!(base.inner().moved, 1);
}

#[test]
fn feedback_with_a_wrong_checksum_is_an_error_and_no_reading() {
    let (faults, time) = faults(&["base:corrupt=0.5"], 7);
    let mut base = FaultyBase::new(Device25ms::new(&time), &faults);
    let mut bad = 0;
    for turn in 1..=1000 {
        time.store(turn * TURN_NS, Ordering::Relaxed);
        match base.poll_feedback() {
            Ok(wheel) => assert_eq!(wheel.unwrap().time_ns, turn * TURN_NS),
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
fn wheels_lie_as_they_are_told_to() {
    let (faults, time) =
        faults(&["base:nan@0..1", "base:jump=-2.5@1..2", "base:contact@1.5..2"], 1);
    let mut base = FaultyBase::new(Device25ms::new(&time), &faults);
    let mut at = |time_ms: u64| {
        time.store(time_ms * 1_000_000, Ordering::Relaxed);
        base.poll_feedback().unwrap().unwrap()
    };
    assert!(at(500).odom.x_m.is_nan());
    let (jumped, touched, well) = (at(1200), at(1700), at(2500));
    assert_eq!((jumped.odom.x_m.to_bits(), jumped.contact), ((-2.5f64).to_bits(), false));
    assert!(touched.contact);
    assert_eq!(well, WheelFeedback { time_ns: 2_500_000_000, ..WheelFeedback::default() });
}

fn one_scan(text: &str) -> LaserScan {
    let (faults, time) = faults(&[text], 3);
    let mut lidar = FaultyLidar::new(Device25ms::new(&time), &faults);
    let mut scan = LaserScan::empty(lidar.geometry());
    assert!(lidar.poll_scan(&mut scan).unwrap());
    scan
}

#[test]
fn beams_are_spoilt_in_their_share_and_stay_within_what_a_scanner_can_say() {
    let spoilt =
        |scan: &LaserScan| scan.ranges.iter().filter(|range| **range != Range::Hit(3.0)).count();
    assert_eq!(one_scan("lidar:blind").ranges, vec![Range::NoReturn; 1081]);
    assert_eq!(one_scan("lidar:error").ranges, vec![Range::Error; 1081]);
    for text in ["lidar:error=0.1", "lidar:ghost=0.1", "lidar:corrupt=0.1"] {
        let scan = one_scan(text);
        // Five standard deviations of a binomial with 1081 draws of 0.1.
        assert!((60..=157).contains(&spoilt(&scan)), "{text}: {}", spoilt(&scan));
        assert!(scan.hits().all(|(_, range_m)| (0.1..=30.0).contains(&range_m)), "{text}");
    }
}

#[test]
fn pictures_are_black_white_cut_or_torn() {
    let picture = |text| {
        let (faults, time) = faults(&[text], 3);
        let mut frame = Frame::empty();
        assert!(FaultyCamera::new(Device25ms::new(&time), &faults).poll_frame(&mut frame).unwrap());
        frame.view().unwrap();
        frame
    };
    assert_eq!(picture("camera:black").data, [0; 96]);
    assert_eq!(picture("camera:white").data, [255; 96]);
    assert_eq!((picture("camera:resize").height, picture("camera:resize").data.len()), (2, 48));
    let torn = picture("camera:corrupt").data;
    let from = torn.iter().position(|byte| *byte != 9).unwrap();
    assert!(from > 0 && torn.len() == 96, "from byte {from}");
}

#[test]
fn a_loop_is_woken_late_and_time_still_goes_on() {
    let (faults, time) = faults(&["clock:slow=30@0.1..0.2"], 1);
    let mut clock = FaultyClock::new(VirtualClock::default(), &faults);
    let woken: Vec<u64> = (1..6)
        .map(|turn| {
            time.store(turn * 50_000_000, Ordering::Relaxed);
            clock.sleep_until_ns(turn * 50_000_000);
            clock.now_ns() / 1_000_000
        })
        .collect();
    assert_eq!(woken, [50, 130, 180, 200, 250]);
}

#[test]
fn the_same_seed_does_the_same_and_devices_draw_apart() {
    let lost = |device: Device, seed| {
        let (faults, _) = faults(&["lidar:drop=0.5", "camera:drop=0.5"], seed);
        let mut injector = faults.of(device);
        (0..64).map(|_| injector.strikes(Kind::Drop)).collect::<Vec<_>>()
    };
    assert_eq!(lost(Device::Lidar, 1), lost(Device::Lidar, 1));
    assert_ne!(lost(Device::Lidar, 1), lost(Device::Lidar, 2));
    assert_ne!(lost(Device::Lidar, 1), lost(Device::Camera, 1));
}

#[test]
fn scanner_and_base_may_be_wrapped_on_the_safety_thread() {
    let every = |device: Device| {
        kinds_of(device)
            .iter()
            .map(move |kind| format!("{}:{}@0..2", device.name(), kind.name()))
            .collect::<Vec<_>>()
    };
    let texts = [every(Device::Lidar), every(Device::Base)].concat();
    for text in &texts {
        let (faults, time) = faults(&[text], 1);
        let mut lidar = FaultyLidar::new(Device25ms::new(&time), &faults);
        let mut base = FaultyBase::new(Device25ms::new(&time), &faults);
        let mut scan = LaserScan::empty(lidar.geometry());
        let mut handed_on = scan.clone();
        handed_on.ranges.reserve(scan.geometry.beams);
        let info = allocation_counter::measure(|| {
            for turn in 0..100 {
                time.store(turn * TURN_NS, Ordering::Relaxed);
                let _ = lidar.poll_scan(&mut scan);
                handed_on.clone_from(&scan);
                let _ = base.poll_feedback();
                let _ =
                    base.drive(&DriveCommand { twist: Twist2::ZERO, counter: 1, plan_age_ns: 0 });
            }
        });
        assert_eq!(info.count_total, 0, "{text}");
    }
}

#[test]
fn a_driver_reports_what_is_injected() {
    let (faults, time) = faults(&["lidar:unplug@0..1", "lidar:stall@1..2"], 1);
    let lidar = FaultyLidar::new(Device25ms::new(&time), &faults);
    let mut state = |time_ms: u64| {
        time.store(time_ms * 1_000_000, Ordering::Relaxed);
        let working = crate::DeviceStatus {
            state: crate::DeviceState::Working,
            ..crate::DeviceStatus::default()
        };
        lidar.injector().status(working).state.to_string()
    };
    assert_eq!(
        [0, 1050, 1200, 2000].map(&mut state),
        ["disconnected", "working", "silent", "working"]
    );
}

#[test]
fn a_text_that_names_no_fault_is_answered_with_what_there_is() {
    let refusal = |text: &str| text.parse::<Fault>().unwrap_err().to_string();
    for (text, answer) in [
        ("stall", "DEVICE:KIND[=AMOUNT][@FROM..TO]"),
        ("laser:stall", "there is no device `laser`; there are camera: delay"),
        ("lidar:black", "`lidar` has no fault `black`; it has delay, drop"),
        ("lidar:stall=3", "`stall=3`: `stall` takes no amount"),
        ("camera:drop=1.5", "a share above 0 and up to 1"),
        ("camera:drop=nan", "a share above 0 and up to 1"),
        ("camera:delay=1.5", "a whole number of readings from 1 to 50"),
        ("base:jump=inf", "a distance in metres"),
        ("disk:slow=-1", "milliseconds"),
        ("lidar:stall@6..4", "`@6..4` is no time"),
        ("lidar:stall@4", "@4..6, @4.. or @..6"),
        ("lidar:stall@nan..4", "is no time"),
    ] {
        assert!(refusal(text).contains(answer), "{text}: {}", refusal(text));
    }
    assert!(refusal("x").contains("disk: slow, full, unplug"));
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
    fn a_fault_gives_back_its_text(text in any_fault()) {
        prop_assert_eq!(text.parse::<Fault>().unwrap().to_string(), text);
    }

    #[test]
    fn a_random_schedule_can_be_written_down_and_run_again(seed in any::<u64>(), span_s in 0.0..500.0f64) {
        let faults = random_faults(seed, span_s);
        prop_assert_eq!(&faults, &random_faults(seed, span_s));
        for fault in &faults {
            prop_assert!(fault.from_s < span_s && fault.from_s >= 0.5 && fault.to_s - fault.from_s < 3.05);
            prop_assert_eq!(&fault.to_string().parse::<Fault>().unwrap(), fault);
        }
        prop_assert!(faults.len() as f64 >= (span_s / 9.0).floor() - 1.0, "{} in {} s", faults.len(), span_s);
    }

    #[test]
    fn no_text_makes_the_reader_panic(text in "[a-z:=@.0-9-]{0,30}") {
        let _ = text.parse::<Fault>();
    }
}

#[test]
fn amounts_come_back_too_and_the_usual_ones_are_as_documented() {
    for text in
        ["camera:delay=5@5..10", "lidar:corrupt=0.01", "base:jump=-3@4..", "disk:slow=250@30.5..40"]
    {
        assert_eq!(text.parse::<Fault>().unwrap().to_string(), text);
    }
    let amount = |text: &str| text.parse::<Fault>().unwrap().amount();
    assert_eq!(
        ["lidar:drop", "camera:delay", "base:jump", "clock:slow"]
            .map(|text| format!("{}", amount(text))),
        ["1", "3", "1", "50"]
    );
}
