//! Every stop, refusal, choice and end has a reason, and all reasons stand here.

use serde::{Deserialize, Serialize};

use crate::perception::NoDepth;

/// Something that a person who asks "why did it do that?" wants to read.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
#[non_exhaustive]
pub enum Event {
    /// A place to go to was chosen.
    GoalChosen {
        /// Target in `odom`, metres.
        x_m: f64,
        /// Target in `odom`, metres.
        y_m: f64,
        /// What makes it worth going there.
        why: GoalReason,
    },
    /// The goal was reached.
    GoalReached,
    /// The goal was given up.
    GoalDropped {
        /// Why.
        why: DropReason,
    },
    /// No goal could be chosen this time.
    NoGoal {
        /// Why.
        why: NoGoalReason,
    },
    /// The safety plane changed its state.
    Safety {
        /// What happened.
        what: SafetyEvent,
    },
    /// This picture gave no depth.
    NoDepth {
        /// Why.
        why: NoDepth,
    },
    /// No frame has come for too long: the robot stands until there is one.
    StandsWithoutFrames,
    /// An input was refused; the loop goes on without it.
    InputRefused {
        /// Why.
        why: RefusedInput,
    },
    /// Another depth network was handed over; it counts from this turn on.
    NetworkTaken {
        /// BLAKE3 digest of its file, in hex.
        digest: String,
    },
    /// The depth network was taken away and none came; from this turn on, coarse depth counts.
    NetworkLeft,
    /// The policy moved from one way of choosing goals to another.
    PolicySwitched {
        /// The new way.
        to: GoalReason,
    },
}

/// What makes a goal worth going to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum GoalReason {
    /// Free floor meets the unknown there.
    Frontier,
    /// Two looks at the same place disagree there.
    Inconsistency,
    /// A frontier behind marks that are old or were seen seldom: nothing else can be reached, and going near shows whether
    /// they are still there.
    LookAgain,
    /// Nothing else is left; a far known place, to look again from elsewhere.
    Revisit,
}

/// Why a goal was given up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum DropReason {
    /// The map no longer has a way there.
    Unreachable,
    /// No progress towards it within the progress timeout.
    NoProgress,
    /// The safety plane tripped on the way too often.
    Blocked,
    /// What made it worth going there has been seen meanwhile.
    Resolved,
    /// The policy switched to another way of choosing goals.
    PolicySwitched,
    /// The budget for one goal is used up.
    Timeout,
}

/// Why no goal could be chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum NoGoalReason {
    /// No frontier is left in the map.
    NoFrontier,
    /// The last two looks agree everywhere.
    NoInconsistency,
    /// There are candidates, but none has a way to it.
    AllUnreachable,
    /// There are candidates, but all are on the blacklist for now.
    AllBlacklisted,
    /// The robot does not stand on floor that the map knows as free.
    StartBlocked,
}

/// What the safety plane did.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum SafetyEvent {
    /// Stopped: something is in the stop zone.
    Tripped {
        /// What noticed it.
        by: TripCause,
        /// Where it is, in `base_link`, metres.
        x_m: f64,
        /// Where it is, in `base_link`, metres.
        y_m: f64,
    },
    /// Backing off has ended and the blocked cell was handed to the planner.
    BackedOff {
        /// How far it went, metres.
        distance_m: f64,
        /// Why it ended.
        end: BackOffEnd,
    },
    /// Repeated trips at one place: turning on the spot until there is a way out.
    Escaping,
    /// The way is clear again.
    Cleared,
    /// Something is ahead: slower, so that the robot can stop before it.
    Slowed {
        /// The speed from which it still can, m/s.
        limit_mps: f64,
    },
    /// Stopped, and stands until the reason is gone.
    Faulted {
        /// Why.
        why: FaultReason,
    },
    /// A plan is not followed; the robot stands until a better one comes.
    PlanRefused {
        /// Why.
        why: PlanRefusal,
    },
    /// Plans move the robot from now on.
    Armed,
    /// Nothing moves the robot from now on.
    Disarmed,
}

/// Why nothing may move the robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum FaultReason {
    /// No scan that is new enough to drive by.
    LidarSilent,
    /// Too many beams of the scan are errors, or none came back.
    LidarBad,
    /// The wheels have not told for too long how they turn.
    BaseSilent,
    /// The base cannot be reached, reports a fault, or refuses to be driven.
    BaseFault,
    /// Odometry holds NaN or infinity.
    OdometryNotFinite,
    /// The loop came late by more than two of its periods.
    LoopOverrun,
    /// The emergency stop is pressed.
    EmergencyStop,
}

impl FaultReason {
    /// Whether the robot may go on by itself when the reason is gone. The others need an operator.
    #[must_use]
    pub fn clears_itself(self) -> bool {
        !matches!(self, Self::BaseFault | Self::EmergencyStop)
    }

    /// What an error of the base means. Silence passes; whatever else is wrong with motors, a person has to look at.
    #[must_use]
    pub fn of_base(kind: hal::ErrorKind) -> Self {
        if kind == hal::ErrorKind::Timeout { Self::BaseSilent } else { Self::BaseFault }
    }
}

/// Why a plan is not followed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum PlanRefusal {
    /// There is none yet.
    None,
    /// It holds NaN or infinity. Such a command is refused, never clamped.
    NotFinite,
    /// It is too old.
    Stale,
}

/// What noticed the obstacle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum TripCause {
    /// A LiDAR return in the stop zone.
    LidarHit,
    /// Something nearer than the LiDAR can measure.
    LidarTooNear,
    /// The base felt it.
    Contact,
}

/// Why backing off ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum BackOffEnd {
    /// It went the whole distance.
    Distance,
    /// Something is behind.
    RearBlocked,
    /// Nobody has looked at the ground behind.
    RearUnknown,
    /// It took too long.
    Timeout,
}

/// Why an input was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum RefusedInput {
    /// Odometry holds NaN or infinity.
    OdometryNotFinite,
    /// The scan's shape is not the sensor's.
    ScanShape,
    /// The picture has another size than the camera model.
    FrameSize,
    /// Time went back.
    TimeWentBack,
}

/// Why exploration ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum ExploreEnd {
    /// The wanted number of frames was seen.
    FrameBudget,
    /// Nothing is left to explore that can be reached.
    Explored,
    /// The user asked for it.
    Interrupted,
    /// The disk is full or the output cannot be written.
    OutputFailed,
    /// A device failed for good.
    DeviceFailed,
}
