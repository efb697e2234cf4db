//! Rollouts by the program itself to stores on this computer, whose robots are a script that answers as `firmware-host` does.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test that cannot set up its programs has failed"
)]

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;
use tempfile::{TempDir, tempdir};

/// A robot's program. Its store has `list.json`, the answer to `model list`, and `answer.json`, that to `model install`. After an
/// install, `after.json` becomes the list, and after the next list `ended.json`, if there is one. The file `kills` lets it end `push-model` after it has stored the model.
const PROGRAM: &str = r#"#!/bin/sh
verb=$2
while [ "$1" != --store ]; do shift; done
cd "$2" || exit 2
if [ "$verb" = list ]; then
    if [ -f list.json ]; then
        cat list.json
        if [ -f ended.json ] && [ ! -f after.json ]; then mv ended.json list.json; fi
        exit 0
    fi
    echo "no route to this robot" >&2
    exit 255
fi
cat > model
echo "$2" >> ../sent
mv after.json list.json
if [ -f kills ]; then rm kills; kill -9 $PPID; fi
cat answer.json
grep -q '"accepted":true' answer.json
"#;

const EMPTY: &str = r#"{"state":{"models":["old"]},"problem":null,"history":[{"unix_s":1,"what":"kept","digest":"old","name":"first","why":""}]}"#;

/// A workstation with a signed model, and a folder of stores.
struct Scene {
    dir: TempDir,
    digest: String,
}

