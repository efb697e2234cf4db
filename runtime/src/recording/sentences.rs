//! Events as sentences.

use crate::event::{
    BackOffEnd, DropReason, Event, FaultReason, GoalReason, NoGoalReason, PlanRefusal,
    RefusedInput, SafetyEvent, TripCause,
};
use crate::perception::NoDepth;

/// How much an event matters to the person who reads the log.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Severity {
    /// All is well.
    Info,
    /// Worth a look when it repeats.
    Warning,
    /// Something is broken.
    Error,
}

/// What happened and why, for a person.
#[must_use]
pub fn sentence(event: &Event) -> (Severity, String) {
    use Severity::{Error, Info, Warning};
    match event {
        Event::GoalChosen { x_m, y_m, why } => {
            (Info, format!("going to ({x_m:.2}, {y_m:.2}) m: {}", goal_reason(*why)))
        }
        Event::GoalReached => (Info, "goal reached".to_owned()),
        Event::GoalDropped { why } => (Info, format!("goal given up: {}", drop_reason(*why))),
        Event::NoGoal { why } => (Warning, format!("no goal: {}", no_goal_reason(*why))),
        Event::StandsWithoutFrames => {
            (Warning, "standing: no frame has come for too long".to_owned())
        }
        Event::Safety { what } => (Warning, safety(what)),
        Event::NoDepth { why } => {
            let severity = match why {
                NoDepth::NoFrame | NoDepth::FirstFrame | NoDepth::TooLittleParallax => Info,
                NoDepth::NetworkOutput | NoDepth::PoseNotFinite | NoDepth::FrameSize => Error,
                NoDepth::PoseJump | NoDepth::NoTexture | NoDepth::SamePicture => Warning,
            };
            (severity, format!("no depth: {}", no_depth(*why)))
        }
        Event::InputRefused { why } => (Error, format!("input refused: {}", refused(*why))),
        Event::NetworkTaken { digest } => {
            (Info, format!("another depth network: {}", digest.get(..12).unwrap_or(digest)))
        }
        Event::NetworkLeft => {
            (Warning, "no depth network any more: coarse depth counts".to_owned())
        }
        Event::PolicySwitched { to } => {
            (Info, format!("policy now looks for: {}", goal_reason(*to)))
        }
    }
}

fn goal_reason(why: GoalReason) -> &'static str {
    match why {
        GoalReason::Frontier => "free floor meets the unknown there",
        GoalReason::Inconsistency => "two looks at that place disagree",
        GoalReason::LookAgain => "a frontier behind doubtful marks, as no other can be reached",
        GoalReason::Revisit => "nothing new is left, so a known place from elsewhere",
    }
}

fn drop_reason(why: DropReason) -> &'static str {
    match why {
        DropReason::Unreachable => "the map has no way there any more",
        DropReason::NoProgress => "no progress towards it in time",
        DropReason::Blocked => "something stood in the way too often",
        DropReason::Resolved => "what was to be seen there has been seen",
        DropReason::PolicySwitched => "the policy looks for something else now",
        DropReason::Timeout => "its time is used up",
    }
}

fn no_goal_reason(why: NoGoalReason) -> &'static str {
    match why {
        NoGoalReason::NoFrontier => "no frontier is left",
        NoGoalReason::NoInconsistency => "the last two looks agree everywhere",
        NoGoalReason::AllUnreachable => "no candidate has a way to it",
        NoGoalReason::AllBlacklisted => "every candidate is on the blacklist for now",
        NoGoalReason::StartBlocked => {
            "the robot does not stand on floor that the map knows as free"
        }
    }
}

