//! What fuzzing has found interesting still holds, without a fuzzer.
#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test that cannot read its corpus has failed")]

use std::fs;
use std::path::Path;

#[path = "../../fuzz/src/scip.rs"]
mod scip;

#[test]
fn the_scip_codec_holds_what_it_promises_for_the_whole_corpus() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/corpus/scip");
    let mut inputs = 0;
    for entry in fs::read_dir(folder).unwrap() {
        scip::check(&fs::read(entry.unwrap().path()).unwrap());
        inputs += 1;
    }
    assert!(inputs >= 8, "{inputs} inputs");
}

#[test]
fn the_camera_driver_keeps_to_the_queues_rules_for_the_whole_corpus() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/corpus/v4l2_queue");
    let mut inputs = 0;
    for entry in fs::read_dir(folder).unwrap() {
        hil::video::torture(&fs::read(entry.unwrap().path()).unwrap());
        inputs += 1;
    }
    assert!(inputs >= 8, "{inputs} inputs");
}
