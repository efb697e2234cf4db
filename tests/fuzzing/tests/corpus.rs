//! What fuzzing has found interesting still holds, without a fuzzer.
#![allow(clippy::unwrap_used, reason = "a test that cannot read its corpus has failed")]

use std::fs;
use std::path::PathBuf;

use fuzzing::TARGETS;

fn corpus() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("corpus")
}

fn runs_through(name: &str) {
    let (_, check) = TARGETS.into_iter().find(|(target, _)| *target == name).unwrap();
    let mut inputs = 0;
    for entry in fs::read_dir(corpus().join(name)).unwrap() {
        let path = entry.unwrap().path();
        // The name of the one that fails is the last that is said.
        println!("{}", path.display());
        check(&fs::read(path).unwrap());
        inputs += 1;
    }
    assert!(inputs >= 5, "{inputs} inputs");
    check(&[]);
}

#[test]
fn a_scanner_may_send_anything() {
    runs_through("scip");
}

#[test]
fn a_can_bus_may_carry_anything() {
    runs_through("can");
}

#[test]
fn a_camera_may_fail_in_any_order() {
    runs_through("v4l2_queue");
}

#[test]
fn the_other_end_of_a_pull_may_say_anything() {
    runs_through("buffer_wire");
}

#[test]
fn a_segment_may_be_any_bytes() {
    runs_through("segment");
}

#[test]
fn a_recording_may_hold_any_messages() {
    runs_through("recording");
}

#[test]
fn whoever_pushes_a_model_may_send_anything() {
    runs_through("bundle");
}

#[test]
fn a_model_may_be_any_file() {
    runs_through("onnx_file");
}

#[test]
fn a_snapshot_may_be_any_bytes() {
    runs_through("snapshot");
}

#[test]
fn a_configuration_may_be_any_text() {
    runs_through("config");
}

#[test]
fn every_target_has_a_corpus_and_every_corpus_a_target() {
    let names = |folder: PathBuf| {
        let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
        let mut names: Vec<String> =
            entries.map(|path| path.file_stem().unwrap().to_string_lossy().into_owned()).collect();
        names.sort();
        names
    };
    let targets = TARGETS.map(|(name, _)| name.to_owned());
    assert_eq!(names(corpus()), targets);
    assert_eq!(names(corpus().join("../fuzz_targets")), targets);
}
