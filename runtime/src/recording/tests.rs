//! Tests of whole recordings: every tick is read back exactly, and damage is always detected.

use std::io::Write;

use hal::{
    CameraModel, DepthMap, LaserScan, Pose2, Pose3, Range, ScanGeometry, Twist2, WheelFeedback,
    camera_mount,
};
use proptest::prelude::*;

use super::*;
use crate::event::{BackOffEnd, Event, GoalReason, SafetyEvent};
use crate::imu::ImuInput;
use crate::localization::LostReason;
use crate::operator::{OperatorOrder, Role};
use crate::outside_pose::{OutsideInput, OutsidePose};
use crate::safety::SentCommand;
use crate::task::{AreaChange, Task};
use crate::tick::{Command, Decision, SafetyReport};

pub(super) fn run_header() -> RunHeader {
    RunHeader {
        seed: 7,
        scene: Some("builtin:house?seed=3".to_owned()),
        policy: "active".to_owned(),
        depth_source: "truth".to_owned(),
        t_base_camera: camera_mount(0.1, 0.8, 0.2),
        t_base_laser: Pose3::translation(0.1, 0.0, 0.3),
        config: serde_json::json!({"map": {"cell_m": 0.05}, "third": 1.0 / 3.0}),
        ..RunHeader::new("test 0.0.0", CameraModel::pinhole(6, 4, std::f64::consts::FRAC_PI_2))
    }
}

fn decision(tick: u64) -> Decision {
    Decision {
        tick,
        time_ns: tick * 100_000_000,
        desired: Command { linear_mps: 0.3, angular_radps: 1.0 / 3.0 },
        sent: Some(Command { linear_mps: 0.1 * tick as f64, angular_radps: -0.0 }),
        t_odom_base: Pose2::new(0.1, 0.2, 0.3),
        t_odom_base_at_frame: Pose2::new(0.09, 0.2, 0.29),
        t_map_odom: Pose2::new(-0.01, 0.0, 0.002),
        lost: tick.is_multiple_of(2).then_some(LostReason::Carried),
        goal_m: (!tick.is_multiple_of(3)).then_some([1.5, -0.1]),
        events: vec![Event::GoalChosen { x_m: 1.5, y_m: -0.1, why: GoalReason::Frontier }],
        input_digest: 3,
        depth_digest: u64::MAX - tick,
        map_digest: 0x8000_0000_0000_0001,
    }
}

