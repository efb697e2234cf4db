//! The dimensions of the robot that several parts of the software must agree on.

use alloc::vec::Vec;

use crate::{CameraMount, LidarMount};

/// Footprint, mounts and discrete actions of one robot: the planner, the safety plane, the simulator and the benchmarks take
/// their dimensions from here. The sections `[base]`, `[camera]` and `[lidar]` of the configuration describe another robot.
///
/// The default is the robot of "Embodied Depth Prediction" (Liu et al.) as far as the paper describes it.
#[derive(Debug, Clone, PartialEq)]
pub struct RobotDescription {
    /// Radius of the circle around the axle's centre that contains the robot.
    pub footprint_radius_m: f64,
    /// Corners of a footprint that is not round, in `base_link`, in order; empty for a round robot.
    pub footprint_m: Vec<[f64; 2]>,
    pub camera: CameraMount,
    pub lidar: LidarMount,
    /// Distance that the robot drives in one forward action.
    pub forward_step_m: f64,
    /// Angle that the robot rotates in one rotation action.
    pub turn_step_deg: f64,
    /// Duration of one action.
    pub tick_ms: u64,
}

impl Default for RobotDescription {
    fn default() -> Self {
        Self {
            // A small round robot.
            footprint_radius_m: 0.16,
            footprint_m: Vec::new(),
            camera: CameraMount::default(),
            lidar: LidarMount::default(),
            // The paper's step.
            forward_step_m: 0.03,
            // The paper rotates by 2 degrees, and a robot that explores a home then rotates for about half of its time.
            turn_step_deg: 4.0,
            // 0.3 m/s and 40 degrees/s.
            tick_ms: 100,
        }
    }
}

impl RobotDescription {
    /// Duration of one action.
    #[must_use]
    pub fn tick_s(&self) -> f64 {
        self.tick_ms as f64 / 1e3
    }

    /// Speed of one forward action per tick.
    #[must_use]
    pub fn speed_mps(&self) -> f64 {
        self.forward_step_m / self.tick_s()
    }

    /// Angular rate of one rotation action per tick.
    #[must_use]
    pub fn turn_radps(&self) -> f64 {
        self.turn_step_deg.to_radians() / self.tick_s()
    }
}
