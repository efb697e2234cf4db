//! The commands that leave the safety loop, as recordings hold them.

use hal::Twist2;
use serde::{Deserialize, Serialize};

/// A command as it left the safety loop for the base.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SentCommand {
    /// When it was sent, monotonic.
    pub time_ns: u64,
    /// The drive command's counter; `None` for a stop, which brakes as hard as the base can.
    pub counter: Option<u32>,
    /// Forward speed, m/s.
    pub linear_mps: f64,
    /// Yaw rate, rad/s, left is positive.
    pub angular_radps: f64,
}

impl SentCommand {
    /// A drive command.
    #[must_use]
    pub fn drive(time_ns: u64, counter: u32, twist: Twist2) -> Self {
        let Twist2 { linear_mps, angular_radps } = twist;
        Self { time_ns, counter: Some(counter), linear_mps, angular_radps }
    }

    /// A command to stop at `time_ns`.
    #[must_use]
    pub fn stop(time_ns: u64) -> Self {
        Self { time_ns, counter: None, linear_mps: 0.0, angular_radps: 0.0 }
    }
}
