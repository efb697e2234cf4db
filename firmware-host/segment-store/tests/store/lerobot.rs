//! Export of runs as LeRobot datasets, read back with the parquet crate, and with LeRobot itself where it is installed.

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::common::{run_header, some_tick};
use hal::Twist2;
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::record::{Field, List, Row, RowAccessor};
use runtime::recording::{RecordedTick, RecordingWriter, SegmentHeader, Views};
use runtime::tick::{Command as Velocity, Decision};
use segment_store::export::{LerobotSummary, lerobot};
use serde_json::Value;
use tempfile::tempdir;

/// A tick with an image, a pose and a command.
fn full_tick(number: u64, time_ns: u64) -> RecordedTick {
    let command = Velocity { linear_mps: 0.3, angular_radps: -0.01 * number as f64 };
    let decision = Decision {
        tick: number,
        time_ns,
        desired: Velocity::default(),
        sent: Some(command),
        goal_m: None,
        t_odom_base: hal::Pose2::new(0.02 * number as f64, 0.01, 0.1),
        t_odom_base_at_frame: hal::Pose2::new(0.02 * number as f64, 0.01, 0.1),
        t_map_odom: hal::Pose2::new(0.5, 0.0, -0.1),
        lost: None,
        events: Vec::new(),
        input_digest: 0,
        depth_digest: 0,
        map_digest: 0,
    };
    let mut tick = RecordedTick { time_ns, decision: Some(decision), ..some_tick(number) };
    tick.wheel.twist = Twist2 { linear_mps: 0.25, angular_radps: 0.125 * number as f64 };
    tick
}

fn write_segment(path: &Path, ticks: &[RecordedTick]) {
    let header = SegmentHeader::new(run_header(), 0, ticks[0].tick, ticks[0].time_ns);
    let mut writer = RecordingWriter::begin(File::create(path).unwrap(), header).unwrap();
    for tick in ticks {
        writer.write(tick, &Views::default()).unwrap();
    }
    writer.finish().map_err(|(_, error)| error).unwrap();
}

/// A tick without a frame, which holds the command that answered the frame before it.
fn closing_tick(last: &RecordedTick) -> RecordedTick {
    let tick = full_tick(last.tick + 1, last.time_ns + 100_000_000);
    RecordedTick { frame: None, ..tick }
}

/// Exports ticks, and one that closes them, as a run of one segment.
fn export(ticks: &[RecordedTick], to: &Path) -> LerobotSummary {
    let dir = tempdir().unwrap();
    let segment = dir.path().join("recording_0000.mcap");
    let mut ticks = ticks.to_vec();
    ticks.extend(ticks.last().map(closing_tick));
    write_segment(&segment, &ticks);
    lerobot(&[segment], to).unwrap()
}

fn rows(path: PathBuf) -> Vec<Row> {
    let reader = SerializedFileReader::new(File::open(path).unwrap()).unwrap();
    reader.get_row_iter(None).unwrap().map(Result::unwrap).collect()
}

fn data(to: &Path) -> Vec<Row> {
    rows(to.join("data/chunk-000/file-000.parquet"))
}

fn floats(list: &List) -> Vec<f32> {
    list.elements()
        .iter()
        .map(|field| if let Field::Float(value) = field { *value } else { f32::NAN })
        .collect()
}

