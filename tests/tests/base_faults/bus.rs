//! Faults of the CAN bus and of the host's interface to it.

use drivers::can::protocol::MotorStage;
use drivers::can::{
    BusEvent, CanBus, CanError, CanFrame, CanId, ErrorState, Phase, Protocol, Trip,
};
use hal::{Base, Error, ErrorKind};
use hil::motor::LineFaults;

use super::{ALL, MS, armed, driving, is_stopped, motion_frames};

#[test]
fn after_a_bus_off_no_motion_is_sent_until_the_base_is_armed_again() {
    for protocol in ALL {
        let mut rig = driving(protocol);
        // The bus is jammed for two ticks: commands wait in the queue. Then the controller goes
        // bus-off.
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
        assert!(is_stopped(&rig), "{protocol:?}");
        assert_eq!(rig.base.counts().bus_off, 1);
        rig.arm().unwrap_or_else(|error| panic!("{protocol:?}: {error}"));
        for _ in 0..100 {
            rig.drive(0.2, 0.0).expect("armed again");
        }
        assert!(!is_stopped(&rig));
    }
}

/// An interface without `restart-ms`: the kernel leaves its controller off the bus.
#[test]
fn a_controller_that_stays_bus_off_is_never_armed_and_drives_again_after_its_restart() {
    for protocol in ALL {
        let mut rig = driving(protocol);
        rig.host.bus_off();
        assert_eq!(rig.drive(0.2, 0.0), Err(CanError::Tripped(Trip::BusOff)));
        for _ in 0..3 {
            assert!(rig.arm().is_err(), "{protocol:?}: armed without a bus");
        }
        assert!(is_stopped(&rig), "{protocol:?}");
        // An administrator restarts it: `ip link set can0 type can restart`.
        rig.host.restart();
        assert!(rig.is_ready_after(1000), "{protocol:?}: {}", rig.base.explain());
        rig.arm().unwrap_or_else(|error| panic!("{protocol:?}: {error}; {}", rig.base.explain()));
        for _ in 0..100 {
            rig.drive(0.2, 0.0).expect("armed again");
        }
        assert!(!is_stopped(&rig), "{protocol:?}");
    }
}

#[test]
fn a_bus_that_goes_off_repeatedly_is_retried_with_an_increasing_delay() {
    let mut rig = driving(Protocol::Odrive);
    let mut tries = 0;
    for _ in 0..2000 {
        let _ = rig.host.take_sent();
        rig.poll();
        if !rig.host.take_sent().is_empty() {
            tries += 1;
            rig.host.bus_off();
            rig.host.restart();
        }
    }
    // In 20 s there are attempts after 0.1, 0.2, 0.4, 0.8 and 1.6 s, then every 2 s.
    assert!((8..=16).contains(&tries), "{tries} tries in 20 s");
    assert!(rig.base.arm().is_err());
}

#[test]
fn a_storm_of_error_frames_costs_a_bounded_amount_of_work_per_turn() {
    let mut rig = driving(Protocol::Odrive);
    for _ in 0..100_000 {
        rig.host.notify(BusEvent::NoAcknowledge);
    }
    let before = rig.base.counts().bus_errors;
    rig.poll();
    assert!(rig.base.counts().bus_errors - before <= 256);
    // Feedback is delayed by the storm, which counts as silence and stops the base.
    (0..15).for_each(|_| rig.poll());
    assert!(matches!(rig.base.phase(), Phase::Tripped(_)));
}

#[test]
fn error_counters_of_the_controller_are_reported() {
    let mut rig = driving(Protocol::Odrive);
    rig.host.errors(ErrorState::Passive, 130, 7);
    rig.poll();
    assert_eq!(rig.base.bus_health(), (ErrorState::Passive, (130, 7)));
    assert!(rig.base.is_armed(), "error-passive still carries frames");
}

#[test]
fn a_full_transmit_queue_loses_a_frame_and_never_delays_one() {
    for protocol in ALL {
        let mut rig = driving(protocol);
        rig.host.set_faults(LineFaults { full: true, ..LineFaults::default() });
        rig.drive(0.2, 0.0).expect("one tick without sending is no fault");
        rig.host.set_faults(LineFaults::default());
        let _ = rig.host.take_sent();
        rig.drive(0.2, 0.0).expect("and the next frame is sent");
        let motions = motion_frames(&rig);
        assert_eq!(motions, 2, "{protocol:?}: one frame per wheel, nothing sent late");
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
fn foreign_frames_are_ignored_and_counted() {
    for protocol in ALL {
        let mut rig = driving(protocol);
        let mut foreign_node = rig.host.connect();
        let before = rig.base.counts().foreign;
        for tick in 0..100u8 {
            let payload = [tick, 1, 2, 3, 4, 5, 6, 7];
            for frame in [
                CanFrame::standard(0x3e5, payload),
                CanFrame::extended_short(0x18fe_f100, payload, 8),
                CanFrame::remote(CanId::Standard(0x7f0), 8).expect("sound"),
            ] {
                let _ = foreign_node.send(&frame);
            }
            rig.drive(0.2, 0.0).expect("undisturbed");
        }
        assert_eq!(rig.base.counts().foreign - before, 300, "{protocol:?}");
        assert!(rig.wheels_radps().iter().all(|speed| (speed - 4.0).abs() < 0.05));
    }
}

#[test]
fn lost_doubled_and_late_frames_do_not_stop_the_base_or_spoil_odometry() {
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
        rig.poll();
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
fn after_a_bus_off_no_motor_counts_as_set_up() {
    for protocol in ALL {
        let mut rig = driving(protocol);
        rig.host.bus_off();
        assert_eq!(rig.drive(0.2, 0.0), Err(CanError::Tripped(Trip::BusOff)));
        for motor in rig.base.motors() {
            assert_eq!((motor.stage, motor.watchdog_ms), (MotorStage::SettingUp, None));
        }
    }
}
