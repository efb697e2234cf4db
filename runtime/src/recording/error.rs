//! Errors of writing and reading a recording.

use hal::{ImageError, PixelFormat};

/// Why a recording cannot be written or read. The caller knows the file's name and adds it to the message.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RecordingError {
    /// The first bytes are not those of an MCAP file.
    #[error(
        "not an MCAP file: its first bytes are not the MCAP magic; give the --out directory of a run or a .mcap file"
    )]
    NotMcap,
    /// The stream ends before its footer: the writer was killed, the power failed, or a copy is incomplete.
    #[error(
        "truncated {}; the ticks before that can be read: copy the file again, or go on with these ticks",
        after(*.after_tick)
    )]
    Truncated {
        /// The last tick that came back whole.
        after_tick: Option<u64>,
    },
    /// A checksum, a length or a record is wrong.
    #[error("corrupt {}: {detail}; copy the file again, or use the other segments", after(*.after_tick))]
    Corrupt {
        /// The last tick that came back whole.
        after_tick: Option<u64>,
        /// The message of the container's reader.
        detail: String,
    },
    /// The first message is not the header of a recording.
    #[error(
        "no {topic} message before the first tick: not a recording of this robot, or a tool has filtered that \
         channel out"
    )]
    MissingHeader {
        /// The header's topic.
        topic: &'static str,
    },
    /// The recording has another format than this program.
    #[error(
        "recording format {found} is not format {supported} that this program reads; use the program that \
         wrote it ({written_by})"
    )]
    FormatVersion {
        /// Format of the recording.
        found: u64,
        /// Format of this program.
        supported: u32,
        /// Program that wrote the recording, from its header.
        written_by: String,
    },
    /// The tick's message says that a message on another channel belongs to it, and that message is missing.
    #[error(
        "tick {tick} has no message on {topic}, and it should: a tool has filtered that channel out; use the \
         recording as the robot wrote it"
    )]
    MissingPart { tick: u64, topic: &'static str },
    /// A message does not have the layout of its channel.
    #[error("tick {tick}: message on {topic} cannot be read: {detail}")]
    BadMessage {
        tick: u64,
        topic: &'static str,
        /// What is wrong with it.
        detail: String,
    },
    /// The number of a tick is not larger than the number of the tick before it.
    #[error(
        "tick {found} follows tick {previous}; ticks count up: the recording was put together wrongly"
    )]
    TickOrder {
        /// Number of the earlier tick.
        previous: u64,
        /// Number of the tick that follows it.
        found: u64,
    },
    /// An image is not RGB8, the only format that is recorded.
    #[error("tick {tick}: a {format:?} image cannot be recorded; convert it to Rgb8 first")]
    FrameFormat {
        tick: u64,
        /// The image's format.
        format: PixelFormat,
    },
    /// The number of an image's bytes does not fit its size.
    #[error("tick {tick}: {source}")]
    Frame {
        tick: u64,
        /// What is wrong with it.
        source: ImageError,
    },
    /// Truth depth is not in whole millimetres, in which it is recorded.
    #[error(
        "tick {tick}: truth depth {depth_m} m at pixel {pixel} is not a whole number of millimetres up to \
         65.535 m; pass it through quantise_mm before the loop sees it"
    )]
    TruthNotMillimetres {
        tick: u64,
        /// The first bad pixel, row-major.
        pixel: usize,
        /// True depth at that pixel, metres.
        depth_m: f32,
    },
    /// A decision holds NaN or infinity.
    #[error(
        "tick {tick}: the decision holds a number that is not finite, so it could not be compared at replay"
    )]
    DecisionNotFinite { tick: u64 },
    /// A message cannot be encoded.
    #[error("tick {tick}: {topic} cannot be encoded: {detail}")]
    Encode {
        tick: u64,
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
    /// Whether only the end of the recording is missing: all ticks before this error are valid.
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
        || "before the first complete tick".to_owned(),
        |tick| format!("after tick {tick}"),
    )
}
