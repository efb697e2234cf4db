//! Restart authority: what ends each stop.
//!
//! A robot that stopped because it could not see may continue when it sees again. A robot whose
//! motors lost power, whose program was suspended, or that was stopped by a person must not: the
//! person beside it may have a hand in a wheel. [`STOPS`] assigns every reason to one of the two
//! classes. The safety loop, `health`, and `docs/faults.md` all use this table.

use crate::event::FaultReason;

/// What has to happen before the robot may move again.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Restart {
    /// The robot continues on its own once there is this evidence, slowly at first
    /// ([`CREEP_MPS`], [`CREEP_RADPS`], for [`CREEP_NS`]).
    Evidence(&'static str),
    /// A person has to inspect the robot and arm it.
    Person,
}

/// One reason for a stop, and what ends the stop.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stop {
    pub why: FaultReason,
    /// The condition that causes the stop, with its limits.
    pub condition: &'static str,
    pub restart: Restart,
    /// The tests that check the stop and its end.
    pub tests: &'static str,
}

/// Highest speed for [`CREEP_NS`] after a stop that ended without a person: a third of the paper's
/// 0.3 m/s. From it, a base that brakes with 1 m/s2 stops within 5 mm.
pub const CREEP_MPS: f64 = 0.1;
/// Highest yaw rate during that time.
pub const CREEP_RADPS: f64 = 0.2;
/// Duration of the slow restart: a person who sees the robot start has a second to react.
pub const CREEP_NS: u64 = 1_000_000_000;

/// Every reason for a stop, once.
pub const STOPS: [Stop; 13] = [
    Stop {
        why: FaultReason::EmergencyStop,
        condition: "the emergency stop of the safety board, of an input line of the computer (GPIO), or of the operator; a broken wire, a line that cannot be read",
        restart: Restart::Person,
        tests: "`restart_authority::a_released_emergency_stop_moves_nothing`, \
                `run::the_safety_boards_emergency_stop_wins_and_survives_a_restart_of_the_program`, \
                `run::an_emergency_stop_on_an_input_line_wins_and_its_release_moves_nothing`",
    },
    Stop {
        why: FaultReason::SafetyBoardSilent,
        condition: "a configured safety board sends nothing new for 100 ms",
        restart: Restart::Person,
        tests: "`restart_authority::a_safety_board_that_was_unplugged_moves_nothing_when_it_is_back`",
    },
    Stop {
        why: FaultReason::BaseSilent,
        condition: "a motor sends no feedback for 100 ms: power cut, cable, or a restart",
        restart: Restart::Person,
        tests: "`restart_authority::motors_that_lose_power_and_get_it_back_stand`, \
                `run::motor_power_that_is_cut_and_restored_moves_nothing_before_sigusr1`",
    },
    Stop {
        why: FaultReason::BaseFault,
        condition: "a controller reports a fault, restarts or leaves operation; the bus fails; a wheel rotates against its command",
        restart: Restart::Person,
        tests: "`restart_authority::a_controller_that_restarts_at_once_is_noticed`, \
                `run::a_motor_that_broke_down_needs_a_person_and_sigusr1_is_that_person`",
    },
    Stop {
        why: FaultReason::LoopStalled,
        condition: "the safety loop, the program or the computer paused for more than 0.5 s",
        restart: Restart::Person,
        tests: "`restart_authority::a_program_that_was_suspended_stands_when_it_resumes`, \
                `run::a_program_that_was_stopped_for_three_seconds_stands_when_it_continues`",
    },
    Stop {
        why: FaultReason::RepeatedContact,
        condition: "three contacts within 30 s and 0.5 m: bumper, cliff sensor, or a wheel that does not rotate",
        restart: Restart::Person,
        tests: "`contact_tests::*`, `cliff_tests::*`, `restart_authority::a_blocked_wheel_is_given_up_after_three_contacts`",
    },
    Stop {
        why: FaultReason::WheelsDisagree,
        condition: "the wheels and the scanner disagree by more than 0.25 m or 0.5 rad: slip, lifted, stuck, wrong radius, track or sign",
        restart: Restart::Person,
        tests: "`witness::tests::*`",
    },
    Stop {
        why: FaultReason::LowBattery,
        condition: "the controllers report less than `low_battery_v` for 5 s; off by default",
        restart: Restart::Person,
        tests: "`power::tests::*`, `control::tests::a_low_battery_stops_the_robot_until_a_person_has_charged_it`, \
                `restart_authority::a_battery_that_runs_low_stops_the_robot_with_every_protocol_that_reports_it`",
    },
    Stop {
        why: FaultReason::LidarSilent,
        condition: "no scan for two periods of the scanner",
        restart: Restart::Evidence("consecutive good scans (`good_scans`)"),
        tests: "`plane::after_silence_three_good_scans_in_a_row_come_before_motion`, \
                `lidar_faults::silence_for_more_than_two_periods_is_a_timeout_and_no_old_scan`",
    },
    Stop {
        why: FaultReason::LidarBad,
        condition: "more than half of the beams are errors, none has a return, or beams are missing",
        restart: Restart::Evidence("consecutive good scans (`good_scans`)"),
        tests: "`faults::a_blind_or_broken_laser_is_not_free_space`",
    },
    Stop {
        why: FaultReason::LidarFrozen,
        condition: "the scanner repeats a scan bit for bit while the wheels move by 5 cm or 0.1 rad",
        restart: Restart::Evidence("consecutive scans that differ (`good_scans`)"),
        tests: "`view_tests::a_scanner_that_repeats_one_scan_while_the_robot_moves_is_frozen`",
    },
    Stop {
        why: FaultReason::OdometryNotFinite,
        condition: "the odometry contains NaN or infinity",
        restart: Restart::Evidence("finite odometry and good scans"),
        tests: "`plane::odometry_that_is_nan_stops_the_robot_and_is_never_used`",
    },
    Stop {
        why: FaultReason::LoopOverrun,
        condition: "a step of the safety loop is late by more than two periods, but by at most 0.5 s",
        restart: Restart::Evidence("a step in time"),
        tests: "`plane::a_tick_that_is_two_periods_late_stops_the_robot_and_it_continues_slowly`",
    },
];

impl FaultReason {
    /// Whether the robot stays where it is until a person arms it. A reason without a row in
    /// [`STOPS`] needs a person.
    #[must_use]
    pub fn needs_person(self) -> bool {
        STOPS
            .iter()
            .find(|stop| stop.why == self)
            .is_none_or(|stop| stop.restart == Restart::Person)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_reason_stands_in_the_table_once() {
        for stop in &STOPS {
            assert_eq!(STOPS.iter().filter(|other| other.why == stop.why).count(), 1, "{stop:?}");
        }
    }

    #[test]
    fn loss_of_power_feedback_or_time_and_every_stop_by_a_person_need_a_person() {
        for why in [
            FaultReason::EmergencyStop,
            FaultReason::SafetyBoardSilent,
            FaultReason::BaseSilent,
            FaultReason::BaseFault,
            FaultReason::LoopStalled,
            FaultReason::RepeatedContact,
            FaultReason::WheelsDisagree,
            FaultReason::LowBattery,
        ] {
            assert!(why.needs_person(), "{why:?}");
        }
        for why in [FaultReason::LidarSilent, FaultReason::LidarBad, FaultReason::LidarFrozen] {
            assert!(!why.needs_person(), "{why:?}");
        }
    }
}
