//! The reasons of every stop, refusal, choice and end.

use serde::{Deserialize, Serialize};

use crate::calibration_watch::{Change, Withdrawal};
use crate::localization::{LostReason, WheelError};
use crate::operator::OperatorOrder;
use crate::perception::NoDepth;

/// An entry of the log: what the robot decided, and why.
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
        /// Why it was chosen.
        why: GoalReason,
    },
    /// The goal was reached.
    GoalReached,
    /// The goal was given up.
    GoalDropped { why: DropReason },
    /// No goal could be chosen this time.
    NoGoal { why: NoGoalReason },
    /// The safety plane changed its state.
    Safety { what: SafetyEvent },
    /// This frame gave no depth.
    NoDepth { why: NoDepth },
    /// No frame has arrived for too long: the robot stands until there is one.
    StandsWithoutFrames,
    /// An input was refused; the loop continues without it.
    InputRefused { why: RefusedInput },
    /// Another depth network is used from this tick on.
    NetworkTaken {
        /// BLAKE3 digest of its file, in hex.
        digest: String,
    },
    /// The depth network was removed without a successor; the map uses depth that needs no network from this tick on.
    NetworkLeft,
    /// Localization closed a loop, and the map was drawn anew on the corrected path.
    MapCorrected {
        /// How far the robot's own place in `map` moved, metres.
        shift_m: f64,
    },
    /// The robot no longer knows where it is in the map. It makes no depth and no map, and searches for itself.
    Lost { why: LostReason },
    /// The robot knows again where it is.
    Found {
        /// How far that is from where it was believed to be, metres.
        shift_m: f64,
    },
    /// The robot has rotated and did not find itself in the map: it stands.
    StandsLost,
    /// The robot has rotated and did not find itself in the map: it begins another one, and explores on.
    MapBegun,
    /// The robot was lost and has found itself in another of its maps: poses in `map` are of that one now.
    MapChanged,
    /// The robot has come to a place of another of its maps, and both are one now, in the frame of the older.
    MapsJoined,
    /// The robot is tilted: it stands and maps nothing until it is level.
    StandsTilted {
        /// Angle between its vertical axis and gravity, degrees.
        tilt_deg: f64,
    },
    /// The robot is level again, or its tilt is not measured any more: it goes on.
    LevelAgain,
    /// The wheels report another motion than the scans; the scans keep the pose.
    WheelsContradicted {
        /// The kind of the difference.
        how: WheelError,
    },
    /// The gyroscope has contradicted the scans so often that it is not used any more in this run.
    GyroscopeRefused,
    /// A sensor or a wheel is no longer as it was at the beginning of the run. It comes once for each change.
    CalibrationChanged {
        /// What has changed, by how much and since when.
        change: Change,
    },
    /// A change that was reported is not confirmed by what followed, or was undone.
    CalibrationChangeWithdrawn {
        /// Of what, and how far it is from its value before.
        withdrawal: Withdrawal,
    },
    /// The program that sent poses has sent none for a second; the wheels give the pose. It comes once until the next pose.
    OutsidePosesSilent,
    /// No frontier is left that the robot can reach: all floor that it can reach has been seen. It comes once.
    Explored,
    /// The policy changed the way in which it chooses goals.
    PolicySwitched {
        /// The new way.
        to: GoalReason,
    },
    /// An order of the operator came, and was accepted or refused.
    Operator {
        /// What was ordered, by which client.
        order: OperatorOrder,
    },
}

/// Why a goal was chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum GoalReason {
    /// Free floor borders on unknown space there.
    Frontier,
    /// Two observations of the same place disagree there.
    Inconsistency,
    /// A frontier behind obstacles that are old or were observed seldom: nothing else can be reached, and from nearby the
    /// robot observes whether they are still there.
    DoubtfulFrontier,
    /// Nothing else is left; a distant known place is observed again from elsewhere.
    Revisit,
    /// The operator asked for it.
    Task,
    /// The robot returns to where the run began.
    Return,
}

impl GoalReason {
    /// Two words at most, for a line of progress.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Frontier => "frontier",
            Self::Inconsistency => "inconsistency",
            Self::DoubtfulFrontier => "doubtful frontier",
            Self::Revisit => "revisit",
            Self::Task => "task",
            Self::Return => "return",
        }
    }
}

/// Why a goal was given up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum DropReason {
    /// The map no longer has a path to it.
    Unreachable,
    /// No progress towards it within the progress timeout.
    NoProgress,
    /// The safety plane tripped too often on the way.
    Blocked,
    /// What was to be observed there has been observed.
    Resolved,
    /// The policy changed the way in which it chooses goals.
    PolicySwitched,
    /// The time for one goal is used up.
    Timeout,
    /// The operator gave another task.
    Task,
}

