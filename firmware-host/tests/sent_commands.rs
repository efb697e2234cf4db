//! The whole binary drives into walls on simulated devices: what its recording says was sent is what arrived at the motors.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::panic,
    reason = "a test that cannot set up its scene has failed"
)]

use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use assert_cmd::cargo::CommandCargoExt;
use drivers::can::{BusEvent, CanBus, CanId, Kinematics, UnixBus};
use firmware_host::recorded::Recorded;
use firmware_host::run::status::Status;
use hal::{CameraModel, Clock, Twist2};
use hil::world::{LiveOptions, LiveWorld};
use monotonic_clock::MonotonicClock;
use runtime::event::SafetyEvent;
use runtime::recording::RecordedTick;
use runtime::safety::SentCommand;
use rustix::process::{Pid, Signal, kill_process};

/// Long enough for a busy computer; an idle one needs a sixth of it.
const PATIENCE: Duration = Duration::from_secs(120);
/// ODrive's `Set_Input_Vel`, the low five bits of the identifier (ODrive, "CAN Protocol").
const SET_INPUT_VEL: u16 = 0x0d;
/// A velocity that is sent in this many steps of the safety loop in a row has been reached by the limits on acceleration below.
const HELD: usize = 8;

/// The limits on acceleration are so high that the base follows within two steps.
const CONFIG: &str = "
[devices.base.limits]
acceleration_mps2 = 20.0
deceleration_mps2 = 20.0
angular_acceleration_radps2 = 100.0
angular_deceleration_radps2 = 100.0
jerk_time_s = 0.0
";

/// Listens on the bus of two ODrives, and returns the velocity that they received, once per pair of frames.
fn listen(socket: &str, running: &AtomicBool, base: &drivers::can::BaseConfig) -> Vec<Twist2> {
    let mut bus = UnixBus::new(socket);
    let mut clock = MonotonicClock;
    let mut rims = [0.0; 2];
    let mut received = Vec::new();
    while running.load(Ordering::Relaxed) {
        while let Some(event) = bus.receive(clock.now_ns()) {
            let BusEvent::Frame(frame) = event.event else { continue };
            let CanId::Standard(id) = frame.id() else { continue };
            let [a, b, c, d, ..] = *frame.data() else { continue };
            if id & 0x1f != SET_INPUT_VEL || frame.is_remote() {
                continue;
            }
            let wheel = usize::from(id >> 5) - 1;
            let shaft_radps = f64::from(f32::from_le_bytes([a, b, c, d])) * std::f64::consts::TAU;
            let sign = if [base.invert_left, base.invert_right][wheel] { -1.0 } else { 1.0 };
            rims[wheel] = sign * shaft_radps / base.gear_ratio * base.wheel_radius_m;
            if wheel == 1 {
                received.push(Kinematics { track_m: base.track_m }.twist(rims));
            }
        }
        clock.sleep_until_ns(clock.now_ns() + 1_000_000);
    }
    received
}

fn is_same(a: &Twist2, b: &Twist2) -> bool {
    (a.linear_mps - b.linear_mps).abs() < 1e-5 && (a.angular_radps - b.angular_radps).abs() < 1e-5
}

/// The velocities without repetitions, each with the number of times that it stood in a row.
fn runs(velocities: &[Twist2]) -> Vec<(Twist2, usize)> {
    let mut runs: Vec<(Twist2, usize)> = Vec::new();
    for velocity in velocities {
        match runs.last_mut() {
            Some((last, count)) if is_same(last, velocity) => *count += 1,
            _ => runs.push((*velocity, 1)),
        }
    }
    runs
}

/// Whether every velocity of `some` that was held is in `all`, in the same order. Names the first that is not.
fn find_missing(some: &[(Twist2, usize)], all: &[(Twist2, usize)]) -> Option<(usize, Twist2)> {
    let mut rest = all.iter();
    some.iter()
        .enumerate()
        .filter(|(_, (_, count))| *count >= HELD)
        .find(|(_, (velocity, _))| !rest.any(|(other, _)| is_same(velocity, other)))
        .map(|(at, (velocity, _))| (at, *velocity))
}

