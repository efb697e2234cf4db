//! Options of a pull.

use super::order::Order;

/// Order and rate of the transfers, and whether the robot is notified of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Options {
    pub order: Order,
    /// The maximum rate in bytes per second; `None` for no limit.
    pub limit: Option<u64>,
    /// Do not write `.pulled` markers on the robot.
    pub no_mark: bool,
}
