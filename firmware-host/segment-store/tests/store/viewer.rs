//! Export of runs for Foxglove and Rerun.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use crate::common::{decision, run_header, some_tick};
use foxglove::{Decode, messages as fox};
use hal::{DepthMap, LaserScan, Pose2, Range, ScanGeometry};
use runtime::event::Event;
use runtime::recording::{MapView, RecordedTick, RecordingWriter, SegmentHeader, Views};
use segment_store::StoreError;
use segment_store::export::{ViewerSummary, viewer};

/// Unix time at which the clock of the recording is zero.
const ZERO_UNIX_NS: u64 = 1_790_000_000_000_000_000;

/// Messages by topic: schema, time and data.
type Messages = BTreeMap<String, Vec<(String, u64, Vec<u8>)>>;

/// A robot that drives along x and rotates, with a scan taken halfway between its ticks.
fn tick(number: u64) -> RecordedTick {
    let tick = some_tick(number);
    let geometry = ScanGeometry {
        beams: 3,
        angle_min_rad: 0.0,
        angle_increment_rad: 0.1,
        ..ScanGeometry::UTM_30LX
    };
    let ranges = vec![Range::Hit(2.0), Range::NoReturn, Range::Error];
    let scan = LaserScan { time_ns: tick.time_ns - 50_000_000, geometry, ranges };
    let mut decided = decision(number, vec![Event::GoalReached]);
    decided.t_odom_base = Pose2::new(number as f64, 0.0, 0.0);
    decided.t_map_odom = Pose2::new(0.0, 10.0, 0.0);
    RecordedTick { scan: Some(scan), decision: Some(decided), ..tick }
}

fn views() -> Views {
    let map = MapView {
        origin_m: [-1.0, 2.0],
        cell_m: 0.05,
        columns: 2,
        occupancy: vec![-1, 0, 100, 100, 0, -1],
    };
    Views {
        map: Some(map),
        path_m: Some(vec![[0.0, 0.0], [1.0, 0.0]]),
        depth: DepthMap::from_vec(2, 1, vec![0.3, 0.0]),
    }
}

fn recorded(dir: &Path, ticks: &[RecordedTick], zero_unix_ns: Option<u64>) -> PathBuf {
    let header = SegmentHeader::new(run_header(), 0, ticks[0].tick, ticks[0].time_ns);
    let header = SegmentHeader { zero_unix_ns, ..header };
    let mut writer = RecordingWriter::begin(Vec::new(), header).unwrap();
    ticks.iter().for_each(|tick| writer.write(tick, &views()).unwrap());
    let path = dir.join("recording_0000.mcap");
    fs::write(&path, writer.finish().map_err(|(_, error)| error).unwrap()).unwrap();
    path
}

fn exported(segment: PathBuf) -> (ViewerSummary, Messages) {
    let to = segment.with_file_name("run.mcap");
    let done = viewer(&[segment], &to).unwrap();
    let mut messages = Messages::new();
    for message in mcap::MessageStream::new(&fs::read(to).unwrap()).unwrap().map(Result::unwrap) {
        let schema = message.channel.schema.as_ref().map(|schema| schema.name.clone());
        messages.entry(message.channel.topic.clone()).or_default().push((
            schema.unwrap_or_default(),
            message.log_time,
            message.data.to_vec(),
        ));
    }
    (done, messages)
}

/// The schemas that Rerun 0.36 draws.
const DRAWN_BY_RERUN: [&str; 9] = [
    "foxglove.CameraCalibration",
    "foxglove.CompressedImage",
    "foxglove.FrameTransforms",
    "foxglove.Log",
    "foxglove.PointCloud",
    "foxglove.PoseInFrame",
    "foxglove.PosesInFrame",
    "foxglove.RawImage",
    "foxglove.VoxelGrid",
];

#[test]
fn map_scan_path_and_goal_have_a_form_that_rerun_draws() {
    let dir = tempfile::tempdir().unwrap();
    let (done, messages) = exported(recorded(dir.path(), &[tick(4), tick(5)], Some(ZERO_UNIX_NS)));
    for topic in ["/map", "/scan", "/path", "/depth", "/goal"] {
        let schemas: Vec<&str> = messages
            .iter()
            .filter(|(name, _)| is_of_topic(name, topic))
            .map(|(_, found)| found[0].0.as_str())
            .collect();
        assert!(
            schemas.iter().any(|schema| DRAWN_BY_RERUN.contains(schema)),
            "{topic}: {schemas:?}"
        );
    }
    assert_eq!((done.ticks, done.unreadable, done.bad_chunks), (2, 0, 0));
    assert_eq!(done.messages, messages.values().map(|found| found.len() as u64).sum::<u64>());
}

fn is_of_topic(name: &str, topic: &str) -> bool {
    name == topic || name.strip_prefix(topic).is_some_and(|rest| rest.starts_with('/'))
}

#[test]
fn all_times_are_dates() {
    let dir = tempfile::tempdir().unwrap();
    let (done, messages) = exported(recorded(dir.path(), &[tick(4)], Some(ZERO_UNIX_NS)));
    assert!(done.dated);
    for (topic, found) in &messages {
        assert_eq!(found[0].1, ZERO_UNIX_NS + 400_000_000, "{topic}");
    }
    let scan = fox::LaserScan::decode(&messages["/scan"][0].2[..]).unwrap();
    assert_eq!(scan.timestamp.unwrap().total_nanos(), ZERO_UNIX_NS + 350_000_000);
    let transforms = fox::FrameTransforms::decode(&messages["/tf"][0].2[..]).unwrap();
    let stamps = transforms.transforms.iter().map(|of| of.timestamp.unwrap().total_nanos());
    assert!(stamps.into_iter().all(|stamp| stamp == ZERO_UNIX_NS + 400_000_000));
}