impl Scene {
    /// A fleet with robots of these names; those that begin with `c` are canaries.
    fn new(robots: &[&str], rules: &str) -> Self {
        let dir = tempdir().unwrap();
        let digest = blake3::hash(b"a model").to_hex().to_string();
        let scene = Self { dir, digest };
        fs::write(scene.path("student.onnx"), "a model").unwrap();
        fs::write(scene.path("student.onnx.minisig"), "a signature").unwrap();
        fs::write(scene.path("program"), PROGRAM).unwrap();
        fs::set_permissions(scene.path("program"), fs::Permissions::from_mode(0o755)).unwrap();
        let mut file = rules.to_owned();
        for name in robots {
            let is_canary = name.starts_with('c');
            file += &format!(
                "[[robot]]\nname = \"{name}\"\ntarget = \"./{name}\"\ncanary = {is_canary}\n"
            );
            fs::create_dir(scene.path(name)).unwrap();
            scene.put(name, "list.json", EMPTY);
            scene.accepts(name);
        }
        fs::write(scene.path("fleet.toml"), file).unwrap();
        scene
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn put(&self, robot: &str, file: &str, text: &str) {
        fs::write(self.path(robot).join(file), text.replace("DIGEST", &self.digest)).unwrap();
    }

    fn accepts(&self, robot: &str) {
        self.put(robot, "answer.json", r#"{"accepted":true,"name":"student","digest":"DIGEST"}"#);
        let history = r#"[{"unix_s":2,"what":"installed","digest":"DIGEST","name":"student"}]"#;
        let state = r#"{"models":["DIGEST","old"],"trial_starts":0}"#;
        let list = format!(r#"{{"state":{state},"problem":null,"history":{history}}}"#);
        self.put(robot, "after.json", &list);
    }

    fn refuses(&self, robot: &str) {
        let answer = r#"{"accepted":false,"kind":"judged","why":"too slow: 90 ms"}"#;
        self.put(robot, "answer.json", answer);
        let entry =
            r#"{"unix_s":2,"what":"refused","digest":"DIGEST","name":"student","why":"too slow"}"#;
        self.put(robot, "after.json", &EMPTY.replace("}]}", &format!("}},{entry}]}}")));
    }

    /// The robot has ended the trial of the model.
    fn ends_trial(&self, robot: &str, what: &str, why: &str) {
        let models = if what == "kept" { r#""DIGEST","old""# } else { r#""old""# };
        let history = format!(
            r#"[{{"unix_s":2,"what":"installed","digest":"DIGEST","name":"student"}},{{"unix_s":3,"what":"{what}","digest":"DIGEST","name":"student","why":"{why}"}}]"#
        );
        let list =
            format!(r#"{{"state":{{"models":[{models}]}},"problem":null,"history":{history}}}"#);
        self.put(robot, "list.json", &list);
    }

    /// The robot will keep the model after it was asked once during the trial.
    fn will_keep(&self, robot: &str) {
        self.ends_trial(robot, "kept", "");
        fs::rename(self.path(robot).join("list.json"), self.path(robot).join("ended.json"))
            .unwrap();
        self.put(robot, "list.json", EMPTY);
    }

    fn push(&self, more: &[&str]) -> Output {
        self.run(&[&["student.onnx"], more].concat())
    }

    /// Runs `push-model` in the folder.
    fn run(&self, arguments: &[&str]) -> Output {
        let mut push = Command::new(env!("CARGO_BIN_EXE_push-model"));
        push.current_dir(self.dir.path()).args(arguments).args(["--fleet", "fleet.toml"]);
        push.arg("--program").arg(self.path("program")).output().unwrap()
    }

    /// The robots that were sent the model, in this order.
    fn sent(&self) -> Vec<String> {
        let sent = fs::read_to_string(self.path("sent")).unwrap_or_default();
        let name = |line: &str| Path::new(line).file_name().unwrap().to_string_lossy().into_owned();
        sent.lines().map(name).collect()
    }

    fn status(&self) -> Value {
        serde_json::from_slice(&self.run(&["--status", "--json"]).stdout).unwrap()
    }

    fn state_file(&self) -> PathBuf {
        self.path(&format!("fleet.rollout-{}.json", &self.digest[..16]))
    }
}

fn text(output: &Output) -> String {
    let out = String::from_utf8_lossy(&output.stdout);
    format!("{out}{}", String::from_utf8_lossy(&output.stderr))
}

#[track_caller]
fn assert_exits(output: &Output, code: i32, words: &[&str]) {
    let said = text(output);
    assert_eq!(output.status.code(), Some(code), "{said}");
    words.iter().for_each(|word| assert!(said.contains(word), "{word}: {said}"));
}

#[test]
fn a_canary_that_refuses_halts_the_rollout_and_nothing_else_is_sent_until_it_is_resumed() {
    let scene = Scene::new(&["c1", "a", "b"], "");
    scene.refuses("c1");
    let why = "1 of 1 answered robots in ring canary refused the model or rolled it back, allowed: 0: c1 (refused: judged: too slow: 90 ms)";
    assert_exits(&scene.push(&[]), 1, &["halted", why, "--resume"]);
    assert_exits(&scene.push(&[]), 1, &["halted"]);
    assert_eq!(scene.sent(), ["c1"]);
    assert_exits(&scene.push(&["--resume"]), 0, &["ring 10 % begins: 1 robot"]);
    assert_eq!(scene.sent().len(), 2);
}

#[test]
fn a_rollback_in_the_second_ring_halts_before_the_third() {
    let scene = Scene::new(&["c1", "a", "b", "d"], "");
    assert_exits(&scene.push(&[]), 0, &["c1: on trial", "kept in ring canary: 0"]);
    scene.ends_trial("c1", "kept", "kept after 600 ticks and 5.0 m");
    assert_exits(&scene.push(&[]), 0, &["c1: kept: kept after 600 ticks", "ring 10 % begins"]);
    let sent = scene.sent();
    assert_eq!(sent.len(), 2);
    scene.ends_trial(&sent[1], "rolled_back", "the bumper trips too often");
    assert_exits(&scene.push(&[]), 1, &["halted", &sent[1], "the bumper trips too often"]);
    assert_eq!(scene.sent(), sent);
    let status = scene.status();
    assert_eq!((&status["standing"], &status["rings"][1]["failed"]), (&"halted".into(), &1.into()));
}

#[test]
fn a_rollout_is_complete_when_every_robot_has_kept_the_model_and_the_table_shows_it() {
    let scene = Scene::new(&["c1", "a"], "[rollout]\nrings_percent = [100]\n");
    scene.push(&[]);
    scene.ends_trial("c1", "kept", "");
    scene.push(&[]);
    scene.ends_trial("a", "kept", "kept after 600 ticks and 5.0 m");
    assert_exits(&scene.push(&["--wait"]), 0, &["ring all: 1 of 1 kept", "complete"]);
    assert_exits(&scene.push(&[]), 0, &["complete"]);
    assert_eq!(scene.sent(), ["c1", "a"]);
    let runs = format!("student {}", &scene.digest[..12]);
    let header = ["robot", "ring", "verdict", "since (UTC)", "runs", "reason"];
    assert_exits(&scene.run(&["--status"]), 0, &[&header[..], &[&runs, "kept after 600"]].concat());
}

#[test]
fn a_call_that_waits_makes_passes_until_the_rollout_is_complete() {
    let scene = Scene::new(&["c1", "a", "b"], "");
    ["c1", "a", "b"].iter().for_each(|name| scene.will_keep(name));
    let words = ["ring 10 % begins", "ring all begins", "complete"];
    assert_exits(&scene.push(&["--wait", "--every", "1"]), 0, &words);
    assert_eq!(scene.sent().len(), 3);
}

#[test]
fn the_program_that_is_ended_between_two_robots_sends_to_neither_twice_when_it_runs_again() {
    let scene = Scene::new(&["c1", "c2", "c3"], "");
    scene.put("c2", "kills", "");
    let ended = scene.push(&["--parallel", "1"]);
    assert_eq!(ended.status.code(), None, "{}", text(&ended));
    assert_eq!(scene.sent(), ["c1", "c2"]);
    assert_exits(&scene.push(&["--parallel", "1"]), 0, &["c2: on trial", "3 on trial"]);
    assert_exits(&scene.push(&[]), 0, &[]);
    assert_eq!(scene.sent(), ["c1", "c2", "c3"]);
}

#[test]
fn a_damaged_state_is_refused_and_nothing_is_sent_and_without_it_the_robots_are_asked_first() {
    let scene = Scene::new(&["c1", "a"], "");
    scene.push(&[]);
    scene.ends_trial("c1", "kept", "");
    let state = fs::read(scene.state_file()).unwrap();
    fs::write(scene.state_file(), &state[..state.len() / 2]).unwrap();
    let words = ["damaged", "fleet.rollout-", "nothing was sent", "move it away"];
    assert_exits(&scene.push(&[]), 2, &words);
    assert_exits(&scene.push(&["--resume"]), 2, &words);
    assert_exits(&scene.run(&["--status"]), 2, &words);
    assert_eq!(scene.sent(), ["c1"]);
    fs::remove_file(scene.state_file()).unwrap();
    assert_exits(&scene.push(&[]), 0, &["c1: kept", "a: on trial"]);
    assert_eq!(scene.sent(), ["c1", "a"]);
}

#[test]
fn a_robot_that_is_not_reached_is_named_with_the_words_of_ssh_and_counts_as_unanswered() {
    let scene = Scene::new(&["c1", "c2"], "");
    fs::remove_file(scene.path("c2/list.json")).unwrap();
    let words = ["c2: not reached: no route to this robot", "1 on trial, 1 unanswered"];
    assert_exits(&scene.push(&[]), 0, &words);
    assert_eq!(scene.sent(), ["c1"]);
    let robots = scene.status()["robots"].clone();
    assert_eq!(
        (&robots[1]["verdict"], &robots[1]["problem"]),
        (&"waiting".into(), &"no route to this robot".into())
    );
    assert_exits(&scene.run(&["--status"]), 0, &["unreachable"]);
}

#[test]
fn another_model_begins_another_rollout_and_does_not_use_the_state_of_the_first() {
    let scene = Scene::new(&["c1"], "");
    scene.refuses("c1");
    assert_exits(&scene.push(&["--state", "mine.json"]), 1, &["halted"]);
    fs::write(scene.path("better.onnx"), "another model").unwrap();
    fs::write(scene.path("better.onnx.minisig"), "a signature").unwrap();
    let words = ["mine.json", "student", "better is another model", "leave --state out"];
    assert_exits(&scene.run(&["better.onnx", "--state", "mine.json"]), 2, &words);
    scene.accepts("c1");
    assert_exits(&scene.run(&["better.onnx"]), 0, &["model better"]);
    assert_eq!(scene.sent(), ["c1", "c1"]);
}

#[test]
fn a_wrong_command_line_or_file_is_exit_code_2_and_says_what_to_do() {
    let scene = Scene::new(&["c1"], "");
    assert_exits(&scene.push(&["--resume"]), 2, &["none to resume", "leave --resume out"]);
    assert_exits(&scene.run(&["--status"]), 2, &["no rollout", "push-model MODEL --fleet"]);
    assert_exits(&scene.push(&["robot.local"]), 2, &["--fleet"]);
    assert_exits(&scene.run(&[]), 2, &["required"]);
    assert_exits(&scene.run(&["nothing.onnx"]), 2, &["nothing.onnx"]);
    assert_exits(&scene.push(&["--status", "--resume"]), 2, &["--resume"]);
    fs::write(scene.path("fleet.toml"), "[[robots]]\nname = \"a\"\n").unwrap();
    assert_exits(&scene.push(&[]), 2, &["fleet.toml line 1", "`robots`", "`robot`"]);
    assert!(scene.sent().is_empty());
}
