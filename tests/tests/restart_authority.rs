//! Nothing moves unless a person asked for it after the last event that needs a person: the real
//! safety loop and base driver, with simulated controllers of all three protocols that lose power,
//! restart, fall silent and boot.
#![allow(missing_docs, clippy::expect_used, clippy::panic)]

use drivers::can::{BaseConfig, Protocol};
use hal::{Base, ScanGeometry, Twist2};
use hil::motor::rig::config;
use hil::motor::wheel::COAST_S;
use hil::motor::{Composition, LineFaults};
use runtime::event::FaultReason;
use runtime::safety::SafetyState;

const ALL: [Protocol; 3] = [Protocol::Odrive, Protocol::Vesc, Protocol::Cia402];
const MS: u64 = 1_000_000;
/// Five seconds at 100 Hz.
const FIVE_SECONDS: usize = 500;

fn robot(protocol: Protocol) -> Composition {
    Composition::new(&config(protocol), ScanGeometry::UTM_30LX).expect("a sound configuration")
}

fn with_board(protocol: Protocol) -> Composition {
    let config = BaseConfig { safety_board: true, ..config(protocol) };
    Composition::new(&config, ScanGeometry::UTM_30LX).expect("a sound configuration")
}

/// Arms the robot and lets it drive for a second.
fn driving(mut robot: Composition) -> Composition {
    robot.steps(50);
    robot.person_arms();
    robot.steps(200);
    let gone_m = robot.drives_m(100);
    assert!(gone_m > 0.15, "{gone_m} m in a second, {:?}", robot.state());
    robot
}

/// The robot stands for five seconds, and drives after a person has armed it.
fn stands_until_a_person_arms_it(robot: &mut Composition, what: &str) {
    let gone_m = robot.drives_m(FIVE_SECONDS);
    assert!(gone_m < 0.01, "{what}: {gone_m} m without being armed; {:?}", robot.state());
    robot.person_arms();
    robot.steps(300);
    let gone_m = robot.drives_m(100);
    assert!(
        gone_m > 0.15,
        "{what}: {gone_m} m after arming; {:?} {}",
        robot.state(),
        robot.base().explain()
    );
}

/// The wheels of released motors lose their speed of 0.2 m/s. The robot rolls as far as that takes it, and no wheel is driven.
fn coasts_to_a_stop(robot: &mut Composition, what: &str) {
    let before = robot.pose();
    // After six time constants, 0.2 mm are left of the distance.
    for _ in 0..(6.0 * COAST_S / 0.01) as usize {
        robot.step(None);
        assert!(!robot.is_driven(), "{what}: driven in {:?}", robot.state());
    }
    let rolled_m = before.distance_m(&robot.pose());
    assert!(rolled_m < robot.plan.linear_mps * COAST_S, "{what}: {rolled_m} m");
}

#[test]
fn motors_that_lose_power_and_get_it_back_stand() {
    for protocol in ALL {
        // The last ones are brown-outs, as when a weak battery feeds motors that start.
        for (off_ms, boot_ns) in
            [(5000, 0), (5000, 300 * MS), (150, 300 * MS), (50, 0), (10, 200 * MS), (10, 0)]
        {
            let mut robot = driving(robot(protocol));
            for node in &mut robot.nodes {
                node.faults().boot_ns = boot_ns;
                node.faults().unpowered = true;
            }
            robot.steps(off_ms / 10);
            for node in &mut robot.nodes {
                node.faults().unpowered = false;
            }
            let what = format!("{protocol:?} off for {off_ms} ms");
            coasts_to_a_stop(&mut robot, &what);
            stands_until_a_person_arms_it(&mut robot, &what);
        }
    }
}

#[test]
fn one_motor_that_loses_power_and_gets_it_back_stands() {
    for protocol in ALL {
        let mut robot = driving(robot(protocol));
        robot.nodes[1].faults().boot_ns = 300 * MS;
        robot.nodes[1].faults().unpowered = true;
        robot.steps(100);
        robot.nodes[1].faults().unpowered = false;
        stands_until_a_person_arms_it(&mut robot, &format!("{protocol:?}"));
    }
}

#[test]
fn a_controller_that_restarts_at_once_is_noticed() {
    for protocol in ALL {
        let mut robot = driving(robot(protocol));
        robot.nodes[0].faults().reboot = true;
        robot.steps(20);
        coasts_to_a_stop(&mut robot, &format!("{protocol:?}"));
        stands_until_a_person_arms_it(&mut robot, &format!("{protocol:?}"));
    }
}

