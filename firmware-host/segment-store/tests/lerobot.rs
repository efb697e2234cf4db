//! Runs as LeRobot datasets, read back by Parquet's own reader, and by LeRobot itself where it is installed.
#![cfg(feature = "lerobot")]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "helpers of tests")]

mod common;

use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::Command;

use common::{run_header, some_tick};
use hal::Twist2;
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::record::{Field, List, Row, RowAccessor};
use runtime::recording::{RecordedTick, RecordingWriter, SegmentHeader, Views};
use runtime::tick::{Command as Velocity, Decision};
use segment_store::export::{LerobotSummary, lerobot};
use serde_json::Value;
use tempfile::tempdir;

/// A turn with a picture, odometry and a command.
fn turn(tick: u64, time_ns: u64) -> RecordedTick {
    let command = Velocity { linear_mps: 0.3, angular_radps: -0.01 * tick as f64 };
    let decision = Decision {
        tick,
        time_ns,
        wanted: Velocity::default(),
        command,
        goal_m: None,
        events: Vec::new(),
        input_digest: 0,
        depth_digest: 0,
        map_digest: 0,
    };
    let mut turn = RecordedTick { time_ns, decision: Some(decision), ..some_tick(tick) };
    turn.wheel.twist = Twist2 { linear_mps: 0.25, angular_radps: 0.125 * tick as f64 };
    turn
}

fn write_segment(path: &Path, turns: &[RecordedTick]) {
    let header = SegmentHeader::new(run_header(), 0, turns[0].tick, turns[0].time_ns);
    let mut writer = RecordingWriter::begin(File::create(path).unwrap(), header).unwrap();
    for turn in turns {
        writer.write(turn, &Views::default()).unwrap();
    }
    writer.finish().map_err(|(_, error)| error).unwrap();
}

