//! What the base promises when its bus, its motors or its host misbehave: with simulated controllers of all three protocols, in
//! virtual time.
#![allow(missing_docs, clippy::expect_used, clippy::panic)]

use drivers::can::messages::SafetyInput;
use drivers::can::protocol::MotorStage;
use drivers::can::{
    BaseConfig, BusEvent, CanBus, CanError, CanFrame, CanId, DifferentialBase, ErrorState, Phase,
    Protocol, Side, Trip, UnixBus,
};
use hal::{Base, Clock, DriveCommand, Error, ErrorKind, Twist2, VirtualClock};
use hil::motor::rig::{config, node, step_nodes};
use hil::motor::{LineFaults, Outbox, Rig};
use rustix::net::{AddressFamily, SocketFlags, SocketType, socketpair};

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

/// Armed, and at 0.2 m/s.
fn driving(protocol: Protocol) -> Rig {
    let mut rig = armed(protocol);
    for _ in 0..150 {
        rig.drive(0.2, 0.0).expect("it drives");
    }
    let speeds = rig.wheels_radps();
    assert!(speeds.iter().all(|speed| (speed - 4.0).abs() < 0.05), "{protocol:?}: {speeds:?}");
    rig
}

/// Whether a frame makes a motor turn.
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

fn stands(rig: &Rig) -> bool {
    rig.wheels_radps().iter().all(|speed| speed.abs() < 0.01)
}

