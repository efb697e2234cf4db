//! Two short explorations decide the same as when their digests were committed.
//!
//! The digest covers every decision of a run bit for bit, so a pure renaming or restructuring cannot change it. A commit that
//! changes the robot's behaviour on purpose replaces the digests and says why in its message:
//!
//! ```text
//! UPDATE_EXPECT=1 cargo test -p firmware-host --test golden_digest
//! ```
#![allow(clippy::unwrap_used, reason = "a test that cannot set up its scene has failed")]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use assert_cmd::Command;
use tempfile::TempDir;

/// Digest of each policy's run.
type Digests = BTreeMap<String, String>;

fn committed() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden_digest.json")
}

/// Explores 150 frames of a simulated home without a network, with the default configuration.
fn digest(policy: &str) -> String {
    let dir = TempDir::new().unwrap();
    let out = dir.path().join("run");
    Command::cargo_bin("firmware-host")
        .unwrap()
        .args(["explore", "--scene", "builtin:apartment?seed=1", "--policy", policy])
        .args(["--frames", "150", "--seed", "3", "--no-recording", "--out", out.to_str().unwrap()])
        .assert()
        .success();
    let summary = std::fs::read(out.join("summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_slice(&summary).unwrap();
    summary["digest"].as_str().unwrap().to_owned()
}

#[test]
fn two_short_explorations_decide_as_committed() {
    let policies = ["active", "random"];
    let found: Digests = policies.map(|policy| (policy.to_owned(), digest(policy))).into();
    if std::env::var_os("UPDATE_EXPECT").is_some() {
        let text = serde_json::to_string_pretty(&found).unwrap();
        std::fs::write(committed(), text + "\n").unwrap();
    }
    let text = std::fs::read_to_string(committed()).unwrap();
    let expected: Digests = serde_json::from_str(&text).unwrap();
    assert_eq!(found, expected, "decisions have changed; the file's head says what to do");
}
