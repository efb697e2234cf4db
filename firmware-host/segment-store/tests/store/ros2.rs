//! Export of runs as ROS 2 bags, read back with the decoder `re_cdr`, which is not part of this project.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use crate::common::{decision, robot, run_header, some_tick};
use hal::{LaserScan, Pose2, Range, ScanGeometry, Twist2};
use runtime::event::Event;
use runtime::recording::{MapView, RecordedTick, RecordingWriter, SegmentHeader, Views};
use segment_store::export::ros2;
use segment_store::{ErrorKind, StoreError};
use serde::Deserialize;
use serde::de::DeserializeOwned;

#[derive(Deserialize, Debug, PartialEq)]
struct Header {
    sec: i32,
    nanosec: u32,
    frame_id: String,
}

#[derive(Deserialize)]
struct Image {
    header: Header,
    height: u32,
    width: u32,
    encoding: String,
    is_bigendian: u8,
    step: u32,
    data: Vec<u8>,
}

#[derive(Deserialize)]
struct CameraInfo {
    header: Header,
    size: (u32, u32),
    distortion_model: String,
    d: Vec<f64>,
    k: [f64; 9],
    _r: [f64; 9],
    p: [f64; 12],
    _binning_and_region: [u32; 6],
    do_rectify: bool,
}

#[derive(Deserialize)]
struct Scan {
    header: Header,
    angle_min: f32,
    angle_max: f32,
    angle_increment: f32,
    time_increment: f32,
    scan_time: f32,
    limits: (f32, f32),
    ranges: Vec<f32>,
    intensities: Vec<f32>,
}

#[derive(Deserialize)]
struct Odometry {
    header: Header,
    child_frame_id: String,
    position: [f64; 3],
    orientation: [f64; 4],
    // serde has no arrays of 36.
    _pose_covariance: [[f64; 6]; 6],
    linear: [f64; 3],
    angular: [f64; 3],
    _twist_covariance: [[f64; 6]; 6],
}

#[derive(Deserialize)]
struct Transform {
    header: Header,
    child_frame_id: String,
    translation: [f64; 3],
    rotation: [f64; 4],
}

type Messages = BTreeMap<String, Vec<Vec<u8>>>;

fn decoded<T: DeserializeOwned>(messages: &Messages, topic: &str) -> Vec<T> {
    messages[topic].iter().map(|data| decode(data, topic)).collect()
}

fn decode<T: DeserializeOwned>(data: &[u8], topic: &str) -> T {
    // The header of XCDR1, little-endian, without options.
    let body = data.strip_prefix(&[0, 1, 0, 0]).unwrap();
    let (message, length) = re_cdr::from_bytes::<T, re_cdr::LittleEndian>(body).unwrap();
    assert_eq!(length, body.len(), "{topic}");
    message
}

/// Unix time at which the clock of the recordings is zero.
const ZERO_UNIX_NS: u64 = 1_790_000_000_000_000_000;

fn stamp(time_ns: u64, frame_id: &str) -> Header {
    let time_ns = ZERO_UNIX_NS + time_ns;
    Header {
        sec: (time_ns / 1_000_000_000) as i32,
        nanosec: (time_ns % 1_000_000_000) as u32,
        frame_id: frame_id.to_owned(),
    }
}

fn bag_of(folder: &Path) -> Messages {
    let mcap = fs::read(folder.join("bag_0.mcap")).unwrap();
    let mut messages = Messages::new();
    for message in mcap::MessageStream::new(&mcap).unwrap().map(Result::unwrap) {
        let schema = message.channel.schema.as_ref().unwrap();
        assert_eq!(
            (schema.encoding.as_str(), message.channel.message_encoding.as_str()),
            ("ros2msg", "cdr")
        );
        messages.entry(message.channel.topic.clone()).or_default().push(message.data.to_vec());
    }
    messages
}

