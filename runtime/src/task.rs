//! What an operator asks of the exploration plane. Whether the robot may move is asked of the safety plane.

use serde::{Deserialize, Serialize};

use crate::exploration::PolicyKind;

/// A task. It replaces the one before.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "task", rename_all = "snake_case", deny_unknown_fields)]
pub enum Task {
    /// Drive to a place and stand there.
    GoTo {
        /// Place in `map`, metres.
        x_m: f64,
        /// Place in `map`, metres.
        y_m: f64,
    },
    /// Drive to where the run began, face as the robot did then, and stand there.
    Return,
    /// Explore, as a robot without a task does.
    Explore,
    /// Explore by another policy from now on.
    ExploreBy { policy: PolicyKind },
    /// Stand where the robot is until there is another task.
    Pause,
    /// Drive at this velocity for [`HOLD_NS`], as far as the safety plane permits, and then stand. A person who drives by hand
    /// gives it again and again.
    Drive {
        /// Forward speed, m/s; negative: backward.
        linear_mps: f64,
        /// Yaw rate, rad/s, left is positive.
        angular_radps: f64,
    },
}

/// A change of the areas that the robot keeps out of.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "change", rename_all = "snake_case", deny_unknown_fields)]
pub enum AreaChange {
    /// Keep out of an area, too.
    Close {
        /// Its corners in order, metres in `map`. Corners that coincide make it a triangle, or a line that the robot does not cross.
        corners_m: [[f64; 2]; 4],
    },
    /// Enter all areas again that were closed by a change. Those of the configuration stay closed.
    OpenAll,
}

impl AreaChange {
    /// Corners farther away than this are a mistake, metres; the configuration has the same limit.
    pub const FARTHEST_M: f64 = 1000.0;

    /// Refuses corners that no home has.
    ///
    /// # Errors
    /// A coordinate that is NaN, infinite or too far away.
    pub fn check(self) -> Result<Self, AreaTooFar> {
        match &self {
            Self::Close { corners_m }
                if !corners_m.as_flattened().iter().all(|at| at.abs() <= Self::FARTHEST_M) =>
            {
                Err(AreaTooFar)
            }
            _ => Ok(self),
        }
    }
}

/// A corner of an area is not a number within [`AreaChange::FARTHEST_M`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("a corner of the area is not within 1,000 m: give metres in the frame `map`")]
pub struct AreaTooFar;

/// The dead man's switch: a robot that is driven by hand stands this long after the last order. Orders come ten times a second, so
/// that it tolerates three lost ones.
pub const HOLD_NS: u64 = 400_000_000;

/// A task has a number that is NaN or infinite.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum NotFinite {
    /// A coordinate of the place to drive to.
    #[error("the place to go to is not finite: give metres in the frame `map`")]
    Place,
    /// A linear or angular velocity to drive at.
    #[error("the velocity to drive at is not finite: give m/s and rad/s")]
    Velocity,
}

impl Task {
    /// Refuses numbers that no place and no velocity has.
    ///
    /// # Errors
    /// A coordinate or a speed that is NaN or infinite.
    pub fn check(self) -> Result<Self, NotFinite> {
        match self {
            Self::GoTo { x_m, y_m } if !are_finite([x_m, y_m]) => Err(NotFinite::Place),
            Self::Drive { linear_mps, angular_radps }
                if !are_finite([linear_mps, angular_radps]) =>
            {
                Err(NotFinite::Velocity)
            }
            task => Ok(task),
        }
    }
}

fn are_finite(numbers: [f64; 2]) -> bool {
    numbers.iter().all(|number| number.is_finite())
}