#[test]
fn a_run_without_a_date_gets_that_of_its_file() {
    let dir = tempfile::tempdir().unwrap();
    let segment = recorded(dir.path(), &[tick(4)], None);
    let written = fs::metadata(&segment).unwrap().modified().unwrap();
    let (done, messages) = exported(segment);
    let written = written.duration_since(std::time::UNIX_EPOCH).unwrap().as_nanos() as u64;
    assert!(!done.dated);
    assert_eq!(messages["/odom"][0].1, written);
}

#[test]
fn a_scan_is_drawn_from_where_the_robot_was_when_it_was_taken() {
    let dir = tempfile::tempdir().unwrap();
    let (_, messages) = exported(recorded(dir.path(), &[tick(4), tick(5)], Some(ZERO_UNIX_NS)));
    let cloud = fox::PointCloud::decode(&messages["/scan/points"][1].2[..]).unwrap();
    assert_eq!((cloud.frame_id.as_str(), cloud.point_stride, cloud.data.len()), ("map", 16, 16));
    let at: Vec<f32> = cloud.data.as_chunks().0.iter().map(|of| f32::from_le_bytes(*of)).collect();
    // The robot was at 4.625 m when the scanner was halfway through the scan, and the hit is 2 m ahead.
    assert_eq!(&at[..3], &[6.625, 10.0, 0.0]);
}

#[test]
fn the_robots_memory_is_left_out() {
    let dir = tempfile::tempdir().unwrap();
    let with_memory = RecordedTick { snapshot: Some(vec![1; 1000]), ..tick(4) };
    let (_, messages) = exported(recorded(dir.path(), &[with_memory], Some(ZERO_UNIX_NS)));
    assert!(!messages.contains_key("/robot/snapshot"));
    assert!(messages.contains_key("/robot/decision") && messages.contains_key("/events"));
}

#[test]
fn an_existing_file_is_not_overwritten_and_another_file_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let segment = recorded(dir.path(), &[tick(4)], None);
    let to = dir.path().join("run.mcap");
    fs::write(&to, "mine").unwrap();
    assert!(matches!(viewer(std::slice::from_ref(&segment), &to), Err(StoreError::Exists { .. })));
    fs::write(&segment, "no recording").unwrap();
    assert!(viewer(&[segment], &dir.path().join("other.mcap")).is_err());
    assert!(!dir.path().join("other.mcap").exists());
}

/// All topics in a layout of Foxglove: keys and values that begin with a slash. A plot's path goes on with fields after a dot.
fn topics_in(value: &serde_json::Value, found: &mut Vec<String>) {
    use serde_json::Value::{Array, Object, String};
    match value {
        String(text) if text.starts_with('/') => found.push(text.clone()),
        Array(values) => values.iter().for_each(|value| topics_in(value, found)),
        Object(fields) => {
            found.extend(fields.keys().filter(|key| key.starts_with('/')).cloned());
            fields.values().for_each(|value| topics_in(value, found));
        }
        _ => {}
    }
}

#[test]
fn every_topic_of_the_foxglove_layout_is_in_an_export() {
    let file =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/viewers/foxglove-layout.json");
    let layout: serde_json::Value = serde_json::from_slice(&fs::read(file).unwrap()).unwrap();
    let mut named = Vec::new();
    topics_in(&layout, &mut named);
    let dir = tempfile::tempdir().unwrap();
    let mut driving = tick(4);
    driving.decision.as_mut().unwrap().sent = Some(runtime::tick::Command::default());
    let (_, messages) = exported(recorded(dir.path(), &[driving], Some(ZERO_UNIX_NS)));
    assert!(named.len() > 10, "{named:?}");
    for name in named {
        let (topic, fields) = name.split_once('.').unwrap_or((&name, ""));
        let (_, _, data) = &messages.get(topic).unwrap_or_else(|| panic!("no {topic}"))[0];
        if !fields.is_empty() {
            let json: serde_json::Value = serde_json::from_slice(data).unwrap();
            let pointer = format!("/{}", fields.replace('.', "/"));
            assert!(json.pointer(&pointer).is_some_and(serde_json::Value::is_number), "{name}");
        }
    }
}

#[test]
fn every_topic_of_the_rerun_view_is_in_an_export_in_a_form_that_rerun_draws() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/viewers/rerun_view.py");
    let script = fs::read_to_string(file).unwrap();
    let quoted = script.split('"').skip(1).step_by(2);
    let named: Vec<&str> = quoted.filter(|text| text.len() > 1 && text.starts_with('/')).collect();
    let dir = tempfile::tempdir().unwrap();
    let (_, messages) = exported(recorded(dir.path(), &[tick(4)], Some(ZERO_UNIX_NS)));
    assert!(named.len() > 5, "{named:?}");
    for topic in named {
        let (schema, ..) = &messages.get(topic).unwrap_or_else(|| panic!("no {topic}"))[0];
        assert!(DRAWN_BY_RERUN.contains(&schema.as_str()), "{topic}: {schema}");
    }
}
