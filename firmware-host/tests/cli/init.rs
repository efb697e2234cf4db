//! `firmware-host init` without devices: its refusals, its files of answers, and the file that it replaces.

use super::*;

#[test]
fn init_asks_no_questions_when_its_input_is_not_a_terminal_and_names_the_way_out() {
    let dir = TempDir::new().unwrap();
    let out = dir.path().join("robot.toml");
    let output = firmware_host(&["init", "--out", out.to_str().unwrap()]);
    let error = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{error}");
    assert!(error.contains("not a terminal") && error.contains("--answers FILE"), "{error}");
    assert!(!out.exists());
}

#[test]
fn init_turns_no_wheel_without_a_person_who_sees_it() {
    let output = firmware_host(&["init", "--answers", "a.toml", "--turn-wheels", "--out", "none"]);
    assert!(text(&output.stderr).contains("a person who sees the wheels"), "{output:?}");
}

#[test]
fn init_replaces_no_file_without_force() {
    let dir = TempDir::new().unwrap();
    let out = dir.path().join("robot.toml");
    std::fs::write(&out, SMALL).unwrap();
    let answers = dir.path().join("answers.toml");
    std::fs::write(&answers, "protocol = \"vesc\"\ncamera_fov_deg = 60\n").unwrap();
    let mut args = vec!["init", "--simulated", dir.path().to_str().unwrap()];
    args.extend(["--out", out.to_str().unwrap(), "--answers", answers.to_str().unwrap()]);
    let refused = firmware_host(&args);
    assert!(text(&refused.stderr).contains("--force replaces it"), "{refused:?}");
    assert_eq!(std::fs::read_to_string(&out).unwrap(), SMALL);
    args.push("--force");
    firmware_host(&args);
    let file = std::fs::read_to_string(&out).unwrap();
    assert!(file.contains("camera.horizontal_fov_deg = 60.0"), "{file}");
    assert!(file.contains("camera.width = 160"), "keys that are not asked for are kept: {file}");
}

#[test]
fn a_real_robot_does_not_run_before_it_was_measured_on_the_floor() {
    let dir = TempDir::new().unwrap();
    let out = dir.path().join("robot.toml");
    let answers = dir.path().join("answers.toml");
    let devices =
        "camera = \"unix:/nowhere/camera\"\nlidar_port = \"/nowhere/lidar\"\nbus = \"nowhere\"\n";
    std::fs::write(&answers, format!("{devices}protocol = \"vesc\"\n")).unwrap();
    let paths = [&out, &answers].map(|path| path.to_str().unwrap());
    firmware_host(&["init", "--out", paths[0], "--answers", paths[1]]);
    let run = dir.path().join("run");
    let error =
        firmware_host(&["run", "--config", paths[0], "--out", run.to_str().unwrap()]).stderr;
    assert!(text(&error).contains("check --drive"), "{}", text(&error));
    assert!(!run.exists());
}

#[test]
fn init_names_every_wrong_answer_of_a_file_and_writes_nothing() {
    let dir = TempDir::new().unwrap();
    let out = dir.path().join("robot.toml");
    let answers = dir.path().join("answers.toml");
    std::fs::write(&answers, "gear_ratio = nan\nlidar = \"sick\"\nwheel_m = 1\n").unwrap();
    let mut args = vec!["init", "--simulated", dir.path().to_str().unwrap()];
    args.extend(["--out", out.to_str().unwrap(), "--answers", answers.to_str().unwrap()]);
    let error = text(&firmware_host(&args).stderr);
    for part in ["answers.toml", "NaN is not allowed", "`sick` is not one of", "`wheels_m`?"] {
        assert!(error.contains(part), "{part} in {error}");
    }
    assert!(!out.exists());
}

#[test]
fn the_answers_that_init_prints_are_a_file_that_it_reads() {
    let dir = TempDir::new().unwrap();
    let folder = dir.path().to_str().unwrap();
    let printed = firmware_host(&["init", "--print-answers", "--simulated", folder]);
    let answers = dir.path().join("answers.toml");
    std::fs::write(&answers, &printed.stdout).unwrap();
    let out = dir.path().join("robot.toml");
    let mut args = vec!["init", "--simulated", folder, "--out", out.to_str().unwrap()];
    args.extend(["--answers", answers.to_str().unwrap()]);
    firmware_host(&args);
    let check = firmware_host(&["check", "--config", out.to_str().unwrap()]);
    // The endpoints of an ODrive have no default that works.
    assert!(text(&check.stderr).contains("enable_watchdog_endpoint"), "{check:?}");
}

#[test]
fn init_asks_nothing_if_the_file_could_not_be_written() {
    let output = firmware_host(&["init", "--out", "/nowhere/robot.toml"]);
    let error = text(&output.stderr);
    assert!(error.contains("cannot write /nowhere/robot.toml: choose another folder"), "{error}");
}
