//! Checks the simulated controllers, the driver's frames and the DBC file with independent
//! software: python-can, canopen, cantools with ODrive's own DBC file, crccheck.
#![allow(missing_docs, clippy::expect_used, clippy::panic)]

use std::fmt::Write as _;
use std::path::Path;
use std::process::Command;

use drivers::can::Protocol;
use drivers::can::messages::{BaseCommand, BaseState, SafetyInput};
use hal::{Clock, Twist2};
use hil::motor::Outbox;
use hil::motor::rig::{config, node, step_nodes};
use hil::motor::{Hub, Rig};
use monotonic_clock::MonotonicClock;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

const STEP_NS: u64 = 1_000_000;

/// The command `can_peers.py`, without arguments.
fn peers() -> Command {
    let python = std::env::var("HIL_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let mut command = Command::new(python);
    command.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("peers/can_peers.py"));
    command
}

/// Runs a peer that communicates with simulated controllers 1 and 2.
fn check_with_peer(protocol: Protocol) {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("can");
    let mut hub = Hub::bind(&path).expect("a hub");
    let mut nodes = [node(protocol, 1), node(protocol, 2)];
    let name = format!("{protocol:?}").to_lowercase();
    let mut peer = peers().arg(name).arg(&path).spawn().expect("a peer");
    let mut clock = MonotonicClock;
    let start_ns = clock.now_ns();
    let mut outbox = Outbox::default();
    let status = loop {
        clock.sleep_until_ns(clock.now_ns() + STEP_NS);
        step_nodes(&mut nodes, &mut hub, clock.now_ns(), &mut outbox);
        if let Some(status) = peer.try_wait().expect("a peer") {
            break status;
        }
        if clock.now_ns() - start_ns > 60_000 * STEP_NS {
            peer.kill().expect("it ends");
        }
    };
    assert!(status.success(), "{protocol:?}");
}

#[test]
#[ignore = "needs tests/peers/requirements.txt; `cargo xtask test --all` installs it"]
fn the_simulated_odrive_conforms_to_odrives_own_dbc_file() {
    check_with_peer(Protocol::Odrive);
}

#[test]
#[ignore = "needs tests/peers/requirements.txt; `cargo xtask test --all` installs it"]
fn the_simulated_vesc_is_accepted_by_python_can_and_crccheck() {
    check_with_peer(Protocol::Vesc);
}

#[test]
#[ignore = "needs tests/peers/requirements.txt; `cargo xtask test --all` installs it"]
fn the_simulated_drive_conforms_to_canopens_cia_402_profile() {
    check_with_peer(Protocol::Cia402);
}

#[test]
#[ignore = "needs tests/peers/requirements.txt; `cargo xtask test --all` installs it"]
fn the_driver_sends_frames_that_conform_to_odrives_dbc_file() {
    let mut rig = Rig::new(&config(Protocol::Odrive)).expect("sound");
    rig.arm().expect("it arms");
    (0..150).for_each(|_| rig.drive(0.2, 0.0).expect("it drives"));
    let mut lines = String::new();
    for (_, frame) in rig.host.take_sent() {
        writeln!(lines, "{frame}").expect("a written line");
    }
    let file = tempfile::NamedTempFile::new().expect("a file");
    std::fs::write(file.path(), lines).expect("a written line");
    assert!(peers().arg("driver").arg(file.path()).status().expect("a peer").success());
}

#[test]
#[ignore = "needs tests/peers/requirements.txt; `cargo xtask test --all` installs it"]
fn cantools_reads_and_writes_our_frames_by_our_dbc_file() {
    let mut rng = Pcg64Mcg::seed_from_u64(7);
    let mut lines = String::new();
    for k in 0..200u32 {
        let counter = (k % 16) as u8;
        let v: i16 = rng.random();
        let w: i16 = rng.random();
        let linear = f64::from(v) * 1e-3;
        let angular = f64::from(w) * 1e-3;
        let twist = Twist2 { linear_mps: linear, angular_radps: angular };
        let a: bool = rng.random();
        let b: bool = rng.random();
        let plan_age_ms: u16 = rng.random();
        let command = BaseCommand { counter, armed: a, stop: b, plan_age_ms, twist }.encode();
        let phase = (k % 5) as u8;
        let trip = (k % 10) as u8;
        let state = BaseState { counter, phase, trip, estop: a, contact: b, twist }.encode();
        let cliff = rng.random();
        let safety = SafetyInput { counter, estop: a, bumper: b, cliff }.encode();
        let cliff = u8::from(cliff);
        let a = u8::from(a);
        let b = u8::from(b);
        let json = [
            (
                command,
                format!(
                    r#""Armed": {a}, "Stop": {b}, "PlanAge": {plan_age_ms}, "Linear": {linear}, "Angular": {angular}"#
                ),
            ),
            (
                state,
                format!(
                    r#""Phase": {phase}, "Trip": {trip}, "EStop": {a}, "Contact": {b}, "Linear": {linear}"#
                ),
            ),
            (safety, format!(r#""EStop": {a}, "Bumper": {b}, "Cliff": {cliff}"#)),
        ];
        for (frame, fields) in json {
            writeln!(lines, r#"{frame} {{"Counter": {counter}, {fields}}}"#)
                .expect("a written line");
        }
    }
    let file = tempfile::NamedTempFile::new().expect("a file");
    std::fs::write(file.path(), lines).expect("a written line");
    let dbc = Path::new(env!("CARGO_MANIFEST_DIR")).join("../drivers/src/can/embodied.dbc");
    assert!(peers().arg("frames").arg(dbc).arg(file.path()).status().expect("a peer").success());
}