fn json(path: PathBuf) -> Value {
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

// Positions of the columns in the file; the image is column 0.
const STATE: usize = 1;
const ACTION: usize = 2;
const TIME: usize = 3;
const TIMESTAMP: usize = 4;
const FRAME: usize = 5;
const EPISODE: usize = 6;
const INDEX: usize = 7;

#[test]
fn every_image_with_its_state_and_sent_command_is_a_frame() {
    let dir = tempdir().unwrap();
    let to = dir.path().join("dataset");
    // More than one row group.
    let ticks: Vec<_> =
        (0..230).map(|tick| full_tick(tick, 5_000_000_000 + tick * 100_000_000)).collect();
    let exported = export(&ticks, &to);
    assert_eq!(exported, LerobotSummary { episodes: 1, frames: 230, left_out: 0, cut: 0 });
    let rows = data(&to);
    assert_eq!(rows.len(), ticks.len());
    for (at, (row, recorded_tick)) in rows.iter().zip(&ticks).enumerate() {
        let pose = recorded_tick.decision.as_ref().unwrap().t_map_base();
        let twist = recorded_tick.wheel.twist;
        let state = [pose.x_m, pose.y_m, pose.yaw_rad, twist.linear_mps, twist.angular_radps]
            .map(|v| v as f32);
        assert_eq!(floats(row.get_list(STATE).unwrap()), state);
        // The command in force when the next tick began.
        let next = full_tick(at as u64 + 1, 0).decision.unwrap();
        let command = next.sent.unwrap();
        let action = [command.linear_mps as f32, command.angular_radps as f32];
        assert_eq!(floats(row.get_list(ACTION).unwrap()), action);
        let png = row.get_group(0).unwrap().get_bytes(0).unwrap();
        let decoded = image::load_from_memory(png.data()).unwrap().into_rgb8();
        assert_eq!(decoded.as_raw(), &recorded_tick.frame.as_ref().unwrap().rgb, "frame {at}");
        for index in [FRAME, INDEX] {
            assert_eq!(row.get_long(index).unwrap(), at as i64);
        }
    }
}

/// The time of a tick in a loop that is late by up to 30 ms, differently each time.
fn late(tick: u64) -> u64 {
    3_600_000_000_000 + tick * 100_000_000 + (tick * 7_777_777) % 30_000_000
}

#[test]
fn timestamps_are_equally_spaced_and_time_s_is_the_real_time() {
    let dir = tempdir().unwrap();
    let to = dir.path().join("dataset");
    let ticks: Vec<_> = (0..150).map(|tick| full_tick(tick, late(tick))).collect();
    export(&ticks, &to);
    assert_eq!(json(to.join("meta/info.json"))["fps"], 10);
    for (at, row) in data(&to).iter().enumerate() {
        assert!((f64::from(row.get_float(TIMESTAMP).unwrap()) - at as f64 / 10.0).abs() < 1e-5);
        assert!(
            (row.get_double(TIME).unwrap() - (late(at as u64) - late(0)) as f64 * 1e-9).abs()
                < 1e-9
        );
    }
    let episodes = rows(to.join("meta/episodes/chunk-000/file-000.parquet"));
    assert!((episodes[0].get_double(9).unwrap() - 3600.0).abs() < 1e-9);
}

#[test]
fn a_gap_starts_a_new_episode_and_a_single_lost_image_does_not() {
    let dir = tempdir().unwrap();
    let to = dir.path().join("dataset");
    let mut ticks: Vec<_> = (0..60).map(|tick| full_tick(tick, tick * 100_000_000)).collect();
    ticks.remove(10);
    for recorded_tick in &mut ticks[29..] {
        recorded_tick.time_ns += 3_000_000_000;
    }
    assert_eq!(export(&ticks, &to).episodes, 2);
    let episodes = rows(to.join("meta/episodes/chunk-000/file-000.parquet"));
    let spans: Vec<_> =
        episodes.iter().map(|row| [2, 5, 6].map(|column| row.get_long(column).unwrap())).collect();
    // The frames before the lost tick and before the gap have no command that answered them.
    assert_eq!(spans, [[27, 0, 27], [30, 27, 57]]);
    let rows = data(&to);
    let episode_and_frame =
        [26, 27, 56].map(|row| [EPISODE, FRAME].map(|column| rows[row].get_long(column).unwrap()));
    assert_eq!(episode_and_frame, [[0, 26], [1, 0], [1, 29]]);
    assert_eq!(json(to.join("meta/info.json"))["splits"]["train"], "0:2");
}

#[test]
fn ticks_without_an_image_a_command_or_a_finite_pose_are_left_out() {
    let dir = tempdir().unwrap();
    let to = dir.path().join("dataset");
    let mut ticks: Vec<_> = (0..20).map(|tick| full_tick(tick, tick * 100_000_000)).collect();
    ticks[3].frame = None;
    // Without it, the frame before it has no action.
    ticks[8].decision = None;
    ticks[5].wheel.twist.linear_mps = f64::NAN;
    let exported = export(&ticks, &to);
    assert_eq!((exported.frames, exported.left_out, exported.episodes), (17, 2, 1));
    assert!(
        data(&to)
            .iter()
            .all(|row| floats(row.get_list(STATE).unwrap()).iter().all(|value| value.is_finite()))
    );
}

#[test]
fn a_cut_run_is_exported_up_to_its_last_complete_tick() {
    let dir = tempdir().unwrap();
    let segments = ["recording_0000.mcap", "recording_0001.mcap"].map(|name| dir.path().join(name));
    let ticks: Vec<_> = (0..60).map(|tick| full_tick(tick, tick * 100_000_000)).collect();
    write_segment(&segments[0], &ticks[..30]);
    write_segment(&segments[1], &ticks[30..]);
    let length = fs::metadata(&segments[1]).unwrap().len();
    File::options().write(true).open(&segments[1]).unwrap().set_len(length / 2).unwrap();
    let exported = lerobot(&segments, &dir.path().join("dataset")).unwrap();
    assert!(
        (30..60).contains(&exported.frames) && exported.cut == 1 && exported.episodes == 1,
        "{exported:?}"
    );
}

#[test]
fn nothing_is_overwritten_and_a_failed_export_leaves_nothing_behind() {
    let dir = tempdir().unwrap();
    let segment = dir.path().join("recording_0000.mcap");
    let to = dir.path().join("dataset");
    write_segment(&segment, &[RecordedTick { frame: None, ..full_tick(0, 0) }]);
    let error = lerobot(std::slice::from_ref(&segment), &to).unwrap_err().to_string();
    assert!(error.contains("nothing to export"), "{error}");
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1, "only the segment");
    fs::create_dir(&to).unwrap();
    assert!(lerobot(&[segment], &to).unwrap_err().to_string().contains("is there already"));
}

#[test]
#[ignore = "needs LEROBOT_PYTHON: the path of a Python with the packages lerobot and mcap; `cargo xtask test` runs it then"]
fn lerobots_own_class_reads_the_same_data_as_the_recording() {
    let python = std::env::var("LEROBOT_PYTHON").expect("LEROBOT_PYTHON is not set");
    let dir = tempdir().unwrap();
    let segment = dir.path().join("recording_0000.mcap");
    let to = dir.path().join("dataset");
    let mut ticks: Vec<_> = (0..150).map(|tick| full_tick(tick, tick * 100_000_000)).collect();
    for recorded_tick in &mut ticks[70..] {
        recorded_tick.time_ns += 5_000_000_000;
    }
    write_segment(&segment, &ticks);
    lerobot(&[segment], &to).unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/store/compare_with_lerobot.py");
    let output = Command::new(python).arg(script).arg(&to).arg(dir.path()).output().unwrap();
    let words = String::from_utf8_lossy(&output.stdout).into_owned()
        + &String::from_utf8_lossy(&output.stderr);
    assert!(
        output.status.success() && words.contains("150 frames in 2 episodes equal the recording"),
        "{words}"
    );
}
