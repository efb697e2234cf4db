//! Kills an install, and a robot that swaps models, at random moments: the store must stay valid,
//! and the robot must start again. The environment variable `KILLS` sets the number of kills.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test that cannot set up its scene has failed"
)]

mod robot;

use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use firmware_host::model::{History, SavedCounts, State};
use hil::kills::{self, KillSchedule};
use robot::{Robot, binary, run};

/// Starts the program without output.
fn start(args: &[&str]) -> Child {
    Command::new(binary()).args(args).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
}

/// Checks that state, history and all models of the store can be read; returns the state.
fn valid_state(robot: &Robot) -> State {
    let store = robot.store();
    let state = store.state().unwrap();
    state.models.iter().for_each(|digest| drop(store.read_model(digest).unwrap()));
    if let Ok(history) = std::fs::read(robot.path("store/history.json")) {
        serde_json::from_slice::<History>(&history).unwrap();
    }
    if let Ok(counts) = std::fs::read(robot.path("store/counts.json")) {
        serde_json::from_slice::<SavedCounts>(&counts).unwrap();
    }
    let files = ["current", "models", "counts.json", "history.json", "lock"];
    for entry in std::fs::read_dir(robot.path("store")).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        let known = files.contains(&name.as_str());
        assert!(known || name.ends_with(".partial"), "{name} is left over");
    }
    state
}

/// Number of processes that examine a model for this robot.
fn examining(robot: &Robot) -> usize {
    let config = robot.text("robot.toml");
    let lines = std::fs::read_dir("/proc").unwrap().flatten();
    let lines = lines.filter_map(|entry| std::fs::read(entry.path().join("cmdline")).ok());
    let words = lines.map(|line| String::from_utf8_lossy(&line).into_owned());
    words.filter(|line| line.contains("examine") && line.contains(&config)).count()
}

#[test]
fn an_install_killed_at_any_moment_leaves_the_old_model_or_the_new_one() {
    let robot = Robot::new();
    let resident = robot.has("worse");
    let bundle = robot.signed("better");
    let config = robot.text("robot.toml");
    let store = robot.text("store");
    let keys = robot.text("trusted_keys");
    let mut args = vec![
        "model",
        "install",
        bundle.to_str().unwrap(),
        "--json",
        "--config",
        &config,
        "--store",
        &store,
    ];
    args.extend(["--trusted-keys", &keys, "--normal-priority", "--again"]);
    let old = State { models: vec![resident.clone()], trial_starts: None };
    let recordings = robot.recordings();
    args.extend(["--recordings", &recordings, "--frames", "120"]);
    let began = Instant::now();
    assert!(start(&args).wait().unwrap().success());
    let mut moments = KillSchedule::new(5, began.elapsed());
    let new = valid_state(&robot);
    assert_eq!((new.previous(), new.trial_starts), (Some(&*resident), Some(0)));
    roll_back_to(&robot, &old);
    let mut kills = 0;
    let mut installed = 0;
    let mut tries = 0;
    while kills < kills::kill_count() {
        tries += 1;
        assert!(tries <= 50 + 4 * kills::kill_count(), "it ends before it can be killed");
        let mut child = start(&args);
        moments.wait(&mut child, || kills::listing(&robot.path("store"))).unwrap();
        kills += u64::from(child.try_wait().unwrap().is_none());
        child.kill().unwrap();
        child.wait().unwrap();
        let state = valid_state(&robot);
        assert!(state == old || state == new, "{state:?}");
        if state == new {
            installed += 1;
            roll_back_to(&robot, &old);
        }
    }
    let began = Instant::now();
    while examining(&robot) > 0 {
        assert!(
            began.elapsed() < Duration::from_secs(10),
            "the examining process outlives its parent"
        );
        std::thread::yield_now();
    }
    println!("{kills} kills in {tries} installs; the new model was current {installed} times");
    // An install without a kill still works.
    assert!(start(&args).wait().unwrap().success());
    assert_eq!(valid_state(&robot), new);
}

