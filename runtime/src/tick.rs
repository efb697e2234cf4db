//! What goes into one turn of the loop, and what comes out.

use hal::{DepthMap, ImageView, LaserScan, Twist2, WheelFeedback};
use serde::{Deserialize, Serialize};

use crate::event::{Event, SafetyEvent};

/// Everything that one turn of the loop knows of the world. Recording this replays the run.
#[derive(Debug, Clone, Copy)]
pub struct TickInput<'a> {
    /// Counts up from 0.
    pub tick: u64,
    /// Now, monotonic.
    pub time_ns: u64,
    /// What the base measured.
    pub wheel: WheelFeedback,
    /// A new scan, if one came.
    pub scan: Option<&'a LaserScan>,
    /// A new picture, if one came: RGB8 in the size that perception works on.
    pub frame: Option<ImageView<'a>>,
    /// Ground-truth depth of `frame`. Only with the depth source `truth`, which exists to test what comes after depth.
    pub truth: Option<&'a DepthMap>,
    /// What the safety plane did since the last turn, where it turns by itself, faster than this loop. `None`: it is turned
    /// with this loop.
    pub safety: Option<&'a SafetyReport>,
}

/// What the safety plane tells the exploration plane.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct SafetyReport {
    /// Wishes have no effect at the moment.
    pub in_charge: bool,
    /// A place that it could not pass, in `odom`, metres: said once.
    pub blocked_m: Option<[f64; 2]>,
    /// What happened since the last turn, in order.
    pub events: Vec<SafetyEvent>,
}

/// What one turn of the loop decided. Two runs are the same when all of their decisions are equal.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Decision {
    /// The turn.
    pub tick: u64,
    /// Its time.
    pub time_ns: u64,
    /// What the policy wanted, before the safety plane.
    pub wanted: Command,
    /// What the base is told, after the safety plane.
    pub command: Command,
    /// Where the robot is heading, in `odom`, metres.
    pub goal_m: Option<[f64; 2]>,
    /// What happened, with reasons.
    pub events: Vec<Event>,
    /// First 8 bytes of the BLAKE3 digest of the whole input: a decision says what it was made on, to the last bit.
    pub input_digest: u64,
    /// First 8 bytes of the BLAKE3 digest of the depth that went into the map (bytes of depth and confidence); 0: none.
    pub depth_digest: u64,
    /// First 8 bytes of the BLAKE3 digest of the cells that the map changed this turn.
    pub map_digest: u64,
}

/// A velocity as it stands in a log: m/s and rad/s.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Command {
    /// Forward speed, m/s.
    pub linear_mps: f64,
    /// Turn rate, rad/s, left is positive.
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