/// A tick with every part.
pub(super) fn some_tick(tick: u64) -> RecordedTick {
    let geometry = ScanGeometry { beams: 5, ..ScanGeometry::UTM_30LX };
    let ranges = vec![
        Range::Hit(1.1),
        Range::NoReturn,
        Range::TooNear,
        Range::Error,
        Range::Hit(tick as f32 * 0.01),
    ];
    let rgb = (0..6 * 4 * 3).map(|i| (i * 37 + tick as usize * 11) as u8).collect();
    RecordedTick {
        tick,
        time_ns: tick * 100_000_000,
        wheel: WheelFeedback {
            time_ns: tick * 100_000_000 + 3,
            odom: Pose2 { x_m: 0.1 * tick as f64, y_m: -0.3, yaw_rad: 3.0 },
            twist: Twist2 { linear_mps: 0.3, angular_radps: 1e-17 },
            contact: tick.is_multiple_of(2),
            cliff: tick.is_multiple_of(3),
        },
        scan: Some(LaserScan { time_ns: tick * 100_000_000 - tick, geometry, ranges }),
        frame: Some(RgbImage { width: 6, height: 4, rgb }),
        truth: DepthMap::from_vec(
            6,
            4,
            (0..24).map(|i| f32::from(i as u16 + tick as u16) / 1000.0).collect(),
        ),
        imu: Some(ImuInput {
            gaps: 3,
            yaw_rad: 0.1 * tick as f64 + 7.0,
            yaw_at_scan_rad: -0.0,
            tilt_rad: tick.is_multiple_of(2).then_some(0.1 + 0.2),
        }),
        outside: Some(OutsideInput {
            outside: OutsidePose {
                time_ns: tick * 100_000_000 + 7,
                pose: Pose2 { x_m: 5.0, y_m: -0.0, yaw_rad: 4.0 },
            },
            wheel_odom: Pose2 { x_m: 0.1 * tick as f64 - 2e-3, y_m: -0.3, yaw_rad: 3.0 },
        }),
        task: Some(match tick % 2 {
            0 => Task::GoTo { x_m: 0.1 + 0.2, y_m: -1e-17 * tick as f64 },
            _ => Task::Drive { linear_mps: -0.1, angular_radps: 1e-17 * tick as f64 },
        }),
        areas: vec![
            AreaChange::OpenAll,
            AreaChange::Close {
                corners_m: [[0.1 + 0.2, -0.0], [tick as f64, 1.0], [2.0, 2.0], [0.0, 1e-17]],
            },
        ],
        orders: vec![OperatorOrder {
            who: "127.0.0.1:9".to_owned(),
            role: Some(Role::Steer),
            what: format!("go to tick {tick}"),
            refused: tick.is_multiple_of(2).then(|| "the run keeps no map".to_owned()),
        }],
        scan_odom: Pose2 { x_m: 0.1 * tick as f64 - 1e-3, y_m: -0.3, yaw_rad: 3.0 },
        safety: SafetyReport {
            in_charge: tick.is_multiple_of(3),
            blocked_m: Some([0.1 + 0.2, -1e-17]),
            unseen_m: tick.is_multiple_of(2).then_some([0.1 + 0.7, -2e-17]),
            events: vec![
                SafetyEvent::Armed,
                SafetyEvent::BackedOff { distance_m: 0.2, end: BackOffEnd::RearUnknown },
            ],
            sent: vec![
                SentCommand::drive(
                    tick * 100_000_000,
                    u32::MAX,
                    Twist2 { linear_mps: 0.1 + 0.2, angular_radps: -0.0 },
                ),
                SentCommand::stop(tick * 100_000_000 + 7),
            ],
            sent_dropped: tick,
        },
        decision: Some(decision(tick)),
        snapshot: Some(vec![tick as u8; 9]),
    }
}

/// A tick without optional parts.
fn bare_tick(tick: u64) -> RecordedTick {
    RecordedTick {
        scan: None,
        imu: None,
        outside: None,
        frame: None,
        truth: None,
        task: None,
        areas: Vec::new(),
        orders: Vec::new(),
        safety: SafetyReport::default(),
        snapshot: None,
        ..some_tick(tick)
    }
}

fn some_views(tick: u64) -> Views {
    let map = MapView {
        origin_m: [-1.0, 2.0],
        cell_m: 0.05,
        columns: 3,
        occupancy: vec![-1, 0, 100, 50, 0, -1],
    };
    Views {
        map: tick.is_multiple_of(5).then_some(map),
        path_m: Some(vec![[0.0, 0.0], [1.0, 1.0]]),
        depth: tick.is_multiple_of(4).then(|| DepthMap::none(6, 4)),
    }
}

fn writer() -> RecordingWriter<Vec<u8>> {
    RecordingWriter::begin(Vec::new(), SegmentHeader::new(run_header(), 0, 0, 0)).unwrap()
}

pub(super) fn segment(ticks: &[RecordedTick]) -> Vec<u8> {
    let mut writer = writer();
    for tick in ticks {
        writer.write(tick, &some_views(tick.tick)).unwrap();
    }
    writer.finish().map_err(|(_, error)| error).unwrap()
}

/// All ticks that can be read, and the error after them if there is one.
fn read(bytes: &[u8]) -> (Vec<RecordedTick>, Option<RecordingError>) {
    let reader = match RecordingReader::open(bytes) {
        Ok(reader) => reader,
        Err(error) => return (Vec::new(), Some(error)),
    };
    let mut ticks = Vec::new();
    for item in reader {
        match item {
            Ok(tick) => ticks.push(tick),
            Err(error) => return (ticks, Some(error)),
        }
    }
    (ticks, None)
}

