//! Kills `pull-buffer` and the robot's side at random times over real ssh. The environment variable `KILLS` sets the number of
//! kills.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test that cannot set up its files has failed"
)]

mod common;

use std::fs::{self, File};
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::{Instant, SystemTime};

use common::{Server, assert_same, robot, serving, stderr_of, unmark};
use hil::kills::{self, KillSchedule};
use rustix::process::{Pid, Signal, kill_process};
use serde_json::Value;
use tempfile::tempdir;

const SEGMENTS: u64 = 4;
const BYTES: usize = 1 << 20;
/// Slow enough that most kills happen during a transfer.
const LIMIT: &str = "--limit=10MB/s";

/// The number of bytes of every segment that are here, after checking that none of them is wrong.
fn have(robot: &Path, here: &Path) -> [u64; SEGMENTS as usize] {
    std::array::from_fn(|number| {
        let file = format!("run/recording_{number:04}.mcap");
        let original = fs::read(robot.join(&file)).unwrap();
        let here = here.join("robot").join(&file);
        match (fs::read(&here), fs::read(here.with_extension("mcap.part"))) {
            (Ok(whole), _) => {
                assert!(whole == original, "{file} has its final name but is not complete");
                whole.len() as u64
            }
            (Err(_), Ok(part)) => {
                assert!(original.starts_with(&part), "{file}: the part differs from what was sent");
                part.len() as u64
            }
            (Err(_), Err(_)) => 0,
        }
    })
}

/// Pulls to the end, and checks that exactly the missing bytes are transferred and no temporary file is left.
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
    for number in 0..SEGMENTS {
        let marker = robot.join(format!("run/recording_{number:04}.mcap.pulled"));
        assert!(marker.exists(), "{} is missing", marker.display());
    }
}

fn report(server: &Server, robot: &Path, here: &Path) -> Value {
    let output = server.pull(robot, here).arg("--json").output().unwrap();
    assert!(output.status.success(), "{}", stderr_of(&output));
    serde_json::from_str(String::from_utf8(output.stdout).unwrap().lines().last().unwrap()).unwrap()
}

/// Checks that another pull does not read any segment again: it does not notice changed contents with the same size and time.
fn reads_nothing_again(server: &Server, robot: &Path, here: &Path) {
    let path = robot.join("run/recording_0001.mcap");
    let original = fs::read(&path).unwrap();
    let time = fs::metadata(&path).unwrap().modified().unwrap();
    write_with_time(&path, &vec![7; original.len()], time);
    let report = report(server, robot, here);
    write_with_time(&path, &original, time);
    assert_eq!(
        (&report["files"], &report["bytes"], &report["there"]),
        (&0.into(), &0.into(), &SEGMENTS.into())
    );
    assert_same(robot, here, SEGMENTS);
}

fn write_with_time(path: &Path, bytes: &[u8], time: SystemTime) {
    fs::write(path, bytes).unwrap();
    File::open(path).unwrap().set_modified(time).unwrap();
}

/// The test for either end of the link. `kill` kills that end and returns whether it was still running.
fn killed_again_and_again(mut kill: impl FnMut(&mut Child, &Path) -> bool) {
    let server = Server::start();
    let robot = robot(SEGMENTS, BYTES);
    let here = tempdir().unwrap();
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
    let mut moments = KillSchedule::new(77, began.elapsed());
    start_again(robot.path(), here.path());
    let mut kills = 0;
    let mut rounds = 0;
    let mut before = [0; SEGMENTS as usize];
    while kills < kills::kill_count() {
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
        // After several kills in a row, one pull runs to the end.
        if killed && kills % 4 == 3 || now.iter().sum::<u64>() >= SEGMENTS * BYTES as u64 {
            completes(&server, robot.path(), here.path());
            if rounds == 0 {
                reads_nothing_again(&server, robot.path(), here.path());
            }
            start_again(robot.path(), here.path());
            rounds += 1;
            before = [0; SEGMENTS as usize];
        }
    }
    completes(&server, robot.path(), here.path());
    reads_nothing_again(&server, robot.path(), here.path());
    println!("{kills} kills, {} pulls completed", rounds + 1);
}

fn start_again(robot: &Path, here: &Path) {
    fs::remove_dir_all(here.join("robot")).unwrap();
    unmark(robot, SEGMENTS);
}

#[test]
#[cfg_attr(not(has_sshd), ignore = "needs /usr/sbin/sshd")]
fn a_puller_killed_at_any_time_resumes_at_the_byte_and_leaves_no_wrong_data() {
    killed_again_and_again(|child, _| {
        let ran = child.try_wait().unwrap().is_none();
        child.kill().unwrap();
        ran
    });
}

#[test]
#[cfg_attr(not(has_sshd), ignore = "needs /usr/sbin/sshd")]
fn after_the_robots_side_is_killed_at_any_time_the_next_pull_resumes_at_the_byte() {
    killed_again_and_again(|_, robot| {
        serving_process(robot).is_some_and(|pid| kill_process(pid, Signal::KILL).is_ok())
    });
}

#[test]
#[cfg_attr(not(has_sshd), ignore = "needs /usr/sbin/sshd")]
fn a_puller_reconnects_after_the_robots_side_was_killed() {
    let server = Server::start();
    let robot = robot(SEGMENTS, BYTES);
    let here = tempdir().unwrap();
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

/// The process that serves this robot's store behind the ssh server.
fn serving_process(robot: &Path) -> Option<Pid> {
    let wanted =
        [serving(), robot.to_owned()].map(|path| path.into_os_string().into_encoded_bytes());
    fs::read_dir("/proc").unwrap().flatten().find_map(|entry| {
        let pid = entry.file_name().to_str()?.parse().ok()?;
        let line = fs::read(entry.path().join("cmdline")).ok()?;
        let words: Vec<_> = line.split(|byte| *byte == 0).collect();
        // Not the shell that started it, whose first argument differs.
        (words.first() == Some(&&*wanted[0]) && words.contains(&&*wanted[1]))
            .then(|| Pid::from_raw(pid))
            .flatten()
    })
}
