//! Installs models as a user does: bad models are refused with a reason, better ones are accepted,
//! and models that misbehave are rolled back.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test that cannot set up its scene has failed"
)]

mod robot;

use std::path::Path;

use firmware_host::config::Config;
use firmware_host::model::{Keeper, Start, State, Swap, What};
use robot::{CONFIG, Robot, model_file, run};

#[test]
fn every_bad_model_is_refused_with_its_reason_and_none_is_accepted() {
    let robot = Robot::new();
    let guess = robot.has("guess");
    let cases: [(&str, &str, &[&str]); 6] = [
        ("wrong_shape", "network", &["80x32", "160x64"]),
        ("wrong_opset", "file", &["opset 9", "opset 17"]),
        ("external_data", "file", &["`bias`", "another file"]),
        ("no_golden_pair", "golden_pair", &["no golden pair"]),
        ("lying_golden_pair", "golden_pair", &["off by 0.05"]),
        // Without recordings the model cannot be shown to be as good as the current one.
        ("better", "judged", &["only 0 held-out frames"]),
    ];
    for (name, kind, words) in cases {
        let said = robot.install(&robot.signed(name), &[]);
        assert_eq!(
            (said["accepted"].as_bool(), said["kind"].as_str()),
            (Some(false), Some(kind)),
            "{name}: {said}"
        );
        let why = said["why"].as_str().unwrap();
        words.iter().for_each(|word| assert!(why.contains(word), "{name}: {why}"));
        assert_eq!(robot.state().current(), Some(&*guess), "{name}");
    }
    let history = robot.store().history();
    assert_eq!(history.entries.iter().filter(|entry| entry.what == What::Refused).count(), 6);
}

#[test]
fn a_model_that_is_slower_than_the_budget_is_refused_with_both_numbers() {
    let robot = Robot::with(&CONFIG.replace("max_p99_ms = 1000", "max_p99_ms = 20"));
    let said = robot.install(&robot.signed("slow"), &["--unproven"]);
    let why = said["why"].as_str().unwrap();
    assert!(
        said["kind"] == "judged" && why.contains("too slow") && why.contains("allowed: 20.0 ms"),
        "{why}"
    );
    assert_eq!(robot.state(), State::default());
}

#[test]
fn a_model_that_takes_all_memory_ends_its_own_process_and_nothing_else() {
    let robot = Robot::new();
    let said = robot.install(&robot.signed("huge_allocation"), &["--unproven"]);
    assert_eq!(said["accepted"], false);
    // Either ONNX Runtime reports the failed allocation, or the process is killed.
    assert!(["network", "died"].contains(&said["kind"].as_str().unwrap()), "{said}");
    assert_eq!(robot.state(), State::default());
}

#[test]
fn a_model_that_never_ends_is_killed_after_the_time_limit() {
    let robot = Robot::with(&CONFIG.replace("gate_timeout_s = 120", "gate_timeout_s = 5"));
    let said = robot.install(&robot.signed("endless_loop"), &["--unproven"]);
    assert_eq!(
        (said["accepted"].as_bool(), said["kind"].as_str()),
        (Some(false), Some("died")),
        "{said}"
    );
    let why = said["why"].as_str().unwrap();
    assert!(why.contains("grey image") && why.contains("5 s"), "{why}");
}

/// Installs a bundle, which must be refused because of its signature. Returns the reason.
fn refused_signature(robot: &Robot, bundle: &Path) -> String {
    let said = robot.install(bundle, &["--unproven"]);
    assert_eq!(
        (said["accepted"].as_bool(), said["kind"].as_str()),
        (Some(false), Some("signature")),
        "{said}"
    );
    said["why"].as_str().unwrap().to_owned()
}

#[test]
fn what_is_not_signed_by_a_trusted_key_is_not_even_read() {
    let robot = Robot::new();
    let stranger = Robot::new();
    let unsigned = robot.path("unsigned.onnx");
    std::fs::copy(model_file("guess"), &unsigned).unwrap();
    assert!(refused_signature(&robot, &unsigned).contains("not signed"));
    assert!(refused_signature(&robot, &stranger.signed("guess")).contains("not trusted"));
    // Change one character of the metadata.
    let path = robot.signed("guess");
    let bytes = std::fs::read(&path).unwrap();
    let at = bytes.windows(5).rposition(|window| window == b"guess").unwrap();
    let mut tampered = bytes.clone();
    tampered[at] = b'G';
    std::fs::write(&path, &tampered).unwrap();
    assert!(refused_signature(&robot, &path).contains("does not match"));
    for length in [0, 1, bytes.len() / 2, bytes.len() - 1] {
        std::fs::write(&path, &bytes[..length]).unwrap();
        assert!(refused_signature(&robot, &path).contains("does not match"), "{length}");
    }
    // A truncated model with a valid signature.
    let cut = robot.sign(&bytes[..bytes.len() - 40], "cut");
    let said = robot.install(&cut, &["--unproven"]);
    assert!(["file", "network", "golden_pair"].contains(&said["kind"].as_str().unwrap()), "{said}");
    assert_eq!(robot.state(), State::default());
}

