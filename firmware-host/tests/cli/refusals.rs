//! What a command refuses: it names the thing, says what to do, and leaves nothing behind.

use super::*;

#[test]
fn perceive_refuses_to_overwrite_the_summary_of_a_run() {
    let dir = TempDir::new().unwrap();
    let (_, run) = explore(&dir, "run", &HOME);
    let before = summary(&run);
    let folder = run.to_str().unwrap();
    let perceive = firmware_host(&["perceive", "--recording", folder, "--out", folder]);
    let said = text(&perceive.stderr);
    assert!(perceive.status.code() == Some(1) && said.contains("choose another --out"), "{said}");
    assert_eq!(summary(&run), before);
}

#[test]
fn the_summary_of_a_run_without_a_recording_is_not_overwritten_by_any_command() {
    let dir = TempDir::new().unwrap();
    let more = [&HOME[..], &["--no-recording"]].concat();
    let map = dir.path().join("home.map");
    let with_map = [&more[..], &["--map", map.to_str().unwrap()]].concat();
    let (first, out) = explore_for(&dir, "3", SMALL, "run", &with_map);
    assert!(first.status.success(), "{}", text(&first.stderr));
    let before = std::fs::read(out.join("summary.json")).unwrap();
    let plot = std::fs::read(out.join("map.png")).unwrap();
    let (again, _) = explore_for(&dir, "4", SMALL, "run", &more);
    // The log is not there: the folder is refused before it is read.
    let [folder, map] = [&out, &map].map(|path| path.to_str().unwrap());
    let localize = ["localize", "--log", "nowhere.log", "--out", folder];
    let export = ["map", "export", map, "--out", folder];
    for refused in [again, firmware_host(&localize), firmware_host(&export)] {
        let said = text(&refused.stderr);
        assert!(
            refused.status.code() == Some(1)
                && said.contains("contains summary.json of another run; choose another --out"),
            "{said}"
        );
    }
    assert!(std::fs::read(out.join("summary.json")).unwrap() == before);
    assert!(std::fs::read(out.join("map.png")).unwrap() == plot);
    // The results of an earlier `localize` are replaced.
    std::fs::write(out.join("online.tum"), "").unwrap();
    let said = text(&firmware_host(&localize).stderr);
    assert!(said.contains("nowhere.log"), "{said}");
}

#[test]
fn perceive_refuses_a_recording_without_a_frame_and_writes_nothing() {
    let dir = TempDir::new().unwrap();
    let config = format!("{SMALL}[recording]\nimages = false\n");
    let (_, run) = explore_for(&dir, "3", &config, "run", &HOME);
    let out = dir.path().join("seen");
    let [run, folder] = [&run, &out].map(|path| path.to_str().unwrap());
    let perceive = firmware_host(&["perceive", "--recording", run, "--out", folder]);
    let said = text(&perceive.stderr);
    assert!(
        perceive.status.code() == Some(1)
            && said.contains("has no frame that can be read; see firmware-host buffer verify"),
        "{said}"
    );
    assert_eq!(std::fs::read_dir(out).unwrap().count(), 0);
}

#[test]
fn a_start_that_fails_leaves_no_recording_that_would_refuse_the_next_try() {
    let dir = TempDir::new().unwrap();
    let file = dir.path().join("text.txt");
    std::fs::write(&file, "mine").unwrap();
    for option in ["--dump", "--live"] {
        let more = [&HOME[..], &[option, file.to_str().unwrap()]].concat();
        let (failed, out) = explore_for(&dir, "3", SMALL, "run", &more);
        assert_eq!(failed.status.code(), Some(1), "{option}");
        assert!(!out.join("recording_0000.mcap").exists(), "{option}");
    }
    assert_eq!(std::fs::read_to_string(&file).unwrap(), "mine");
    let (corrected, out) = explore_for(&dir, "3", SMALL, "run", &HOME);
    assert!(corrected.status.success(), "{}", text(&corrected.stderr));
    assert!(out.join("recording_0000.mcap").exists());
}

#[test]
fn a_run_that_would_begin_outside_of_the_area_to_keep_in_is_refused_and_leaves_no_folder() {
    let dir = TempDir::new().unwrap();
    let area = dir.path().join("kitchen.geojson");
    let corners = [[3.0, 3.0], [4.0, 3.0], [4.0, 4.0], [3.0, 3.0]];
    let polygon = serde_json::json!({ "type": "Polygon", "coordinates": [corners] });
    std::fs::write(&area, polygon.to_string()).unwrap();
    let more = [&HOME[..], &["--keep-in", area.to_str().unwrap()]].concat();
    let (explored, out) = explore_for(&dir, "3", SMALL, "run", &more);
    let said = text(&explored.stderr);
    assert!(
        explored.status.code() == Some(1) && said.contains("outside of the areas to keep in"),
        "{said}"
    );
    assert!(!out.exists());
}

