//! An exported ROS 2 bag is read by an independent implementation and must contain the same data as
//! the recording.
#![allow(clippy::unwrap_used, reason = "a test that cannot make its bag has failed")]

use std::path::Path;
use std::process::Command;

use segment_store::export::ros2;

#[test]
#[ignore = "needs tests/peers/requirements.txt; `cargo xtask test --all` installs it"]
fn rosbags_reads_from_a_bag_what_the_mcap_package_reads_from_the_recording() {
    let python = std::env::var("HIL_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let recording = here.join("tests/reproducers/stop_zone.mcap");
    let dir = tempfile::tempdir().unwrap();
    let bag = dir.path().join("bag");
    let bagged = ros2(std::slice::from_ref(&recording), &bag).unwrap();
    let script = here.join("../tests/peers/ros2_bag.py");
    let output = Command::new(python).arg(script).args([&bag, &recording]).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let counts: serde_json::Map<String, serde_json::Value> =
        serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(counts.values().filter_map(serde_json::Value::as_u64).sum::<u64>(), bagged.messages);
}
