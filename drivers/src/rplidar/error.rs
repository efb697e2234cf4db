//! Why an answer is refused.

/// An answer that is not what the scanner sent, or that this driver does not read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum AnswerError {
    /// The check bits of a measurement are wrong.
    #[error("RPLIDAR measurement {bytes:02x?} has wrong check bits: bytes were lost or changed")]
    CheckBits { bytes: [u8; 5] },
    /// The checksum of a capsule is wrong.
    #[error("RPLIDAR capsule has the checksum {found:#04x} instead of {computed:#04x}")]
    Checksum { found: u8, computed: u8 },
    /// An angle is beyond a full revolution.
    #[error("RPLIDAR answer names the angle {q6} / 64 degrees, allowed: 0 to 360")]
    Angle { q6: u16 },
    /// A scan of another kind than the driver reads.
    #[error(
        "RPLIDAR answers with data of the kind {kind:#04x} in packets of {length} bytes, readable \
         are 0x81, 0x82 and 0x85; set `scan_mode = \"standard\"`"
    )]
    Kind { kind: u8, length: u32 },
}
