//! Faults of the motor controllers, the motors and the wheels.

use drivers::can::{BaseConfig, CanError, Phase, Protocol, Side, Trip};
use hal::{Error, ErrorKind};
use hil::motor::Rig;
use hil::motor::rig::config;
use hil::motor::wheel::{COAST_S, LAG_S};

use super::{
    ALL, MS, armed, driving, is_stopped, motion_frames, motion_frames_after, rig, rolls_out,
};

#[test]
fn feedback_that_stops_for_100_ms_stops_the_base() {
    for protocol in ALL {
        let mut rig = driving(protocol);
        rig.nodes[1].faults().silent = true;
        let began_ns = rig.now_ns;
        let ticks = (0..100).take_while(|_| rig.drive(0.2, 0.0).is_ok()).count();
        assert!(ticks < 100, "{protocol:?}: silence must stop the base");
        let took_ms = (rig.now_ns - began_ns) / MS;
        assert!((90..=120).contains(&took_ms), "{protocol:?}: {took_ms} ms");
        assert_eq!(rig.base.phase(), Phase::Tripped(Trip::FeedbackSilent(Side::Right)));
        (0..20).for_each(|_| rig.poll());
        assert!(is_stopped(&rig), "{protocol:?}");
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
        (0..5).for_each(|_| rig.poll());
        let outcome = rig.arm();
        assert!(outcome.is_err(), "{protocol:?}");
        assert_eq!(motion_frames_after(&mut rig, 100), 0);
    }
}

#[test]
fn a_controller_that_restarts_while_driving_stops_the_base() {
    for protocol in ALL {
        let mut rig = driving(protocol);
        rig.nodes[0].faults().reboot = true;
        (0..30).for_each(|_| drop(rig.drive(0.2, 0.0)));
        let expected = [Trip::MotorFault(Side::Left), Trip::MotorRestarted(Side::Left)];
        assert!(
            expected.map(Phase::Tripped).contains(&rig.base.phase()),
            "{protocol:?}: {}",
            rig.base.explain()
        );
        // The wheel of the controller that has restarted is not powered: it coasts.
        rolls_out(&mut rig, COAST_S, Rig::poll, &format!("{protocol:?}"));
    }
}

#[test]
fn a_drive_that_lost_its_power_and_its_configuration_can_be_armed_again() {
    for protocol in ALL {
        let mut rig = driving(protocol);
        for node in &mut rig.nodes {
            node.faults().boot_ns = 300 * MS;
            node.faults().unpowered = true;
        }
        (0..200).for_each(|_| rig.poll());
        assert!(!rig.base.is_armed());
        rig.nodes.iter_mut().for_each(|node| node.faults().unpowered = false);
        (0..300).for_each(|_| rig.poll());
        rig.arm().unwrap_or_else(|error| panic!("{protocol:?}: {error}; {}", rig.base.explain()));
        (0..100).for_each(|_| rig.drive(0.2, 0.0).expect("it drives"));
        assert!(!is_stopped(&rig), "{protocol:?}");
    }
}

#[test]
fn the_gear_ratio_is_applied_to_commands_and_to_feedback() {
    for protocol in ALL {
        let config = BaseConfig { gear_ratio: 3.0, ..config(protocol) };
        let mut rig = Rig::new(&config).expect("sound");
        rig.arm().expect("it arms");
        (0..150).for_each(|_| rig.drive(0.2, 0.0).expect("it drives"));
        // 0.2 m/s are 4 rad/s of a wheel with a radius of 5 cm, and 12 rad/s of its motor.
        let speeds = rig.wheels_radps();
        assert!(speeds.iter().all(|speed| (speed - 12.0).abs() < 0.2), "{protocol:?}: {speeds:?}");
        let motor_rad = rig.nodes[0].wheel().position_rad();
        let pose = rig.base.odometry().pose();
        assert!((pose.x_m - motor_rad / 3.0 * 0.05).abs() < 0.01, "{protocol:?}: {pose:?}");
    }
}

#[test]
fn a_drive_that_loses_its_host_brakes_instead_of_coasting() {
    let mut rig = driving(Protocol::Cia402);
    for node in &mut rig.nodes {
        node.wheel_mut().coast_s = 10.0;
    }
    rig.advance(400 * MS);
    assert!(is_stopped(&rig), "{:?}", rig.wheels_radps());
}

#[test]
fn a_fault_of_a_motor_stops_both_and_is_cleared_by_arming_once_it_is_gone() {
    for protocol in ALL {
        let mut rig = driving(protocol);
        rig.nodes[0].faults().broken = true;
        (0..30).for_each(|_| drop(rig.drive(0.2, 0.0)));
        assert_eq!(rig.base.phase(), Phase::Tripped(Trip::MotorFault(Side::Left)), "{protocol:?}");
        // With a fault, ODrive and VESC release the motor, and a CiA 402 drive brakes.
        let decay_s = if protocol == Protocol::Cia402 { LAG_S } else { COAST_S };
        rolls_out(&mut rig, decay_s, Rig::poll, &format!("{protocol:?}"));
        assert!(rig.arm().is_err(), "{protocol:?}: still broken");
        rig.nodes[0].faults().broken = false;
        (0..150).for_each(|_| rig.poll());
        rig.arm().unwrap_or_else(|error| panic!("{protocol:?}: {error}; {}", rig.base.explain()));
    }
}

