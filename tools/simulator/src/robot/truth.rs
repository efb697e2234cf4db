//! What only the simulator knows.

use std::sync::{Arc, Mutex};

use hal::{DepthMap, Pose2, Pose3};

use super::body::Body;
use super::lock;
use crate::floor::FloorPlan;

/// The truth about a robot, to judge it by.
#[derive(Debug, Clone)]
pub struct Truth {
    body: Arc<Mutex<Body>>,
}

impl Truth {
    pub(super) fn new(body: Arc<Mutex<Body>>) -> Self {
        Self { body }
    }

    /// True pose of the base in the world, now.
    #[must_use]
    pub fn pose(&self) -> Pose2 {
        lock(&self.body).pose
    }

    /// Where the odometry's frame lies in the world: where the robot would have to have started for its odometry to be right
    /// now. It moves as odometry drifts; without noise it stays at the start pose.
    #[must_use]
    pub fn t_world_odom(&self) -> Pose2 {
        let body = lock(&self.body);
        body.pose.compose(&body.t_odom_base().inverse())
    }

    /// Copies the z-depth of the newest frame into `depth` and returns the frame's time and the base's true pose at it;
    /// `None` before the first frame. The depth is free of nuisances.
    pub fn frame_depth(&self, depth: &mut DepthMap) -> Option<(u64, Pose2)> {
        let body = lock(&self.body);
        depth.clone_from(&body.depth);
        body.framed
    }

    /// True pose of the camera in the world for a pose of the base.
    #[must_use]
    pub fn t_world_camera(&self, t_world_base: &Pose2) -> Pose3 {
        t_world_base.to_pose3() * lock(&self.body).options.t_base_camera
    }

    /// Where this robot can be.
    #[must_use]
    pub fn floor_plan(&self) -> Arc<FloorPlan> {
        Arc::clone(&lock(&self.body).plan)
    }

    /// How often the robot has run into something. Pushing on counts once.
    #[must_use]
    pub fn contacts(&self) -> u64 {
        lock(&self.body).contacts
    }

    /// Length of the way that the base has really moved, metres.
    #[must_use]
    pub fn path_m(&self) -> f64 {
        lock(&self.body).path_m
    }
}
