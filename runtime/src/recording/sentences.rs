//! The sentences that describe events in logs, in `health` and in the viewer.

use super::calibration_words::{changed, withdrawn};
use crate::event::{
    BackOffEnd, DropReason, Event, FaultReason, GoalReason, NoGoalReason, PlanRefusal,
    RefusedInput, SafetyEvent, TripCause,
};
use crate::localization::{LostReason, WheelError};
use crate::perception::NoDepth;

/// Level of a log message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Severity {
    /// An event of normal operation.
    Info,
    /// Worth investigating when it repeats.
    Warning,
    /// Something is broken or wrongly configured.
    Error,
}

/// What happened and why, as a sentence for a log.
#[must_use]
pub fn sentence(event: &Event) -> (Severity, String) {
    use Severity::{Error, Info, Warning};
    match event {
        Event::GoalChosen { x_m, y_m, why } => {
            (Info, format!("going to ({x_m:.2}, {y_m:.2}) m: {}", goal_reason(*why)))
        }
        Event::GoalReached => (Info, "goal reached".to_owned()),
        // A place that was observed from afar is as good as one that was reached.
        Event::GoalDropped { why: DropReason::Resolved } => (Info, "goal seen from afar".to_owned()),
        Event::GoalDropped { why } => (Info, format!("goal given up: {}", drop_reason(*why))),
        Event::NoGoal { why } => (Warning, format!("no goal: {}", no_goal_reason(*why))),
        Event::StandsWithoutFrames => {
            (Warning, "stopped: no frame has arrived for too long".to_owned())
        }
        Event::Safety { what } => (Warning, safety(what)),
        Event::NoDepth { why } => {
            let severity = match why {
                NoDepth::NoFrame
                | NoDepth::FirstFrame
                | NoDepth::TooLittleParallax
                | NoDepth::Lost => Info,
                NoDepth::NetworkOutput | NoDepth::PoseNotFinite | NoDepth::FrameSize => Error,
                NoDepth::PoseJump | NoDepth::NoTexture | NoDepth::SameImage => Warning,
            };
            (severity, format!("no depth: {}", no_depth(*why)))
        }
        Event::InputRefused { why } => (Error, format!("input refused: {}", refused(*why))),
        Event::NetworkTaken { digest } => {
            (Info, format!("depth network loaded: {}", digest.get(..12).unwrap_or(digest)))
        }
        Event::NetworkLeft => {
            (Warning, "depth network removed: the map uses depth that needs no network".to_owned())
        }
        Event::MapCorrected { shift_m } => {
            (Info, format!("a loop was closed: the map moved {shift_m:.2} m at the robot's place"))
        }
        Event::Lost { why } => (Warning, format!("lost: {}", lost_reason(*why))),
        Event::Found { shift_m } => {
            (Info, format!("found: the robot is {shift_m:.2} m from where it was believed to be"))
        }
        Event::MapBegun => (
            Warning,
            "does not recognize this place: begins another map, which becomes one with the map before where both show the same place"
                .to_owned(),
        ),
        Event::MapChanged => (Info, "found in another of its maps, and goes on there".to_owned()),
        Event::MapsJoined => {
            (Info, "recognizes a place of another map: both are one map from now on".to_owned())
        }
        Event::StandsLost => (
            Warning,
            "stopped: the robot is lost and does not recognize this place; move it, or clear the map"
                .to_owned(),
        ),
        Event::StandsTilted { tilt_deg } => (
            Warning,
            format!(
                "stopped: the robot is tilted by {tilt_deg:.0} degrees; put it on level floor, or correct the mount in [devices.imu]"
            ),
        ),
        Event::LevelAgain => (Info, "the robot is level again".to_owned()),
        Event::WheelsContradicted { how } => {
            (Warning, format!("wheels and scans disagree: {}", wheel_error(*how)))
        }
        Event::GyroscopeRefused => (
            Warning,
            "the gyroscope contradicts the scans and is not used any more: check the mount in [devices.imu]"
                .to_owned(),
        ),
        Event::CalibrationChanged { change } => (Warning, changed(change)),
        Event::CalibrationChangeWithdrawn { withdrawal } => (Info, withdrawn(withdrawal)),
        Event::OutsidePosesSilent => (
            Warning,
            "no pose from outside for a second: the wheels give the pose until one comes".to_owned(),
        ),
        Event::Explored => (Info, "all reachable floor seen".to_owned()),
        Event::Operator { order } => {
            (if order.refused.is_some() { Warning } else { Info }, order.sentence())
        }
        Event::PolicySwitched { to } => {
            (Info, format!("policy now chooses goals by: {}", goal_reason(*to)))
        }
    }
}