/// Comparing these distinguishes different NaNs, and 0.0 from -0.0.
fn digests(ticks: &[RecordedTick]) -> (String, String) {
    let mut digest = RunDigest::new();
    for tick in ticks {
        digest.add_input(&tick.input().unwrap());
        if let Some(decision) = &tick.decision {
            digest.add_decision(decision);
        }
    }
    (digest.inputs(), digest.decisions())
}

fn any_range() -> impl Strategy<Value = Range> {
    prop_oneof![
        any::<u32>().prop_map(|bits| Range::Hit(f32::from_bits(bits))),
        Just(Range::NoReturn),
        Just(Range::TooNear),
        Just(Range::Error),
    ]
}

fn any_f64() -> impl Strategy<Value = f64> {
    any::<u64>().prop_map(f64::from_bits)
}

fn finite() -> impl Strategy<Value = f64> {
    any_f64().prop_filter("finite", |value| value.is_finite())
}

fn any_scan() -> impl Strategy<Value = LaserScan> {
    let geometry = (
        any_f64(),
        any_f64(),
        0usize..2000,
        any::<f32>(),
        any::<f32>(),
        any::<u64>(),
        any::<bool>(),
    );
    (any::<u64>(), geometry, prop::collection::vec(any_range(), 0..20)).prop_map(
        |(time_ns, g, ranges)| LaserScan {
            time_ns,
            geometry: ScanGeometry {
                angle_min_rad: g.0,
                angle_increment_rad: g.1,
                beams: g.2,
                range_min_m: g.3,
                range_max_m: g.4,
                period_ns: g.5,
                clockwise: g.6,
            },
            ranges,
        },
    )
}

fn any_wheel() -> impl Strategy<Value = WheelFeedback> {
    (any::<u64>(), prop::array::uniform5(any_f64()), any::<bool>(), any::<bool>()).prop_map(
        |(time_ns, v, contact, cliff)| WheelFeedback {
            time_ns,
            odom: Pose2 { x_m: v[0], y_m: v[1], yaw_rad: v[2] },
            twist: Twist2 { linear_mps: v[3], angular_radps: v[4] },
            contact,
            cliff,
        },
    )
}

fn any_imu() -> impl Strategy<Value = ImuInput> {
    (any::<u32>(), any_f64(), any_f64(), prop::option::of(any_f64())).prop_map(
        |(gaps, yaw_rad, yaw_at_scan_rad, tilt_rad)| ImuInput {
            gaps,
            yaw_rad,
            yaw_at_scan_rad,
            tilt_rad,
        },
    )
}

fn any_outside() -> impl Strategy<Value = OutsideInput> {
    (any::<u64>(), prop::array::uniform6(any_f64())).prop_map(|(time_ns, v)| OutsideInput {
        outside: OutsidePose { time_ns, pose: Pose2 { x_m: v[0], y_m: v[1], yaw_rad: v[2] } },
        wheel_odom: Pose2 { x_m: v[3], y_m: v[4], yaw_rad: v[5] },
    })
}

fn any_image() -> impl Strategy<Value = RgbImage> {
    (1usize..9, 1usize..5).prop_flat_map(|(width, height)| {
        prop::collection::vec(any::<u8>(), width * height * 3).prop_map(move |rgb| RgbImage {
            width,
            height,
            rgb,
        })
    })
}

fn any_truth() -> impl Strategy<Value = DepthMap> {
    (1usize..9, 1usize..5).prop_flat_map(|(width, height)| {
        prop::collection::vec(any::<u16>(), width * height).prop_map(move |mm| {
            DepthMap::from_vec(
                width,
                height,
                mm.into_iter().map(|mm| f32::from(mm) / 1000.0).collect(),
            )
            .unwrap()
        })
    })
}

