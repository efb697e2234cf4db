//! The program `pull-buffer` with an object store as destination, here a `file:///` URL. The environment variable `KILLS` sets how
//! often an upload is killed.
#![cfg(feature = "object-store")]
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test that cannot set up its files has failed"
)]

mod common;

use std::fs;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::Instant;

use common::{assert_same, robot, stderr_of, unmark};
use hil::kills::{self, KillSchedule};
use segment_store::Digest;
use tempfile::tempdir;

const SEGMENTS: u64 = 4;
const BYTES: usize = 1 << 20;

fn upload(robot: &Path, store: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_pull-buffer"));
    command.arg(format!("robot={}", robot.display())).arg(format!("file://{}", store.display()));
    command
}

/// Checks all objects in the store, and returns the number of segments that are complete and have their digest.
fn complete(robot: &Path, store: &Path) -> u64 {
    (0..SEGMENTS).filter(|number| is_complete(robot, store, *number)).count() as u64
}

fn is_complete(robot: &Path, store: &Path, number: u64) -> bool {
    let file = format!("run/recording_{number:04}.mcap");
    let original = fs::read(robot.join(&file)).unwrap();
    let there = store.join("robot").join(&file);
    let whole = fs::read(&there).inspect(|bytes| {
        assert!(*bytes == original, "{file} has its final name but is not complete");
    });
    let digest = fs::read_to_string(there.with_extension("mcap.blake3"));
    if let Ok(digest) = &digest {
        assert!(digest.starts_with(&Digest::of(&original).to_string()), "{file}: {digest}");
    }
    assert!(
        whole.is_ok() || !robot.join(format!("{file}.pulled")).exists(),
        "{file} is marked but not in the store"
    );
    whole.is_ok() && digest.is_ok()
}

#[test]
fn an_upload_killed_at_any_time_leaves_complete_objects_and_the_next_one_finishes() {
    let robot = robot(SEGMENTS, BYTES);
    let dir = tempdir().unwrap();
    let store = dir.path().join("store");
    start_again(robot.path(), &store);
    let began = Instant::now();
    assert!(slow_upload(robot.path(), &store).wait().unwrap().success());
    let mut moments = KillSchedule::new(78, began.elapsed());
    start_again(robot.path(), &store);
    let mut kills = 0;
    let mut rounds = 0;
    while kills < kills::kill_count() {
        let mut child = slow_upload(robot.path(), &store);
        moments.wait(&mut child, || kills::listing(&store)).unwrap();
        kills += u64::from(child.try_wait().unwrap().is_none());
        child.kill().unwrap();
        child.wait().unwrap();
        let there = complete(robot.path(), &store);
        assert!(rounds <= 50 + kills, "the program ends before it can be killed");
        if kills % 4 == 3 || there == SEGMENTS {
            let output = upload(robot.path(), &store).output().unwrap();
            assert!(output.status.success(), "{}", stderr_of(&output));
            assert_eq!(complete(robot.path(), &store), SEGMENTS);
            start_again(robot.path(), &store);
            rounds += 1;
        }
    }
    println!("{kills} kills, {rounds} uploads completed");
}

/// An upload that is slow enough that most kills happen during a transfer.
fn slow_upload(robot: &Path, store: &Path) -> Child {
    upload(robot, store).arg("--limit=10MB/s").stderr(Stdio::null()).spawn().unwrap()
}

fn start_again(robot: &Path, store: &Path) {
    let _ = fs::remove_dir_all(store);
    fs::create_dir(store).unwrap();
    unmark(robot, SEGMENTS);
}

