//! From the view to the robot: one JSON object a line.

use runtime::exploration::PolicyKind;
use runtime::operator::Role;
use runtime::task::{AreaChange, Task};
use serde::{Deserialize, Serialize};

/// The longest line. An order needs 200 bytes, a subscription of all channels as many.
pub const MAX_BYTES: usize = 4096;
/// The longest name of a client.
pub const MAX_WHO: usize = 120;

/// What the view sends.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Line {
    /// The channels whose messages are wanted from now on, in place of those before.
    Subscribe(Vec<u16>),
    /// An order of a client.
    Order(OrderLine),
}

/// An order with the client that gave it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OrderLine {
    /// Comes back in the answer.
    pub id: u64,
    /// The client, as the view knows it.
    pub who: String,
    /// What the client may do.
    pub role: Role,
    /// What it wants.
    pub order: Order,
}

/// What an operator may ask for.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "order", rename_all = "snake_case", deny_unknown_fields)]
pub enum Order {
    /// Emergency stop. A person has to arm the robot again.
    Stop,
    /// Stop and release the motors.
    Disarm,
    /// Clear a fault and let plans move the robot.
    Arm,
    /// Stand until there is another task.
    Pause,
    /// Explore again after a pause or another task.
    Resume,
    /// Explore by another policy from now on.
    ExploreBy { policy: PolicyKind },
    /// Drive to a place in `map` and stand there.
    GoTo { x_m: f64, y_m: f64 },
    /// Drive to where the run began and stand there.
    Return,
    /// Write the map to its file now.
    SaveMap,
    /// Drive at a velocity for [`HOLD_NS`](runtime::task::HOLD_NS), and stand then. A person who drives by hand gives it ten times
    /// a second.
    Drive {
        /// Forward speed, m/s; negative: backward.
        linear_mps: f64,
        /// Yaw rate, rad/s, left is positive.
        angular_radps: f64,
    },
    /// Keep out of an area.
    KeepOut {
        /// Its corners in order, metres in `map`. Corners that coincide make it a triangle or a line.
        corners_m: [[f64; 2]; 4],
    },
    /// Enter all areas again that were closed by [`KeepOut`](Self::KeepOut).
    OpenAreas,
}

impl Order {
    /// All orders, with some place, velocity and policy.
    pub const ALL: [Self; 12] = [
        Self::Stop,
        Self::Disarm,
        Self::Arm,
        Self::Pause,
        Self::Resume,
        Self::GoTo { x_m: 0.0, y_m: 0.0 },
        Self::Return,
        Self::SaveMap,
        Self::Drive { linear_mps: 0.0, angular_radps: 0.0 },
        Self::KeepOut { corners_m: [[0.0; 2]; 4] },
        Self::OpenAreas,
        Self::ExploreBy { policy: PolicyKind::Active },
    ];

    /// The order in words, for people and for the recording.
    #[must_use]
    pub fn words(&self) -> String {
        match self {
            Self::Stop => "stop".to_owned(),
            Self::Disarm => "disarm".to_owned(),
            Self::Arm => "arm".to_owned(),
            Self::Pause => "pause".to_owned(),
            Self::Resume => "resume".to_owned(),
            Self::ExploreBy { policy } => format!("explore by the policy `{}`", policy.name()),
            Self::GoTo { x_m, y_m } => format!("go to ({x_m:.2}, {y_m:.2}) m"),
            Self::Return => "return to the start".to_owned(),
            Self::SaveMap => "save the map".to_owned(),
            Self::Drive { .. } => "drive by hand".to_owned(),
            Self::KeepOut { corners_m } => {
                let corners = corners_m.map(|[x_m, y_m]| format!("({x_m:.2}, {y_m:.2})"));
                format!("keep out of {} m", corners.join(", "))
            }
            Self::OpenAreas => "open the closed areas".to_owned(),
        }
    }

    /// The least role that may give the order. Every client that sees the robot may stop it.
    #[must_use]
    pub fn needs(&self) -> Role {
        match self {
            Self::Stop => Role::Watch,
            _ => Role::Steer,
        }
    }