#[test]
fn calibrate_refuses_its_configuration_and_its_output_before_it_measures() {
    let dir = TempDir::new().unwrap();
    // The recording is not there: everything else is refused before it is read.
    let recording = ["calibrate", "--recording", "nowhere"];
    let unwritable = dir.path().join("nosuchdir/calibration.toml");
    let folder = dir.path().to_str().unwrap();
    for (more, named) in [
        (["--out", unwritable.to_str().unwrap()], "cannot write"),
        (["--out", folder], "is not a regular file"),
        (["--config", "none.toml"], "none.toml"),
    ] {
        let refused = firmware_host(&[&recording[..], &more].concat());
        let said = text(&refused.stderr);
        assert!(!refused.status.success() && said.contains(named), "{more:?}: {said}");
        assert_eq!(text(&refused.stdout), "");
    }
    let of_log = ["calibrate", "--log", "nowhere.log", "--out", unwritable.to_str().unwrap()];
    let said = text(&firmware_host(&of_log).stderr);
    assert!(said.contains("nosuchdir") && !said.contains("nowhere.log"), "{said}");
}

#[test]
fn health_refuses_a_file_that_is_not_a_status() {
    let dir = TempDir::new().unwrap();
    let file = dir.path().join("summary.json");
    std::fs::write(&file, "{\"frames\": 3}").unwrap();
    let health = firmware_host(&["health", "--status", file.to_str().unwrap()]);
    let said = text(&health.stderr);
    assert!(health.status.code() == Some(1) && said.contains("is not a status"), "{said}");
}

#[test]
fn impossible_arguments_are_refused_by_name_and_leave_no_files() {
    let dir = TempDir::new().unwrap();
    let no_model = dir.path().join("none.onnx");
    let empty = dir.path().join("empty.obj");
    std::fs::write(&empty, "# nothing\n").unwrap();
    let cases: &[(&[&str], &str)] = &[
        (&["--scene", "nowhere.glb"], "nowhere.glb"),
        (&["--scene", "builtin:castle"], "apartment, house and office"),
        (&["--scene", "apartment"], "builtin:apartment"),
        (&["--scene", "builtin:apartment", "--scene-scale", "-1"], "above 0"),
        (&["--scene", empty.to_str().unwrap()], "triangle"),
        (&["--scene", "builtin:apartment?seed=1", "--start", "90,90,0"], "nearest free position"),
        (
            &["--scene", "builtin:apartment?seed=1", "--model", no_model.to_str().unwrap()],
            "none.onnx",
        ),
        (&["--scene", "builtin:apartment?seed=1", "--depth", "network"], "--model"),
    ];
    for (index, (args, named)) in cases.iter().enumerate() {
        let (output, out) = explore(&dir, &format!("case{index}"), args);
        let said = text(&output.stderr);
        assert!(matches!(output.status.code(), Some(1 | 2)), "{args:?}: {:?}", output.status);
        assert!(said.contains(named) && !said.contains("panicked"), "{args:?}: {said}");
        assert!(said.matches("os error").count() < 2, "repeated: {said}");
        assert!(
            !out.join("summary.json").exists() && !out.join("recording_0000.mcap").exists(),
            "{args:?}"
        );
    }
}

#[test]
fn an_impossible_configuration_is_a_usage_error_with_file_key_value_and_range() {
    let dir = TempDir::new().unwrap();
    let config = dir.path().join("robot.toml");
    std::fs::write(&config, "[base]\nforward_step_m = -1\n[camera]\nwidht = 640\n").unwrap();
    let check = firmware_host(&["check", "--config", config.to_str().unwrap()]);
    let said = text(&check.stderr);
    assert_eq!(check.status.code(), Some(2));
    for named in ["robot.toml", "base.forward_step_m", "-1", "0.005", "did you mean `width`"] {
        assert!(said.contains(named), "{named}: {said}");
    }
}

#[test]
fn check_refuses_what_run_refuses_and_run_leaves_no_recording_of_it() {
    let dir = TempDir::new().unwrap();
    let endpoints =
        "[devices.base.odrive]\nenable_watchdog_endpoint = 195\nwatchdog_timeout_endpoint = 196\n";
    let cases = [
        ("[devices.base]\nwheel_radius_m = 50\n".to_owned() + endpoints, "wheel_radius_m"),
        ("[devices.base]\nbus = \"can0\"\n".to_owned(), "flat_endpoints.json"),
        ("[devices.lens]\nfx = 0\n".to_owned() + endpoints, "devices.lens.fx"),
        ("[devices.lens]\ncx = -90000\n".to_owned() + endpoints, "[devices.lens]"),
    ];
    for (content, named) in cases {
        let config = dir.path().join("robot.toml");
        std::fs::write(&config, &content).unwrap();
        let config = config.to_str().unwrap();
        let out = dir.path().join("run");
        for command in [
            &["check", "--config", config][..],
            &["run", "--config", config, "--out", out.to_str().unwrap()],
        ] {
            let refused = firmware_host(command);
            let said = text(&refused.stderr);
            assert!(refused.status.code() == Some(2) && said.contains(named), "{content}{said}");
        }
        assert!(!out.exists(), "{content}");
    }
}

