//! Faulty or missing commands, stops, and the safety board.

use drivers::can::messages::SafetyInput;
use drivers::can::protocol::MotorStage;
use drivers::can::{
    BaseConfig, CanBus, CanError, CanFrame, DifferentialBase, Phase, Protocol, Trip, UnixBus,
};
use hal::{Base, Clock, DriveCommand, Twist2, VirtualClock};
use hil::motor::rig::{TICK_NS, config, decay_after_watchdog_s, node, step_nodes};
use hil::motor::{MemoryBus, Outbox, Rig};
use rustix::net::{AddressFamily, SocketFlags, SocketType, socketpair};

use super::{ALL, MS, driving, is_motion, is_stopped, motion_frames, rolls_out};

#[test]
fn a_command_that_is_repeated_or_late_is_refused() {
    let mut rig = driving(Protocol::Odrive);
    let counter = rig.counter;
    for old in [counter, counter - 1, counter.wrapping_sub(1000)] {
        let refused = CanError::Counter { found: old, last: counter };
        assert_eq!(rig.base.drive(&slow_command(old)), Err(refused));
    }
    assert_eq!(rig.base.drive(&slow_command(counter + 3)), Ok(()));
    assert_eq!((rig.base.counts().skipped, rig.base.counts().refused), (2, 3));
}

fn slow_command(counter: u32) -> DriveCommand {
    DriveCommand { twist: Twist2 { linear_mps: 0.1, angular_radps: 0.0 }, counter, plan_age_ns: 0 }
}

#[test]
fn a_sender_that_only_repeats_itself_stops_the_base_within_the_watchdog() {
    let mut rig = driving(Protocol::Odrive);
    let twist = Twist2 { linear_mps: 0.2, angular_radps: 0.0 };
    let counter = rig.counter;
    for _ in 0..50 {
        rig.poll();
        let _ = rig.base.drive(&DriveCommand { twist, counter, plan_age_ns: 0 });
    }
    assert!(is_stopped(&rig));
}

