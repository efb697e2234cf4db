//! What can be wrong with a reply.

use hal::ErrorKind;

/// A reply was dropped. The scan buffer then holds nothing of worth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ScipError {
    /// The reply does not end with an empty line, or has lines too few or too many.
    #[error("SCIP reply is cut or runs into the next one: no {missing} where one must be")]
    Shape {
        /// What was expected.
        missing: &'static str,
    },
    /// The reply answers another request.
    #[error("SCIP reply echoes another request than the one that was sent")]
    Echo,
    /// A line fails its checksum.
    #[error("SCIP line {line} fails its checksum: `{found}` came, `{computed}` fits", found = char::from(*.found), computed = char::from(*.computed))]
    Checksum {
        /// Counted from 0, the echo.
        line: usize,
        /// The checksum that came.
        found: u8,
        /// The one that fits the line.
        computed: u8,
    },
    /// A character that SCIP does not use for data.
    #[error("SCIP line {line} holds the byte {byte:#04x}, allowed: 0x30 to 0x6f")]
    Character {
        /// Counted from 0, the echo.
        line: usize,
        /// The byte.
        byte: u8,
    },
    /// Not as many ranges as were asked for.
    #[error(
        "SCIP reply holds {found} bytes of data with the ends of their lines, the request needs {needed}"
    )]
    Length {
        /// Bytes that came.
        found: usize,
        /// Bytes that the beams of the request need.
        needed: usize,
    },
    /// The caller's buffer does not fit the request.
    #[error(
        "the buffer for ranges or intensities holds {buffer} beams, the request asks for {request}"
    )]
    Buffer {
        /// Beams in the buffer.
        buffer: usize,
        /// Beams of the request.
        request: usize,
    },
    /// A line `KEY:value` is not as it must be.
    #[error("the scanner's line `{key}` is missing, fails its checksum or holds no such value")]
    Field {
        /// Its key.
        key: &'static str,
    },
    /// The sensor speaks SCIP 1.1.
    #[error("the scanner speaks SCIP 1.1; send `SCIP2.0` first")]
    OldProtocol,
    /// The sensor refused the request or reports a fault.
    #[error("the scanner answers status `{}{}`: {}", char::from(.status[0]), char::from(.status[1]), meaning(*.status))]
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

/// 50 to 97: laser, motor or electronics; 0L of the Ethernet models: abnormal state.
fn is_fault(status: [u8; 2]) -> bool {
    status[1].is_ascii_digit() && (*b"50"..=*b"97").contains(&status) || status == *b"0L"
}

fn meaning(status: [u8; 2]) -> &'static str {
    match &status {
        b"01" | b"02" | b"03" | b"06" | b"07" => "a number of the request is no number",
        b"04" => "the last step is outside the sensor's range",
        b"05" => "the last step comes before the first",
        b"10" => "the laser is off; send BM first",
        b"98" => "resumed after a fault; send the request again",
        [b'0', b'A'..=b'H'] => "the sensor does not know this command or its parameters",
        b"0M" => "the sensor is unstable and measures again when it has settled",
        b"0I" => "the sensor is in firmware update mode; restart it",
        _ if is_fault(status) => {
            "hardware fault of laser, motor or electronics; power-cycle the sensor"
        }
        _ => "the measurement was interrupted; check the sensor and send the request again",
    }
}
