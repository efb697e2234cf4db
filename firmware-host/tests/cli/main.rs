//! Runs the binary as a user does, and checks its outputs, files and exit codes.
#![allow(clippy::unwrap_used, reason = "a test that cannot set up its scene has failed")]

mod init;
mod recordings;
mod refusals;

use std::path::{Path, PathBuf};
use std::process::Output;

use assert_cmd::Command;
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
fn every_second_stretch_of_a_dump_is_dense_depth_of_a_robot_that_has_just_started() {
    let dir = TempDir::new().unwrap();
    let (_, run) =
        explore(&dir, "run", &[&HOME[..], &["--depth", "truth", "--policy", "forward"]].concat());
    let out = |name: &str| dir.path().join(name);
    for (name, more) in [("whole", &[][..]), ("restarts", &["--restart-every", "10"][..])] {
        let folder = out(name);
        let dump = folder.join("dump");
        let [run, folder, dump] = [&run, &folder, &dump].map(|path| path.to_str().unwrap());
        let perceive = ["perceive", "--recording", run, "--out", folder, "--dump", dump];
        assert!(firmware_host(&[&perceive[..], more].concat()).status.success());
    }
    let read = |name: &str, file: &str| std::fs::read(out(name).join("dump").join(file)).ok();
    assert!((0..60).all(|frame| read("restarts", &format!("{frame:06}_dense.npy")).is_some()));
    let is_same = |file: &str| read("whole", file) == read("restarts", file);
    for frame in 0..60 {
        assert!(is_same(&format!("{frame:06}.npy")), "coarse depth {frame}");
        let has_memory = (frame / 10) % 2 == 0;
        let dense = format!("{frame:06}_dense.npy");
        assert!(is_same(&dense) || !has_memory, "dense depth {frame}");
        assert!(!is_same(&dense) || has_memory || frame < 20, "dense depth {frame}");
    }
    for first in ["000030_dense.npy", "000050_dense.npy"] {
        assert!(confidence(&read("restarts", first)) < confidence(&read("whole", first)));
    }
}

/// Mean of the second plane of a dumped depth of 64x160 pixels.
fn confidence(file: &Option<Vec<u8>>) -> f64 {
    let file = file.as_ref().unwrap();
    let plane = &file[file.len() - 2 * 64 * 160..];
    let values = plane.chunks_exact(2).map(|two| f64::from(u16::from_le_bytes([two[0], two[1]])));
    values.sum::<f64>() / (64.0 * 160.0)
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
        [("firmware-host camera", "camera-latency"), ("firmware-host run --keep-o", "--keep-out")]
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