#[test]
fn a_better_model_is_accepted_a_worse_one_and_one_with_nan_are_not() {
    let robot = Robot::new();
    let guess = robot.has("guess");
    let worse = robot.judged_by_recordings("worse");
    assert_eq!(
        (worse["accepted"].as_bool(), worse["kind"].as_str()),
        (Some(false), Some("judged")),
        "{worse}"
    );
    assert!(worse["why"].as_str().unwrap().contains("worse than the resident model"), "{worse}");
    let nan = robot.judged_by_recordings("nan_in_the_dark");
    assert!(nan["why"].as_str().unwrap().contains("NaN"), "{nan}");
    assert_eq!(robot.state().current(), Some(&*guess));
    let robot = Robot::new();
    let worse = robot.has("worse");
    let better = robot.judged_by_recordings("better");
    assert_eq!(better["accepted"], true, "{better}");
    let state = robot.state();
    assert_eq!(
        (state.models.len(), state.previous(), state.trial_starts),
        (2, Some(&*worse), Some(0))
    );
    // Now other models are compared with it.
    let mut store = robot.store();
    let current = state.current().unwrap().to_owned();
    store.keep(&current, "for the test").unwrap();
    let back = robot.judged_by_recordings("worse");
    assert_eq!(back["kind"], "judged", "{back}");
    assert_eq!(robot.judged_by_recordings("better")["kind"], "current");
}

#[test]
fn models_that_are_blind_near_the_robot_are_refused_and_one_that_is_as_good_is_accepted() {
    let robot = Robot::new();
    let better = robot.has("better");
    for name in ["blind_middle", "blind_near"] {
        let said = robot.judged_by_recordings(name);
        assert_eq!(said["accepted"], false, "{name}: {said}");
        assert!(said["why"].as_str().unwrap().contains("of the obstacles"), "{name}: {said}");
        assert_eq!(robot.state().current(), Some(&*better), "{name}");
    }
    let as_good = robot.judged_by_recordings("as_good");
    assert_eq!(as_good["accepted"], true, "{as_good}");
}

#[test]
fn a_sequence_of_models_that_become_blind_column_by_column_ends_at_a_limit_that_does_not_slide() {
    let robot = Robot::new();
    robot.has("better");
    let accepted = (1..=6).map(|step| {
        let said = robot.judged_by_recordings(&format!("creeping_{step}"));
        if said["accepted"] == true {
            // The next one is compared with this one.
            robot.store().keep(said["digest"].as_str().unwrap(), "for the test").unwrap();
            return true;
        }
        assert!(said["why"].as_str().unwrap().contains("of the obstacles"), "{step}: {said}");
        false
    });
    let accepted: Vec<bool> = accepted.collect();
    assert!(!accepted[5], "{accepted:?}");
}

#[test]
fn a_model_that_behaves_is_kept_and_its_run_replays_exactly_with_the_store() {
    let robot = Robot::new();
    robot.has("guess");
    let bytes = std::fs::read(model_file("better")).unwrap();
    robot.put(&bytes, "better");
    robot.explore("run", "400", &[]);
    let state = robot.state();
    assert_eq!((state.trial_starts, state.models.len()), (None, 2));
    assert_eq!(robot.store().history().entries.last().unwrap().what, What::Kept);
    let out = robot.text("run");
    let store = robot.text("store");
    let replayed = run(&["replay", &out, "--model-store", &store]);
    let said = String::from_utf8_lossy(&replayed.stdout).into_owned();
    assert!(replayed.status.success() && said.contains("replay: ticks=400 mismatches=0"), "{said}");
    let refused = run(&["replay", &out]);
    assert!(String::from_utf8_lossy(&refused.stderr).contains("--model-store"));
}

