//! The program `pull-buffer` with local directories as sources.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test that cannot set up its files has failed"
)]

use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::{Command, Output};

use runtime::recording::{
    RecordedTick, RecordingWriter, RgbImage, RunHeader, SegmentHeader, Views,
};
use tempfile::tempdir;

fn pull(arguments: &[&str], dir: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_pull-buffer"))
        .args(arguments)
        .current_dir(dir)
        .output()
        .unwrap()
}

fn stderr_of(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn segment() -> Vec<u8> {
    let run = RunHeader {
        t_base_camera: hal::camera_mount(0.1, 0.8, 0.2),
        ..RunHeader::new("test 0.0.0", hal::CameraModel::pinhole(16, 12, 1.5))
    };
    let mut writer = RecordingWriter::begin(Vec::new(), SegmentHeader::new(run, 0, 0, 0)).unwrap();
    for tick in 0..20 {
        let time_ns = tick * 100_000_000;
        let rgb = (0..16 * 12 * 3).map(|i| (i * 7 + tick as usize) as u8).collect();
        let tick = RecordedTick {
            frame: Some(RgbImage { width: 16, height: 12, rgb }),
            ..RecordedTick::new(tick, time_ns)
        };
        writer.write(&tick, &Views::default()).unwrap();
    }
    writer.finish().map_err(|(_, error)| error).unwrap()
}

#[test]
fn two_robots_are_pulled_in_parallel_into_their_own_directories() {
    let dir = tempdir().unwrap();
    for robot in ["kitchen", "hall"] {
        fs::create_dir_all(dir.path().join(robot).join("run")).unwrap();
        fs::write(dir.path().join(robot).join("run/recording_0000.mcap"), segment()).unwrap();
    }
    let output = pull(&["kitchen", "east=hall", "all"], dir.path());
    assert!(output.status.success(), "{}", stderr_of(&output));
    for name in ["kitchen", "east"] {
        let here =
            fs::read(dir.path().join("all").join(name).join("run/recording_0000.mcap")).unwrap();
        assert!(here == segment());
    }
}

#[test]
fn a_segment_that_cannot_be_read_is_named_and_the_exit_code_is_1() {
    let dir = tempdir().unwrap();
    let run = dir.path().join("kitchen/run");
    fs::create_dir_all(&run).unwrap();
    fs::write(run.join("recording_0000.mcap"), segment()).unwrap();
    symlink("recording_0000.mcap", run.join("recording_0001.mcap")).unwrap();
    let output = pull(&["kitchen", "here", "--json"], dir.path());
    let said = stderr_of(&output);
    assert_eq!(output.status.code(), Some(1), "{said}");
    let warning =
        "warning: not pulled: cannot read kitchen/run/recording_0001.mcap: it is a symbolic link";
    assert!(said.contains(warning), "{said}");
    assert!(said.contains("1 new") && said.contains("1 not readable"), "{said}");
    let last = String::from_utf8_lossy(&output.stdout).lines().last().unwrap().to_owned();
    let pulled: serde_json::Value = serde_json::from_str(&last).unwrap();
    assert_eq!(pulled["unread"].as_array().map(Vec::len), Some(1), "{last}");
    assert!(dir.path().join("here/kitchen/run/recording_0000.mcap").exists());
}

#[test]
fn invalid_arguments_exit_with_2_and_a_way_out() {
    let dir = tempdir().unwrap();
    for (arguments, way_out) in [
        (&["only"][..], "required"),
        (&["no_such_directory", "here"], "give the directory"),
        (&["a:/x", "b@a:/y", "here"], "NAME=SOURCE"),
        (&["host:", "here"], "[user@]host:/path"),
        (&["a:/x", "here", "--limit", "warp"], "5MB/s"),
        (&["s3://fleet/kitchen", "gs://fleet"], "rclone"),
        (&["a:/x", "s3://fleet", "--as=tum"], "into a directory"),
    ] {
        let output = pull(arguments, dir.path());
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {}", stderr_of(&output));
        assert!(stderr_of(&output).contains(way_out), "{arguments:?}: {}", stderr_of(&output));
    }
}

#[test]
fn a_robot_that_ssh_cannot_reach_is_an_error_with_a_way_out() {
    let dir = tempdir().unwrap();
    // No server listens on port 1.
    let arguments = ["127.0.0.1:/x", "here", "--retries=0", "--ssh=-p1", "--ssh=-oBatchMode=yes"];
    let output = pull(&arguments, dir.path());
    let text = stderr_of(&output);
    if Command::new("ssh").arg("-V").output().is_ok() {
        assert!(text.contains("ssh could not connect to 127.0.0.1"), "{text}");
        assert_eq!(output.status.code(), Some(1), "{text}");
    } else {
        assert!(text.contains("cannot start ssh"), "{text}");
        assert_eq!(output.status.code(), Some(75), "{text}");
    }
}

#[test]
fn runs_are_also_exported_in_the_tum_format() {
    let dir = tempdir().unwrap();
    fs::create_dir_all(dir.path().join("robot/run")).unwrap();
    fs::write(dir.path().join("robot/run/recording_0000.mcap"), segment()).unwrap();
    let output = pull(&["robot", "here", "--as", "tum"], dir.path());
    assert!(output.status.success(), "{}", stderr_of(&output));
    let tum = dir.path().join("here/robot/tum/run");
    assert_eq!(fs::read_dir(tum.join("rgb")).unwrap().count(), 20);
    let poses = fs::read_to_string(tum.join("groundtruth.txt")).unwrap();
    assert_eq!(poses.lines().filter(|line| !line.starts_with('#')).count(), 20);
    assert!(fs::read_to_string(tum.join("dataset.toml")).unwrap().contains("nominal_fps = 10.0"));
    // A second pull does not export again.
    let output = pull(&["robot", "here", "--as", "tum"], dir.path());
    assert!(output.status.success(), "{}", stderr_of(&output));
}