#[test]
fn a_wheel_that_rotates_against_its_command_stops_the_base_within_centimetres_and_is_not_armed_again()
 {
    for protocol in ALL {
        let mut rig = armed(protocol);
        rig.nodes[1].wheel_mut().encoder_reversed = true;
        let ticks = (0..300).take_while(|_| rig.drive(0.2, 0.0).is_ok()).count();
        assert_eq!(
            rig.base.phase(),
            Phase::Tripped(Trip::WrongDirection(Side::Right)),
            "{protocol:?} after {ticks} ticks"
        );
        (0..100).for_each(|_| rig.poll());
        let travelled = rig.nodes[1].wheel().position_rad().abs() * 0.05;
        assert!(travelled < 0.06, "{protocol:?}: {travelled} m");
        let refused = Err(CanError::Tripped(Trip::WrongDirection(Side::Right)));
        assert_eq!(rig.base.arm(), refused);
        assert!(rig.base.explain().contains("invert_right"), "{}", rig.base.explain());
    }
}

/// Forward motion of a motor that is mounted in reverse is a negative velocity.
#[test]
fn a_motor_mounted_in_reverse_is_handled_by_invert_right() {
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
fn swapped_wheels_rotate_the_robot_in_the_right_direction_with_swap_wheels() {
    for protocol in ALL {
        // Node 1 is mounted right: in a left rotation it is the wheel that moves forward.
        let mut rig =
            Rig::new(&BaseConfig { swap_wheels: true, ..config(protocol) }).expect("sound");
        rig.arm().expect("it arms");
        (0..150).for_each(|_| rig.drive(0.0, 0.8).expect("it ticks"));
        let [node_1, node_2] = rig.wheels_radps();
        assert!(node_1 > 1.0 && node_2 < -1.0, "{protocol:?}: {node_1} {node_2}");
        assert!(rig.base.odometry().pose().yaw_rad > 0.5, "{protocol:?}");
    }
}

#[test]
fn a_blocked_wheel_is_contact() {
    for protocol in ALL {
        let mut rig = driving(protocol);
        rig.nodes[0].wheel_mut().blocked = true;
        let mut contact_after = None;
        for tick in 0..60 {
            rig.drive(0.2, 0.0).expect("it pushes");
            if let Ok(Some(feedback)) = &rig.feedback
                && feedback.contact
            {
                contact_after.get_or_insert(tick);
            }
        }
        assert!(
            contact_after.is_some_and(|tick| (25..45).contains(&tick)),
            "{protocol:?}: {contact_after:?}"
        );
    }
}

#[test]
fn a_robot_that_is_pushed_is_not_armed() {
    let mut rig = rig(Protocol::Odrive);
    assert!(rig.is_ready_after(100));
    for node in &mut rig.nodes {
        // The robot is pushed: the wheels keep rotating for a while.
        node.wheel_mut().coast_s = 10.0;
    }
    let mut rolling = driving(Protocol::Odrive);
    for node in &mut rolling.nodes {
        node.wheel_mut().coast_s = 10.0;
        node.faults().broken = true;
    }
    (0..30).for_each(|_| rolling.poll());
    assert!(
        matches!(rolling.base.arm(), Err(CanError::Moving { side: Side::Left, .. })),
        "{:?}",
        rolling.base.arm()
    );
}

/// The wheels' true speed is the commanded one, and so is the reported speed.
#[test]
fn the_speed_that_the_base_reports_is_that_of_its_wheels_also_of_one_mounted_in_reverse() {
    for protocol in ALL {
        for (invert_left, invert_right) in [(false, false), (true, false), (false, true)] {
            let config = BaseConfig { invert_left, invert_right, ..config(protocol) };
            let mut rig = Rig::new(&config).expect("sound");
            rig.arm().expect("it arms");
            (0..150).for_each(|_| rig.drive(0.2, 0.0).expect("it drives"));
            let twist = rig.feedback.as_ref().expect("feedback").expect("new feedback").twist;
            let is_right = (twist.linear_mps - 0.2).abs() < 0.01 && twist.angular_radps.abs() < 0.1;
            assert!(is_right, "{protocol:?}, {invert_left}, {invert_right}: {twist:?}");
        }
    }
}

#[test]
fn wheels_of_different_radius_drive_straight_and_measure_a_straight_line() {
    for protocol in ALL {
        let config = BaseConfig { right_radius_scale: 0.8, ..config(protocol) };
        let mut rig = Rig::new(&config).expect("sound");
        rig.arm().expect("it arms");
        (0..150).for_each(|_| rig.drive(0.2, 0.0).expect("it drives"));
        // 0.2 m/s are 4 rad/s of a wheel with a radius of 5 cm, and 5 rad/s of one with 4 cm.
        let [left, right] = rig.wheels_radps();
        assert!((left - 4.0).abs() < 0.1 && (right - 5.0).abs() < 0.1, "{left} {right}");
        let pose = rig.base.odometry().pose();
        assert!(pose.x_m > 0.2 && pose.yaw_rad.abs() < 0.03, "{protocol:?}: {pose:?}");
    }
}

#[test]
fn feedback_of_one_wheel_alone_is_no_feedback() {
    for protocol in ALL {
        let mut rig = driving(protocol);
        rig.nodes[1].faults().silent = true;
        rig.drive(0.2, 0.0).expect("it drives");
        for _ in 0..5 {
            rig.drive(0.2, 0.0).expect("the other wheel may still report in time");
            assert_eq!(rig.feedback, Ok(None), "{protocol:?}");
        }
    }
}
