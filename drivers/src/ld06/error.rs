//! Why a packet is refused.

/// A packet that is not what the scanner sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum PacketError {
    /// The checksum is wrong.
    #[error("LD06 packet has the checksum {found:#04x} instead of {computed:#04x}")]
    Checksum { found: u8, computed: u8 },
    /// An angle is beyond a full revolution.
    #[error(
        "LD06 packet names the angle {centidegrees} hundredths of a degree, allowed: 0 to 36000"
    )]
    Angle { centidegrees: u16 },
    /// The points of one packet are spread over an angle that no rotation rate explains.
    #[error(
        "LD06 packet spreads its points over {centidegrees} hundredths of a degree, allowed: 0 to {limit}"
    )]
    Span { centidegrees: u16, limit: u16 },
}