/// Why a goal was chosen.
#[must_use]
pub fn goal_reason(why: GoalReason) -> &'static str {
    match why {
        GoalReason::Frontier => "free floor beside unknown space",
        GoalReason::Inconsistency => "two observations of that place disagree",
        GoalReason::DoubtfulFrontier => {
            "a frontier behind uncertain obstacles; no other can be reached"
        }
        GoalReason::Task => "the operator asked for it",
        GoalReason::Return => "back to where the run began",
        GoalReason::Revisit => "nothing unknown is left; a known place seen from another side",
    }
}

/// Why a goal was given up.
#[must_use]
pub fn drop_reason(why: DropReason) -> &'static str {
    match why {
        DropReason::Unreachable => "the map has no path to it any more",
        DropReason::NoProgress => "no progress towards it in time",
        DropReason::Blocked => "the safety plane stopped the robot on the path too often",
        DropReason::Resolved => "the place has been observed meanwhile",
        DropReason::PolicySwitched => "the policy chooses goals by another criterion now",
        DropReason::Task => "the operator gave another task",
        DropReason::Timeout => "the time for one goal is used up",
    }
}

fn no_goal_reason(why: NoGoalReason) -> &'static str {
    match why {
        NoGoalReason::NoFrontier => "no frontier is left",
        NoGoalReason::NoInconsistency => "the last two observations agree everywhere",
        NoGoalReason::AllUnreachable => "no candidate has a path to it",
        NoGoalReason::AllBlacklisted => "every candidate is on the blacklist for now",
        NoGoalReason::StartBlocked => "the floor under the robot is not free in the map",
    }
}

/// Why the robot does not know where it is. `health` and logs show it.
#[must_use]
pub fn lost_reason(why: LostReason) -> &'static str {
    match why {
        LostReason::ScanDoesNotFit => "scans do not fit what was seen a moment ago",
        LostReason::Carried => "scans changed while the wheels stood: the robot was carried",
        LostReason::Loaded => "the robot was started in a saved map",
    }
}

fn wheel_error(how: WheelError) -> &'static str {
    match how {
        WheelError::Spin => "the wheels spin, or the robot is held",
        WheelError::Pushed => "the robot moves and its wheels do not: it is pushed or carried",
        WheelError::Reversed => "the robot moves as far as its wheels report, the other way",
    }
}

fn safety(what: &SafetyEvent) -> String {
    match what {
        SafetyEvent::Tripped { by, x_m, y_m } => {
            format!(
                "stopped for an obstacle at ({x_m:.2}, {y_m:.2}) m from the robot: {}",
                trip_cause(*by)
            )
        }
        SafetyEvent::BackedOff { distance_m, end } => {
            let end = match end {
                BackOffEnd::Distance => "the whole distance",
                BackOffEnd::RearBlocked => "an obstacle is behind",
                BackOffEnd::RearUnknown => "the ground behind was not observed",
                BackOffEnd::Timeout => "it took too long",
            };
            format!("backed off {distance_m:.2} m: {end}")
        }
        SafetyEvent::Escaping => {
            "repeated stops at this place: rotating until there is a way out".to_owned()
        }
        SafetyEvent::Cleared => "the stop zone is clear again".to_owned(),
        SafetyEvent::Slowed { limit_mps } => format!("slowed down to {limit_mps:.2} m/s"),
        SafetyEvent::ViewLost => "stopped: the scanner does not see the way ahead".to_owned(),
        SafetyEvent::Faulted { why } => format!("stopped: {}", fault_reason(*why)),
        SafetyEvent::PlanRefused { why } => format!("stopped: {}", plan_refusal(*why)),
        SafetyEvent::Armed => "armed: plans move the robot".to_owned(),
        SafetyEvent::Disarmed => "disarmed: nothing moves the robot".to_owned(),
        SafetyEvent::ArmingLapsed { why } => {
            format!(
                "not armed: arming was cancelled: {}; send the request again",
                fault_reason(*why)
            )
        }
    }
}