fn any_decision() -> impl Strategy<Value = Decision> {
    (prop::array::uniform8(finite()), any::<[u64; 2]>(), any::<bool>()).prop_map(
        |(v, digests, goal)| Decision {
            tick: 0,
            time_ns: digests[0],
            desired: Command { linear_mps: v[0], angular_radps: v[1] },
            sent: goal.then_some(Command { linear_mps: v[2], angular_radps: v[3] }),
            t_odom_base: Pose2::new(v[0], v[1], v[2]),
            t_odom_base_at_frame: Pose2::new(v[2], v[0], v[1]),
            t_map_odom: Pose2::new(v[3], v[4], v[5]),
            lost: goal.then_some(LostReason::Loaded),
            goal_m: goal.then_some([v[4], v[5]]),
            events: vec![
                Event::GoalReached,
                Event::GoalChosen { x_m: v[6], y_m: v[7], why: GoalReason::Revisit },
            ],
            input_digest: 3,
            depth_digest: digests[0],
            map_digest: digests[1],
        },
    )
}

prop_compose! {
    fn any_sent()(time_ns in any::<u64>(), counter in any::<Option<u32>>(), v in prop::array::uniform2(finite())) -> SentCommand {
        SentCommand { time_ns, counter, linear_mps: v[0], angular_radps: v[1] }
    }
}

prop_compose! {
    fn any_report()(in_charge in any::<bool>(), sent in prop::collection::vec(any_sent(), 0..12), sent_dropped in any::<u64>()) -> SafetyReport {
        SafetyReport { in_charge, sent, sent_dropped, ..SafetyReport::default() }
    }
}