    /// Whether a client of this role may give the order.
    #[must_use]
    pub fn is_allowed_to(&self, role: Role) -> bool {
        role == Role::Steer || self.needs() == Role::Watch
    }

    /// The task of the exploration plane that the order is, if it is one.
    #[must_use]
    pub fn task(&self) -> Option<Task> {
        match *self {
            Self::Pause => Some(Task::Pause),
            Self::Resume => Some(Task::Explore),
            Self::ExploreBy { policy } => Some(Task::ExploreBy { policy }),
            Self::GoTo { x_m, y_m } => Some(Task::GoTo { x_m, y_m }),
            Self::Return => Some(Task::Return),
            Self::Drive { linear_mps, angular_radps } => {
                Some(Task::Drive { linear_mps, angular_radps })
            }
            Self::Stop
            | Self::Disarm
            | Self::Arm
            | Self::SaveMap
            | Self::KeepOut { .. }
            | Self::OpenAreas => None,
        }
    }

    /// The change of the closed areas that the order is, if it is one.
    #[must_use]
    pub fn area(&self) -> Option<AreaChange> {
        match *self {
            Self::KeepOut { corners_m } => Some(AreaChange::Close { corners_m }),
            Self::OpenAreas => Some(AreaChange::OpenAll),
            _ => None,
        }
    }
}

