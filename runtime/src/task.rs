//! What an operator asks of the exploration plane. Whether the robot may move is asked of the safety plane.

use serde::{Deserialize, Serialize};

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
    /// Stand where the robot is until there is another task.
    Pause,
}

/// A task has a coordinate that is NaN or infinite.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the place to go to is not finite: give metres in the frame `map`")]
pub struct PlaceNotFinite;

impl Task {
    /// Refuses numbers that no place has.
    ///
    /// # Errors
    /// A coordinate that is NaN or infinite.
    pub fn check(self) -> Result<Self, PlaceNotFinite> {
        match self {
            Self::GoTo { x_m, y_m } if !(x_m.is_finite() && y_m.is_finite()) => Err(PlaceNotFinite),
            task => Ok(task),
        }
    }
}
