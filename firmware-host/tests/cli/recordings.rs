//! Recordings of runs: they are replayed, cut, damaged and killed.

use firmware_host::replay::rewrite;

use super::*;

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
fn a_moment_is_reproduced_although_the_first_segment_cannot_be_read() {
    let dir = TempDir::new().unwrap();
    let (_, run) = explore_for(&dir, "70", SHORT_SEGMENTS, "run", &HOME);
    std::fs::write(run.join("recording_0000.mcap"), "no recording").unwrap();
    let bug = dir.path().join("bug.mcap");
    let (made, said) = reproduce(&run, "45", &bug);
    assert!(made && said.contains(" mismatches=0"), "{said}");
    let (made, said) = reproduce(&run, "5", &dir.path().join("lost.mcap"));
    assert!(!made && said.contains("recording_0000.mcap"), "{said}");
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
    // Files of another process, or of a person, stay, and the command does not need their names.
    let left = dir.path().join("bug.mcap.part");
    std::fs::write(&left, "mine").unwrap();
    let before = names_in(dir.path());
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
    assert_eq!(names_in(dir.path()), before);

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
    assert_eq!(names_in(dir.path()).len(), before.len() + 1);
}

fn names_in(folder: &Path) -> Vec<std::ffi::OsString> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<_> = entries.map(|entry| entry.unwrap().file_name()).collect();
    names.sort();
    names
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