/// Why a line is not one.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LineError {
    /// No end of line within the longest line.
    #[error("a line has more than {MAX_BYTES} bytes")]
    TooLong,
    /// Not a line of this protocol.
    #[error("not an order or a subscription: {0}")]
    Json(#[from] serde_json::Error),
    /// A name that would fill the recording.
    #[error("a client's name has more than {MAX_WHO} bytes")]
    Who,
    /// A number that no place and no velocity has.
    #[error(transparent)]
    NotFinite(#[from] runtime::task::NotFinite),
    /// A corner that is not in the home.
    #[error(transparent)]
    Area(#[from] runtime::task::AreaTooFar),
}

impl Line {
    /// Reads a line without its end.
    ///
    /// # Errors
    /// What is not a line of this protocol.
    pub fn parse(bytes: &[u8]) -> Result<Self, LineError> {
        if bytes.len() > MAX_BYTES {
            return Err(LineError::TooLong);
        }
        let line: Self = serde_json::from_slice(bytes)?;
        if let Self::Order(line) = &line {
            if line.who.len() > MAX_WHO {
                return Err(LineError::Who);
            }
            line.order.task().map(Task::check).transpose()?;
            line.order.area().map(AreaChange::check).transpose()?;
        }
        Ok(line)
    }

    /// The line with its end.
    ///
    /// # Errors
    /// Never for a place that is finite.
    pub fn to_bytes(&self) -> Result<Vec<u8>, LineError> {
        let mut bytes = serde_json::to_vec(self)?;
        bytes.push(b'\n');
        Ok(bytes)
    }
}

/// Finds lines in a stream that comes in pieces. What is too long is dropped up to its end and reported once.
#[derive(Debug, Default)]
pub struct LineReader {
    bytes: Vec<u8>,
    skips: bool,
}

impl LineReader {
    /// Takes a piece of the stream, and returns the lines that it completes.
    pub fn push(&mut self, piece: &[u8]) -> Vec<Result<Line, LineError>> {
        let mut lines = Vec::new();
        for part in piece.split_inclusive(|byte| *byte == b'\n') {
            let (text, ends) = match part.split_last() {
                Some((b'\n', text)) => (text, true),
                _ => (part, false),
            };
            if !self.skips {
                self.bytes.extend_from_slice(text);
            }
            if self.bytes.len() > MAX_BYTES {
                lines.push(Err(LineError::TooLong));
                self.bytes.clear();
                self.skips = true;
            }
            if ends {
                if !self.skips && !self.bytes.is_empty() {
                    lines.push(Line::parse(&self.bytes));
                }
                self.bytes.clear();
                self.skips = false;
            }
        }
        lines
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn order(order: Order) -> Line {
        Line::Order(OrderLine { id: 7, who: "127.0.0.1:4000".to_owned(), role: Role::Steer, order })
    }

    #[test]
    fn every_order_comes_back_in_the_form_that_the_documentation_shows() {
        for each in Order::ALL {
            let bytes = order(each).to_bytes().unwrap();
            assert_eq!(LineReader::default().push(&bytes).remove(0).unwrap(), order(each));
        }
        let text = r#"{"order":{"id":7,"who":"127.0.0.1:4000","role":"steer","order":{"order":"go_to","x_m":1.5,"y_m":-2}}}"#;
        let expected = order(Order::GoTo { x_m: 1.5, y_m: -2.0 });
        assert_eq!(Line::parse(text.as_bytes()).unwrap(), expected);
    }

    #[test]
    fn numbers_that_are_not_finite_or_too_far_an_unknown_key_and_a_long_name_are_refused() {
        for text in [
            r#"{"order":{"id":7,"who":"a","role":"steer","order":{"order":"go_to","x_m":1e999,"y_m":0}}}"#,
            r#"{"order":{"id":7,"who":"a","role":"steer","force":true,"order":{"order":"stop"}}}"#,
            r#"{"order":{"id":7,"who":"a","role":"root","order":{"order":"stop"}}}"#,
            r#"{"order":{"id":7,"who":"a","role":"steer","order":{"order":"drive","linear_mps":0,"angular_radps":1e999}}}"#,
            r#"{"order":{"id":7,"who":"a","role":"steer","order":{"order":"keep_out","corners_m":[[0,0],[1,0],[1,2000]]}}}"#,
            r#"{"order":{"id":7,"who":"a","role":"steer","order":{"order":"keep_out","corners_m":[[0,0],[1,0],[1,2000],[0,1]]}}}"#,
            r#"{"steer":1}"#,
        ] {
            assert!(Line::parse(text.as_bytes()).is_err(), "{text}");
        }
        let Line::Order(line) = order(Order::Stop) else { unreachable!() };
        let long = Line::Order(OrderLine { who: "a".repeat(MAX_WHO + 1), ..line });
        assert!(matches!(Line::parse(&serde_json::to_vec(&long).unwrap()), Err(LineError::Who)));
    }

    #[test]
    fn a_watcher_may_stop_the_robot_and_nothing_else() {
        let allowed: Vec<_> =
            Order::ALL.into_iter().filter(|order| order.is_allowed_to(Role::Watch)).collect();
        assert_eq!(allowed, [Order::Stop]);
        assert!(Order::ALL.iter().all(|order| order.is_allowed_to(Role::Steer)));
    }

    #[test]
    fn a_line_without_end_is_reported_once_and_the_next_one_is_read() {
        let mut reader = LineReader::default();
        let endless = vec![b'x'; 3 * MAX_BYTES];
        assert!(matches!(reader.push(&endless)[..], [Err(LineError::TooLong)]));
        let next = [b"xx\n".to_vec(), order(Order::Arm).to_bytes().unwrap()].concat();
        let lines = reader.push(&next);
        assert!(matches!(&lines[..], [Ok(line)] if *line == order(Order::Arm)), "{lines:?}");
    }

    proptest! {
        #[test]
        fn a_stream_gives_the_same_lines_however_it_is_cut(
            orders in prop::collection::vec(0..Order::ALL.len(), 0..6),
            piece in 1usize..50,
        ) {
            let lines: Vec<_> = orders.iter().map(|at| order(Order::ALL[*at])).collect();
            let stream: Vec<u8> = lines.iter().flat_map(|line| line.to_bytes().unwrap()).collect();
            let mut reader = LineReader::default();
            let read: Vec<_> = stream.chunks(piece).flat_map(|piece| reader.push(piece)).collect();
            let read: Vec<_> = read.into_iter().map(Result::unwrap).collect();
            prop_assert_eq!(read, lines);
        }
    }
}