/// Exports these turns as a run of one segment.
fn export(turns: &[RecordedTick], to: &Path) -> LerobotSummary {
    let dir = tempdir().unwrap();
    let segment = dir.path().join("recording_0000.mcap");
    write_segment(&segment, turns);
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

// Columns by their order in the file, behind the picture.
const STATE: usize = 1;
const ACTION: usize = 2;
const TIME: usize = 3;
const TIMESTAMP: usize = 4;
const FRAME: usize = 5;
const EPISODE: usize = 6;
const INDEX: usize = 7;

#[test]
fn every_picture_with_what_was_known_and_done_is_a_frame() {
    let dir = tempdir().unwrap();
    let to = dir.path().join("dataset");
    // More than one row group.
    let turns: Vec<_> =
        (0..230).map(|tick| turn(tick, 5_000_000_000 + tick * 100_000_000)).collect();
    let exported = export(&turns, &to);
    assert_eq!(exported, LerobotSummary { episodes: 1, frames: 230, left_out: 0, cut: 0 });
    let rows = data(&to);
    assert_eq!(rows.len(), turns.len());
    for (at, (row, turn)) in rows.iter().zip(&turns).enumerate() {
        let (odom, twist) = (turn.wheel.odom, turn.wheel.twist);
        let state = [odom.x_m, odom.y_m, odom.yaw_rad, twist.linear_mps, twist.angular_radps]
            .map(|v| v as f32);
        assert_eq!(floats(row.get_list(STATE).unwrap()), state);
        let command = turn.decision.as_ref().unwrap().command;
        let action = [command.linear_mps as f32, command.angular_radps as f32];
        assert_eq!(floats(row.get_list(ACTION).unwrap()), action);
        let picture = row.get_group(0).unwrap().get_bytes(0).unwrap();
        let decoded = image::load_from_memory(picture.data()).unwrap().into_rgb8();
        assert_eq!(decoded.as_raw(), &turn.frame.as_ref().unwrap().rgb, "frame {at}");
        for index in [FRAME, INDEX] {
            assert_eq!(row.get_long(index).unwrap(), at as i64);
        }
    }
}

#[test]
fn timestamps_are_where_lerobot_wants_them_and_the_real_time_stands_beside() {
    let dir = tempdir().unwrap();
    let to = dir.path().join("dataset");
    // A loop that is late by up to 30 ms, each time differently.
    let late = |tick: u64| 3_600_000_000_000 + tick * 100_000_000 + (tick * 7_777_777) % 30_000_000;
    let turns: Vec<_> = (0..150).map(|tick| turn(tick, late(tick))).collect();
    export(&turns, &to);
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
fn a_break_begins_a_new_episode_and_a_lost_picture_does_not() {
    let dir = tempdir().unwrap();
    let to = dir.path().join("dataset");
    let mut turns: Vec<_> = (0..60).map(|tick| turn(tick, tick * 100_000_000)).collect();
    turns.remove(10);
    for turn in &mut turns[29..] {
        turn.time_ns += 3_000_000_000;
    }
    assert_eq!(export(&turns, &to).episodes, 2);
    let episodes = rows(to.join("meta/episodes/chunk-000/file-000.parquet"));
    let from_to =
        |row: &Row| (row.get_long(2).unwrap(), row.get_long(5).unwrap(), row.get_long(6).unwrap());
    assert_eq!(episodes.iter().map(from_to).collect::<Vec<_>>(), [(29, 0, 29), (30, 29, 59)]);
    let rows = data(&to);
    let of = |row: &Row| (row.get_long(EPISODE).unwrap(), row.get_long(FRAME).unwrap());
    assert_eq!([&rows[28], &rows[29], &rows[58]].map(of), [(0, 28), (1, 0), (1, 29)]);
    assert_eq!(json(to.join("meta/info.json"))["splits"]["train"], "0:2");
}

#[test]
fn turns_without_a_picture_or_a_command_or_a_finite_pose_are_left_out() {
    let dir = tempdir().unwrap();
    let to = dir.path().join("dataset");
    let mut turns: Vec<_> = (0..20).map(|tick| turn(tick, tick * 100_000_000)).collect();
    turns[3].frame = None;
    turns[4].decision = None;
    turns[5].wheel.odom.x_m = f64::NAN;
    let exported = export(&turns, &to);
    assert_eq!((exported.frames, exported.left_out, exported.episodes), (17, 2, 1));
    assert!(
        data(&to)
            .iter()
            .all(|row| floats(row.get_list(STATE).unwrap()).iter().all(|value| value.is_finite()))
    );
}

#[test]
fn a_run_that_was_cut_off_is_exported_as_far_as_it_goes() {
    let dir = tempdir().unwrap();
    let segments = ["recording_0000.mcap", "recording_0001.mcap"].map(|name| dir.path().join(name));
    let turns: Vec<_> = (0..60).map(|tick| turn(tick, tick * 100_000_000)).collect();
    write_segment(&segments[0], &turns[..30]);
    write_segment(&segments[1], &turns[30..]);
    let length = fs::metadata(&segments[1]).unwrap().len();
    File::options().write(true).open(&segments[1]).unwrap().set_len(length / 2).unwrap();
    let exported = lerobot(&segments, &dir.path().join("dataset")).unwrap();
    assert!(
        (30..60).contains(&exported.frames) && exported.cut == 1 && exported.episodes == 1,
        "{exported:?}"
    );
}

#[test]
fn nothing_is_written_over_and_nothing_is_left_behind_by_a_run_without_pictures() {
    let dir = tempdir().unwrap();
    let (segment, to) = (dir.path().join("recording_0000.mcap"), dir.path().join("dataset"));
    write_segment(&segment, &[RecordedTick { frame: None, ..turn(0, 0) }]);
    let error = lerobot(std::slice::from_ref(&segment), &to).unwrap_err().to_string();
    assert!(error.contains("nothing to export"), "{error}");
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 1, "only the segment");
    fs::create_dir(&to).unwrap();
    assert!(lerobot(&[segment], &to).unwrap_err().to_string().contains("is there already"));
}

/// Set `LEROBOT_PYTHON` to a Python that has `lerobot` and `mcap`.
#[test]
fn lerobots_own_class_reads_what_the_recording_holds() {
    let Ok(python) = std::env::var("LEROBOT_PYTHON") else {
        eprintln!("LEROBOT_PYTHON is not set: not compared with LeRobot");
        return;
    };
    let dir = tempdir().unwrap();
    let (segment, to) = (dir.path().join("recording_0000.mcap"), dir.path().join("dataset"));
    let mut turns: Vec<_> = (0..150).map(|tick| turn(tick, tick * 100_000_000)).collect();
    for turn in &mut turns[70..] {
        turn.time_ns += 5_000_000_000;
    }
    write_segment(&segment, &turns);
    lerobot(&[segment], &to).unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/compare_with_lerobot.py");
    let output = Command::new(python).arg(script).arg(&to).arg(dir.path()).output().unwrap();
    let words = String::from_utf8_lossy(&output.stdout).into_owned()
        + &String::from_utf8_lossy(&output.stderr);
    assert!(
        output.status.success() && words.contains("150 frames in 2 episodes are the recording's"),
        "{words}"
    );
}