#[test]
fn segments_uploaded_by_a_robot_are_pulled_by_a_workstation() {
    let robot = robot(SEGMENTS, 1000);
    let dir = tempdir().unwrap();
    let store = dir.path().join("store");
    let here = dir.path().join("here");
    fs::create_dir(&store).unwrap();
    for new in [SEGMENTS, 0] {
        let output = upload(robot.path(), &store).arg("--json").output().unwrap();
        assert!(output.status.success(), "{}", stderr_of(&output));
        let last = String::from_utf8(output.stdout).unwrap().lines().last().unwrap().to_owned();
        let report: serde_json::Value = serde_json::from_str(&last).unwrap();
        assert_eq!(
            (&report["files"], &report["there"]),
            (&new.into(), &(SEGMENTS - new).into()),
            "{report}"
        );
    }
    // A segment without its end counts as still being written for half a minute.
    for number in 0..SEGMENTS {
        let object =
            fs::File::open(store.join(format!("robot/run/recording_{number:04}.mcap"))).unwrap();
        object.set_modified(std::time::UNIX_EPOCH).unwrap();
    }
    let from = format!("file://{}/robot", store.display());
    let output =
        Command::new(env!("CARGO_BIN_EXE_pull-buffer")).arg(from).arg(&here).output().unwrap();
    assert!(output.status.success(), "{}", stderr_of(&output));
    assert_same(robot.path(), &here, SEGMENTS);
}

/// A key as `age-keygen` makes it: that of the age crate's own tests.
const PUBLIC: &str = "age1t7rxyev2z3rw82stdlrrepyc39nvn86l5078zqkf5uasdy86jp6svpy7pa";
const SECRET: &str = "AGE-SECRET-KEY-1GQ9778VQXMMJVE8SK7J6VT8UJ4HDQAJUVSFCWCM02D8GEWQ72PVQ2Y5J33";

fn pull_buffer(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_pull-buffer")).args(arguments).output().unwrap()
}

#[test]
fn encrypted_segments_need_their_key_and_its_absence_is_an_error_that_names_the_way() {
    let robot = robot(SEGMENTS, 1000);
    let dir = tempdir().unwrap();
    let store = dir.path().join("store");
    let here = dir.path().join("here");
    let key = dir.path().join("key.txt");
    fs::create_dir(&store).unwrap();
    fs::write(&key, SECRET).unwrap();
    let output = upload(robot.path(), &store).args(["--encrypt-to", PUBLIC]).output().unwrap();
    assert!(output.status.success(), "{}", stderr_of(&output));
    for number in 0..SEGMENTS {
        let object = store.join(format!("robot/run/recording_{number:04}.mcap"));
        assert!(!object.exists());
        // A segment without its end counts as still being written for half a minute.
        let encrypted = fs::File::open(object.with_extension("mcap.age")).unwrap();
        encrypted.set_modified(std::time::UNIX_EPOCH).unwrap();
    }
    let from = format!("file://{}/robot", store.display());
    let output = pull_buffer(&[&from, here.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(1));
    let said = stderr_of(&output);
    for number in 0..SEGMENTS {
        let why = format!("not pulled: run/recording_{number:04}.mcap.age is encrypted");
        assert!(said.contains(&why) && said.contains("--identity key.txt"), "{said}");
    }
    let identity = format!("--identity={}", key.display());
    let output = pull_buffer(&[&from, here.to_str().unwrap(), &identity]);
    assert!(output.status.success(), "{}", stderr_of(&output));
    assert_same(robot.path(), &here, SEGMENTS);
}

#[test]
fn keys_that_would_not_be_used_or_are_none_are_refused_before_anything_is_copied() {
    let robot = robot(1, 1000);
    let dir = tempdir().unwrap();
    let from = format!("robot={}", robot.path().display());
    let from = from.as_str();
    let here = dir.path().join("here");
    let to = here.to_str().unwrap();
    let store = format!("file://{}", dir.path().display());
    let in_store = format!("robot={store}");
    for (arguments, why) in [
        ([from, to, "--encrypt-to", PUBLIC], "is a directory"),
        ([from, to, "--identity", "key.txt"], "no SOURCE is one"),
        ([from, &store, "--identity", "key.txt"], "no SOURCE is one"),
        ([from, &store, "--encrypt-to", "age1wrong"], "no public key of age"),
        ([from, &store, "--encrypt-to", SECRET], "age-keygen -y"),
        ([&in_store, to, "--identity", "nosuch.txt"], "nosuch.txt"),
    ] {
        let output = pull_buffer(&arguments);
        let said = stderr_of(&output);
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(said.contains(why) && !said.contains(SECRET), "{said}");
    }
    assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
}
