//! Behaviour of the base driver when its bus, its motors or its host fail, with simulated
//! controllers of all three protocols in virtual time.
#![allow(missing_docs, clippy::expect_used, clippy::panic)]

use drivers::can::{CanError, CanFrame, CanId, Protocol};
use hil::motor::Rig;
use hil::motor::rig::{TICK_NS, config};
use hil::motor::wheel::STANDING_RADPS;
mod bus;
mod commands;
mod motors;
mod protocols;

const ALL: [Protocol; 3] = [Protocol::Odrive, Protocol::Vesc, Protocol::Cia402];
const MS: u64 = 1_000_000;

fn rig(protocol: Protocol) -> Rig {
    Rig::new(&config(protocol)).expect("a sound configuration")
}

fn armed(protocol: Protocol) -> Rig {
    let mut rig = rig(protocol);
    rig.arm().unwrap_or_else(|error| panic!("{protocol:?}: {error}; {}", rig.base.explain()));
    rig
}

/// A base that is armed and drives at 0.2 m/s.
fn driving(protocol: Protocol) -> Rig {
    let mut rig = armed(protocol);
    for _ in 0..150 {
        rig.drive(0.2, 0.0).expect("it drives");
    }
    let speeds = rig.wheels_radps();
    assert!(speeds.iter().all(|speed| (speed - 4.0).abs() < 0.05), "{protocol:?}: {speeds:?}");
    rig
}

/// Whether a frame commands a motor to move.
fn is_motion(frame: &CanFrame) -> bool {
    match (frame.id(), frame.data()) {
        (CanId::Standard(id), [a, b, c, d, ..]) if id & 0x1f == 0x0d && id < 0x080 => {
            [a, b, c, d].iter().any(|byte| **byte != 0)
        }
        (CanId::Standard(0x201 | 0x202), [_, _, speed @ ..]) => speed.iter().any(|byte| *byte != 0),
        (CanId::Extended(id), speed) => id >> 8 == 3 && speed.iter().any(|byte| *byte != 0),
        _ => false,
    }
}

fn motion_frames(rig: &Rig) -> usize {
    rig.host.take_sent().iter().filter(|(_, frame)| is_motion(frame)).count()
}

fn is_stopped(rig: &Rig) -> bool {
    rig.wheels_radps().iter().all(|speed| speed.abs() < STANDING_RADPS)
}

/// Lets the wheels roll until they stand. A wheel that loses its speed v with a time constant rolls v times that constant, and has lost
/// all but a share s of the speed after ln(1 / s) times it. `tick` is the control loop, or what is left of it.
fn rolls_out(rig: &mut Rig, decay_s: f64, tick: impl Fn(&mut Rig), what: &str) {
    let speeds = rig.wheels_radps();
    let before = rig.nodes.each_ref().map(|node| node.wheel().position_rad());
    let fastest = speeds.iter().fold(STANDING_RADPS, |most, speed| most.max(speed.abs()));
    let seconds = decay_s * (fastest / STANDING_RADPS).ln();
    let ticks = (seconds * 1e9 / TICK_NS as f64) as usize + 2;
    (0..ticks).for_each(|_| tick(rig));
    assert!(is_stopped(rig), "{what}: {:?} after {ticks} ticks", rig.wheels_radps());
    for (node, before) in rig.nodes.iter().zip(before) {
        let rolled_rad = (node.wheel().position_rad() - before).abs();
        assert!(rolled_rad <= fastest * decay_s, "{what}: {rolled_rad} rad from {fastest} rad/s");
    }
}

#[test]
fn every_protocol_arms_drives_and_measures_its_own_motion() {
    for protocol in ALL {
        let mut rig = armed(protocol);
        for tick in 0..400 {
            rig.drive(0.2, if tick < 200 { 0.0 } else { 0.5 }).expect("it drives");
        }
        for _ in 0..50 {
            rig.drive(0.0, 0.0).expect("it stops");
        }
        let [left, right] = rig.nodes.each_ref().map(|node| node.wheel().position_rad() * 0.05);
        let pose = rig.base.odometry().pose();
        let heading = (right - left) / 0.24;
        // One commutation step of the VESC is 1.2 mm at the rim.
        assert!(
            (hal::wrap_angle(heading) - pose.yaw_rad).abs() < 0.02,
            "{protocol:?}: {heading} and {pose:?}"
        );
        let travelled = (left + right) / 2.0;
        assert!((0.75..0.8).contains(&travelled), "{protocol:?}: {travelled} m");
        assert!(is_stopped(&rig));
        assert!(rig.base.odometry().covariance()[(2, 2)] > 0.0);
    }
}

#[test]
fn nothing_moves_before_the_base_is_armed() {
    for protocol in ALL {
        let mut rig = rig(protocol);
        assert!(rig.is_ready_after(200), "{protocol:?}: {}", rig.base.explain());
        for _ in 0..20 {
            assert_eq!(rig.drive(0.2, 0.0), Err(CanError::NotArmed));
        }
        assert_eq!(motion_frames(&rig), 0);
        assert!(is_stopped(&rig));
    }
}

fn motion_frames_after(rig: &mut Rig, ticks: usize) -> usize {
    let _ = rig.host.take_sent();
    (0..ticks).for_each(|_| drop(rig.drive(0.2, 0.0)));
    motion_frames(rig)
}