/// Why nothing may move the robot. `health` and logs show it.
#[must_use]
pub fn fault_reason(why: FaultReason) -> &'static str {
    match why {
        FaultReason::LidarSilent => "no new scan from the LiDAR",
        FaultReason::LidarBad => "too many beams are errors, or no beam returned",
        FaultReason::BaseSilent => "no wheel feedback from the base",
        FaultReason::BaseFault => "the base cannot be driven",
        FaultReason::OdometryNotFinite => "odometry is not finite",
        FaultReason::LoopOverrun => "the safety loop was late",
        FaultReason::EmergencyStop => "the emergency stop is pressed",
        FaultReason::SafetyBoardSilent => "no message from the safety board",
        FaultReason::LoopStalled => "the program was paused",
        FaultReason::RepeatedContact => "three contacts at one place",
        FaultReason::LidarFrozen => "the LiDAR repeats one scan",
        FaultReason::WheelsDisagree => "the wheels and the LiDAR measure different motions",
        FaultReason::LowBattery => "the battery is low",
    }
}

fn plan_refusal(why: PlanRefusal) -> &'static str {
    match why {
        PlanRefusal::None => "there is no plan yet",
        PlanRefusal::NotFinite => "the plan is not finite",
        PlanRefusal::Stale => "the plan is too old",
    }
}

fn trip_cause(by: TripCause) -> &'static str {
    match by {
        TripCause::LidarHit => "a LiDAR return in the stop zone",
        TripCause::LidarTooNear => "an obstacle nearer than the LiDAR can measure",
        TripCause::Contact => "the base reported contact",
        TripCause::Cliff => "a cliff sensor saw no floor",
    }
}

fn no_depth(why: NoDepth) -> &'static str {
    match why {
        NoDepth::NoFrame => "no image arrived",
        NoDepth::FirstFrame => "no earlier image yet",
        NoDepth::TooLittleParallax => {
            "too little parallax: the robot does not move or only rotates"
        }
        NoDepth::PoseJump => "the pose jumped, earlier frames were forgotten",
        NoDepth::PoseNotFinite => "the pose is not finite",
        NoDepth::FrameSize => "the image has another size than the camera model",
        NoDepth::NoTexture => "the image has no texture to match",
        NoDepth::SameImage => {
            "the robot has moved but the image is the previous one: the camera is frozen"
        }
        NoDepth::Lost => "the robot is lost",
        NoDepth::NetworkOutput => "the network failed or its output is out of range",
    }
}

fn refused(why: RefusedInput) -> &'static str {
    match why {
        RefusedInput::OdometryNotFinite => "odometry is not finite",
        RefusedInput::ScanShape => {
            "the scan has another number of beams than its geometry, or no pose"
        }
        RefusedInput::FrameSize => "the image has another size than the camera model",
        RefusedInput::TimeWentBack => "time went back",
        RefusedInput::OutsidePoseNotFinite => "the pose from outside is not finite",
        RefusedInput::OutsidePoseTime => {
            "the pose from outside is too old, ahead of this computer's monotonic clock, or a repetition"
        }
        RefusedInput::OutsidePoseJump => {
            "the pose from outside has jumped; the wheels carry the pose over the jump"
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trip_is_described_by_its_place_and_cause() {
        let event = Event::Safety {
            what: SafetyEvent::Tripped { by: TripCause::LidarHit, x_m: 0.25, y_m: -0.1 },
        };
        let expected = "stopped for an obstacle at (0.25, -0.10) m from the robot: a LiDAR return in the stop zone";
        assert_eq!(sentence(&event), (Severity::Warning, expected.to_owned()));
    }

    #[test]
    fn missing_parallax_is_information_but_a_bad_network_is_an_error() {
        assert_eq!(sentence(&Event::NoDepth { why: NoDepth::TooLittleParallax }).0, Severity::Info);
        assert_eq!(sentence(&Event::NoDepth { why: NoDepth::NetworkOutput }).0, Severity::Error);
    }
}