/// Why no goal could be chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum NoGoalReason {
    /// No frontier is left in the map.
    NoFrontier,
    /// The last two observations agree everywhere.
    NoInconsistency,
    /// There are candidates, but none has a path to it.
    AllUnreachable,
    /// There are candidates, but all are on the blacklist at present.
    AllBlacklisted,
    /// The robot does not stand on floor that the map knows as free.
    StartBlocked,
}

/// What the safety plane did.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum SafetyEvent {
    /// It stopped the robot: an obstacle is in the stop zone, or the base reports a contact or a cliff.
    Tripped {
        /// What detected the obstacle.
        by: TripCause,
        /// Position of the obstacle in `base_link`, metres.
        x_m: f64,
        /// Position of the obstacle in `base_link`, metres.
        y_m: f64,
    },
    /// The back-off has ended, and the blocked cell was reported to the planner.
    BackedOff {
        /// Length of the back-off, metres.
        distance_m: f64,
        /// Why it ended.
        end: BackOffEnd,
    },
    /// Repeated trips at one place: the robot rotates on the spot until a direction is free.
    Escaping,
    /// The way is clear again.
    Cleared,
    /// Plans pass at a reduced speed: an obstacle is near, the view ahead is incomplete, or the
    /// robot continues after a stop.
    Slowed {
        /// The highest speed that is allowed now, m/s.
        limit_mps: f64,
    },
    /// The robot stands because the scanner has not seen the way ahead for too long.
    ViewLost,
    /// It stopped the robot until the condition of the stop has ended.
    Faulted { why: FaultReason },
    /// A plan is not followed; the robot stands until there is a valid one.
    PlanRefused { why: PlanRefusal },
    /// Plans move the robot from now on.
    Armed,
    /// Nothing moves the robot from now on.
    Disarmed,
    /// A request to arm was cancelled, because the robot could not be armed in time or because of an
    /// event that needs a person. It has to be given again.
    ArmingLapsed {
        /// What prevented the arming.
        why: FaultReason,
    },
}

/// Why nothing may move the robot. `runtime::safety::STOPS` lists what ends each of these stops.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum FaultReason {
    /// No scan is new enough to drive by.
    LidarSilent,
    /// Too many beams of the scan are errors, or none came back.
    LidarBad,
    /// The wheels have reported no motion for too long: no power, no cable, or a restart.
    BaseSilent,
    /// The base cannot be reached, reports a fault, or refuses commands.
    BaseFault,
    /// The odometry contains NaN or infinity.
    OdometryNotFinite,
    /// A step of the safety loop was late by more than two of its periods.
    LoopOverrun,
    /// The emergency stop is pressed, or was requested by the operator.
    EmergencyStop,
    /// The safety board sends nothing.
    SafetyBoardSilent,
    /// The safety loop, the program or the computer paused for longer than half a second.
    LoopStalled,
    /// Three contacts or cliffs at one place in a short time.
    RepeatedContact,
    /// The scanner repeats one scan while the wheels move.
    LidarFrozen,
    /// The motion that the wheels report is not the motion that the scanner observes.
    WheelsDisagree,
    /// The battery's voltage stays below the configured limit.
    LowBattery,
}

impl FaultReason {
    /// What an error of the base means.
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
    /// There is no plan yet.
    None,
    /// It contains NaN or infinity. Such a command is refused, never clamped.
    NotFinite,
    /// It is too old.
    Stale,
}

/// What detected the obstacle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum TripCause {
    /// A LiDAR return in the stop zone.
    LidarHit,
    /// An obstacle that is nearer than the LiDAR can measure.
    LidarTooNear,
    /// The base reported a contact.
    Contact,
    /// A cliff sensor of the base saw no floor.
    Cliff,
}

/// Why backing off ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum BackOffEnd {
    /// The whole distance was covered.
    Distance,
    /// An obstacle is behind the robot.
    RearBlocked,
    /// The ground behind the robot was not observed.
    RearUnknown,
    /// It took too long.
    Timeout,
}

/// Why an input was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum RefusedInput {
    /// The odometry contains NaN or infinity.
    OdometryNotFinite,
    /// The scan's shape is not the sensor's.
    ScanShape,
    /// The frame has another size than the camera model.
    FrameSize,
    /// The time went backwards.
    TimeWentBack,
    /// A pose from another program contains NaN or infinity.
    OutsidePoseNotFinite,
    /// A pose from another program is too old, from the future, or not newer than the one before.
    OutsidePoseTime,
    /// The poses from another program have jumped. The wheels carry the pose over the jump.
    OutsidePoseJump,
}

/// Why exploration ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum ExploreEnd {
    /// The requested number of frames was processed.
    FrameBudget,
    /// Nothing is left to explore that can be reached.
    Explored,
    /// The user asked for it.
    Interrupted,
    /// The disk is full or the output cannot be written.
    OutputFailed,
    /// A device failed permanently.
    DeviceFailed,
    /// The simulated robot drove over an edge of the floor.
    Fell,
}