/// The scanner returns, or the CAN adapter.
fn returns(robot: &mut Composition, is_scanner: bool) {
    if is_scanner {
        robot.silence_scanner(false);
    } else {
        robot.host.set_faults(LineFaults::default());
    }
}

#[test]
fn scanner_and_can_adapter_that_vanish_at_once_and_return_in_any_order_move_nothing() {
    for protocol in ALL {
        // A USB hub that was reset finds its devices one after the other.
        for (scanner_first, steps_between) in [(true, 0), (true, 100), (false, 100)] {
            let mut robot = driving(robot(protocol));
            robot.silence_scanner(true);
            robot.host.set_faults(LineFaults { gone: true, ..LineFaults::default() });
            robot.steps(200);
            assert_eq!(robot.state(), SafetyState::Fault(FaultReason::BaseFault), "{protocol:?}");
            returns(&mut robot, scanner_first);
            robot.steps(steps_between);
            returns(&mut robot, !scanner_first);
            let what = format!("{protocol:?} scanner first {scanner_first}, {steps_between} steps");
            stands_until_a_person_arms_it(&mut robot, &what);
        }
    }
}

#[test]
fn a_released_emergency_stop_moves_nothing() {
    for protocol in ALL {
        let mut robot = driving(with_board(protocol));
        robot.pressed = true;
        let gone_m = robot.drives_m(100);
        assert!(gone_m < 0.1, "{protocol:?}: {gone_m} m after the stop was pressed");
        assert_eq!(robot.state(), SafetyState::Fault(FaultReason::EmergencyStop));
        robot.pressed = false;
        stands_until_a_person_arms_it(&mut robot, &format!("{protocol:?}"));
    }
}

#[test]
fn an_emergency_stop_that_is_pressed_for_one_frame_only_is_seen() {
    for protocol in ALL {
        let mut robot = driving(with_board(protocol));
        robot.send_board(true);
        robot.send_board(false);
        robot.steps(100);
        stands_until_a_person_arms_it(&mut robot, &format!("{protocol:?}"));
    }
}

#[test]
fn an_emergency_stop_wins_in_every_state() {
    for protocol in ALL {
        // The emergency stop is pressed while the scanner is silent.
        let mut waits = driving(with_board(protocol));
        waits.silence_scanner(true);
        waits.steps(50);
        waits.pressed = true;
        waits.steps(50);
        waits.silence_scanner(false);
        waits.steps(50);
        waits.pressed = false;
        stands_until_a_person_arms_it(&mut waits, &format!("{protocol:?}: without a scanner"));
        // The emergency stop is pressed while the motors are being armed, and at power-on.
        for wait in [0, 1, 5, 20, 60] {
            let mut arming = with_board(protocol);
            arming.steps(50);
            arming.person_arms();
            arming.steps(wait);
            arming.pressed = true;
            arming.steps(50);
            arming.pressed = false;
            let what = format!("{protocol:?}: {wait} steps after a request to arm");
            stands_until_a_person_arms_it(&mut arming, &what);
        }
        let mut starting = with_board(protocol);
        starting.pressed = true;
        starting.person_arms();
        starting.steps(100);
        starting.pressed = false;
        stands_until_a_person_arms_it(&mut starting, &format!("{protocol:?}: at power-on"));
    }
}

#[test]
fn a_safety_board_that_was_unplugged_moves_nothing_when_it_is_back() {
    for protocol in ALL {
        let mut robot = driving(with_board(protocol));
        robot.board_is_silent = true;
        let gone_m = robot.drives_m(300);
        assert!(gone_m < 0.1, "{protocol:?}: {gone_m} m without the board");
        assert_eq!(robot.state(), SafetyState::Fault(FaultReason::SafetyBoardSilent));
        robot.board_is_silent = false;
        stands_until_a_person_arms_it(&mut robot, &format!("{protocol:?}"));
    }
}

#[test]
fn a_program_that_was_suspended_stands_when_it_resumes() {
    for protocol in ALL {
        for pause_ms in [600, 3000] {
            let mut robot = driving(robot(protocol));
            robot.pause(pause_ms * MS);
            robot.step(None);
            assert_eq!(robot.state(), SafetyState::Fault(FaultReason::LoopStalled), "{protocol:?}");
            let what = format!("{protocol:?} {pause_ms} ms");
            coasts_to_a_stop(&mut robot, &what);
            stands_until_a_person_arms_it(&mut robot, &what);
        }
    }
}

