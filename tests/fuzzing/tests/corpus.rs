//! Runs the fuzzing targets over their corpora, without a fuzzer.
#![allow(clippy::unwrap_used, reason = "a test that cannot read its corpus has failed")]

use std::fs;
use std::path::PathBuf;

use fuzzing::TARGETS;

fn corpus() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("corpus")
}

fn run_corpus(name: &str) {
    let (_, check) = TARGETS.into_iter().find(|(target, _)| *target == name).unwrap();
    let mut inputs = 0;
    for entry in fs::read_dir(corpus().join(name)).unwrap() {
        let path = entry.unwrap().path();
        // On failure, the last printed path is the failing input.
        println!("{}", path.display());
        check(&fs::read(path).unwrap());
        inputs += 1;
    }
    assert!(inputs >= 5, "{inputs} inputs");
    check(&[]);
}

#[test]
fn any_bytes_from_a_scanner_are_handled() {
    run_corpus("scip");
}

#[test]
fn any_bytes_from_an_ld06_are_handled() {
    run_corpus("ld06");
}

#[test]
fn any_bytes_from_an_rplidar_are_handled() {
    run_corpus("rplidar");
}

#[test]
fn any_records_of_an_inertial_measurement_unit_are_handled() {
    run_corpus("iio");
}

#[test]
fn any_records_from_a_can_bus_are_handled() {
    run_corpus("can");
}

#[test]
fn any_sequence_of_camera_events_is_handled() {
    run_corpus("v4l2_queue");
}

#[test]
fn any_bytes_from_the_other_end_of_a_pull_are_handled() {
    run_corpus("buffer_wire");
}

#[test]
fn any_bytes_as_a_segment_are_handled() {
    run_corpus("segment");
}

#[test]
fn any_messages_in_a_recording_are_handled() {
    run_corpus("recording");
}

#[test]
fn any_messages_are_exported_for_viewers() {
    run_corpus("viewer");
}

#[test]
fn any_bytes_as_a_pushed_model_are_handled() {
    run_corpus("bundle");
}

#[test]
fn any_file_as_a_model_is_handled() {
    run_corpus("onnx_file");
}

#[test]
fn any_bytes_as_a_snapshot_are_handled() {
    run_corpus("snapshot");
}

#[test]
fn any_text_as_a_configuration_is_handled() {
    run_corpus("config");
}

#[test]
fn any_text_as_a_log_is_handled() {
    run_corpus("localize_log");
}

#[test]
fn every_target_has_a_corpus_and_every_corpus_a_target() {
    let targets = TARGETS.map(|(name, _)| name.to_owned());
    assert_eq!(file_stems(corpus()), targets);
    assert_eq!(file_stems(corpus().join("../fuzz_targets")), targets);
}

fn file_stems(folder: PathBuf) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut names: Vec<String> =
        entries.map(|path| path.file_stem().unwrap().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

#[test]
fn any_bytes_as_a_map_are_handled() {
    run_corpus("map_state");
}

#[test]
fn any_bytes_from_a_client_of_the_live_view_are_handled() {
    run_corpus("live_view");
}
