//! Path planning on the occupancy map, and path following.
//!
//! | part | what it answers |
//! |---|---|
//! | [`Costmap`] | may the robot's centre be in this cell, and what does a metre there cost? |
//! | [`KeepOut`] | which areas has a person closed? |
//! | [`Planner`] | what is the cheapest path to a goal (A*), and what is the distance to every cell (Dijkstra)? |
//! | [`Costmap::shorten`] | which straight segments replace the path's steps at no higher cost? |
//! | [`Follower`] | which motion primitive follows the path from the robot's pose? |

mod astar;
mod buckets;
mod config;
mod costmap;
mod distance;
mod follower;
mod keep_out;
mod shorten;
mod steps;

pub use astar::{NoPath, Planner, Reach};
pub use config::{ConfigError, FollowerConfig, PlanConfig, PlanningSection};
pub use costmap::Costmap;
pub use follower::{FollowError, Follower, Primitive, Progress, Step};
pub use keep_out::KeepOut;