fn trips(run: &Path) -> usize {
    let Ok(recorded) = Recorded::open(run) else { return 0 };
    let ticks = recorded.ticks().map_while(Result::ok);
    ticks
        .flat_map(|tick| tick.safety.events)
        .filter(|event| matches!(event, SafetyEvent::Tripped { .. }))
        .count()
}

/// Exports take what was sent from the decision of the next tick: it is the newest command of the safety loop's whole list.
fn assert_decisions_hold_the_newest(ticks: &[RecordedTick]) {
    for tick in ticks {
        let decision = tick.decision.as_ref().unwrap();
        let newest = tick.safety.sent.last().map(SentCommand::command);
        assert_eq!(decision.sent, newest, "tick {}", tick.tick);
    }
}

#[test]
fn the_recording_of_a_drive_into_walls_holds_every_velocity_that_the_motors_received() {
    let folder = tempfile::tempdir().unwrap();
    let options = LiveOptions {
        camera: CameraModel::pinhole(160, 64, std::f64::consts::FRAC_PI_2),
        ..LiveOptions::default()
    };
    let world = LiveWorld::start(folder.path(), &options).unwrap();
    let config = std::fs::read_to_string(world.config()).unwrap();
    let limits = config.find("[devices.base.limits]").unwrap();
    let after = config[limits + 1..].find("\n[").map_or(config.len(), |end| limits + 1 + end);
    let config = format!("{}{CONFIG}{}", &config[..limits], &config[after..]);
    std::fs::write(world.config(), config).unwrap();

    let running = Arc::new(AtomicBool::new(true));
    let socket = folder.path().join("can").display().to_string();
    let base = hil::motor::rig::config(options.protocol);
    let listener = std::thread::spawn({
        let running = Arc::clone(&running);
        move || listen(&socket, &running, &base)
    });
    let out = folder.path().join("run");
    let mut robot = Command::cargo_bin("firmware-host")
        .unwrap()
        .args(["run", "--policy", "forward", "--config"])
        .arg(world.config())
        .arg("--out")
        .arg(&out)
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let began = Instant::now();
    let status = folder.path().join("status.json");
    let mut clock = MonotonicClock;
    while !Status::read(&status).is_ok_and(|status| status.safety.stops >= 2) {
        assert!(began.elapsed() < PATIENCE, "it did not stop twice for an obstacle");
        clock.sleep_until_ns(clock.now_ns() + 100_000_000);
    }
    // Time for the second back-off.
    clock.sleep_until_ns(clock.now_ns() + 3_000_000_000);
    kill_process(Pid::from_raw(robot.id() as i32).unwrap(), Signal::TERM).unwrap();
    assert!(robot.wait().unwrap().success());
    running.store(false, Ordering::Relaxed);
    let received = runs(&listener.join().unwrap());

    assert!(trips(&out) >= 2);
    let recorded = Recorded::open(&out).unwrap();
    let ticks: Vec<_> = recorded.ticks().map(Result::unwrap).collect();
    assert_decisions_hold_the_newest(&ticks);
    let sent: Vec<Twist2> =
        ticks.iter().flat_map(|tick| &tick.safety.sent).map(|sent| sent.command().into()).collect();
    let sent = runs(&sent);
    let backwards = sent.iter().filter(|(velocity, _)| velocity.linear_mps < -0.01).count();
    assert!(backwards > 0, "the recording has no back-off");
    assert_eq!(find_missing(&sent, &received), None, "in the recording, not at the motors");
    // What the safety loop sent after the last recorded tick is in no recording: the stop of the shutdown.
    let driven = received.iter().rposition(|(velocity, _)| !is_same(velocity, &Twist2::ZERO));
    let driven = &received[..driven.unwrap_or_default()];
    assert_eq!(find_missing(driven, &sent), None, "at the motors, not in the recording");
}