/// A tick with an image, a scan with every kind of beam, odometry and velocity.
fn full_tick(number: u64) -> RecordedTick {
    let mut tick = some_tick(number);
    let geometry = ScanGeometry { beams: 5, ..ScanGeometry::UTM_30LX };
    let ranges = vec![
        Range::Hit(1.25),
        Range::NoReturn,
        Range::TooNear,
        Range::Error,
        Range::Hit(0.1 + number as f32),
    ];
    tick.scan = Some(LaserScan { time_ns: tick.time_ns + 7, geometry, ranges });
    tick.wheel.twist = Twist2 { linear_mps: 0.3, angular_radps: -0.1 * number as f64 };
    tick
}

fn recorded(dir: &Path, ticks: &[RecordedTick]) -> std::path::PathBuf {
    recorded_with(dir, ticks, &Views::default())
}

/// The same views with every tick.
fn recorded_with(dir: &Path, ticks: &[RecordedTick], views: &Views) -> std::path::PathBuf {
    let header = SegmentHeader::new(run_header(), 0, ticks[0].tick, ticks[0].time_ns);
    let header = SegmentHeader { zero_unix_ns: Some(ZERO_UNIX_NS), ..header };
    let mut writer = RecordingWriter::begin(Vec::new(), header).unwrap();
    ticks.iter().for_each(|tick| writer.write(tick, views).unwrap());
    let path = dir.join("recording_0000.mcap");
    fs::write(&path, writer.finish().map_err(|(_, error)| error).unwrap()).unwrap();
    path
}

#[test]
fn every_image_scan_and_pose_is_exported_as_recorded() {
    let dir = tempfile::tempdir().unwrap();
    let ticks: Vec<_> = (13..25).map(full_tick).collect();
    let to = dir.path().join("bag");
    let bagged = ros2(&[recorded(dir.path(), &ticks)], &to).unwrap();
    assert_eq!((bagged.images, bagged.scans, bagged.messages), (12, 12, 12 * 5 + 1));
    let messages = bag_of(&to);
    let images: Vec<Image> = decoded(&messages, "/camera/image");
    let infos: Vec<CameraInfo> = decoded(&messages, "/camera/camera_info");
    let scans: Vec<Scan> = decoded(&messages, "/scan");
    let odometry: Vec<Odometry> = decoded(&messages, "/odom");
    let transforms: Vec<Vec<Transform>> = decoded(&messages, "/tf");
    assert!(
        [images.len(), infos.len(), scans.len(), odometry.len(), transforms.len()]
            == [ticks.len(); 5]
    );
    let camera = run_header().camera;
    for (at, tick) in ticks.iter().enumerate() {
        let image = &images[at];
        let frame = tick.frame.as_ref().unwrap();
        assert_eq!(image.header, stamp(tick.time_ns, "camera_optical"));
        assert_eq!((image.width, image.height, image.step), (16, 12, 48));
        assert_eq!(
            (image.encoding.as_str(), image.is_bigendian, &image.data),
            ("rgb8", 0, &frame.rgb)
        );

        let info = &infos[at];
        assert_eq!((&info.header, info.size), (&image.header, (12, 16)));
        assert_eq!(
            (info.distortion_model.as_str(), &info.d[..], info.do_rectify),
            ("plumb_bob", &[0.0; 5][..], false)
        );
        assert_eq!(
            (info.k[0], info.k[2], info.k[4], info.k[5]),
            (camera.fx, camera.cx, camera.fy, camera.cy)
        );
        assert_eq!((info.p[0], info.p[6], info.p[10]), (camera.fx, camera.cy, 1.0));

        let scan = &scans[at];
        let of = tick.scan.as_ref().unwrap();
        assert_eq!(scan.header, stamp(of.time_ns, "laser"));
        let geometry = of.geometry;
        assert_eq!((scan.angle_min, scan.limits), (geometry.angle_min_rad as f32, (0.1, 30.0)));
        assert!((scan.angle_max - (scan.angle_min + 4.0 * scan.angle_increment)).abs() < 1e-6);
        assert_eq!(scan.scan_time, 0.025);
        assert!((scan.time_increment - 0.025 / 1440.0).abs() < 1e-9);
        // REP-117.
        assert_eq!(scan.ranges[..3], [1.25, f32::INFINITY, f32::NEG_INFINITY]);
        assert!(
            scan.ranges[3].is_nan()
                && scan.ranges[4] == 0.1 + tick.tick as f32
                && scan.intensities.is_empty()
        );

        let odom = &odometry[at];
        let pose = tick.wheel.odom.to_pose3();
        assert_eq!(
            (&odom.header, odom.child_frame_id.as_str()),
            (&stamp(tick.wheel.time_ns, "odom"), "base_link")
        );
        assert_eq!(odom.position, [tick.wheel.odom.x_m, tick.wheel.odom.y_m, 0.0]);
        assert_eq!(
            odom.orientation,
            [pose.rotation.i, pose.rotation.j, pose.rotation.k, pose.rotation.w]
        );
        assert_eq!((odom.linear[0], odom.angular[2]), (0.3, -0.1 * tick.tick as f64));

        let transform = &transforms[at][0];
        assert_eq!(
            (&transform.header, transform.child_frame_id.as_str()),
            (&odom.header, "base_link")
        );
        assert_eq!((transform.translation, transform.rotation), (odom.position, odom.orientation));
    }
}