prop_compose! {
    fn any_tick()(
        time_ns in any::<u64>(),
        wheel in any_wheel(),
        scan in prop::option::of(any_scan()),
        frame in prop::option::of(any_image()),
        truth in prop::option::of(any_truth()),
        decision in prop::option::of(any_decision()),
        safety in any_report(),
        imu in prop::option::of(any_imu()),
        outside in prop::option::of(any_outside()),
    ) -> RecordedTick {
        let scan_odom = wheel.odom;
        RecordedTick { tick: 0, time_ns, wheel, scan, scan_odom, imu, outside, frame, truth, task: None, areas: Vec::new(), orders: Vec::new(), safety, decision, snapshot: None }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn every_tick_is_read_back_bit_for_bit(mut ticks in prop::collection::vec(any_tick(), 0..8)) {
        for (number, tick) in ticks.iter_mut().enumerate() {
            tick.tick = number as u64 * 3;
        }
        let (back, error) = read(&segment(&ticks));
        prop_assert!(error.is_none(), "{:?}", error);
        prop_assert_eq!(back.len(), ticks.len());
        prop_assert_eq!(digests(&back), digests(&ticks));
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn a_flipped_bit_is_always_noticed_and_never_gives_a_tick_that_was_not_recorded(
        at in any::<prop::sample::Index>(),
        bit in 0u8..8,
    ) {
        let ticks: Vec<_> = (0..13).map(bare_tick).collect();
        let mut bytes = segment(&ticks);
        let at = at.index(bytes.len());
        bytes[at] ^= 1 << bit;
        let (back, error) = read(&bytes);
        prop_assert!(error.is_some(), "byte {}", at);
        prop_assert!(back.iter().all(|tick| *tick == ticks[tick.tick as usize]), "byte {}", at);
    }

    #[test]
    fn a_damaged_file_is_an_error_and_never_a_panic(
        cuts in prop::collection::vec((any::<prop::sample::Index>(), prop::collection::vec(any::<u8>(), 0..12)), 1..6),
    ) {
        let mut bytes = segment(&[bare_tick(0), some_tick(1)]);
        for (at, patch) in cuts {
            let at = at.index(bytes.len());
            bytes.splice(at..(at + 5).min(bytes.len()), patch);
        }
        prop_assert!(read(&bytes).1.is_some());
    }
}

#[test]
fn the_same_run_gives_the_same_bytes() {
    let ticks: Vec<_> = (0..30).map(some_tick).collect();
    assert_eq!(segment(&ticks), segment(&ticks));
}

#[test]
fn the_header_is_read_back() {
    let bytes = segment(&[]);
    let reader = RecordingReader::open(&bytes[..]).unwrap();
    assert_eq!(reader.header(), &SegmentHeader::new(run_header(), 0, 0, 0));
    assert_eq!(reader.count(), 0);
}

#[test]
fn a_segment_cut_at_any_byte_gives_every_tick_of_its_complete_chunks_and_says_that_it_is_cut() {
    // Two chunks: ticks 0 to 10 span a second, the rest comes at the end.
    let ticks: Vec<_> = (0..13).map(bare_tick).collect();
    let bytes = segment(&ticks);
    let mut seen = std::collections::BTreeSet::new();
    for cut in 0..bytes.len() {
        let (back, error) = read(&bytes[..cut]);
        let error =
            error.unwrap_or_else(|| panic!("cut at {cut} of {} was not noticed", bytes.len()));
        assert!(error.is_truncation(), "cut at {cut}: {error}");
        assert!(
            seen.last().is_none_or(|best| back.len() >= *best),
            "cut at {cut} gives less than a shorter cut"
        );
        assert_eq!(back[..], ticks[..back.len()]);
        seen.insert(back.len());
    }
    assert_eq!(seen.into_iter().collect::<Vec<_>>(), [0, 11, 13]);
}

#[test]
fn a_cut_in_the_last_chunk_costs_only_that_chunk() {
    let ticks: Vec<_> = (0..25).map(some_tick).collect();
    let mut writer = writer();
    for tick in &ticks {
        writer.write(tick, &Views::default()).unwrap();
    }
    let (back, error) = read(&writer.abandon());
    assert_eq!(back[..], ticks[..22]);
    assert!(matches!(error, Some(RecordingError::Truncated { after_tick: Some(21) })), "{error:?}");
}

#[test]
fn complete_chunks_and_the_short_end_make_a_whole_file() {
    let ticks: Vec<_> = (0..25).map(some_tick).collect();
    let mut writer = writer();
    for tick in &ticks {
        writer.write(tick, &Views::default()).unwrap();
    }
    let mut bytes = writer.abandon();
    bytes.extend_from_slice(&END_WITHOUT_SUMMARY);
    let (back, error) = read(&bytes);
    assert!(error.is_none(), "{error:?}");
    assert_eq!(back[..], ticks[..22]);
    assert!(mcap::Summary::read(&bytes).unwrap().is_none());
}

#[test]
fn what_is_no_recording_is_refused_with_its_reason() {
    assert!(matches!(read(b"PNG and more than eight bytes").1, Some(RecordingError::NotMcap)));
    assert!(matches!(read(b"").1, Some(RecordingError::Truncated { after_tick: None })));
    let mut other = mcap::Writer::new(std::io::Cursor::new(Vec::new())).unwrap();
    other.finish().unwrap();
    let bytes = other.into_inner().into_inner();
    assert!(matches!(read(&bytes).1, Some(RecordingError::MissingHeader { .. })));
}

/// The same segment with every message passed through `edit`; `None` drops it.
fn rewrite(bytes: &[u8], edit: impl Fn(&str, Vec<u8>) -> Option<Vec<u8>>) -> Vec<u8> {
    let mut out = mcap::Writer::new(std::io::Cursor::new(Vec::new())).unwrap();
    for message in mcap::MessageStream::new(bytes).unwrap() {
        let mut message = message.unwrap();
        if let Some(data) = edit(&message.channel.topic, message.data.to_vec()) {
            message.data = data.into();
            out.write(&message).unwrap();
        }
    }
    out.finish().unwrap();
    out.into_inner().into_inner()
}

#[test]
fn a_recording_of_another_format_is_refused_with_both_versions() {
    let bytes = rewrite(&segment(&[some_tick(0)]), |topic, data| {
        let text =
            String::from_utf8_lossy(&data).replace("\"format_version\":2", "\"format_version\":1");
        Some(if topic == "/robot/header" { text.into_bytes() } else { data })
    });
    let message = read(&bytes).1.unwrap().to_string();
    assert!(message.contains("format 1") && message.contains("test 0.0.0"), "{message}");
}

#[test]
fn a_channel_that_was_filtered_out_is_named() {
    let bytes = segment(&[some_tick(0), some_tick(1)]);
    for gone in ["/scan", "/camera/image", "/camera/truth_depth", "/robot/decision"] {
        let (back, error) = read(&rewrite(&bytes, |topic, data| (topic != gone).then_some(data)));
        assert!(back.is_empty());
        assert!(
            matches!(&error, Some(RecordingError::MissingPart { tick: 0, topic }) if *topic == gone),
            "{error:?}"
        );
    }
    let (back, error) =
        read(&rewrite(&bytes, |topic, data| (topic != "/map" && topic != "/tf").then_some(data)));
    assert!(error.is_none() && back.len() == 2, "channels for people are not needed");
}

#[test]
fn ticks_that_do_not_count_up_are_refused() {
    let bytes = segment(&[some_tick(4), some_tick(4)]);
    assert!(matches!(read(&bytes).1, Some(RecordingError::TickOrder { previous: 4, found: 4 })));
}

#[test]
fn what_cannot_be_recorded_exactly_is_refused_when_written() {
    let mut between = some_tick(1);
    between.truth.as_mut().unwrap().values_mut()[3] = 0.000_4;
    let error = writer().write(&between, &Views::default()).unwrap_err();
    assert!(
        matches!(error, RecordingError::TruthNotMillimetres { tick: 1, pixel: 3, .. }),
        "{error}"
    );
    let mut lost = some_tick(2);
    lost.decision.as_mut().unwrap().desired.linear_mps = f64::NAN;
    let error = writer().write(&lost, &Views::default()).unwrap_err();
    assert!(matches!(error, RecordingError::DecisionNotFinite { tick: 2 }), "{error}");
    let mut torn = some_tick(3);
    torn.frame.as_mut().unwrap().rgb.pop();
    let error = writer().write(&torn, &Views::default()).unwrap_err();
    assert!(
        matches!(error, RecordingError::Encode { tick: 3, topic: "/camera/image", .. }),
        "{error}"
    );
}

/// A sink that holds at most `capacity` bytes.
struct FullDisk {
    capacity: usize,
    bytes: Vec<u8>,
}

impl Write for FullDisk {
    fn write(&mut self, data: &[u8]) -> std::io::Result<usize> {
        let fits = data.len().min(self.capacity - self.bytes.len());
        if fits == 0 && !data.is_empty() {
            return Err(std::io::ErrorKind::StorageFull.into());
        }
        self.bytes.extend_from_slice(&data[..fits]);
        Ok(fits)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

#[test]
fn a_full_sink_is_an_error_and_the_sink_is_returned() {
    let whole = segment(&(0..60).map(some_tick).collect::<Vec<_>>()).len();
    for capacity in (0..whole).step_by(97) {
        let sink = FullDisk { capacity, bytes: Vec::new() };
        let Ok(mut writer) =
            RecordingWriter::begin(sink, SegmentHeader::new(run_header(), 0, 0, 0))
        else {
            continue;
        };
        let failed = (0..60)
            .map(some_tick)
            .find_map(|tick| writer.write(&tick, &some_views(tick.tick)).err());
        let (sink, error) = match failed {
            Some(error) => (writer.abandon(), error),
            None => {
                writer.finish().map(|_| panic!("{capacity} bytes cannot hold {whole}")).unwrap_err()
            }
        };
        assert!(matches!(error, RecordingError::Io(_)), "{error}");
        assert!(sink.bytes.len() <= capacity);
    }
}