#[test]
fn a_configuration_without_devices_is_valid_and_check_says_that_run_needs_them() {
    let dir = TempDir::new().unwrap();
    let config = dir.path().join("robot.toml");
    std::fs::write(&config, SMALL).unwrap();
    let check = firmware_host(&["check", "--config", config.to_str().unwrap()]);
    let said = text(&check.stdout);
    assert!(check.status.success() && said.contains("`run` needs a section [devices]"), "{said}");
}

#[test]
fn a_task_without_a_robot_and_a_list_without_a_store_create_nothing_and_say_what_to_give() {
    let dir = TempDir::new().unwrap();
    let nowhere = dir.path().join("nowhere");
    let task = nowhere.join("task.json");
    let [folder, task] = [&nowhere, &task].map(|path| path.to_str().unwrap());
    for (command, named) in [
        (&["return", "--task-file", task][..], "--task-file"),
        (&["model", "list", "--store", folder], "there is no model store at"),
        (&["model", "rollback", "--store", folder], "there is no model store at"),
    ] {
        let refused = firmware_host(command);
        let said = text(&refused.stderr);
        assert!(refused.status.code() == Some(1) && said.contains(named), "{command:?}: {said}");
        assert!(!nowhere.exists(), "{command:?}");
    }
}

/// Runs a command, reads nothing of what it prints, and returns its exit code and standard error.
fn with_closed_output(args: &[&str]) -> (Option<i32>, String) {
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let output = std::process::Command::new(assert_cmd::cargo::cargo_bin("firmware-host"))
        .args(args)
        .stdout(writer)
        .stderr(std::process::Stdio::piped())
        .output()
        .unwrap();
    (output.status.code(), text(&output.stderr))
}

#[test]
fn commands_whose_output_is_not_read_do_their_work_and_do_not_panic() {
    let dir = TempDir::new().unwrap();
    let (run, out) = explore(&dir, "run", &HOME);
    assert!(run.status.success());
    let status = dir.path().join("status.json");
    std::fs::write(&status, "{\"pid\": 1}").unwrap();
    let map = dir.path().join("home.map");
    let exported = dir.path().join("exported");
    let bug = dir.path().join("bug.mcap");
    let [out, status, map, exported, bug] =
        [&out, &status, &map, &exported, &bug].map(|path| path.to_str().unwrap());
    let commands: [(&[&str], i32); 11] = [
        (&["check"], 0),
        (&["health", "--json", "--status", status], 1),
        (&["health", "--status", status], 1),
        (&["health", "--watch", "--status", status], 0),
        (&["buffer", "list", out], 0),
        (&["buffer", "verify", out], 0),
        (&["replay", out], 0),
        (&["reproduce", out, "--at", "30", "--out", bug], 0),
        (&["map", "save", out, "--out", map], 0),
        (&["map", "show", map], 0),
        (&["map", "export", map, "--out", exported], 0),
    ];
    for (command, code) in commands {
        assert_eq!(with_closed_output(command), (Some(code), String::new()), "{command:?}");
    }
    assert!(dir.path().join("exported/map.pgm").exists());
}

#[test]
fn output_that_does_not_fit_on_the_disk_is_an_error() {
    let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    let check = std::process::Command::new(assert_cmd::cargo::cargo_bin("firmware-host"))
        .arg("check")
        .stdout(full)
        .stderr(std::process::Stdio::piped())
        .output()
        .unwrap();
    let said = text(&check.stderr);
    assert!(
        check.status.code() == Some(1) && said.contains("cannot write to standard output"),
        "{said}"
    );
}

#[test]
fn an_output_folder_that_is_a_file_or_holds_a_recording_is_refused() {
    let dir = TempDir::new().unwrap();
    std::fs::write(dir.path().join("file"), "mine").unwrap();
    let (onto_file, _) = explore(&dir, "file", &HOME);
    assert_eq!(onto_file.status.code(), Some(1));
    let said = text(&onto_file.stderr);
    assert!(said.ends_with("file is a file, not a folder; choose another folder\n"), "{said}");
    assert_eq!(std::fs::read_to_string(dir.path().join("file")).unwrap(), "mine");
    let (_, out) = explore(&dir, "run", &HOME);
    let before = std::fs::read(out.join("recording_0000.mcap")).unwrap();
    let (again, _) = explore(&dir, "run", &HOME);
    assert_eq!(again.status.code(), Some(1), "{}", text(&again.stderr));
    assert!(std::fs::read(out.join("recording_0000.mcap")).unwrap() == before);
}

#[test]
fn an_unknown_fault_is_refused_with_the_list_of_known_ones() {
    let dir = TempDir::new().unwrap();
    let (output, _) = explore(&dir, "none", &[&HOME[..], &["--fault", "lidar:explode"]].concat());
    assert_eq!(output.status.code(), Some(2));
    let error = text(&output.stderr);
    assert!(error.contains("`lidar` has no fault `explode`; it has delay, drop"), "{error}");
}
