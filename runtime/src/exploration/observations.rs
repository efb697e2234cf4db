//! What a policy is given in a tick.

use hal::Pose2;

use crate::mapping::{OccupancyGrid, SingleFrameMap};

/// The policy's inputs of one tick.
#[derive(Debug, Clone, Copy)]
pub struct Observations<'a> {
    pub tick: u64,
    pub time_ns: u64,
    /// Pose of the robot, `t_odom_base`.
    pub pose: Pose2,
    pub map: &'a OccupancyGrid,
    /// The newest single-frame map and an older one, to compare them.
    pub frame_maps: Option<(&'a SingleFrameMap, &'a SingleFrameMap)>,
    /// The safety plane has just backed off from an obstacle.
    pub bumped: bool,
}
