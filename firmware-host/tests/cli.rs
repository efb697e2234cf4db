//! Runs the binary as a user does, and checks its outputs, files and exit codes.
#![allow(clippy::unwrap_used, reason = "a test that cannot set up its scene has failed")]

use std::path::{Path, PathBuf};
use std::process::Output;

use assert_cmd::Command;
use firmware_host::replay::rewrite;
use hal::Clock;
use tempfile::TempDir;

const SMALL: &str = "[camera]\nwidth = 160\nheight = 64\n";

fn firmware_host(args: &[&str]) -> Output {
    Command::cargo_bin("firmware-host").unwrap().args(args).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Explores for 60 frames with a small camera and writes into `dir/NAME`.
fn explore(dir: &TempDir, name: &str, more: &[&str]) -> (Output, PathBuf) {
    explore_for(dir, "60", SMALL, name, more)
}

/// Explores for some frames with this configuration and writes into `dir/NAME`.
fn explore_for(
    dir: &TempDir,
    frames: &str,
    config: &str,
    name: &str,
    more: &[&str],
) -> (Output, PathBuf) {
    let file = dir.path().join("robot.toml");
    std::fs::write(&file, config).unwrap();
    let out = dir.path().join(name);
    let mut args =
        vec!["explore", "--frames", frames, "--seed", "5", "--config", file.to_str().unwrap()];
    args.extend(["--out", out.to_str().unwrap()]);
    args.extend(more);
    (firmware_host(&args), out)
}

const HOME: [&str; 2] = ["--scene", "builtin:apartment?seed=1"];

fn summary(out: &Path) -> serde_json::Value {
    serde_json::from_slice(&std::fs::read(out.join("summary.json")).unwrap()).unwrap()
}

fn first_segment(out: &Path) -> Vec<u8> {
    std::fs::read(out.join("recording_0000.mcap")).unwrap()
}

#[test]
fn the_same_seed_gives_the_same_decisions_and_the_same_recording_byte_for_byte() {
    let dir = TempDir::new().unwrap();
    let (first, a) = explore(&dir, "a", &HOME);
    let (_, b) = explore(&dir, "b", &HOME);
    assert!(first.status.success(), "{}", text(&first.stderr));
    let one = summary(&a);
    let two = summary(&b);
    for key in [
        "frames",
        "digest",
        "recording_digest",
        "coverage",
        "path_m",
        "goals",
        "accuracy",
        "end_reason",
    ] {
        assert_eq!(one[key], two[key], "{key}");
    }
    assert!(first_segment(&a) == first_segment(&b));
    for file in ["map.png", "depth.png"] {
        assert!(std::fs::metadata(a.join(file)).unwrap().len() > 1000, "{file}");
    }
}

#[test]
fn a_replay_repeats_every_decision_and_detects_one_changed_input() {
    let dir = TempDir::new().unwrap();
    let (run, out) = explore(&dir, "run", &HOME);
    assert!(run.status.success(), "{}", text(&run.stderr));
    let replay = firmware_host(&["replay", out.to_str().unwrap()]);
    assert!(
        text(&replay.stdout).trim_end().ends_with("replay: ticks=60 mismatches=0"),
        "{}",
        text(&replay.stdout)
    );
    assert!(replay.status.success());

    let flipped = dir.path().join("flipped");
    std::fs::create_dir(&flipped).unwrap();
    rewrite(&out, &flipped, |tick| {
        if tick.tick == 30 {
            tick.wheel.odom.x_m += 1e-6;
        }
    })
    .unwrap();
    let replay = firmware_host(&["replay", flipped.to_str().unwrap()]);
    assert!(!replay.status.success());
    let said = text(&replay.stdout);
    assert!(
        said.contains("replay: ticks=60 mismatches=") && !said.contains("mismatches=0"),
        "{said}"
    );
}

#[test]
fn a_truncated_recording_is_replayed_up_to_the_damage_and_fails() {
    let dir = TempDir::new().unwrap();
    let (_, out) = explore(&dir, "run", &HOME);
    let file = out.join("recording_0000.mcap");
    let bytes = std::fs::read(&file).unwrap();
    std::fs::write(&file, &bytes[..bytes.len() * 2 / 3]).unwrap();
    let replay = firmware_host(&["replay", file.to_str().unwrap()]);
    assert_eq!(replay.status.code(), Some(1));
    let said = text(&replay.stdout) + &text(&replay.stderr);
    assert!(said.contains("recording_0000.mcap") && said.contains("mismatches=0"), "{said}");
}

#[test]
fn a_truncated_segment_is_reported_and_recovered_unless_a_process_is_still_writing_it() {
    let dir = TempDir::new().unwrap();
    let (_, run) = explore(&dir, "run", &HOME);
    let file = run.join("recording_0000.mcap");
    let bytes = std::fs::read(&file).unwrap();
    std::fs::write(&file, &bytes[..bytes.len() * 2 / 3]).unwrap();
    let whole = dir.path().join("whole");
    let [run, out] = [&run, &whole].map(|path| path.to_str().unwrap());
    let cut = firmware_host(&["buffer", "verify", run]);
    assert!(
        cut.status.code() == Some(1) && text(&cut.stdout).contains("cut: complete up to"),
        "{}",
        text(&cut.stdout)
    );

    // A recorder holds this lock while it writes.
    let held = std::fs::File::open(&file).unwrap();
    held.lock().unwrap();
    let open = firmware_host(&["buffer", "verify", run]);
    assert!(
        open.status.success() && text(&open.stdout).contains("still being written"),
        "{}",
        text(&open.stdout)
    );
    drop(held);

    let recover = firmware_host(&["buffer", "recover", run, "--out", out]);
    assert!(
        recover.status.success() && text(&recover.stdout).contains("1 recovered"),
        "{}",
        text(&recover.stdout)
    );
    assert!(firmware_host(&["buffer", "verify", out]).status.success());
    assert!(firmware_host(&["replay", out]).status.success());
}

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
fn ground_truth_depth_is_stamped_into_the_summary_and_replays_too() {
    let dir = TempDir::new().unwrap();
    let (_, out) =
        explore(&dir, "run", &[&HOME[..], &["--depth", "truth", "--policy", "frontier"]].concat());
    assert_eq!(summary(&out)["depth_source"], "truth");
    assert!(firmware_host(&["replay", out.to_str().unwrap()]).status.success());
}

/// Runs `perceive` on a recording, checks that coarse depth is plausible, and returns the dump's
/// index.
fn perceive_with_dump(run: &Path, out: &Path) -> serde_json::Value {
    let dump = out.join("coarse");
    let [run, folder, dump_folder] = [run, out, &dump].map(|path| path.to_str().unwrap());
    let output =
        firmware_host(&["perceive", "--recording", run, "--out", folder, "--dump", dump_folder]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(summary(out)["accuracy"]["coarse"]["all"]["delta1_unscaled"].as_f64().unwrap() > 0.5);
    serde_json::from_slice(&std::fs::read(dump.join("dump.json")).unwrap()).unwrap()
}

#[test]
fn perceive_dumps_the_coarse_depth_of_a_run_even_of_a_truncated_one() {
    let dir = TempDir::new().unwrap();
    let (_, run) =
        explore(&dir, "run", &[&HOME[..], &["--depth", "truth", "--policy", "forward"]].concat());
    let whole = perceive_with_dump(&run, &dir.path().join("whole"));
    let frames = whole["frames"].as_array().unwrap();
    assert_eq!((frames.len(), &whole["width"]), (60, &serde_json::json!(160)));
    assert_eq!((&frames[0]["coarse"], &frames[59]["coarse"]), (&false.into(), &true.into()));
    let planes = std::fs::read(dir.path().join("whole/coarse/000059.npy")).unwrap();
    assert_eq!(planes.len() % 64, 2 * 2 * 64 * 160 % 64);

    let file = run.join("recording_0000.mcap");
    let bytes = std::fs::read(&file).unwrap();
    std::fs::write(&file, &bytes[..bytes.len() * 2 / 3]).unwrap();
    let part =
        perceive_with_dump(&run, &dir.path().join("part"))["frames"].as_array().unwrap().clone();
    assert!((10..60).contains(&part.len()), "{}", part.len());
    assert_eq!(part[..], frames[..part.len()]);
}

#[test]
fn perceive_computes_the_same_dense_depth_of_a_recording_as_the_robot_had() {
    let dir = TempDir::new().unwrap();
    let robots = dir.path().join("robot");
    // Without localization the whole map is one section, as it is for `perceive`.
    let config = dir.path().join("wheels.toml");
    std::fs::write(&config, format!("{SMALL}[localization]\nsource = \"wheels\"\n")).unwrap();
    let run = dir.path().join("run");
    let [config, out, dump] = [&config, &run, &robots].map(|path| path.to_str().unwrap());
    let drive =
        ["explore", "--frames", "60", "--seed", "5", "--depth", "truth", "--policy", "forward"];
    let to = ["--config", config, "--out", out, "--dump", dump];
    assert!(firmware_host(&[&drive[..], &HOME, &to].concat()).status.success());
    perceive_with_dump(&run, &dir.path().join("whole"));
    for frame in 30..60 {
        let name = format!("{frame:06}_dense.npy");
        let of_robot = std::fs::read(robots.join(&name)).unwrap();
        let of_recording = std::fs::read(dir.path().join("whole/coarse").join(&name)).unwrap();
        assert!(of_robot == of_recording, "{name}");
    }
}

#[test]
fn onnx_runtime_sends_no_telemetry() {
    let dir = TempDir::new().unwrap();
    let home = dir.path().join("home");
    let model = dir.path().join("model.onnx");
    let config = dir.path().join("robot.toml");
    std::fs::create_dir(&home).unwrap();
    std::fs::write(&model, small_model()).unwrap();
    std::fs::write(&config, SMALL).unwrap();
    let mut explore = Command::cargo_bin("firmware-host").unwrap();
    explore
        .arg("explore")
        .args(HOME)
        .args(["--frames", "3", "--model"])
        .arg(model)
        .arg("--config")
        .arg(config);
    // With any of these variables ONNX Runtime disables its telemetry itself.
    for variable in ["ORT_DISABLE_TELEMETRY", "CI", "ORT_RUNNING_UNIT_TESTS", "XDG_CACHE_HOME"] {
        explore.env_remove(variable);
    }
    explore.env("HOME", &home).arg("--out").arg(dir.path().join("run")).assert().success();
    // Telemetry would first be stored in a file below ~/.cache.
    assert_eq!(std::fs::read_dir(&home).unwrap().count(), 0);
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
fn the_printed_defaults_are_a_valid_configuration() {
    let dir = TempDir::new().unwrap();
    let printed = firmware_host(&["check"]);
    assert!(printed.status.success());
    let config = dir.path().join("robot.toml");
    // The endpoints of the robot's own motors are the only values that have no default.
    let mut endpoints = 0;
    let completed: Vec<String> = text(&printed.stdout)
        .lines()
        .map(|line| {
            let is_endpoint = line.ends_with("_endpoint = 0");
            endpoints += u32::from(is_endpoint);
            if is_endpoint { line.replace("= 0", "= 195") } else { line.to_owned() }
        })
        .collect();
    assert_eq!(endpoints, 2);
    std::fs::write(&config, completed.join("\n")).unwrap();
    assert!(firmware_host(&["check", "--config", config.to_str().unwrap()]).status.success());
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
fn completions_and_man_pages_name_every_command() {
    let dir = TempDir::new().unwrap();
    for shell in ["bash", "zsh", "fish"] {
        let script = firmware_host(&["completions", shell]);
        let script = text(&script.stdout);
        assert!(script.contains("camera-latency") && script.contains("model-store"), "{shell}");
    }
    let pages = dir.path().join("man1");
    let made = firmware_host(&["man-pages", pages.to_str().unwrap()]);
    assert!(made.status.success(), "{}", text(&made.stderr));
    let run = std::fs::read_to_string(pages.join("firmware-host-run.1")).unwrap();
    assert!(run.contains("SIGTERM"), "{run}");
    assert!(std::fs::read_to_string(pages.join("firmware-host.1")).unwrap().contains("RUST_LOG"));
}

#[test]
fn bash_completes_commands_and_the_options_of_a_command() {
    let script = firmware_host(&["completions", "bash"]).stdout;
    // The words of the line, and the words that complete the last one.
    for (line, expected) in
        [("firmware-host camera", "camera-latency"), ("firmware-host run --keep", "--keep-out")]
    {
        let words: Vec<&str> = line.split(' ').collect();
        let ask = format!(
            "{}\nCOMP_WORDS=({line}); COMP_CWORD={}\n$(complete -p firmware-host | sed 's/.*-F \\([^ ]*\\).*/\\1/') \
             firmware-host {} {}\necho \"${{COMPREPLY[@]}}\"",
            text(&script),
            words.len() - 1,
            words[words.len() - 1],
            words[words.len() - 2],
        );
        let bash = std::process::Command::new("bash").args(["-c", &ask]).output().unwrap();
        assert_eq!(text(&bash.stdout).trim(), expected, "{line}: {}", text(&bash.stderr));
    }
}

#[test]
fn quiet_exploration_shows_no_progress_and_still_its_summary() {
    let dir = TempDir::new().unwrap();
    let (shown, _) = explore(&dir, "shown", &HOME);
    assert!(text(&shown.stderr).contains("60/60 frames"), "{}", text(&shown.stderr));
    let (quiet, _) = explore(&dir, "quiet", &[&HOME[..], &["--quiet"]].concat());
    assert_eq!(text(&quiet.stderr), "");
    assert!(text(&quiet.stdout).contains("coverage"), "{}", text(&quiet.stdout));
}

#[test]
#[cfg(not(feature = "lerobot"))]
fn a_build_without_lerobot_says_which_build_has_it() {
    let dir = TempDir::new().unwrap();
    let (_, run) = explore(&dir, "run", &HOME);
    let out = dir.path().join("dataset");
    let [run, out] = [&run, &out].map(|path| path.to_str().unwrap());
    let refused = firmware_host(&["buffer", "export", run, "--as", "lerobot", "--out", out]);
    let said = text(&refused.stderr);
    assert!(refused.status.code() == Some(1) && said.contains("--features lerobot"), "{said}");
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
fn commands_whose_output_nobody_reads_do_their_work_and_do_not_panic() {
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
fn explore_that_is_ended_by_a_signal_writes_its_summary() {
    use rustix::process::{Pid, Signal, kill_process};
    for signal in [Signal::INT, Signal::TERM, Signal::HUP] {
        let dir = TempDir::new().unwrap();
        let config = dir.path().join("robot.toml");
        std::fs::write(&config, SMALL).unwrap();
        let out = dir.path().join("run");
        let mut run = std::process::Command::new(assert_cmd::cargo::cargo_bin("firmware-host"))
            .args(["explore", "--frames", "100000", "--config", config.to_str().unwrap()])
            .args(HOME)
            .args(["--out", out.to_str().unwrap()])
            .stdout(std::process::Stdio::null())
            .stderr(std::process::Stdio::null())
            .spawn()
            .unwrap();
        while !out.join("recording_0000.mcap").exists() {
            std::thread::yield_now();
        }
        let mut clock = monotonic_clock::MonotonicClock;
        let then_ns = clock.now_ns() + 500_000_000;
        clock.sleep_until_ns(then_ns);
        kill_process(Pid::from_raw(run.id() as i32).unwrap(), signal).unwrap();
        assert!(run.wait().unwrap().success(), "{signal:?}");
        assert_eq!(summary(&out)["end_reason"], "interrupted", "{signal:?}");
    }
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

/// Explores with a policy, then measures the camera's latency in the recording.
fn camera_latency(dir: &TempDir, policy: &str, frames: &str, odometry: &str) -> Output {
    let out = dir.path().join(format!("{policy}-{odometry}"));
    let out = out.to_str().unwrap();
    let run = ["--scene", "builtin:house", "--policy", policy, "--frames", frames];
    let run = [&run[..], &["--odometry", odometry, "--out", out]].concat();
    assert!(firmware_host(&[&["explore"][..], &run].concat()).status.success());
    firmware_host(&["camera-latency", out])
}

#[test]
fn the_latency_of_a_simulated_camera_is_measured_and_a_run_without_rotation_is_refused() {
    let dir = TempDir::new().unwrap();
    let found = camera_latency(&dir, "random", "250", "realistic");
    let said = text(&found.stdout);
    let found_ms = said.split(' ').find_map(|word| word.parse::<f64>().ok());
    // The seed draws it from half of 20 ms to one and a half times that.
    assert!(found_ms.is_some_and(|found_ms| (9.0..31.0).contains(&found_ms)), "{said}");
    let found = camera_latency(&dir, "random", "250", "perfect");
    let said = text(&found.stdout);
    assert!(
        said.ends_with("The configuration already has this value.\n"),
        "{said}{}",
        text(&found.stderr)
    );
    let found_ms = said.split(' ').find_map(|word| word.parse::<f64>().ok());
    assert!(found_ms.is_some_and(|found_ms| found_ms < 3.0), "{said}");
    let refused = camera_latency(&dir, "forward", "20", "perfect");
    assert_eq!(refused.status.code(), Some(1));
    assert!(
        text(&refused.stderr).contains("record a minute in which it rotates left and right"),
        "{}",
        text(&refused.stderr)
    );
}

/// The same run as that of [`explore`], with networks handed over before ticks 20 and 40.
fn explore_with_hand_over(dir: &TempDir, name: &str, more: &[&str]) -> (Output, PathBuf) {
    let models = dir.path().join("models");
    let hand_over = ["--hand-over", models.to_str().unwrap(), "--first", "20", "--every", "20"];
    explore(dir, name, &[&HOME[..], &hand_over, more].concat())
}

/// A network for 160x64 images that outputs the mean of each pixel's colours.
fn small_model() -> Vec<u8> {
    std::fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/../runtime/tests/models/any_size.onnx"))
        .unwrap()
}

/// The request for network `k`, once the run has written it.
fn round(models: &Path, k: u32) -> Option<serde_json::Value> {
    let request = std::fs::read(models.join(format!("round_000{k}.json"))).ok()?;
    serde_json::from_slice(&request).ok()
}

#[test]
#[expect(clippy::disallowed_methods, reason = "waits for another process")]
fn a_run_waits_for_its_networks_and_a_second_run_with_the_same_ones_is_identical() {
    let dir = TempDir::new().unwrap();
    let models = dir.path().join("models");
    std::fs::create_dir(&models).unwrap();
    std::thread::scope(|scope| {
        let run = scope.spawn(|| {
            explore_with_hand_over(
                &dir,
                "a",
                &["--dump", dir.path().join("dump").to_str().unwrap()],
            )
        });
        for k in 0..2 {
            while round(&models, k).is_none() && !run.is_finished() {
                std::thread::sleep(std::time::Duration::from_millis(5));
            }
            let request = round(&models, k).expect("the run ended without requesting a network");
            assert_eq!(request["frames"], 20 * (k + 1));
            // The segments named in the request are complete, although the run continues.
            let segment = dir.path().join(format!("a/recording_000{k}.mcap"));
            assert!(std::fs::read(segment).unwrap().ends_with(b"\x89MCAP0\r\n"));
            let index = std::fs::read(dir.path().join("dump/dump.json")).unwrap();
            let index: serde_json::Value = serde_json::from_slice(&index).unwrap();
            assert_eq!(index["frames"].as_array().unwrap().len(), 20 * (k as usize + 1));
            std::fs::write(models.join("partial"), small_model()).unwrap();
            std::fs::rename(models.join("partial"), models.join(format!("model_000{k}.onnx")))
                .unwrap();
        }
        let (output, _) = run.join().unwrap();
        assert!(output.status.success(), "{}", text(&output.stderr));
    });
    let (again, b) = explore_with_hand_over(&dir, "b", &[]);
    assert!(again.status.success(), "{}", text(&again.stderr));
    assert_eq!(summary(&dir.path().join("a"))["digest"], summary(&b)["digest"]);
    let request = round(&models, 1).unwrap();
    assert_eq!((&request["segments"], request["digest"].as_str().unwrap().len()), (&2.into(), 64));

    let b = b.to_str().unwrap();
    let exact = firmware_host(&["replay", b, "--hand-over", models.to_str().unwrap()]);
    assert!(
        text(&exact.stdout).contains("replay: ticks=60 mismatches=0"),
        "{}",
        text(&exact.stdout)
    );
    let without = firmware_host(&["replay", b]);
    assert!(
        !without.status.success() && text(&without.stderr).contains("--hand-over"),
        "{}",
        text(&without.stderr)
    );
}

/// Renders eight test views into `out`; returns the frames of the index.
fn render_views(config: &Path, out: &Path, seed: &str) -> Vec<serde_json::Value> {
    let [config, folder] = [config, out].map(|path| path.to_str().unwrap());
    let views = ["views", "--count", "8", "--seed", seed, "--config", config, "--out", folder];
    let output = firmware_host(&[&views[..], &HOME].concat());
    assert!(output.status.success(), "{}", text(&output.stderr));
    let index: serde_json::Value =
        serde_json::from_slice(&std::fs::read(out.join("dump.json")).unwrap()).unwrap();
    index["frames"].as_array().unwrap().clone()
}

#[test]
fn test_views_contain_images_truth_coarse_depth_and_the_approach() {
    let dir = TempDir::new().unwrap();
    let config = dir.path().join("robot.toml");
    std::fs::write(&config, SMALL).unwrap();
    let a = dir.path().join("a");
    let frames = render_views(&config, &a, "1");
    // Each view comes after eight images from the path to it.
    assert_eq!(frames.len(), 8 * 9);
    let mut rotated = Vec::new();
    for (index, frame) in frames.iter().enumerate() {
        let is_view = index % 9 == 8;
        let driven = frame["approach"] == "drive";
        assert_eq!((&frame["view"], &frame["rgb"]), (&(index / 9).into(), &true.into()));
        // Rotation alone gives no parallax, so there is no coarse depth.
        assert_eq!(
            (&frame["truth"], &frame["coarse"]),
            (&is_view.into(), &(is_view && driven).into())
        );
        rotated.extend(is_view.then_some(!driven));
    }
    assert_eq!(rotated, [false, false, false, true, false, false, false, true]);
    assert_eq!(render_views(&config, &dir.path().join("b"), "1"), frames);
    assert_ne!(render_views(&config, &dir.path().join("c"), "2"), frames);
    // The last frames of the first view and of the fourth, which was reached by rotation.
    assert!(
        a.join("000008.npy").exists()
            && a.join("000035_rgb.npy").exists()
            && !a.join("000035.npy").exists()
    );
}

#[test]
fn a_run_with_injected_faults_lists_them_and_its_recording_replays_without_injection() {
    let dir = TempDir::new().unwrap();
    let faults = [
        "--fault",
        "lidar:stall@2..3",
        "--fault",
        "camera:reorder=0.5@1..4",
        "--fault",
        "base:drop=0.3",
    ];
    let more = [&HOME[..], &faults, &["--fault", "random", "--fault-seed", "2"]].concat();
    let (output, out) = explore(&dir, "broken", &more);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let (_, out_without) = explore(&dir, "well", &HOME);
    let broken = summary(&out);
    let well = summary(&out_without);
    assert_eq!(
        (&broken["faults"][0], &broken["fault_seed"]),
        (&"lidar:stall@2..3".into(), &2.into())
    );
    assert!(broken["faults"].as_array().unwrap().len() > 3, "{}", broken["faults"]);
    assert_ne!(broken["digest"], well["digest"]);
    assert!(well.get("faults").is_none());
    let replayed = firmware_host(&["replay", out.to_str().unwrap()]);
    assert!(text(&replayed.stdout).contains("mismatches=0"), "{}", text(&replayed.stdout));
    assert!(replayed.status.success());
}

#[test]
fn an_injected_full_disk_ends_the_run_with_a_summary_and_a_readable_recording() {
    let dir = TempDir::new().unwrap();
    let (run, out) = explore(
        &dir,
        "full",
        &[&HOME[..], &["--fault", "disk:full@2..", "--fault", "disk:slow=1"]].concat(),
    );
    assert_eq!(summary(&out)["end_reason"], "output_failed");
    let said = text(&run.stderr);
    assert!(run.status.code() == Some(1) && said.contains("not recorded to its end"), "{said}");
    let replayed = firmware_host(&["replay", out.to_str().unwrap()]);
    assert!(text(&replayed.stdout).contains("mismatches=0"), "{}", text(&replayed.stdout));
}

#[test]
fn an_unknown_fault_is_refused_with_the_list_of_known_ones() {
    let dir = TempDir::new().unwrap();
    let (output, _) = explore(&dir, "none", &[&HOME[..], &["--fault", "lidar:explode"]].concat());
    assert_eq!(output.status.code(), Some(2));
    let error = text(&output.stderr);
    assert!(error.contains("`lidar` has no fault `explode`; it has delay, drop"), "{error}");
}

/// Segments of two seconds, so that a short run has several.
const SHORT_SEGMENTS: &str = "[camera]\nwidth = 160\nheight = 64\n[recording]\nsegment_s = 2.0\n";

/// Replays a run, which must be exact; returns the output.
fn replayed(run: &Path, more: &[&str]) -> String {
    let replay = firmware_host(&[&["replay", run.to_str().unwrap()], more].concat());
    assert!(replay.status.success(), "{}", text(&replay.stdout));
    text(&replay.stdout)
}

#[test]
fn a_replay_starts_at_a_given_time_and_works_without_the_first_segments() {
    let dir = TempDir::new().unwrap();
    let config = dir.path().join("short.toml");
    std::fs::write(&config, SHORT_SEGMENTS).unwrap();
    let out = dir.path().join("run");
    let arguments = [
        "explore",
        "--frames",
        "90",
        "--config",
        config.to_str().unwrap(),
        "--out",
        out.to_str().unwrap(),
    ];
    let run = firmware_host(&[&arguments[..], &HOME].concat());
    assert!(run.status.success(), "{}", text(&run.stderr));
    let said = replayed(&out, &["--from", "4.5s"]);
    assert!(said.contains(" 40 at 4.100 s\nreplay: ticks=50 mismatches=0\n"), "{said}");
    for command in [
        &["replay", out.to_str().unwrap(), "--from", "90"][..],
        &["reproduce", out.to_str().unwrap(), "--at", "9s"],
    ] {
        let bug = dir.path().join("bug.mcap");
        let more =
            if command[0] == "replay" { vec![] } else { vec!["--out", bug.to_str().unwrap()] };
        let beyond = firmware_host(&[command, &more].concat());
        let said = text(&beyond.stderr);
        assert!(beyond.status.code() == Some(1) && said.contains(" is 89"), "{said}");
    }
    std::fs::remove_file(out.join("recording_0000.mcap")).unwrap();
    let said = replayed(&out, &[]);
    assert!(said.contains(" 20 at 2.100 s\nreplay: ticks=70 mismatches=0\n"), "{said}");
}

#[test]
fn the_seconds_around_a_moment_become_a_file_that_replays_alone() {
    let dir = TempDir::new().unwrap();
    let (run, out) = explore(&dir, "run", &HOME);
    assert!(run.status.success(), "{}", text(&run.stderr));
    let file = dir.path().join("bug.mcap");
    let arguments =
        ["reproduce", out.to_str().unwrap(), "--at", "30", "--before", "1", "--after", "0.5"];
    let arguments = [&arguments[..], &["--out", file.to_str().unwrap()]].concat();
    let made = firmware_host(&arguments);
    let said = text(&made.stdout);
    assert!(
        made.status.success()
            && said.contains("16 ticks")
            && said.contains("ticks=16 mismatches=0"),
        "{said}"
    );
    let replay = firmware_host(&["replay", file.to_str().unwrap()]);
    assert!(replay.status.success(), "{}", text(&replay.stdout));
    let again = firmware_host(&arguments);
    assert!(
        !again.status.success() && text(&again.stderr).contains("already exists"),
        "{}",
        text(&again.stderr)
    );
}

/// Runs `reproduce RUN --at MOMENT --out OUT`. Returns whether it succeeded, and all that it said.
fn reproduce(run: &Path, moment: &str, out: &Path) -> (bool, String) {
    let [run, out] = [run, out].map(|path| path.to_str().unwrap());
    let made = firmware_host(&["reproduce", run, "--at", moment, "--out", out]);
    (made.status.success(), text(&made.stdout) + &text(&made.stderr))
}

#[test]
fn a_moment_after_missing_ticks_is_reproduced_from_the_next_snapshot_and_a_missing_one_is_refused()
{
    let dir = TempDir::new().unwrap();
    let (_, run) = explore_for(&dir, "70", SHORT_SEGMENTS, "run", &HOME);
    let second = run.join("recording_0001.mcap");
    let missing = "recording_0001.mcap is missing";
    let damage: [(&str, &dyn Fn(), &str); 2] = [
        ("missing", &|| std::fs::remove_file(&second).unwrap(), missing),
        ("corrupt", &|| std::fs::write(&second, "no recording").unwrap(), "recording_0001.mcap: "),
    ];
    for (name, damage, words) in damage {
        damage();
        let bug = dir.path().join(format!("{name}.mcap"));
        let (made, said) = reproduce(&run, "45", &bug);
        for part in [words, ": the file begins at tick 40", "26 ticks", "ticks=26 mismatches=0"] {
            assert!(made && said.contains(part), "{name}: {part}: {said}");
        }
        let other = dir.path().join(format!("{name}-25.mcap"));
        let (made, said) = reproduce(&run, "25", &other);
        let refused = "tick 25 cannot be reproduced: ";
        assert!(!made && said.contains(refused) && said.contains(words), "{name}: {said}");
        assert!(!other.exists());
    }
}

#[test]
fn a_moment_is_refused_if_no_snapshot_lies_between_it_and_missing_ticks() {
    let dir = TempDir::new().unwrap();
    let (_, run) = explore_for(&dir, "20", SMALL, "run", &HOME);
    let holed = dir.path().join("holed");
    std::fs::create_dir(&holed).unwrap();
    rewrite(&run, &holed, |tick| tick.tick += if tick.tick < 10 { 0 } else { 5 }).unwrap();
    let missing = "ticks 10 to 14 are missing (recording_0000.mcap)";
    for (moment, words) in [
        ("18", format!("{missing}, and no snapshot lies between that and tick 18; choose an ")),
        ("12", format!("{missing}; choose an --at from tick 15 on")),
    ] {
        let bug = dir.path().join("bug.mcap");
        let (made, said) = reproduce(&holed, moment, &bug);
        let refused = format!("tick {moment} cannot be reproduced: {words}");
        assert!(!made && said.contains(&refused), "{said}");
        assert!(!bug.exists());
    }
    let (made, said) = reproduce(&holed, "5", &dir.path().join("before.mcap"));
    assert!(made && said.contains("ticks=10 mismatches=0"), "{said}");
}

#[test]
fn reproduce_names_damage_that_may_hold_a_stop_and_a_file_that_does_not_fit_on_the_disk() {
    let dir = TempDir::new().unwrap();
    let (_, run) = explore_for(&dir, "60", SMALL, "run", &HOME);
    let bug = dir.path().join("bug.mcap");
    // What is left of another process, or of a person, stays and is in nobody's way.
    let left = dir.path().join("bug.mcap.part");
    std::fs::write(&left, "mine").unwrap();
    let names = || {
        let entries = std::fs::read_dir(dir.path()).unwrap();
        let mut names: Vec<_> = entries.map(|entry| entry.unwrap().file_name()).collect();
        names.sort();
        names
    };
    let before = names();
    // A limit of the file size stands for a full disk.
    let limited = "trap '' XFSZ; ulimit -f 1; exec \"$0\" \"$@\"";
    let full = std::process::Command::new("bash")
        .args(["-c", limited, assert_cmd::cargo::cargo_bin("firmware-host").to_str().unwrap()])
        .arg("reproduce")
        .arg(&run)
        .args(["--at", "30", "--out"])
        .arg(&bug)
        .output()
        .unwrap();
    let said = text(&full.stderr);
    assert!(
        full.status.code() == Some(1)
            && said.contains("bug.mcap: File too large")
            && said.contains("; free disk space or choose another --out"),
        "{said}"
    );
    assert_eq!(names(), before);

    let file = run.join("recording_0000.mcap");
    let bytes = std::fs::read(&file).unwrap();
    std::fs::write(&file, &bytes[..bytes.len() * 2 / 3]).unwrap();
    let arguments = ["reproduce", run.to_str().unwrap(), "--out", bug.to_str().unwrap()];
    let damaged = text(&firmware_host(&arguments).stderr);
    assert!(
        damaged.contains("no stop in what can be read; recording_0000.mcap is damaged after tick "),
        "{damaged}"
    );
    let (made, said) = reproduce(&run, "5", &bug);
    assert!(made && bug.exists(), "{said}");
    assert_eq!(std::fs::read_to_string(&left).unwrap(), "mine");
    assert_eq!(names().len(), before.len() + 1);
}

/// The environment variable `KILLS` sets the number of kills.
#[test]
fn killed_at_any_moment_the_recording_is_good_as_far_as_it_goes() {
    let kills = hil::kills::kill_count();
    let dir = TempDir::new().unwrap();
    let config = dir.path().join("short.toml");
    std::fs::write(&config, SHORT_SEGMENTS).unwrap();
    let mut replayed = 0;
    for kill in 0..kills {
        let out = dir.path().join(kill.to_string());
        let mut run = std::process::Command::new(assert_cmd::cargo::cargo_bin("firmware-host"))
            .args(["explore", "--frames", "100000", "--config", config.to_str().unwrap()])
            .args(["--scene", "builtin:apartment?seed=1", "--out", out.to_str().unwrap()])
            .stdout(std::process::Stdio::null())
            .stderr(std::process::Stdio::null())
            .spawn()
            .unwrap();
        // Waits until the second segment exists, then for a time that differs in each kill (97 is
        // prime).
        while !out.join("recording_0001.mcap").exists() {
            std::thread::yield_now();
        }
        let mut clock = monotonic_clock::MonotonicClock;
        let then_ns = clock.now_ns() + kill % 97 * 13_000_000;
        clock.sleep_until_ns(then_ns);
        run.kill().unwrap();
        run.wait().unwrap();
        let replay = firmware_host(&["replay", out.to_str().unwrap()]);
        let said = text(&replay.stdout);
        assert!(said.trim_end().ends_with("mismatches=0"), "kill {kill}: {said}");
        let problem = said.lines().find(|line| line.starts_with("warning: "));
        assert!(problem.is_none_or(|line| line.contains("truncated")), "kill {kill}: {said}");
        replayed += said.matches("ticks=").count();
        std::fs::remove_dir_all(out).unwrap();
    }
    assert_eq!(replayed as u64, kills);
}
