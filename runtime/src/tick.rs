//! The input and the decision of one tick of the exploration loop.

use hal::{DepthMap, ImageView, LaserScan, Pose2, Twist2, WheelFeedback};
use serde::{Deserialize, Serialize};

use crate::event::{Event, SafetyEvent};
use crate::imu::ImuInput;
use crate::localization::LostReason;
use crate::operator::OperatorOrder;
use crate::outside_pose::OutsideInput;
use crate::safety::SentCommand;
use crate::task::{AreaChange, Task};

/// Everything that enters one tick. A recording of all inputs replays the run.
#[derive(Debug, Clone, Copy)]
pub struct TickInput<'a> {
    /// Counts up from 0.
    pub tick: u64,
    /// Time of the tick, monotonic.
    pub time_ns: u64,
    /// Wheel feedback at the time of `frame`; the newest where there is no frame.
    pub wheel: WheelFeedback,
    /// The scan nearest to the frame in time, if it is a new one.
    pub scan: Option<&'a LaserScan>,
    /// `t_odom_base` when the scanner was halfway through `scan`; that of `wheel` where there is no scan.
    pub scan_odom: Pose2,
    /// Rotation and tilt by the inertial measurement unit, if the robot has one and its samples are new enough.
    pub imu: Option<ImuInput>,
    /// The newest pose that another program has sent since the previous tick.
    pub outside: Option<OutsideInput>,
    /// A new frame, if one came: RGB8 in the size that perception works on.
    pub frame: Option<ImageView<'a>>,
    /// Ground-truth depth of `frame`. Only with the depth source `truth`, which exists to test mapping and planning apart from
    /// depth.
    pub truth: Option<&'a DepthMap>,
    /// What the operator has asked for since the previous tick.
    pub task: Option<Task>,
    /// Areas that the operator has closed or opened since the previous tick, in order.
    pub areas: &'a [AreaChange],
    /// The orders that came since the previous tick, accepted and refused. They are noted only: what they do reaches the robot as
    /// `task` and through the safety plane.
    pub orders: &'a [OperatorOrder],
    /// What the safety loop did since the previous tick.
    pub safety: &'a SafetyReport,
}

/// What the safety loop did between two ticks.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct SafetyReport {
    /// The safety plane moves or stops the robot itself at the moment; the desired command has no effect.
    pub in_charge: bool,
    /// A place in `odom` that could not be passed, metres. Each place is reported once.
    pub blocked_m: Option<[f64; 2]>,
    /// A place in `odom` before which the robot stands because the scanner does not see it, metres. It is reported again while
    /// plans lead there.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub unseen_m: Option<[f64; 2]>,
    /// Changes of state since the previous tick, in order.
    pub events: Vec<SafetyEvent>,
    /// Every command that left the safety loop since the previous tick, in order.
    pub sent: Vec<SentCommand>,
    /// Sent commands that are missing in `sent` because the exploration loop was late for longer than the queue holds.
    #[serde(skip_serializing_if = "is_zero", default)]
    pub sent_dropped: u64,
}

fn is_zero(count: &u64) -> bool {
    *count == 0
}

impl SafetyReport {
    /// Forgets the previous tick and keeps the memory of its lists.
    pub fn clear(&mut self) {
        self.in_charge = false;
        self.blocked_m = None;
        self.unseen_m = None;
        self.events.clear();
        self.sent.clear();
        self.sent_dropped = 0;
    }
}

impl SentCommand {
    /// The velocity of this command, without its time and counter.
    #[must_use]
    pub fn command(&self) -> Command {
        Command { linear_mps: self.linear_mps, angular_radps: self.angular_radps }
    }
}

/// What one tick decided. Two runs are the same when all of their decisions are equal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Decision {
    /// The tick's number.
    pub tick: u64,
    /// The tick's time, monotonic.
    pub time_ns: u64,
    /// The velocity that the policy desires. The safety loop passes it on, slows it down, stops it, or replaces it.
    pub desired: Command,
    /// The velocity that was in force when this tick began: the newest command that left the safety loop since the previous
    /// tick (the whole list is in [`SafetyReport::sent`]). `None` when none left it.
    pub sent: Option<Command>,
    /// Where the robot is heading, in `map`, metres.
    pub goal_m: Option<[f64; 2]>,
    /// Where localization believes the robot to be at the tick's wheel feedback, in `odom`: smooth, never jumps.
    pub t_odom_base: Pose2,
    /// The same when the frame was exposed, which is earlier than its time stamp. Depth is made from it.
    pub t_odom_base_at_frame: Pose2,
    /// Pose of `odom` in `map`. It changes when localization corrects the path.
    pub t_map_odom: Pose2,
    /// Why the robot does not know where it is in `map`; `None` if it does. `t_map_odom` is then the last one that was known.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub lost: Option<LostReason>,
    /// What happened, with reasons.
    pub events: Vec<Event>,
    /// First 8 bytes of the BLAKE3 digest of the whole input: identifies what the decision was made on, to the last bit.
    pub input_digest: u64,
    /// First 8 bytes of the BLAKE3 digest of the depth that went into the map (bytes of depth and confidence); 0: none.
    pub depth_digest: u64,
    /// First 8 bytes of the BLAKE3 digest of the cells that the map changed in this tick.
    pub map_digest: u64,
}

impl Decision {
    /// Where localization believed the robot to be, in `map`.
    #[must_use]
    pub fn t_map_base(&self) -> Pose2 {
        self.t_map_odom.compose(&self.t_odom_base)
    }

    /// The same when the frame was exposed.
    #[must_use]
    pub fn t_map_base_at_frame(&self) -> Pose2 {
        self.t_map_odom.compose(&self.t_odom_base_at_frame)
    }
}

/// A velocity as recorded.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Command {
    /// Forward speed, m/s.
    pub linear_mps: f64,
    /// Yaw rate, rad/s, left is positive.
    pub angular_radps: f64,
}

impl From<Twist2> for Command {
    fn from(twist: Twist2) -> Self {
        Self { linear_mps: twist.linear_mps, angular_radps: twist.angular_radps }
    }
}

impl From<Command> for Twist2 {
    fn from(command: Command) -> Self {
        Self { linear_mps: command.linear_mps, angular_radps: command.angular_radps }
    }
}