#[test]
fn every_protocol_arms_drives_and_measures_its_own_motion() {
    for protocol in ALL {
        let mut rig = armed(protocol);
        for turn in 0..400 {
            rig.drive(0.2, if turn < 200 { 0.0 } else { 0.5 }).expect("it drives");
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
        assert!(stands(&rig));
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
        assert!(stands(&rig));
    }
}

#[test]
fn after_a_bus_off_no_motion_leaves_until_somebody_arms_again() {
    for protocol in ALL {
        let mut rig = driving(protocol);
        // The bus is sick for two turns: commands wait in the queue. Then the controller gives up.
        rig.host.set_faults(LineFaults { jammed: true, ..LineFaults::default() });
        let _ = rig.drive(0.2, 0.0);
        let _ = rig.drive(0.2, 0.0);
        rig.host.bus_off();
        let _ = rig.host.take_sent();
        assert_eq!(rig.drive(0.2, 0.0), Err(CanError::Tripped(Trip::BusOff)));
        rig.host.set_faults(LineFaults::default());
        rig.host.restart();
        for _ in 0..500 {
            assert_eq!(rig.drive(0.2, 0.0), Err(CanError::Tripped(Trip::BusOff)));
        }
        assert_eq!(motion_frames(&rig), 0, "{protocol:?}");
        assert!(stands(&rig), "{protocol:?}");
        assert_eq!(rig.base.counts().bus_off, 1);
        rig.arm().unwrap_or_else(|error| panic!("{protocol:?}: {error}"));
        for _ in 0..100 {
            rig.drive(0.2, 0.0).expect("armed again");
        }
        assert!(!stands(&rig));
    }
}

#[test]
fn a_bus_that_goes_off_again_and_again_is_tried_ever_less_often() {
    let mut rig = driving(Protocol::Odrive);
    let mut tries = 0;
    for _ in 0..2000 {
        let _ = rig.host.take_sent();
        rig.listen();
        if !rig.host.take_sent().is_empty() {
            tries += 1;
            rig.host.bus_off();
            rig.host.restart();
        }
    }
    // 20 s: after 0.1, 0.2, 0.4, 0.8, 1.6 s, then every 2 s.
    assert!((8..=16).contains(&tries), "{tries} tries in 20 s");
    assert!(rig.base.arm().is_err());
}

#[test]
fn a_storm_of_error_frames_costs_a_bounded_amount_of_work_per_turn() {
    let mut rig = driving(Protocol::Odrive);
    for _ in 0..100_000 {
        rig.host.tell(BusEvent::NoAcknowledge);
    }
    let before = rig.base.counts().bus_errors;
    rig.listen();
    assert!(rig.base.counts().bus_errors - before <= 256);
    // Feedback is stuck behind the storm: that is silence, and silence stops.
    (0..15).for_each(|_| rig.listen());
    assert!(matches!(rig.base.phase(), Phase::Tripped(_)));
}

#[test]
fn error_counters_of_the_controller_are_told() {
    let mut rig = driving(Protocol::Odrive);
    rig.host.errors(ErrorState::Passive, 130, 7);
    rig.listen();
    assert_eq!(rig.base.bus_health(), (ErrorState::Passive, (130, 7)));
    assert!(rig.base.is_armed(), "error-passive still carries frames");
}

#[test]
fn a_full_transmit_queue_loses_a_frame_and_never_delays_one() {
    for protocol in ALL {
        let mut rig = driving(protocol);
        rig.host.set_faults(LineFaults { full: true, ..LineFaults::default() });
        rig.drive(0.2, 0.0).expect("one turn without sending is no fault");
        rig.host.set_faults(LineFaults::default());
        let _ = rig.host.take_sent();
        rig.drive(0.2, 0.0).expect("and the next goes out");
        let motions = motion_frames(&rig);
        assert_eq!(motions, 2, "{protocol:?}: one frame per wheel, nothing made up for");
    }
}

#[test]
fn a_transmit_queue_that_stays_full_stops_the_base() {
    for protocol in ALL {
        let mut rig = driving(protocol);
        rig.host.set_faults(LineFaults { full: true, ..LineFaults::default() });
        let result = (0..8).map(|_| rig.drive(0.2, 0.0)).find(Result::is_err);
        assert_eq!(result, Some(Err(CanError::Tripped(Trip::TransmitBlocked))), "{protocol:?}");
        rig.host.set_faults(LineFaults::default());
        let _ = rig.host.take_sent();
        (0..300).for_each(|_| drop(rig.drive(0.2, 0.0)));
        assert_eq!(motion_frames(&rig), 0, "{protocol:?}");
    }
}

#[test]
fn feedback_that_stops_for_100_ms_stops_the_base() {
    for protocol in ALL {
        let mut rig = driving(protocol);
        rig.nodes[1].faults().silent = true;
        let began_ns = rig.now_ns;
        let turns = (0..100).take_while(|_| rig.drive(0.2, 0.0).is_ok()).count();
        assert!(turns < 100, "{protocol:?}: silence must stop the base");
        let took_ms = (rig.now_ns - began_ns) / MS;
        assert!((90..=120).contains(&took_ms), "{protocol:?}: {took_ms} ms");
        assert_eq!(rig.base.phase(), Phase::Tripped(Trip::FeedbackSilent(Side::Right)));
        (0..20).for_each(|_| rig.listen());
        assert!(stands(&rig), "{protocol:?}");
        let error = rig.feedback.as_ref().expect_err("silence is no feedback");
        assert_eq!(error.kind(), ErrorKind::Timeout);
        assert_eq!(
            rig.base.arm().map_err(|error| error.kind()),
            Err(ErrorKind::Timeout),
            "{protocol:?}"
        );
    }
}

#[test]
fn a_controller_that_has_not_confirmed_its_watchdog_is_never_armed() {
    for protocol in ALL {
        let mut rig = rig(protocol);
        rig.nodes[0].faults().forgets_watchdog = true;
        assert!(!rig.is_ready_after(300), "{protocol:?}");
        let error = rig.base.arm().expect_err("no watchdog, no motion");
        assert!(error.to_string().contains("watchdog"), "{protocol:?}: {error}");
        assert!(rig.base.explain().contains("watchdog"), "{}", rig.base.explain());
        assert_eq!(motion_frames(&rig), 0);
    }
}

#[test]
fn the_watchdog_is_confirmed_anew_each_time_the_base_is_armed() {
    for protocol in ALL {
        let mut rig = driving(protocol);
        rig.base.disarm();
        assert!(rig.is_ready_after(200), "{protocol:?}: {}", rig.base.explain());
        rig.nodes[0].faults().forgets_watchdog = true;
        rig.nodes[0].faults().reboot = true;
        (0..5).for_each(|_| rig.listen());
        let outcome = rig.arm();
        assert!(outcome.is_err(), "{protocol:?}");
        assert_eq!(motion_frames_after(&mut rig, 100), 0);
    }
}

fn motion_frames_after(rig: &mut Rig, turns: usize) -> usize {
    let _ = rig.host.take_sent();
    (0..turns).for_each(|_| drop(rig.drive(0.2, 0.0)));
    motion_frames(rig)
}

#[test]
fn a_controller_that_restarts_while_driving_stops_the_base() {
    for protocol in [Protocol::Odrive, Protocol::Cia402] {
        let mut rig = driving(protocol);
        rig.nodes[0].faults().reboot = true;
        (0..30).for_each(|_| drop(rig.drive(0.2, 0.0)));
        assert_eq!(
            rig.base.phase(),
            Phase::Tripped(Trip::MotorFault(Side::Left)),
            "{protocol:?}: {}",
            rig.base.explain()
        );
        (0..30).for_each(|_| rig.listen());
        assert!(stands(&rig), "{protocol:?}");
    }
}

#[test]
fn a_fault_of_a_motor_stops_both_and_is_cleared_by_arming_once_it_is_gone() {
    for protocol in ALL {
        let mut rig = driving(protocol);
        rig.nodes[0].faults().broken = true;
        (0..30).for_each(|_| drop(rig.drive(0.2, 0.0)));
        assert_eq!(rig.base.phase(), Phase::Tripped(Trip::MotorFault(Side::Left)), "{protocol:?}");
        (0..30).for_each(|_| rig.listen());
        assert!(stands(&rig), "{protocol:?}");
        assert!(rig.arm().is_err(), "{protocol:?}: still broken");
        rig.nodes[0].faults().broken = false;
        (0..150).for_each(|_| rig.listen());
        rig.arm().unwrap_or_else(|error| panic!("{protocol:?}: {error}; {}", rig.base.explain()));
    }
}

#[test]
fn a_wheel_that_turns_against_its_command_stops_the_base_within_centimetres_and_is_not_armed_again()
{
    for protocol in ALL {
        let mut rig = armed(protocol);
        rig.nodes[1].wheel_mut().encoder_reversed = true;
        let turns = (0..300).take_while(|_| rig.drive(0.2, 0.0).is_ok()).count();
        assert_eq!(
            rig.base.phase(),
            Phase::Tripped(Trip::WrongDirection(Side::Right)),
            "{protocol:?} after {turns} turns"
        );
        (0..100).for_each(|_| rig.listen());
        let travelled = rig.nodes[1].wheel().position_rad().abs() * 0.05;
        assert!(travelled < 0.06, "{protocol:?}: {travelled} m");
        let refused = Err(CanError::Tripped(Trip::WrongDirection(Side::Right)));
        assert_eq!(rig.base.arm(), refused);
        assert!(rig.base.explain().contains("invert_right"), "{}", rig.base.explain());
    }
}

/// A motor that is mounted the other way round: forwards is backwards.
#[test]
fn a_motor_mounted_the_other_way_round_is_a_matter_of_configuration() {
    for protocol in ALL {
        let mut rig =
            Rig::new(&BaseConfig { invert_right: true, ..config(protocol) }).expect("sound");
        rig.arm().expect("it arms");
        (0..150).for_each(|_| rig.drive(0.2, 0.0).expect("it drives"));
        let [left, right] = rig.wheels_radps();
        assert!(left > 3.0 && right < -3.0, "{protocol:?}: {left} {right}");
        assert!(rig.base.odometry().pose().x_m > 0.2, "{protocol:?}");
    }
}

#[test]
fn swapped_wheels_turn_the_robot_the_right_way_with_swap_wheels() {
    for protocol in ALL {
        // Node 1 is mounted right: turning left, it is the one that goes forwards.
        let mut rig =
            Rig::new(&BaseConfig { swap_wheels: true, ..config(protocol) }).expect("sound");
        rig.arm().expect("it arms");
        (0..150).for_each(|_| rig.drive(0.0, 0.8).expect("it turns"));
        let [node_1, node_2] = rig.wheels_radps();
        assert!(node_1 > 1.0 && node_2 < -1.0, "{protocol:?}: {node_1} {node_2}");
        assert!(rig.base.odometry().pose().yaw_rad > 0.5, "{protocol:?}");
    }
}

#[test]
fn somebody_elses_frames_are_ignored_and_counted() {
    for protocol in ALL {
        let mut rig = driving(protocol);
        let mut stranger = rig.host.connect();
        let before = rig.base.counts().foreign;
        for turn in 0..100u8 {
            let payload = [turn, 1, 2, 3, 4, 5, 6, 7];
            for frame in [
                CanFrame::standard(0x3e5, payload),
                CanFrame::extended_short(0x18fe_f100, payload, 8),
                CanFrame::remote(CanId::Standard(0x7f0), 8).expect("sound"),
            ] {
                let _ = stranger.send(&frame);
            }
            rig.drive(0.2, 0.0).expect("undisturbed");
        }
        assert_eq!(rig.base.counts().foreign - before, 300, "{protocol:?}");
        assert!(rig.wheels_radps().iter().all(|speed| (speed - 4.0).abs() < 0.05));
    }
}

#[test]
fn a_command_that_is_repeated_or_late_is_refused() {
    let mut rig = driving(Protocol::Odrive);
    let counter = rig.counter;
    let command = |counter| DriveCommand {
        twist: Twist2 { linear_mps: 0.1, angular_radps: 0.0 },
        counter,
        plan_age_ns: 0,
    };
    for old in [counter, counter - 1, counter.wrapping_sub(1000)] {
        let refused = CanError::Counter { found: old, last: counter };
        assert_eq!(rig.base.drive(&command(old)), Err(refused));
    }
    assert_eq!(rig.base.drive(&command(counter + 3)), Ok(()));
    assert_eq!((rig.base.counts().skipped, rig.base.counts().refused), (2, 3));
}

#[test]
fn a_sender_that_only_repeats_itself_stops_the_base_within_the_watchdog() {
    let mut rig = driving(Protocol::Odrive);
    let (twist, counter) = (Twist2 { linear_mps: 0.2, angular_radps: 0.0 }, rig.counter);
    for _ in 0..50 {
        rig.listen();
        let _ = rig.base.drive(&DriveCommand { twist, counter, plan_age_ns: 0 });
    }
    assert!(stands(&rig));
}

#[test]
fn a_stale_plan_moves_nothing() {
    for protocol in ALL {
        let mut rig = driving(protocol);
        let twist = Twist2 { linear_mps: 0.2, angular_radps: 0.0 };
        for _ in 0..60 {
            rig.listen();
            rig.counter += 1;
            let error = rig.base.drive(&DriveCommand {
                twist,
                counter: rig.counter,
                plan_age_ns: 501 * MS,
            });
            assert_eq!(error, Err(CanError::PlanTooOld { age_ms: 501, limit_ms: 500 }));
        }
        assert!(stands(&rig), "{protocol:?}");
        assert!(rig.base.is_armed());
        rig.drive(0.2, 0.0).expect("a fresh plan moves it again");
    }
}

#[test]
fn a_command_that_is_not_finite_is_refused_and_stops() {
    let mut rig = driving(Protocol::Cia402);
    for (v, w) in [(f64::NAN, 0.0), (0.1, f64::INFINITY)] {
        assert!(matches!(rig.drive(v, w), Err(CanError::NotFinite { .. })));
    }
    (0..40).for_each(|_| drop(rig.drive(f64::NAN, 0.0)));
    assert!(stands(&rig));
}

#[test]
fn a_caller_that_falls_silent_stops_the_base_and_may_go_on_later() {
    for protocol in ALL {
        let mut rig = driving(protocol);
        (0..60).for_each(|_| rig.listen());
        assert!(stands(&rig), "{protocol:?}");
        assert!(rig.base.is_armed(), "{protocol:?}: its loop is alive");
        (0..60).for_each(|_| rig.drive(0.2, 0.0).expect("it goes on"));
        assert!(!stands(&rig));
    }
}

#[test]
fn a_loop_that_stands_still_is_stopped_by_the_motors_watchdogs_and_stays_stopped() {
    for protocol in ALL {
        let mut rig = driving(protocol);
        let expired = rig.nodes[0].watchdog().expired;
        rig.pass(100 * MS);
        assert_eq!(rig.nodes[0].watchdog().expired, expired, "{protocol:?}: not before its time");
        rig.pass(12 * MS);
        for node in &rig.nodes {
            assert_eq!(node.watchdog().expired, expired + 1, "{protocol:?}");
            let waited_ns = node.watchdog().expired_ns - node.watchdog().fed_ns;
            assert!(waited_ns <= 101 * MS, "{protocol:?}: {waited_ns} ns");
        }
        rig.pass(400 * MS);
        assert!(stands(&rig), "{protocol:?}");
        let _ = rig.host.take_sent();
        assert_eq!(rig.drive(0.2, 0.0), Err(CanError::Tripped(Trip::LoopStalled)), "{protocol:?}");
        (0..100).for_each(|_| drop(rig.drive(0.2, 0.0)));
        assert_eq!(motion_frames(&rig), 0, "{protocol:?}");
        assert!(stands(&rig), "{protocol:?}");
    }
}

#[test]
fn the_emergency_stop_stops_at_once_and_forbids_arming() {
    for protocol in ALL {
        let mut rig = driving(protocol);
        let _ = rig.host.take_sent();
        rig.base.set_emergency_stop(true);
        assert_eq!(motion_frames(&rig), 0);
        assert_eq!(rig.drive(0.2, 0.0), Err(CanError::Tripped(Trip::EmergencyStop)));
        (0..40).for_each(|_| rig.listen());
        assert!(stands(&rig), "{protocol:?}");
        assert_eq!(rig.base.arm(), Err(CanError::Tripped(Trip::EmergencyStop)));
        rig.base.set_emergency_stop(false);
        assert!(!rig.base.is_armed(), "released is not armed");
        rig.arm().unwrap_or_else(|error| panic!("{protocol:?}: {error}"));
    }
}

#[test]
fn a_safety_board_on_the_bus_stops_the_base_and_so_does_its_silence() {
    let config = BaseConfig { safety_board: true, ..config(Protocol::Odrive) };
    let mut rig = Rig::new(&config).expect("sound");
    let mut board = rig.host.connect();
    assert!(rig.is_ready_after(100));
    assert_eq!(rig.base.arm(), Err(CanError::Tripped(Trip::SafetySilent)));
    let mut counter = 0;
    let mut tell = |rig: &mut Rig, estop, bumper, counts: bool| {
        counter = if counts { (counter + 1) % 16 } else { counter };
        let _ = board.send(&SafetyInput { counter, estop, bumper }.encode());
        rig.drive(0.1, 0.0)
    };
    let _ = tell(&mut rig, false, false, true);
    rig.base.arm().expect("the board is well");
    (0..60).for_each(|_| drop(tell(&mut rig, false, false, true)));
    assert!(rig.base.is_armed());
    tell(&mut rig, false, true, true).expect("a bumper is contact, not a trip");
    rig.listen();
    assert!(
        rig.feedback
            .as_ref()
            .is_ok_and(|feedback| feedback.is_some_and(|feedback| feedback.contact))
    );
    assert_eq!(tell(&mut rig, true, false, true), Err(CanError::Tripped(Trip::EmergencyStop)));
    let _ = tell(&mut rig, false, false, true);
    (0..60).for_each(|_| drop(tell(&mut rig, false, false, true)));
    rig.base.arm().expect("released");
    (0..60).for_each(|_| drop(tell(&mut rig, false, false, true)));
    // The same frame over and over is a stuck board.
    (0..15).for_each(|_| drop(tell(&mut rig, false, false, false)));
    assert_eq!(rig.base.phase(), Phase::Tripped(Trip::SafetySilent));
}

#[test]
fn a_frame_of_ours_that_fails_its_checksum_is_dropped_and_counted() {
    let mut rig = driving(Protocol::Vesc);
    let mut board = rig.host.connect();
    let pressed = SafetyInput { counter: 1, estop: true, bumper: false }.encode();
    let broken = [pressed.data()[0] ^ 1, pressed.data()[1]];
    let _ = board.send(&CanFrame::new(pressed.id(), &broken).expect("sound"));
    rig.drive(0.2, 0.0).expect("noise stops nobody");
    assert_eq!(rig.base.counts().corrupt, 1);
    let _ = board.send(&pressed);
    assert!(rig.drive(0.2, 0.0).is_err(), "also without a configured board, pressed is pressed");
}

#[test]
fn a_blocked_wheel_is_contact() {
    for protocol in ALL {
        let mut rig = driving(protocol);
        rig.nodes[0].wheel_mut().blocked = true;
        let mut contact_after = None;
        for turn in 0..60 {
            rig.drive(0.2, 0.0).expect("it pushes");
            if let Ok(Some(feedback)) = &rig.feedback
                && feedback.contact
            {
                contact_after.get_or_insert(turn);
            }
        }
        assert!(
            contact_after.is_some_and(|turn| (25..45).contains(&turn)),
            "{protocol:?}: {contact_after:?}"
        );
    }
}

#[test]
fn lost_doubled_and_late_frames_do_not_spoil_the_ride() {
    for protocol in ALL {
        let mut rig = armed(protocol);
        let faults = LineFaults {
            lost_share: 0.03,
            doubled_share: 0.05,
            late_ns: 4 * MS,
            ..LineFaults::default()
        };
        rig.host.set_faults(faults);
        rig.motors.set_faults(LineFaults {
            doubled_share: 0.05,
            late_ns: 2 * MS,
            ..LineFaults::default()
        });
        for _ in 0..1000 {
            rig.drive(0.2, 0.1)
                .unwrap_or_else(|error| panic!("{protocol:?}: {error}; {}", rig.base.explain()));
        }
        (0..50).for_each(|_| drop(rig.drive(0.0, 0.0)));
        let [left, right] = rig.nodes.each_ref().map(|node| node.wheel().position_rad() * 0.05);
        let yaw = hal::wrap_angle((right - left) / 0.24);
        assert!(
            hal::wrap_angle(yaw - rig.base.odometry().pose().yaw_rad).abs() < 0.02,
            "{protocol:?}"
        );
    }
}

#[test]
fn an_interface_that_vanishes_is_disconnected_and_comes_back_unarmed() {
    for protocol in ALL {
        let mut rig = driving(protocol);
        rig.host.set_faults(LineFaults { gone: true, ..LineFaults::default() });
        assert_eq!(rig.drive(0.2, 0.0).map_err(|error| error.kind()), Err(ErrorKind::Disconnected));
        rig.listen();
        assert_eq!(rig.feedback.as_ref().map_err(Error::kind), Err(ErrorKind::Disconnected));
        assert!(rig.base.stop().is_err());
        rig.host.set_faults(LineFaults::default());
        let _ = rig.host.take_sent();
        (0..200).for_each(|_| drop(rig.drive(0.2, 0.0)));
        assert_eq!(motion_frames(&rig), 0, "{protocol:?}");
        assert_eq!(rig.base.status().reopened, 1);
        rig.arm().unwrap_or_else(|error| panic!("{protocol:?}: {error}; {}", rig.base.explain()));
    }
}

#[test]
fn a_stop_is_zero_in_the_very_next_frames() {
    for protocol in ALL {
        let mut rig = driving(protocol);
        let _ = rig.host.take_sent();
        rig.base.stop().expect("connected");
        let sent = rig.host.take_sent();
        assert!(sent.len() >= 2 && !sent.iter().any(|(_, frame)| is_motion(frame)), "{protocol:?}");
    }
}

#[test]
fn a_robot_that_is_pushed_is_not_armed() {
    let mut rig = rig(Protocol::Odrive);
    assert!(rig.is_ready_after(100));
    for node in &mut rig.nodes {
        // Somebody rolls it: the wheels keep turning for a while.
        node.wheel_mut().coast_s = 10.0;
    }
    let mut rolling = driving(Protocol::Odrive);
    for node in &mut rolling.nodes {
        node.wheel_mut().coast_s = 10.0;
        node.faults().broken = true;
    }
    (0..30).for_each(|_| rolling.listen());
    assert!(
        matches!(rolling.base.arm(), Err(CanError::Moving { side: Side::Left, .. })),
        "{:?}",
        rolling.base.arm()
    );
}

#[test]
fn disarming_brakes_before_it_lets_the_motors_go() {
    for protocol in ALL {
        let mut rig = driving(protocol);
        rig.base.disarm();
        assert_eq!(rig.base.phase(), Phase::Disarming);
        (0..40).for_each(|_| rig.listen());
        assert!(stands(&rig), "{protocol:?}");
        (0..20).for_each(|_| rig.listen());
        assert_eq!(rig.base.phase(), Phase::Disarmed);
        assert!(rig.is_ready_after(100), "{protocol:?}");
        assert!(rig.base.motors().iter().all(|motor| motor.stage == MotorStage::Ready));
        assert!(!rig.nodes[0].is_powered(), "{protocol:?}");
    }
}

/// Over a Unix socket, whose driver allocates no more than SocketCAN's does; the bus in memory does.
#[test]
fn an_armed_turn_allocates_nothing() {
    for protocol in ALL {
        let flags = SocketFlags::NONBLOCK;
        let (host, motors) = socketpair(AddressFamily::UNIX, SocketType::SEQPACKET, flags, None)
            .expect("two sockets");
        let (mut motors, mut now_ns) = (UnixBus::from_fd(motors), 1_000 * MS);
        let clock = VirtualClock::starting_at_ns(now_ns);
        let mut base =
            DifferentialBase::with_clock(UnixBus::from_fd(host), &config(protocol), clock)
                .expect("a sound configuration");
        let mut nodes = [node(protocol, 1), node(protocol, 2)];
        let (mut outbox, mut counter, mut measured) = (Outbox::default(), 0, 0);
        for _ in 0..600 {
            for _ in 0..10 {
                now_ns += MS;
                step_nodes(&mut nodes, &mut motors, now_ns, &mut outbox);
            }
            base.clock_mut().sleep_until_ns(now_ns);
            let is_armed = base.is_armed() || base.arm().is_ok() && base.is_armed();
            let twist = Twist2 { linear_mps: 0.2, angular_radps: 0.1 };
            counter += 1;
            let counted = allocation_counter::measure(|| {
                let _ = base.poll_feedback();
                let _ = base.drive(&DriveCommand { twist, counter, plan_age_ns: 0 });
            });
            if is_armed {
                assert_eq!(counted.count_total, 0, "{protocol:?}");
                measured += 1;
            }
        }
        assert!(measured > 300, "{protocol:?}: armed for {measured} turns; {}", base.explain());
    }
}