#[test]
fn sensor_mounts_are_latched_static_transforms() {
    let dir = tempfile::tempdir().unwrap();
    let to = dir.path().join("bag");
    ros2(&[recorded(dir.path(), &[full_tick(0), full_tick(1)])], &to).unwrap();
    let mounts: Vec<Vec<Transform>> = decoded(&bag_of(&to), "/tf_static");
    assert_eq!(mounts.len(), 1);
    let names: Vec<_> = mounts[0]
        .iter()
        .map(|mount| (mount.header.frame_id.as_str(), &*mount.child_frame_id))
        .collect();
    assert_eq!(names, [("base_link", "camera_optical"), ("base_link", "laser")]);
    assert_eq!(mounts[0][0].translation, [0.1, 0.0, 0.8]);
    let metadata = fs::read_to_string(to.join("metadata.yaml")).unwrap();
    assert_eq!(metadata.matches("durability: 1").count(), 1);
    assert!(
        metadata.contains("message_count: 11\n") && metadata.contains("- 'bag_0.mcap'"),
        "{metadata}"
    );
}

#[test]
fn several_segments_become_one_bag_and_cut_ones_are_counted() {
    let dir = tempfile::tempdir().unwrap();
    robot(dir.path());
    let segments: Vec<_> = (0..3)
        .map(|number| dir.path().join(format!("monday/recording_{number:04}.mcap")))
        .collect();
    let last = fs::read(&segments[2]).unwrap();
    fs::write(&segments[2], &last[..last.len() / 2]).unwrap();
    let bagged = ros2(&segments, &dir.path().join("bag")).unwrap();
    assert!(bagged.cut == 1 && (60..80).contains(&bagged.images), "{bagged:?}");
    let images: Vec<Image> = decoded(&bag_of(&dir.path().join("bag")), "/camera/image");
    assert!(images.windows(2).all(|pair| (pair[0].header.sec, pair[0].header.nanosec)
        < (pair[1].header.sec, pair[1].header.nanosec)));
}

#[test]
fn repeated_wheel_feedback_and_non_finite_poses_are_left_out() {
    let dir = tempfile::tempdir().unwrap();
    let mut ticks = vec![full_tick(0), full_tick(1), full_tick(2)];
    ticks[1].wheel = ticks[0].wheel;
    ticks[2].wheel.odom = Pose2 { x_m: f64::NAN, ..Pose2::IDENTITY };
    let bagged = ros2(&[recorded(dir.path(), &ticks)], &dir.path().join("bag")).unwrap();
    let messages = bag_of(&dir.path().join("bag"));
    assert_eq!((messages["/odom"].len(), messages["/tf"].len(), bagged.without_pose), (1, 1, 1));
    assert_eq!(messages["/scan"].len(), 3);
}

#[derive(Deserialize)]
struct Grid {
    header: Header,
    _load_time: (i32, u32),
    resolution: f32,
    size: (u32, u32),
    origin: [f64; 7],
    data: Vec<i8>,
}

