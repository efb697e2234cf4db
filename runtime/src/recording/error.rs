//! What can be wrong with a recording.

use hal::{ImageError, PixelFormat};

/// Why a recording cannot be written or read. The caller, who knows the file's name, adds it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RecordingError {
    /// The first bytes are not those of an MCAP file.
    #[error(
        "not an MCAP file: its first bytes are not the MCAP magic; give the --out directory of a run or a .mcap file"
    )]
    NotMcap,
    /// The stream ends before its footer: the writer was killed, the power went, or a copy is incomplete.
    #[error(
        "truncated {}; the turns before that are good: copy the file again, or go on with what is there",
        after(*.after_tick)
    )]
    Truncated {
        /// The last turn that came back whole.
        after_tick: Option<u64>,
    },
    /// A checksum, a length or a record is wrong.
    #[error("corrupt {}: {detail}; copy the file again, or use the other segments", after(*.after_tick))]
    Corrupt {
        /// The last turn that came back whole.
        after_tick: Option<u64>,
        /// What the container's reader says.
        detail: String,
    },
    /// An MCAP file without our header.
    #[error(
        "no {topic} message before the first turn: not a recording of this robot, or a tool has filtered that \
         channel out"
    )]
    MissingHeader {
        /// Where the header should be.
        topic: &'static str,
    },
    /// Written by a program with another format.
    #[error(
        "recording format {found} is not format {supported} that this program reads; use the program that \
         wrote it ({written_by})"
    )]
    FormatVersion {
        /// The recording's.
        found: u64,
        /// Ours.
        supported: u32,
        /// What the header says about the writer.
        written_by: String,
    },
    /// A turn says that a part belongs to it, and the part is not there.
    #[error(
        "turn {tick} has no message on {topic}, and it should: a tool has filtered that channel out; use the \
         recording as the robot wrote it"
    )]
    MissingPart {
        /// The turn.
        tick: u64,
        /// The channel.
        topic: &'static str,
    },
    /// A message does not hold what its channel promises.
    #[error("turn {tick}: message on {topic} cannot be read: {detail}")]
    BadMessage {
        /// The turn.
        tick: u64,
        /// The channel.
        topic: &'static str,
        /// What is wrong with it.
        detail: String,
    },
    /// Turns that do not count up.
    #[error(
        "turn {found} follows turn {previous}; turns count up: the recording was put together wrongly"
    )]
    TickOrder {
        /// The earlier one.
        previous: u64,
        /// What came then.
        found: u64,
    },
    /// Only RGB8 is recorded.
    #[error("turn {tick}: a {format:?} picture cannot be recorded; convert it to Rgb8 first")]
    FrameFormat {
        /// The turn.
        tick: u64,
        /// The picture's format.
        format: PixelFormat,
    },
    /// A picture whose bytes do not fit its size.
    #[error("turn {tick}: {source}")]
    Frame {
        /// The turn.
        tick: u64,
        /// What is wrong with it.
        source: ImageError,
    },
    /// Depth is recorded in millimetres.
    #[error(
        "turn {tick}: truth depth {depth_m} m at pixel {pixel} is not a whole number of millimetres up to \
         65.535 m; pass it through quantise_mm before the loop sees it"
    )]
    TruthNotMillimetres {
        /// The turn.
        tick: u64,
        /// The first bad pixel, row-major.
        pixel: usize,
        /// Its depth.
        depth_m: f32,
    },
    /// A decision that holds NaN or infinity.
    #[error(
        "turn {tick}: the decision holds a number that is not finite, so it could not be compared at replay"
    )]
    DecisionNotFinite {
        /// The turn.
        tick: u64,
    },
    /// A message could not be put into bytes.
    #[error("turn {tick}: {topic} cannot be encoded: {detail}")]
    Encode {
        /// The turn.
        tick: u64,
        /// The channel.
        topic: &'static str,
        /// What is wrong.
        detail: String,
    },
    /// The sink or the source failed.
    #[error("{0}")]
    Io(#[from] std::io::Error),
    /// The container's writer refused.
    #[error("MCAP writer: {0}")]
    Container(mcap::McapError),
}

impl RecordingError {
    /// Whether what was read before this error is good and only the end is missing.
    #[must_use]
    pub fn is_truncation(&self) -> bool {
        matches!(self, Self::Truncated { .. })
    }

    pub(super) fn writing(error: mcap::McapError) -> Self {
        match error {
            mcap::McapError::Io(error) => Self::Io(error),
            other => Self::Container(other),
        }
    }

    pub(super) fn reading(error: mcap::McapError, after_tick: Option<u64>) -> Self {
        use mcap::McapError as E;
        match error {
            E::UnexpectedEof => Self::Truncated { after_tick },
            E::Io(error) => Self::Io(error),
            other => Self::Corrupt { after_tick, detail: other.to_string() },
        }
    }
}

fn after(tick: Option<u64>) -> String {
    tick.map_or_else(
        || "before the first complete turn".to_owned(),
        |tick| format!("after turn {tick}"),
    )
}
