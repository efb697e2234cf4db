//! Ways through the map, and how to drive them.
//!
//! [`Costmap`] says where the robot may go and how willingly; [`Planner`] finds the cheapest way (A*) or the distance to
//! everywhere (Dijkstra); [`Costmap::shorten`] straightens it; [`Follower`] turns it into motion primitives.

mod astar;
mod buckets;
mod config;
mod costmap;
mod distance;
mod follower;
mod shorten;
mod steps;

pub use astar::{NoPath, Planner, Reach};
pub use config::{ConfigError, FollowerConfig, PlanConfig, PlanningSection};
pub use costmap::Costmap;
pub use follower::{FollowError, Follower, Primitive, Progress, Step};
