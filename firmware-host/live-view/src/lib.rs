//! `live-view`: shows a running robot in a browser and in Foxglove, and passes an operator's orders on.
//!
//! It is a program of its own, so that the robot's process neither links nor waits for a web server: it connects to the robot's
//! Unix socket ([`robot`]), and serves a page and Foxglove's WebSocket protocol ([`protocol`]) at one address. The page is a client
//! of the same protocol. The server of Foxglove's SDK cannot be used here: it asks for no token, knows no roles, and checks no
//! `Origin`; [`access`] does.
#![forbid(unsafe_code)]

pub mod access;
mod layout;
mod page;
pub mod protocol;
pub mod publish;
pub mod robot;
pub mod server;
mod session;
pub mod tls;

pub use layout::layout;