#[test]
fn a_short_pause_of_the_loop_is_followed_by_a_slow_restart() {
    for protocol in ALL {
        let mut robot = driving(robot(protocol));
        robot.pause(200 * MS);
        robot.steps(300);
        let gone_m = robot.drives_m(100);
        assert!(gone_m > 0.15, "{protocol:?}: {gone_m} m; {:?}", robot.state());
    }
}

#[test]
fn a_gap_of_the_scanner_is_followed_by_a_slow_restart_without_a_person() {
    for protocol in ALL {
        let mut robot = driving(robot(protocol));
        robot.silence_scanner(true);
        robot.steps(200);
        assert_eq!(robot.state(), SafetyState::Fault(FaultReason::LidarSilent));
        robot.silence_scanner(false);
        let slowly_m = robot.drives_m(100);
        assert!((0.03..0.101).contains(&slowly_m), "{protocol:?}: {slowly_m} m in a second");
        let gone_m = robot.drives_m(100);
        assert!(gone_m > 0.15, "{protocol:?}: {gone_m} m in the next second");
    }
}

#[test]
fn a_battery_that_runs_low_stops_the_robot_with_every_protocol_that_reports_it() {
    for protocol in ALL {
        let mut robot = robot(protocol);
        robot.limit_voltage(21.0).expect("a sound configuration");
        let mut robot = driving(robot);
        assert_eq!(robot.base().power().voltage_v, Some(24.0), "{protocol:?}");
        robot.nodes[1].faults().supply.voltage_v = 20.5;
        robot.steps(700);
        assert_eq!(robot.state(), SafetyState::Fault(FaultReason::LowBattery), "{protocol:?}");
        robot.person_arms();
        let gone_m = robot.drives_m(FIVE_SECONDS);
        assert!(gone_m < 0.01, "{protocol:?}: {gone_m} m with an empty battery");
        robot.nodes[1].faults().supply.voltage_v = 25.0;
        robot.steps(200);
        stands_until_a_person_arms_it(&mut robot, &format!("{protocol:?}"));
    }
}

#[test]
fn hot_controllers_slow_the_robot_down_where_the_protocol_reports_a_temperature() {
    for protocol in [Protocol::Odrive, Protocol::Vesc] {
        let mut robot = driving(robot(protocol));
        robot.nodes[0].faults().supply.motor_c = 120.0;
        robot.steps(300);
        let gone_m = robot.drives_m(100);
        assert!((0.05..0.08).contains(&gone_m), "{protocol:?}: {gone_m} m in a second");
        robot.nodes[0].faults().supply.motor_c = 50.0;
        robot.steps(300);
        let gone_m = robot.drives_m(100);
        assert!(gone_m > 0.15, "{protocol:?}: {gone_m} m in a second, cool again");
    }
}

#[test]
fn a_blocked_wheel_is_given_up_after_three_contacts() {
    for protocol in ALL {
        let mut robot = driving(robot(protocol));
        robot.nodes[0].wheel_mut().blocked = true;
        let mut pushed = 0;
        for _ in 0..18_000 {
            robot.step(None);
            pushed += usize::from(robot.is_driven());
        }
        assert!(pushed < 500, "{protocol:?}: pushed for {} s of 180 s", pushed as f64 * 0.01);
        assert_eq!(robot.state(), SafetyState::Fault(FaultReason::RepeatedContact));
        robot.nodes[0].wheel_mut().blocked = false;
        stands_until_a_person_arms_it(&mut robot, &format!("{protocol:?}"));
    }
}

#[test]
fn a_blocked_wheel_is_given_up_while_the_robot_rotates_too() {
    for protocol in ALL {
        let mut robot = driving(robot(protocol));
        robot.plan = Twist2 { linear_mps: 0.0, angular_radps: 0.6 };
        robot.steps(100);
        robot.nodes[0].wheel_mut().blocked = true;
        robot.steps(1000);
        assert_eq!(robot.state(), SafetyState::Fault(FaultReason::RepeatedContact), "{protocol:?}");
    }
}

#[test]
fn a_program_that_ends_leaves_its_motors_idle_and_without_an_expired_watchdog() {
    for protocol in ALL {
        let nodes = driving(robot(protocol)).end();
        for node in &nodes {
            assert!(!node.is_powered(), "{protocol:?}");
            let expired = node.watchdog().expired;
            // A VESC has no fault of its watchdog: it only brakes.
            assert!(expired == 0 || protocol == Protocol::Vesc, "{protocol:?}: {expired}");
        }
    }
}