fn roll_back_to(robot: &Robot, old: &State) {
    let output = run(&["model", "rollback", "--json", "--store", &robot.text("store")]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(valid_state(robot), *old);
    // Each comparison makes the next one stricter; every install of this test is to be a first try.
    std::fs::remove_file(robot.path("store/history.json")).unwrap();
}

/// Starts an exploration with the store for the given number of frames, without output.
fn drive(robot: &Robot, out: &Path, frames: &str) -> Child {
    let config = robot.text("robot.toml");
    let store = robot.text("store");
    let scene = "builtin:apartment?seed=1";
    let mut args =
        vec!["explore", "--frames", frames, "--seed", "2", "--scene", scene, "--config", &config];
    args.extend(["--model-store", &store, "--out", out.to_str().unwrap()]);
    start(&args)
}

/// Kills a robot that switches to the model `name` while it drives. The store must be on trial with
/// the new model, or in the state after the trial, which `after_trial` returns.
fn killed_while_swapping(name: &str, after_trial: fn(guess: &str, new: &str) -> State) {
    let robot = Robot::new();
    let guess = robot.has("guess");
    let bytes = std::fs::read(robot::model_file(name)).unwrap();
    let new = blake3::hash(&bytes).to_hex().to_string();
    let old = State { models: vec![guess.clone()], trial_starts: None };
    let end = after_trial(&guess, &new);
    let out = robot.path("run");
    robot.put(&bytes, name);
    let began = Instant::now();
    assert!(drive(&robot, &out, "150").wait().unwrap().success());
    assert_eq!(valid_state(&robot), end);
    let mut moments = KillSchedule::new(9, began.elapsed());
    let mut kills = 0;
    let mut tries = 0;
    let mut ends = 0;
    let mut trials = 0;
    while kills < kills::kill_count() {
        tries += 1;
        assert!(tries <= 50 + 4 * kills::kill_count(), "it ends before it can be killed");
        // Restore the store to its state before the install.
        std::fs::remove_file(robot.path("store/history.json")).unwrap();
        std::fs::write(robot.path("store/current"), serde_json::to_vec(&old).unwrap()).unwrap();
        let _ = std::fs::remove_dir_all(&out);
        let mut child = drive(&robot, &out, "150");
        moments.until(&mut child, || out.join("recording_0000.mcap").exists()).unwrap();
        assert!(out.join("recording_0000.mcap").exists(), "the robot does not drive");
        robot.put(&bytes, name);
        moments.wait(&mut child, || kills::listing(&robot.path("store"))).unwrap();
        kills += u64::from(child.try_wait().unwrap().is_none());
        child.kill().unwrap();
        child.wait().unwrap();
        let state = valid_state(&robot);
        let on_trial = State { models: vec![new.clone(), guess.clone()], trial_starts: Some(0) };
        assert!(state == on_trial || state == end, "{state:?}");
        ends += u64::from(state == end);
        trials += u64::from(state == on_trial);
        // The robot starts again with the current model.
        std::fs::remove_dir_all(&out).unwrap();
        assert!(drive(&robot, &out, "2").wait().unwrap().success(), "after {state:?}");
        let summary = std::fs::read(out.join("summary.json")).unwrap();
        let summary: serde_json::Value = serde_json::from_slice(&summary).unwrap();
        assert_eq!(summary["model"].as_str(), state.current());
        let again = valid_state(&robot);
        let started = State { trial_starts: state.trial_starts.map(|starts| starts + 1), ..state };
        // A bad model may show what it is in these two frames, too.
        assert!(again == started || again == end, "{again:?}");
    }
    println!(
        "{name}: {kills} kills in {tries} drives, {trials} on trial, {ends} after the trial's end"
    );
}

#[test]
fn a_robot_killed_while_it_takes_a_good_model_has_it_on_trial_or_keeps_it() {
    killed_while_swapping("better", |guess, new| State {
        models: vec![new.to_owned(), guess.to_owned()],
        trial_starts: None,
    });
}

#[test]
fn a_robot_killed_while_it_takes_a_bad_model_has_it_on_trial_or_is_back() {
    killed_while_swapping("nan_in_the_dark", |guess, _| State {
        models: vec![guess.to_owned()],
        trial_starts: None,
    });
}
