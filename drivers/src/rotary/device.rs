//! What the drivers of rotating scanners do differently.

use super::{Event, RotaryError};
use crate::ld06::PacketError;
use crate::rplidar::AnswerError;
use crate::scanner::{End, Identity, Link, LinkError};

/// Why data was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum WireError {
    #[error(transparent)]
    Ld06(#[from] PacketError),
    #[error(transparent)]
    Rplidar(#[from] AnswerError),
}

/// One kind of scanner.
pub(crate) trait Device: Send {
    /// Makes the scanner send scans. What it sends from then on is passed to
    /// [`push`](Self::push).
    fn bring_up(&mut self, link: &Link) -> Result<Identity, End<RotaryError>>;

    /// Takes the next byte, and passes what it completes to `sink`.
    fn push(&mut self, byte: u8, sink: &mut dyn FnMut(Event<WireError>));

    /// Stops scan and motor, if the scanner still listens.
    fn shut_down(&mut self, link: &Link);
}

impl From<LinkError> for End<RotaryError> {
    fn from(error: LinkError) -> Self {
        Self::Failed(error.into())
    }
}
