//! `pull-buffer` and the robot's side, killed at random moments over real ssh. `KILLS` says how often.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test that cannot set up its files has failed")]

mod common;

use std::fs::{self, File};
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::Instant;

use common::{Server, assert_same, robot, serving, words};
use hil::kills::{self, Moments};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use tempfile::tempdir;

const SEGMENTS: u64 = 4;
const BYTES: usize = 1 << 20;
/// Slow enough that most kills come in the middle of something.
const LIMIT: &str = "--limit=10MB/s";

/// What is here of every segment: nothing of it may ever be wrong, and a `.part` is how far its segment came.
fn have(robot: &Path, here: &Path) -> [u64; SEGMENTS as usize] {
    std::array::from_fn(|number| {
        let file = format!("run/recording_{number:04}.mcap");
        let original = fs::read(robot.join(&file)).unwrap();
        let here = here.join("robot").join(&file);
        match (fs::read(&here), fs::read(here.with_extension("mcap.part"))) {
            (Ok(whole), _) => {
                assert!(whole == original, "{file} has its name and is not whole");
                whole.len() as u64
            }
            (Err(_), Ok(part)) => {
                assert!(original.starts_with(&part), "{file}: what came is not what was sent");
                part.len() as u64
            }
            (Err(_), Err(_)) => 0,
        }
    })
}

/// Pulls to the end: brings exactly what was missing, and leaves nothing behind.
fn completes(server: &Server, robot: &Path, here: &Path) {
    let missing = SEGMENTS * BYTES as u64 + (0..SEGMENTS).sum::<u64>()
        - have(robot, here).iter().sum::<u64>();
    let report = report(server, robot, here);
    assert_eq!(report["bytes"], missing, "{report}");
    assert_same(robot, here, SEGMENTS);
    for entry in fs::read_dir(here.join("robot/run")).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        assert!(name.ends_with(".mcap"), "{name} is left over");
    }
    let marked = |number| robot.join(format!("run/recording_{number:04}.mcap.pulled")).exists();
    assert!((0..SEGMENTS).all(marked), "the robot does not know what it may delete");
}

fn report(server: &Server, robot: &Path, here: &Path) -> Value {
    let output = server.pull(robot, here).arg("--json").output().unwrap();
    assert!(output.status.success(), "{}", words(&output));
    serde_json::from_str(String::from_utf8(output.stdout).unwrap().lines().last().unwrap()).unwrap()
}

/// Another pull reads no segment again: it does not even notice that one was changed behind everybody's back.
fn reads_nothing_again(server: &Server, robot: &Path, here: &Path) {
    let path = robot.join("run/recording_0001.mcap");
    let original = fs::read(&path).unwrap();
    let time = fs::metadata(&path).unwrap().modified().unwrap();
    let write = |bytes: &[u8]| {
        fs::write(&path, bytes).unwrap();
        File::open(&path).unwrap().set_modified(time).unwrap();
    };
    write(&vec![7; original.len()]);
    let report = report(server, robot, here);
    write(&original);
    assert_eq!(
        (&report["files"], &report["bytes"], &report["there"]),
        (&0.into(), &0.into(), &SEGMENTS.into())
    );
    assert_same(robot, here, SEGMENTS);
}

/// The same for both ends of the link. `kill` ends the one that is meant, if it is there; whether it was.
fn killed_again_and_again(mut kill: impl FnMut(&mut Child, &Path) -> bool) {
    let Some(server) = Server::start() else { return };
    let (robot, here) = (robot(SEGMENTS, BYTES), tempdir().unwrap());
    let began = Instant::now();
    assert!(
        server
            .pull(robot.path(), here.path())
            .arg(LIMIT)
            .stderr(Stdio::null())
            .status()
            .unwrap()
            .success()
    );
    let mut moments = Moments::new(77, began.elapsed());
    let fresh = || {
        fs::remove_dir_all(here.path().join("robot")).unwrap();
        (0..SEGMENTS).for_each(|number| {
            // Nor does the robot remember.
            let _ = fs::remove_file(
                robot.path().join(format!("run/recording_{number:04}.mcap.pulled")),
            );
        });
    };
    fresh();
    let (mut kills, mut rounds, mut before) = (0, 0, [0; SEGMENTS as usize]);
    while kills < kills::wanted() {
        let mut child = server
            .pull(robot.path(), here.path())
            .args([LIMIT, "--retries=0"])
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        moments.wait(&mut child, || kills::listing(&here.path().join("robot/run"))).unwrap();
        let killed = kill(&mut child, robot.path());
        kills += u64::from(killed);
        child.wait().unwrap();
        let now = have(robot.path(), here.path());
        assert!(
            now.iter().zip(before).all(|(now, before)| *now >= before),
            "{before:?}, then {now:?}"
        );
        before = now;
        assert!(rounds <= 50 + kills, "the program ends before it can be killed");
        // Killed in one piece for some time, then through to the end.
        if killed && kills % 4 == 3 || now.iter().sum::<u64>() >= SEGMENTS * BYTES as u64 {
            completes(&server, robot.path(), here.path());
            if rounds == 0 {
                reads_nothing_again(&server, robot.path(), here.path());
            }
            fresh();
            (rounds, before) = (rounds + 1, [0; SEGMENTS as usize]);
        }
    }
    completes(&server, robot.path(), here.path());
    reads_nothing_again(&server, robot.path(), here.path());
    println!("{kills} kills, {} pulls completed", rounds + 1);
}

#[test]
fn a_puller_killed_at_any_time_resumes_at_the_byte_and_leaves_no_wrong_data() {
    killed_again_and_again(|child, _| {
        let ran = child.try_wait().unwrap().is_none();
        child.kill().unwrap();
        ran
    });
}

#[test]
fn after_the_robots_side_is_killed_at_any_time_the_next_pull_resumes_at_the_byte() {
    killed_again_and_again(|_, robot| {
        serving_process(robot).is_some_and(|pid| kill_process(pid, Signal::KILL).is_ok())
    });
}

#[test]
fn a_puller_reconnects_after_the_robots_side_was_killed() {
    let Some(server) = Server::start() else { return };
    let (robot, here) = (robot(SEGMENTS, BYTES), tempdir().unwrap());
    let mut child =
        server.pull(robot.path(), here.path()).arg(LIMIT).stderr(Stdio::null()).spawn().unwrap();
    let part = here.path().join("robot/run/recording_0001.mcap.part");
    while !part.exists() {
        assert!(child.try_wait().unwrap().is_none());
        std::thread::yield_now();
    }
    kill_process(serving_process(robot.path()).unwrap(), Signal::KILL).unwrap();
    assert!(child.wait().unwrap().success());
    assert_same(robot.path(), here.path(), SEGMENTS);
}

/// What serves this robot's buffer behind the ssh server.
fn serving_process(robot: &Path) -> Option<Pid> {
    let wanted =
        [serving(), robot.to_owned()].map(|path| path.into_os_string().into_encoded_bytes());
    fs::read_dir("/proc").unwrap().flatten().find_map(|entry| {
        let pid = entry.file_name().to_str()?.parse().ok()?;
        let line = fs::read(entry.path().join("cmdline")).ok()?;
        let words: Vec<_> = line.split(|byte| *byte == 0).collect();
        // Not the shell that starts it.
        (words.first() == Some(&&*wanted[0]) && words.contains(&&*wanted[1]))
            .then(|| Pid::from_raw(pid))
            .flatten()
    })
}
