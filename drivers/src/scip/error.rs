//! Errors in the messages of a scanner.

use hal::ErrorKind;

/// Why a message was dropped. The contents of the scan buffer are invalid then.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ScipError {
    /// The message does not end with an empty line, or has too few or too many lines.
    #[error("SCIP message is truncated or runs into the next one: missing {missing}")]
    Shape { missing: &'static str },
    /// The message answers another request.
    #[error("SCIP message echoes another request than the one that was sent")]
    Echo,
    /// The checksum of a line is wrong.
    #[error(
        "SCIP line {line} has the wrong checksum: `{}` instead of `{}`",
        char::from(*.found),
        char::from(*.computed)
    )]
    Checksum {
        /// Number of the line; the echo is line 0.
        line: usize,
        found: u8,
        computed: u8,
    },
    /// A line contains a byte that is not a SCIP data character.
    #[error("SCIP line {line} holds the byte {byte:#04x}, allowed: 0x30 to 0x6f")]
    Character {
        /// Number of the line; the echo is line 0.
        line: usize,
        byte: u8,
    },
    /// The message does not contain the requested number of ranges.
    #[error("SCIP message has {found} bytes of data lines, the request requires {needed}")]
    Length { found: usize, needed: usize },
    /// The caller's buffer has another length than the request.
    #[error(
        "the buffer for ranges or intensities has {buffer} beams, the request asks for {request}"
    )]
    Buffer { buffer: usize, request: usize },
    /// A line `KEY:value` is missing or invalid.
    #[error("the scanner's line `{key}` is missing, has a wrong checksum or no valid value")]
    Field { key: &'static str },
    /// The sensor speaks SCIP 1.1.
    #[error("the scanner speaks SCIP 1.1; send `SCIP2.0` first")]
    OldProtocol,
    /// The sensor refused the request or reports a fault.
    #[error(
        "the scanner answers status `{}{}`: {}",
        char::from(.status[0]),
        char::from(.status[1]),
        meaning(*.status)
    )]
    Status {
        /// The two characters of the status.
        status: [u8; 2],
    },
}

impl hal::Error for ScipError {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::Status { status } if is_fault(*status) => ErrorKind::Fault,
            Self::Status { .. } | Self::Echo | Self::OldProtocol => ErrorKind::Rejected,
            Self::Buffer { .. } => ErrorKind::Unsupported,
            _ => ErrorKind::Corrupt,
        }
    }
}

/// Whether a status reports a hardware fault. 50 to 97: laser, motor or electronics. 0L of the
/// Ethernet models: abnormal state.
fn is_fault(status: [u8; 2]) -> bool {
    status[1].is_ascii_digit() && (*b"50"..=*b"97").contains(&status) || status == *b"0L"
}

fn meaning(status: [u8; 2]) -> &'static str {
    match &status {
        b"01" | b"02" | b"03" | b"06" | b"07" => "a field of the request is not a number",
        b"04" => "the last step is outside the sensor's range",
        b"05" => "the last step is before the first",
        b"10" => "the laser is off; send BM first",
        b"98" => "resumed after a fault; send the request again",
        [b'0', b'A'..=b'H'] => "the sensor does not know this command or its parameters",
        b"0M" => "the sensor is unstable and will measure again when it has stabilized",
        b"0I" => "the sensor is in firmware update mode; restart it",
        _ if is_fault(status) => {
            "hardware fault of laser, motor or electronics; power-cycle the sensor"
        }
        _ => "the measurement was interrupted; check the sensor and send the request again",
    }
}
