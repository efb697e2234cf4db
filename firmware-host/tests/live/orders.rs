//! Orders over the robot's socket act, are refused with a reason, and are recorded.

use std::collections::BTreeSet;
use std::fs::File;
use std::process::Command;

use live_link::Order;
use runtime::event::Event;
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
    let replayed = Command::new(assert_cmd::cargo::cargo_bin!("firmware-host"))
        .arg("replay")
        .arg(run.path("run"))
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&replayed.stdout);
    assert!(replayed.status.success() && said.contains("mismatches=0"), "{said}");
}

#[test]
fn a_run_decides_the_same_with_a_live_view_as_without() {
    let digest = |live: bool| {
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
    };
    assert_eq!(digest(false), digest(true));
}
