//! What a running robot and its live view say to each other over a Unix socket.
//!
//! The robot sends [frames](frame): first its channels, then messages of those that were subscribed, and answers to orders. The
//! view sends [lines](line): subscriptions and orders, one JSON object each. Both ends limit what they read, and both treat what
//! cannot be read as the end of the connection or as a refused order, never as a reason to stop.
#![forbid(unsafe_code)]

pub mod frame;
pub mod line;

pub use frame::{Answer, Channel, Frame, FrameError, FrameReader};
pub use line::{Line, LineError, LineReader, Order, OrderLine};