#[test]
fn a_model_that_passes_the_gate_and_then_misbehaves_is_rolled_back_within_its_trial() {
    let robot = Robot::new();
    let guess = robot.has("guess");
    // On held-out frames without dark corners this model would pass. The test installs it directly.
    let store = robot.store();
    let bytes = std::fs::read(model_file("nan_in_the_dark")).unwrap();
    robot.put(&bytes, "nan_in_the_dark");
    robot.explore("run", "60", &[]);
    assert_eq!(robot.state(), State { models: vec![guess.clone()], trial_starts: None });
    let history = store.history();
    let last = history.entries.last().unwrap();
    assert!(last.what == What::RolledBack && last.why.contains("NaN"), "{last:?}");
    // A model that was rolled back is not installed again.
    let again = robot.install(&robot.signed("nan_in_the_dark"), &["--unproven"]);
    assert_eq!(again["kind"], "rolled_back_before", "{again}");
}

#[test]
fn a_trial_goes_on_over_restarts_and_is_compared_with_what_was_counted_before_them() {
    let robot = Robot::with(&CONFIG.replace("trial_m = 0.2", "trial_m = 30"));
    let guess = robot.has("guess");
    robot.explore("resident", "200", &[]);
    let resident = robot.store().counts().resident;
    assert_eq!((resident.digest.as_deref(), resident.counts.ticks), (Some(&*guess), 200));
    let better = std::fs::read(model_file("better")).unwrap();
    robot.put(&better, "better");
    for run in 1..=5 {
        robot.explore(&format!("run{run}"), "70", &[]);
        let saved = robot.store().counts();
        assert_eq!(saved.resident, resident);
        let counts = saved.trial.unwrap().counts;
        // Starts without a crash are not held against the model.
        assert_eq!((robot.state().trial_starts, counts.ticks), (Some(0), 70 * run));
        assert!(counts.moving_ticks > 0 && counts.moving_ticks <= counts.ticks);
    }
}

#[test]
fn a_model_whose_depth_is_never_right_is_rolled_back_in_its_trial() {
    let robot = Robot::new();
    let guess = robot.has("guess");
    // Without counts of the resident model: the absolute limit holds.
    let far = std::fs::read(model_file("far")).unwrap();
    robot.put(&far, "far");
    robot.explore("run", "120", &[]);
    assert_eq!(robot.state().current(), Some(&*guess));
    let history = robot.store().history();
    let last = history.entries.last().unwrap();
    assert!(last.why.contains("right against the LiDAR"), "{last:?}");
}

#[test]
fn a_model_that_is_blind_near_the_robot_is_rolled_back_in_its_trial() {
    let robot = Robot::with(&CONFIG.replace("trial_m = 0.2", "trial_m = 30"));
    let better = robot.has("better");
    let blind = std::fs::read(model_file("blind_near")).unwrap();
    robot.put(&blind, "blind_near");
    robot.explore("run", "1500", &[]);
    let history = robot.store().history();
    let last = history.entries.last().unwrap();
    assert!(last.why.contains("missed"), "{last:?}");
    assert_eq!(robot.state().current(), Some(&*better));
}

#[test]
fn a_first_model_that_misbehaves_leaves_no_network() {
    let robot = Robot::new();
    let said = robot.install(&robot.signed("nan_in_the_dark"), &["--unproven"]);
    assert_eq!(said["accepted"], true, "{said}");
    robot.explore("run", "60", &[]);
    assert_eq!(robot.state(), State::default());
}

