//! Orders over the robot's socket act, are refused with a reason, and are recorded.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::fs::File;
use std::process::Command;

use hal::Clock;
use live_link::Order;
use monotonic_clock::MonotonicClock;
use runtime::event::Event;
use runtime::exploration::PolicyKind;
use runtime::operator::{OperatorOrder, Role};
use runtime::recording::RecordingReader;
use runtime::task::Task;

use super::explore::{Explore, Visitor};

/// The orders and the tasks in a recording.
fn recorded(run: &Explore) -> (Vec<OperatorOrder>, Vec<Task>) {
    let file = File::open(run.path("run/recording_0000.mcap")).unwrap();
    let mut orders = Vec::new();
    let mut tasks = Vec::new();
    for tick in RecordingReader::open(file).unwrap() {
        let tick = tick.unwrap();
        tasks.extend(tick.task);
        let events = tick.decision.unwrap().events;
        let noted = events.into_iter().filter_map(|event| match event {
            Event::Operator { order } => Some(order),
            _ => None,
        });
        let noted: Vec<_> = noted.collect();
        assert_eq!(noted, tick.orders);
        orders.extend(noted);
    }
    (orders, tasks)
}

/// What `replay` says of a run.
fn replay(run: &Explore) -> String {
    let mut replay = Command::new(assert_cmd::cargo::cargo_bin!("firmware-host"));
    let output = replay.arg("replay").arg(run.path("run")).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

#[test]
fn a_client_sees_the_run_and_its_orders_act_and_are_recorded_and_replayed() {
    let mut run = Explore::start(&["--seed", "1", "--map", "home.map"]);
    let mut visitor = Visitor::come(&run.socket());
    visitor.subscribe(&["/robot/now", "/map", "/scan", "/path", "/camera/image", "/depth/image"]);
    let mut seen = BTreeSet::new();
    while seen.len() < 6 {
        seen.extend(visitor.message().map(|(topic, _)| topic));
    }
    visitor.subscribe(&["/robot/now"]);

    let refused = visitor.order(Role::Watch, Order::Pause);
    assert!(!refused.accepted && refused.text.contains("watch"), "{refused:?}");
    assert!(visitor.order(Role::Steer, Order::Pause).accepted);
    visitor.wait_now("a pause", |now| now["why"] == "Paused. Press Resume to go on.");
    visitor.wait_now("standing", |now| now["linear_mps"] == 0.0 && now["angular_radps"] == 0.0);
    assert!(visitor.order(Role::Steer, Order::Resume).accepted);
    visitor.wait_now("driving", |now| now["stands"] == false && now["linear_mps"] != 0.0);

    let stopped = visitor.order(Role::Watch, Order::Stop);
    assert_eq!(stopped.text, "the safety plane has stopped the robot");
    let now = visitor.wait_now("a stop", |now| now["plane"] == "fault" && now["linear_mps"] == 0.0);
    assert!(now["needs_person"] == true && now["why"].as_str().unwrap().contains("emergency stop"));
    assert!(visitor.order(Role::Steer, Order::Arm).accepted);
    visitor.wait_now("driving again", |now| now["plane"] == "clear" && now["stands"] == false);

    assert!(visitor.order(Role::Steer, Order::SaveMap).accepted);
    run.wait("the map", |run| run.path("home.map").exists());
    assert!(visitor.order(Role::Steer, Order::GoTo { x_m: 0.3, y_m: 0.0 }).accepted);
    visitor.wait_now("going there", |now| now["goal"]["why"] == "task" || now["stands"] == true);
    drop(visitor);
    run.end();
    assert!(!run.socket().exists());

    let (orders, tasks) = recorded(&run);
    let words: Vec<&str> = orders.iter().map(|order| order.what.as_str()).collect();
    let expected =
        ["pause", "pause", "resume", "stop", "arm", "save the map", "go to (0.30, 0.00) m"];
    assert_eq!(words, expected);
    assert_eq!(orders.iter().filter(|order| order.refused.is_some()).count(), 1);
    assert_eq!(tasks, [Task::Pause, Task::Explore, Task::GoTo { x_m: 0.3, y_m: 0.0 }]);
    let said = replay(&run);
    assert!(said.contains("mismatches=0"), "{said}");
}

#[test]
fn a_drive_by_hand_and_a_drawn_area_act_are_recorded_replayed_and_the_area_is_kept_with_the_map() {
    let mut run = Explore::start(&["--seed", "1", "--map", "home.map"]);
    let mut visitor = Visitor::come(&run.socket());
    visitor.subscribe(&["/robot/now"]);
    let first = visitor.wait_now("a tick", |_| true);
    assert!(first["most_mps"].as_f64().unwrap() > 0.2);
    let area = Order::KeepOut { corners_m: [[5.0, 0.0], [6.0, 0.0], [6.0, 1.0], [5.0, 1.0]] };
    let kept = visitor.order(Role::Steer, area);
    assert!(kept.accepted && kept.text.contains("kept with the map"), "{kept:?}");
    run.wait("the file of areas", |run| run.path("home.map.keep-out.geojson").exists());
    let rotation = Order::Drive { linear_mps: 0.0, angular_radps: 0.2 };
    for _ in 0..15 {
        assert!(visitor.order(Role::Steer, rotation).accepted);
        visitor.wait_now("a tick", |now| now["why"].as_str().unwrap().starts_with("Driven"));
    }
    visitor.wait_now("the hand's velocity", |now| now["angular_radps"] == 0.2);
    let words = "Stands where it was driven by hand. Press Resume to explore.";
    visitor.wait_now("standing", |now| now["why"] == words && now["angular_radps"] == 0.0);
    let blind = visitor.order(Role::Steer, Order::ExploreBy { policy: PolicyKind::Random });
    assert!(!blind.accepted && blind.text.contains("closed areas"), "{blind:?}");
    let policy = PolicyKind::Frontier;
    assert!(visitor.order(Role::Steer, Order::ExploreBy { policy }).accepted);
    visitor.wait_now("exploring", |now| now["stands"] == false);
    drop(visitor);
    run.end();

    let (orders, mut tasks) = recorded(&run);
    assert_eq!(tasks.pop(), Some(Task::ExploreBy { policy }));
    let words: Vec<&str> = orders.iter().map(|order| order.what.as_str()).collect();
    let close = "keep out of (5.00, 0.00), (6.00, 0.00), (6.00, 1.00), (5.00, 1.00) m";
    let by = ["explore by the policy `random`", "explore by the policy `frontier`"];
    assert_eq!(words, [close, "drive by hand", by[0], by[1]]);
    assert!(tasks.len() > 3 && tasks.iter().all(|task| Some(*task) == rotation.task()));
    let said = replay(&run);
    assert!(said.contains("mismatches=0"), "{said}");
}

#[test]
fn a_robot_pauses_when_its_last_watcher_is_gone_where_the_configuration_says_so() {
    let config = "[camera]\nwidth = 320\nheight = 96\n[live]\npause_when_unwatched_s = 0.3\n";
    let mut run = Explore::with(config, &["--seed", "1"]);
    let mut visitor = Visitor::come(&run.socket());
    visitor.subscribe(&["/robot/now"]);
    visitor.wait_now("driving", |now| now["stands"] == false);
    drop(visitor);
    // The client that saw the pause stays connected, so that the robot does not pause a second time.
    let witness = RefCell::new(None);
    run.wait("the pause", |run| {
        // A client that looks counts as a watcher, so that the robot is left alone for longer than 0.3 s between two looks.
        let mut clock = MonotonicClock;
        clock.sleep_until_ns(clock.now_ns() + 1_000_000_000);
        let mut visitor = Visitor::come(&run.socket());
        visitor.subscribe(&["/robot/now"]);
        let now = visitor.wait_now("a tick", |_| true);
        let is_paused = now["why"] == "Paused. Press Resume to go on.";
        *witness.borrow_mut() = is_paused.then_some(visitor);
        is_paused
    });
    run.end();
    let (orders, tasks) = recorded(&run);
    assert_eq!(tasks, [Task::Pause]);
    assert!(orders[0].what.contains("no client watches"), "{orders:?}");
}

#[test]
fn a_run_decides_the_same_with_a_live_view_as_without() {
    assert_eq!(digest(false), digest(true));
}

fn digest(live: bool) -> String {
    let folder = tempfile::tempdir().unwrap();
    let mut command = Command::new(assert_cmd::cargo::cargo_bin!("firmware-host"));
    command
        .args(["explore", "--scene", "builtin:apartment?seed=1", "--frames", "60"])
        .args(["--no-recording", "--out", "run"])
        .current_dir(folder.path());
    if live {
        command.args(["--live", "live.sock"]);
    }
    assert!(command.output().unwrap().status.success());
    let summary = std::fs::read_to_string(folder.path().join("run/summary.json")).unwrap();
    let summary: serde_json::Value = serde_json::from_str(&summary).unwrap();
    summary["digest"].as_str().unwrap().to_owned()
}