fn safety(what: &SafetyEvent) -> String {
    match what {
        SafetyEvent::Tripped { by, x_m, y_m } => {
            format!(
                "stopped for something at ({x_m:.2}, {y_m:.2}) m from the robot: {}",
                trip_cause(*by)
            )
        }
        SafetyEvent::BackedOff { distance_m, end } => {
            let end = match end {
                BackOffEnd::Distance => "the whole distance",
                BackOffEnd::RearBlocked => "something is behind",
                BackOffEnd::RearUnknown => "the ground behind was not observed",
                BackOffEnd::Timeout => "it took too long",
            };
            format!("backed off {distance_m:.2} m: {end}")
        }
        SafetyEvent::Escaping => "stops repeat here: turning until there is a way out".to_owned(),
        SafetyEvent::Cleared => "the way is clear again".to_owned(),
        SafetyEvent::Slowed { limit_mps } => {
            format!("slower, at most {limit_mps:.2} m/s")
        }
        SafetyEvent::ViewLost => "standing: the scanner does not see the way ahead".to_owned(),
        SafetyEvent::Faulted { why } => format!("standing: {}", fault_reason(*why)),
        SafetyEvent::PlanRefused { why } => format!("standing: {}", plan_refusal(*why)),
        SafetyEvent::Armed => "armed: plans move the robot".to_owned(),
        SafetyEvent::Disarmed => "disarmed: nothing moves the robot".to_owned(),
        SafetyEvent::ArmingLapsed { why } => {
            format!("not armed, and the request to arm is void: {}", fault_reason(*why))
        }
    }
}

/// For logs and `health` too.
#[must_use]
pub fn fault_reason(why: FaultReason) -> &'static str {
    match why {
        FaultReason::LidarSilent => "the LiDAR is silent",
        FaultReason::LidarBad => "too many beams are errors or none came back",
        FaultReason::BaseSilent => "the wheels do not tell how they turn",
        FaultReason::BaseFault => "the base cannot be driven",
        FaultReason::OdometryNotFinite => "odometry is not finite",
        FaultReason::LoopOverrun => "the safety loop came late",
        FaultReason::EmergencyStop => "emergency stop",
        FaultReason::SafetyBoardSilent => "the safety board sends nothing",
        FaultReason::LoopStalled => "the program was paused",
        FaultReason::RepeatedContact => "three contacts at one place",
        FaultReason::LidarFrozen => "the LiDAR repeats one scan",
        FaultReason::WheelsDisagree => "the wheels and the LiDAR measure different motions",
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
        TripCause::LidarTooNear => "something nearer than the LiDAR can measure",
        TripCause::Contact => "the base felt it",
    }
}

fn no_depth(why: NoDepth) -> &'static str {
    match why {
        NoDepth::NoFrame => "no picture came",
        NoDepth::FirstFrame => "no earlier picture yet",
        NoDepth::TooLittleParallax => "standing still or turning on the spot",
        NoDepth::PoseJump => "the pose jumped, earlier frames were forgotten",
        NoDepth::PoseNotFinite => "the pose is not finite",
        NoDepth::FrameSize => "the picture has another size than the camera model",
        NoDepth::NoTexture => "the picture has no texture to match",
        NoDepth::SamePicture => {
            "the robot has moved but the picture is the one before: the camera is frozen"
        }
        NoDepth::NetworkOutput => "the network failed or left its allowed range",
    }
}

fn refused(why: RefusedInput) -> &'static str {
    match why {
        RefusedInput::OdometryNotFinite => "odometry is not finite",
        RefusedInput::ScanShape => "the scan has another shape than the sensor",
        RefusedInput::FrameSize => "the picture has another size than the camera model",
        RefusedInput::TimeWentBack => "time went back",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trip_reads_like_a_sentence_with_its_place_and_cause() {
        let event = Event::Safety {
            what: SafetyEvent::Tripped { by: TripCause::LidarHit, x_m: 0.25, y_m: -0.1 },
        };
        let expected = "stopped for something at (0.25, -0.10) m from the robot: a LiDAR return in the stop zone";
        assert_eq!(sentence(&event), (Severity::Warning, expected.to_owned()));
    }

    #[test]
    fn standing_still_is_no_warning_but_a_bad_network_is_an_error() {
        assert_eq!(sentence(&Event::NoDepth { why: NoDepth::TooLittleParallax }).0, Severity::Info);
        assert_eq!(sentence(&Event::NoDepth { why: NoDepth::NetworkOutput }).0, Severity::Error);
    }
}