#[test]
fn the_map_is_exported_as_an_occupancy_grid_for_late_subscribers() {
    let dir = tempfile::tempdir().unwrap();
    let map = MapView {
        origin_m: [-1.0, 2.0],
        cell_m: 0.05,
        columns: 3,
        occupancy: vec![-1, 0, 100, 100, 0, -1],
    };
    let views = Views { map: Some(map), ..Views::default() };
    let segment = recorded_with(dir.path(), &[full_tick(4), full_tick(5)], &views);
    let bagged = ros2(&[segment], &dir.path().join("bag")).unwrap();
    let grids: Vec<Grid> = decoded(&bag_of(&dir.path().join("bag")), "/map");
    assert_eq!((grids.len(), bagged.maps), (2, 2));
    assert_eq!(grids[1].header, stamp(500_000_000, "map"));
    assert_eq!((grids[0].resolution, grids[0].size), (0.05, (3, 2)));
    assert_eq!(grids[0].origin, [-1.0, 2.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
    assert_eq!(grids[0].data, [-1, 0, 100, 100, 0, -1]);
    let metadata = fs::read_to_string(dir.path().join("bag/metadata.yaml")).unwrap();
    assert_eq!(metadata.matches("durability: 1").count(), 2);
}

#[derive(Deserialize)]
struct Diagnostics {
    header: Header,
    status: Vec<Status>,
}

#[derive(Deserialize)]
struct Status {
    level: u8,
    name: String,
    message: String,
    _hardware_id: String,
    values: Vec<(String, String)>,
}

#[test]
fn a_decision_is_a_diagnostic_with_its_reasons() {
    let dir = tempfile::tempdir().unwrap();
    let tick = full_tick(7);
    let events = vec![Event::GoalReached, Event::StandsWithoutFrames];
    let tick = RecordedTick { decision: Some(decision(7, events)), ..tick };
    ros2(&[recorded(dir.path(), &[tick])], &dir.path().join("bag")).unwrap();
    let found: Vec<Diagnostics> = decoded(&bag_of(&dir.path().join("bag")), "/diagnostics");
    assert_eq!((&found[0].header, found[0].status.len()), (&stamp(700_000_000, ""), 1));
    let status = &found[0].status[0];
    assert_eq!((status.level, status.name.as_str()), (1, "embodied_depth: decision"));
    assert_eq!(status.message, "goal reached; stopped: no frame has arrived for too long");
    let goal = status.values.iter().find(|(key, _)| key == "goal_y_m");
    assert_eq!(goal.map(|(_, value)| value.as_str()), Some("-2"));
}

#[test]
fn a_simulation_that_begins_at_zero_has_no_stamp_that_tf_reads_as_the_latest() {
    let dir = tempfile::tempdir().unwrap();
    robot(dir.path());
    let segment = dir.path().join("monday/recording_0000.mcap");
    let bagged = ros2(&[segment], &dir.path().join("bag")).unwrap();
    let images: Vec<Image> = decoded(&bag_of(&dir.path().join("bag")), "/camera/image");
    assert!(!bagged.dated);
    assert!(images[0].header.sec > 1_700_000_000, "{:?}", images[0].header);
}

#[test]
fn nothing_is_overwritten_and_a_failed_bag_leaves_nothing_behind() {
    let dir = tempfile::tempdir().unwrap();
    let segment = recorded(dir.path(), &[full_tick(0)]);
    let to = dir.path().join("bag");
    ros2(std::slice::from_ref(&segment), &to).unwrap();
    assert!(matches!(ros2(&[segment], &to), Err(StoreError::Exists { .. })));
    let text = dir.path().join("text.mcap");
    fs::write(&text, "no recording").unwrap();
    let refused = ros2(&[text], &dir.path().join("other")).unwrap_err();
    assert_eq!(refused.kind(), ErrorKind::Usage, "{refused}");
    assert!(!dir.path().join("other").exists() && !dir.path().join("other.partial").exists());
}

#[test]
fn a_time_that_ros_cannot_represent_is_an_error() {
    let dir = tempfile::tempdir().unwrap();
    let mut tick = full_tick(0);
    tick.time_ns = 3_000_000_000 * 1_000_000_000;
    let refused = ros2(&[recorded(dir.path(), &[tick])], &dir.path().join("bag")).unwrap_err();
    assert!(refused.to_string().contains("68 years"), "{refused}");
}