#[test]
fn rollback_works_while_the_new_model_is_damaged_on_the_disk() {
    let robot = Robot::new();
    let guess = robot.has("guess");
    let better = robot.has("better");
    std::fs::write(robot.store().model_path(&better), b"rot").unwrap();
    let store = robot.text("store");
    let output = run(&["model", "rollback", "--store", &store]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(robot.state().current(), Some(&*guess));
    // A robot that finds the model damaged rolls it back automatically.
    let worse = robot.has("worse");
    std::fs::write(robot.store().model_path(&worse), b"rot").unwrap();
    robot.explore("run", "5", &[]);
    assert_eq!(robot.state().current(), Some(&*guess));
}

#[test]
fn a_robot_starts_although_the_file_that_names_its_model_is_damaged() {
    let robot = Robot::new();
    robot.has("guess");
    let better = robot.has("better");
    std::fs::write(robot.path("store/current"), "{").unwrap();
    let summary = robot.explore("run", "3", &[]);
    assert_eq!(summary["model"], *better);
    assert_eq!(robot.state().current(), Some(&*better));
    let history = robot.store().history();
    assert!(
        history.entries.last().unwrap().why.contains("rolled back automatically"),
        "{history:?}"
    );
}

#[test]
fn a_robot_with_a_read_only_store_starts_with_the_model_that_passed_its_trial() {
    let robot = Robot::new();
    let guess = robot.has("guess");
    let better = std::fs::read(model_file("better")).unwrap();
    robot.put(&better, "better");
    let before = robot.state();
    // A folder in its place makes the file impossible to write.
    std::fs::create_dir(robot.path("store/current.partial")).unwrap();
    assert_eq!(robot.explore("run", "30", &[])["model"], *guess);
    assert_eq!(robot.state(), before);
    std::fs::remove_dir(robot.path("store/current.partial")).unwrap();
    assert_eq!(robot.explore("again", "3", &[])["model"].as_str(), before.current());
    assert_eq!(robot.state().trial_starts, Some(1));
}

/// Digest of the network to switch to (empty for none), and whether it is on trial.
fn digest(swap: Option<Swap>) -> Option<(String, bool)> {
    match swap {
        Some(Swap::To { network, on_trial }) => Some((network.digest().to_owned(), on_trial)),
        Some(Swap::ToNone) => Some((String::new(), false)),
        None => None,
    }
}

#[test]
fn a_model_whose_key_is_not_trusted_any_more_is_not_used_and_comes_back_with_the_key() {
    let robot = Robot::new();
    let guess = robot.has("guess");
    let config = Config::load(&robot.path("robot.toml")).unwrap();
    assert_eq!(started(&robot, &config).network.unwrap().digest(), guess);
    let keys = std::fs::read(robot.path("trusted_keys")).unwrap();
    let other = signed_model::generate_keys(&robot.path("other_key"), None, "other").unwrap();
    for revoked in [other.as_str(), "# no key\n"] {
        std::fs::write(robot.path("trusted_keys"), revoked).unwrap();
        assert!(started(&robot, &config).network.is_none());
        let store = robot.text("store");
        let config = robot.text("robot.toml");
        let listed = run(&["model", "list", "--store", &store, "--config", &config]);
        let listed = String::from_utf8_lossy(&listed.stdout).into_owned();
        assert!(listed.contains("NOT TRUSTED: not used"), "{listed}");
    }
    std::fs::write(robot.path("trusted_keys"), keys).unwrap();
    assert_eq!(started(&robot, &config).network.unwrap().digest(), guess);
}

fn started(robot: &Robot, config: &Config) -> Start {
    Keeper::start(&robot.path("store"), None, config).unwrap().1
}

#[test]
fn a_model_that_was_put_into_the_store_without_a_signature_is_not_used() {
    let robot = Robot::new();
    let guess = robot.has("guess");
    let better = std::fs::read(model_file("better")).unwrap();
    robot.store().install(&better, "", "better").unwrap();
    let config = Config::load(&robot.path("robot.toml")).unwrap();
    let (_, start) = Keeper::start(&robot.path("store"), None, &config).unwrap();
    // The one before it is signed.
    assert_eq!(start.network.unwrap().digest(), guess);
    assert_eq!(start.on_trial, None);
    // The model that comes with the program needs no signature.
    let (_, first) =
        Keeper::start(&robot.path("new_store"), Some(&model_file("guess")), &config).unwrap();
    assert_eq!(first.network.unwrap().digest(), guess);
}

#[test]
fn a_model_that_cannot_be_loaded_is_rolled_back_and_the_next_poll_returns_the_one_before() {
    let robot = Robot::new();
    let guess = robot.has("guess");
    let config = Config::load(&robot.path("robot.toml")).unwrap();
    let (mut keeper, start) = Keeper::start(&robot.path("store"), None, &config).unwrap();
    assert_eq!(start.network.unwrap().digest(), guess);
    assert_eq!(digest(keeper.poll()), None);
    let better = std::fs::read(model_file("better")).unwrap();
    robot.put(&better, "better");
    assert_eq!(digest(keeper.poll()), Some((blake3::hash(&better).to_hex().to_string(), true)));
    // While that model is on trial, another one is installed whose file is not a network.
    robot.put(b"rot", "rot");
    assert_eq!(digest(keeper.poll()), None);
    assert_eq!(robot.state(), State { models: vec![guess.clone()], trial_starts: None });
    assert_eq!(digest(keeper.poll()), Some((guess, false)));
    assert_eq!(digest(keeper.poll()), None);
}

#[test]
fn the_first_pushed_model_is_compared_with_the_network_that_came_with_the_program() {
    let robot = Robot::new();
    let better = model_file("better");
    let summary = robot.explore(
        "run",
        "3",
        &["--scene", "builtin:apartment?seed=1", "--model", better.to_str().unwrap()],
    );
    assert_eq!(summary["model"].as_str(), robot.state().current());
    let worse = robot.judged_by_recordings("worse");
    assert!(worse["why"].as_str().unwrap().contains("worse than the resident model"), "{worse}");
}
