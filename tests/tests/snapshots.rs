//! A robot that starts from another robot's snapshot continues exactly as that one, whatever its
//! state was.
#![allow(clippy::unwrap_used, reason = "a test that cannot set up its scene has failed")]

use hil::{Scenario, successor};
use runtime::exploration::PolicyKind;
use runtime::robot::Robot;
use runtime::snapshot::{SNAPSHOT_VERSION, SnapshotError};

#[test]
fn whatever_the_policy_a_robot_from_a_snapshot_decides_as_the_robot_itself() {
    for policy in PolicyKind::ALL {
        Scenario::new(policy, &[], 3).unwrap().shadowed().unwrap().ticks(150).unwrap();
    }
}

#[test]
fn while_everything_fails_a_robot_from_a_snapshot_decides_as_the_robot_itself() {
    for seed in 1..=3 {
        Scenario::new(PolicyKind::Active, &["random"], seed)
            .unwrap()
            .shadowed()
            .unwrap()
            .ticks(300)
            .unwrap();
    }
}

#[test]
fn bumping_backing_off_and_escaping_are_remembered() {
    Scenario::new(PolicyKind::Forward, &["base:contact@3..3.5"], 3)
        .unwrap()
        .shadowed()
        .unwrap()
        .ticks(250)
        .unwrap();
}

fn explored() -> Scenario {
    let mut scenario = Scenario::new(PolicyKind::Active, &[], 3).unwrap();
    scenario.ticks(40).unwrap();
    scenario
}

#[test]
fn the_snapshot_of_a_successor_is_the_snapshot_it_came_from() {
    let scenario = explored();
    assert_eq!(successor(scenario.robot()).unwrap().snapshot(), scenario.robot().snapshot());
}

#[test]
fn a_cut_snapshot_is_refused_wherever_it_is_cut_and_so_is_one_that_is_too_long() {
    let scenario = explored();
    let mut bytes = scenario.robot().snapshot();
    for len in (0..100).chain((100..bytes.len()).step_by(bytes.len() / 50)) {
        let refusal = fresh(&scenario).restore(&bytes[..len]).unwrap_err();
        assert!(matches!(refusal, SnapshotError::Damaged(_)), "{len}: {refusal}");
    }
    bytes.push(0);
    assert!(matches!(fresh(&scenario).restore(&bytes), Err(SnapshotError::Damaged(_))));
}

/// A robot of the same configuration that has not driven yet.
fn fresh(scenario: &Scenario) -> Robot {
    Robot::new(scenario.robot().config().clone(), None).unwrap()
}

#[test]
fn flipped_bits_are_refused_or_change_numbers_but_never_end_the_program() {
    let scenario = explored();
    let bytes = scenario.robot().snapshot();
    for at in (0..400).chain((400..bytes.len()).step_by(bytes.len() / 100)) {
        let mut damaged = bytes.clone();
        damaged[at] ^= 1 << (at % 8);
        let _ = fresh(&scenario).restore(&damaged);
    }
}

#[test]
fn a_snapshot_of_another_layout_is_refused_by_its_number() {
    let scenario = explored();
    let mut bytes = scenario.robot().snapshot();
    bytes[0] ^= 0x40;
    let refusal = successor(scenario.robot()).unwrap().restore(&bytes).unwrap_err();
    let layout = SNAPSHOT_VERSION ^ 0x40;
    assert!(refusal.to_string().contains(&format!("layout {layout}")), "{refusal}");
}