#[test]
fn a_stale_plan_moves_nothing() {
    for protocol in ALL {
        let mut rig = driving(protocol);
        let twist = Twist2 { linear_mps: 0.2, angular_radps: 0.0 };
        for _ in 0..60 {
            rig.poll();
            rig.counter += 1;
            let error = rig.base.drive(&DriveCommand {
                twist,
                counter: rig.counter,
                plan_age_ns: 501 * MS,
            });
            assert_eq!(error, Err(CanError::PlanTooOld { age_ms: 501, limit_ms: 500 }));
        }
        assert!(is_stopped(&rig), "{protocol:?}");
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
    assert!(is_stopped(&rig));
}

#[test]
fn a_caller_that_falls_silent_stops_the_base_and_may_continue_later() {
    for protocol in ALL {
        let mut rig = driving(protocol);
        (0..60).for_each(|_| rig.poll());
        assert!(is_stopped(&rig), "{protocol:?}");
        assert!(rig.base.is_armed(), "{protocol:?}: its loop is alive");
        (0..60).for_each(|_| rig.drive(0.2, 0.0).expect("it goes on"));
        assert!(!is_stopped(&rig));
    }
}

#[test]
fn a_stalled_loop_is_stopped_by_the_motors_watchdogs_and_stays_stopped() {
    for protocol in ALL {
        let mut rig = driving(protocol);
        let expired = rig.nodes[0].watchdog().expired;
        rig.advance(100 * MS);
        assert_eq!(rig.nodes[0].watchdog().expired, expired, "{protocol:?}: not before its time");
        rig.advance(12 * MS);
        for node in &rig.nodes {
            assert_eq!(node.watchdog().expired, expired + 1, "{protocol:?}");
            let waited_ns = node.watchdog().expired_ns - node.watchdog().fed_ns;
            assert!(waited_ns <= 101 * MS, "{protocol:?}: {waited_ns} ns");
        }
        // An ODrive coasts, so the wheels stand later than they did while the simulated ones lost their speed within 0.05 s.
        let decay_s = decay_after_watchdog_s(protocol);
        rolls_out(&mut rig, decay_s, |rig| rig.advance(TICK_NS), &format!("{protocol:?}"));
        let _ = rig.host.take_sent();
        assert_eq!(rig.drive(0.2, 0.0), Err(CanError::Tripped(Trip::LoopStalled)), "{protocol:?}");
        (0..100).for_each(|_| drop(rig.drive(0.2, 0.0)));
        assert_eq!(motion_frames(&rig), 0, "{protocol:?}");
        assert!(is_stopped(&rig), "{protocol:?}");
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
        (0..40).for_each(|_| rig.poll());
        assert!(is_stopped(&rig), "{protocol:?}");
        assert_eq!(rig.base.arm(), Err(CanError::Tripped(Trip::EmergencyStop)));
        rig.base.set_emergency_stop(false);
        assert!(!rig.base.is_armed(), "released is not armed");
        rig.arm().unwrap_or_else(|error| panic!("{protocol:?}: {error}"));
    }
}

/// A safety board on the bus.
struct SafetyBoard {
    bus: MemoryBus,
    counter: u8,
}

impl SafetyBoard {
    /// Sends the state of the board with a new counter, then runs one tick of the base.
    fn send_and_drive(&mut self, rig: &mut Rig, estop: bool, bumper: bool) -> Result<(), CanError> {
        self.send(SafetyInput { estop, bumper, ..SafetyInput::default() });
        rig.drive(0.1, 0.0)
    }

    /// Sends the state of the board with a new counter.
    fn send(&mut self, input: SafetyInput) {
        self.counter = (self.counter + 1) % 16;
        let _ = self.bus.send(&SafetyInput { counter: self.counter, ..input }.encode());
    }

    /// Sends the last frame again, as a stuck board does, then runs one tick of the base.
    fn repeat_and_drive(&mut self, rig: &mut Rig) -> Result<(), CanError> {
        let input = SafetyInput { counter: self.counter, ..SafetyInput::default() };
        let _ = self.bus.send(&input.encode());
        rig.drive(0.1, 0.0)
    }
}

#[test]
fn a_safety_board_on_the_bus_stops_the_base_and_so_does_its_silence() {
    let config = BaseConfig { safety_board: true, ..config(Protocol::Odrive) };
    let mut rig = Rig::new(&config).expect("sound");
    let mut board = SafetyBoard { bus: rig.host.connect(), counter: 0 };
    assert!(rig.is_ready_after(100));
    assert_eq!(rig.base.arm(), Err(CanError::Tripped(Trip::SafetySilent)));
    let _ = board.send_and_drive(&mut rig, false, false);
    rig.base.arm().expect("the board is well");
    (0..60).for_each(|_| drop(board.send_and_drive(&mut rig, false, false)));
    assert!(rig.base.is_armed());
    board.send(SafetyInput { cliff: true, ..SafetyInput::default() });
    rig.drive(0.1, 0.0).expect("a cliff is no trip of the base");
    rig.poll();
    assert!(rig.feedback.as_ref().is_ok_and(|feedback| {
        feedback.is_some_and(|feedback| feedback.cliff && !feedback.contact)
    }));
    board.send_and_drive(&mut rig, false, true).expect("a bumper is contact, not a trip");
    rig.poll();
    assert!(
        rig.feedback
            .as_ref()
            .is_ok_and(|feedback| feedback.is_some_and(|feedback| feedback.contact))
    );
    assert_eq!(
        board.send_and_drive(&mut rig, true, false),
        Err(CanError::Tripped(Trip::EmergencyStop))
    );
    let _ = board.send_and_drive(&mut rig, false, false);
    (0..60).for_each(|_| drop(board.send_and_drive(&mut rig, false, false)));
    rig.base.arm().expect("released");
    (0..60).for_each(|_| drop(board.send_and_drive(&mut rig, false, false)));
    // A repeated frame means that the board is stuck.
    (0..15).for_each(|_| drop(board.repeat_and_drive(&mut rig)));
    assert_eq!(rig.base.phase(), Phase::Tripped(Trip::SafetySilent));
}

#[test]
fn a_safety_frame_with_a_wrong_checksum_is_dropped_and_counted() {
    let mut rig = driving(Protocol::Vesc);
    let mut board = rig.host.connect();
    let pressed = SafetyInput { counter: 1, estop: true, ..SafetyInput::default() }.encode();
    let broken = [pressed.data()[0] ^ 1, pressed.data()[1]];
    let _ = board.send(&CanFrame::new(pressed.id(), &broken).expect("sound"));
    rig.drive(0.2, 0.0).expect("a corrupt frame does not stop the base");
    assert_eq!(rig.base.counts().corrupt, 1);
    let _ = board.send(&pressed);
    assert!(rig.drive(0.2, 0.0).is_err(), "also without a configured board, pressed is pressed");
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
fn disarming_brakes_before_it_releases_the_motors() {
    for protocol in ALL {
        let mut rig = driving(protocol);
        rig.base.disarm();
        assert_eq!(rig.base.phase(), Phase::Disarming);
        (0..40).for_each(|_| rig.poll());
        assert!(is_stopped(&rig), "{protocol:?}");
        (0..20).for_each(|_| rig.poll());
        assert_eq!(rig.base.phase(), Phase::Disarmed);
        assert!(rig.is_ready_after(100), "{protocol:?}");
        assert!(rig.base.motors().iter().all(|motor| motor.stage == MotorStage::Ready));
        assert!(!rig.nodes[0].is_powered(), "{protocol:?}");
    }
}

#[test]
fn motors_that_are_disarmed_keep_their_power_and_hold_zero_for_half_a_second() {
    for protocol in [Protocol::Odrive, Protocol::Cia402] {
        let mut rig = driving(protocol);
        rig.base.disarm();
        for tick in 1..50 {
            rig.poll();
            let is_powered = rig.nodes.iter().all(|node| node.is_powered());
            assert!(is_powered, "{protocol:?}: without power after {tick} ticks");
        }
        (0..10).for_each(|_| rig.poll());
        assert!(rig.nodes.iter().all(|node| !node.is_powered()), "{protocol:?}");
    }
}

#[test]
fn a_base_that_is_left_while_it_drives_leaves_the_watchdogs_on() {
    for protocol in ALL {
        let mut rig = driving(protocol);
        rig.base.finish();
        rig.advance(10 * MS);
        for node in &rig.nodes {
            assert!(node.watchdog().limit_ns.is_some(), "{protocol:?}");
        }
        // The watchdog's time, and a step.
        rig.advance(101 * MS);
        let decay_s = decay_after_watchdog_s(protocol);
        rolls_out(&mut rig, decay_s, |rig| rig.advance(TICK_NS), &format!("{protocol:?}"));
    }
}

#[test]
fn a_press_of_the_boards_emergency_stop_counts_even_if_it_is_over_within_one_tick() {
    let mut rig = driving(Protocol::Odrive);
    let mut board = rig.host.connect();
    for (counter, estop) in [(1, false), (2, true), (3, false)] {
        let _ = board.send(&SafetyInput { counter, estop, ..SafetyInput::default() }.encode());
    }
    rig.advance(10 * MS);
    let command = DriveCommand { counter: rig.counter + 1, ..slow_command(0) };
    assert_eq!(rig.base.drive(&command), Err(CanError::Tripped(Trip::EmergencyStop)));
}

#[test]
fn a_late_frame_of_the_safety_board_releases_no_emergency_stop() {
    let mut rig = driving(Protocol::Odrive);
    let mut board = rig.host.connect();
    send(5, false, &mut board, &mut rig);
    send(6, true, &mut board, &mut rig);
    (0..100).for_each(|_| rig.poll());
    // Four frames older than the press.
    send(2, false, &mut board, &mut rig);
    assert_eq!(rig.base.check(), Err(CanError::Tripped(Trip::EmergencyStop)));
}

fn send(counter: u8, estop: bool, board: &mut MemoryBus, rig: &mut Rig) {
    let _ = board.send(&SafetyInput { counter, estop, ..SafetyInput::default() }.encode());
    (0..5).for_each(|_| rig.poll());
}

/// Uses a Unix socket, whose driver allocates no more than that of SocketCAN; the bus in memory
/// does allocate.
#[test]
fn an_armed_tick_allocates_nothing() {
    for protocol in ALL {
        let flags = SocketFlags::NONBLOCK;
        let (host, motors) = socketpair(AddressFamily::UNIX, SocketType::SEQPACKET, flags, None)
            .expect("two sockets");
        let mut motors = UnixBus::from_fd(motors);
        let mut now_ns = 1_000 * MS;
        let clock = VirtualClock::starting_at_ns(now_ns);
        let mut base =
            DifferentialBase::with_clock(UnixBus::from_fd(host), &config(protocol), clock)
                .expect("a sound configuration");
        let mut nodes = [node(protocol, 1), node(protocol, 2)];
        let mut outbox = Outbox::default();
        let mut measured = 0;
        for counter in 1..=600 {
            for _ in 0..10 {
                now_ns += MS;
                step_nodes(&mut nodes, &mut motors, now_ns, &mut outbox);
            }
            base.clock_mut().sleep_until_ns(now_ns);
            let is_armed = base.is_armed() || base.arm().is_ok() && base.is_armed();
            let twist = Twist2 { linear_mps: 0.2, angular_radps: 0.1 };
            let counted = allocation_counter::measure(|| {
                let _ = base.poll_feedback();
                let _ = base.drive(&DriveCommand { twist, counter, plan_age_ns: 0 });
            });
            if is_armed {
                assert_eq!(counted.count_total, 0, "{protocol:?}");
                measured += 1;
            }
        }
        assert!(measured > 300, "{protocol:?}: armed for {measured} ticks; {}", base.explain());
    }
}
