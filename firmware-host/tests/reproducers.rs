//! Regression tests: recordings of past incidents, extracted by `firmware-host reproduce`, must
//! replay with identical decisions in every tick, to the last bit. docs/recording.md explains how
//! to add one.
#![allow(clippy::unwrap_used, reason = "a test that cannot read its recording has failed")]

use std::fs;
use std::path::{Path, PathBuf};

use firmware_host::cli::RunModels;
use firmware_host::replay::{Run, Span, replay};
use firmware_host::replay_run::build;
use runtime::recording::sentence;

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/reproducers")
}

/// Replays a recording and returns its events as sentences.
fn replayed(path: &Path) -> Vec<String> {
    let mut out = Vec::new();
    let models = RunModels { model: None, hand_over: None, model_store: None };
    let report =
        replay(path, Span::default(), |header| build(path, header, &models), &mut out).unwrap();
    assert!(
        report.is_exact() && report.unknown == 0,
        "{}: {}",
        path.display(),
        String::from_utf8_lossy(&out)
    );
    let ticks = Run::open(path).unwrap().map(Result::unwrap);
    let events = ticks.flat_map(|tick| tick.decision.unwrap().events);
    events.map(|event| sentence(&event).1).collect()
}

#[test]
fn every_reproducer_decides_to_the_last_bit_as_the_robot_did() {
    let paths = fs::read_dir(folder()).unwrap().map(|entry| entry.unwrap().path());
    let recordings: Vec<_> =
        paths.filter(|path| path.extension().is_some_and(|end| end == "mcap")).collect();
    assert!(!recordings.is_empty());
    for path in recordings {
        replayed(&path);
    }
}

#[test]
fn a_robot_stops_for_an_obstacle_ahead_and_backs_off() {
    let said = replayed(&folder().join("stop_zone.mcap"));
    let expected = [
        "stopped for an obstacle at (0.25, -0.01) m from the robot: a LiDAR return in the stop zone",
        "backed off 0.20 m: the whole distance",
    ];
    assert_eq!(said, expected);
}
