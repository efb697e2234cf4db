//! One classic CAN frame.

use std::fmt;

/// The identifier of a frame. On the bus, the frame with the smaller identifier has priority.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum CanId {
    /// An identifier of 11 bits.
    Standard(u16),
    /// An identifier of 29 bits.
    Extended(u32),
}

impl CanId {
    /// Whether the number has no more bits than its format allows.
    #[must_use]
    pub fn is_valid(self) -> bool {
        match self {
            Self::Standard(id) => id <= 0x7ff,
            Self::Extended(id) => id <= 0x1fff_ffff,
        }
    }
}

impl fmt::Display for CanId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Standard(id) => write!(f, "{id:03X}"),
            Self::Extended(id) => write!(f, "{id:08X}"),
        }
    }
}

/// A data or remote frame. Bytes beyond its length are always zero, so that frames of equal content
/// compare as equal.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct CanFrame {
    id: CanId,
    remote: bool,
    length: u8,
    data: [u8; 8],
}

impl CanFrame {
    /// A data frame. `None` if the id exceeds its format or the payload has more than 8 bytes.
    #[must_use]
    pub fn new(id: CanId, payload: &[u8]) -> Option<Self> {
        let mut data = [0; 8];
        data.get_mut(..payload.len())?.copy_from_slice(payload);
        id.is_valid().then_some(Self { id, remote: false, length: payload.len() as u8, data })
    }

    /// A remote frame: it requests a data frame of this id and length, and carries no data itself.
    #[must_use]
    pub fn remote(id: CanId, length: u8) -> Option<Self> {
        (id.is_valid() && length <= 8).then_some(Self { id, remote: true, length, data: [0; 8] })
    }

    /// A data frame of 8 bytes with an 11-bit id. Higher bits of `id` are ignored, for protocols
    /// that compute ids from node numbers that were already checked.
    #[must_use]
    pub fn standard(id: u16, data: [u8; 8]) -> Self {
        Self { id: CanId::Standard(id & 0x7ff), remote: false, length: 8, data }
    }

    /// As [`standard`](Self::standard) with fewer bytes. A `length` above 8 counts as 8.
    #[must_use]
    pub fn standard_short(id: u16, mut data: [u8; 8], length: usize) -> Self {
        let length = length.min(8);
        data.iter_mut().skip(length).for_each(|byte| *byte = 0);
        Self { id: CanId::Standard(id & 0x7ff), remote: false, length: length as u8, data }
    }

    /// As [`standard_short`](Self::standard_short), with a 29-bit id.
    #[must_use]
    pub fn extended_short(id: u32, data: [u8; 8], length: usize) -> Self {
        Self { id: CanId::Extended(id & 0x1fff_ffff), ..Self::standard_short(0, data, length) }
    }

    #[must_use]
    pub fn id(&self) -> CanId {
        self.id
    }

    /// Whether this is a remote frame, which requests data.
    #[must_use]
    pub fn is_remote(&self) -> bool {
        self.remote
    }

    /// The length code, 0 to 8. For a remote frame, the requested length.
    #[must_use]
    pub fn length(&self) -> u8 {
        self.length
    }

    /// The payload, empty for a remote frame.
    #[must_use]
    pub fn data(&self) -> &[u8] {
        let length = if self.remote { 0 } else { usize::from(self.length) };
        self.data.get(..length).unwrap_or(&[])
    }

    /// The payload if this is a data frame of exactly 8 bytes.
    #[must_use]
    pub fn eight(&self) -> Option<&[u8; 8]> {
        (!self.remote && self.length == 8).then_some(&self.data)
    }
}

impl fmt::Display for CanFrame {
    /// As `candump` prints it: `123#DEADBEEF`, `123#R`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}#", self.id)?;
        if self.remote {
            return write!(f, "R{}", self.length);
        }
        self.data().iter().try_for_each(|byte| write!(f, "{byte:02X}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_of_equal_content_are_equal() {
        let short = CanFrame::standard_short(0x123, [1, 2, 3, 4, 5, 6, 7, 8], 2);
        assert_eq!(Some(short), CanFrame::new(CanId::Standard(0x123), &[1, 2]));
        assert_ne!(Some(short), CanFrame::new(CanId::Standard(0x123), &[1, 2, 0]));
        assert_ne!(Some(short), CanFrame::new(CanId::Extended(0x123), &[1, 2]));
    }

    #[test]
    fn ids_and_lengths_beyond_their_format_are_refused() {
        assert_eq!(CanFrame::new(CanId::Standard(0x800), &[]), None);
        assert_eq!(CanFrame::new(CanId::Extended(0x2000_0000), &[]), None);
        assert_eq!(CanFrame::new(CanId::Standard(1), &[0; 9]), None);
        assert_eq!(CanFrame::remote(CanId::Standard(1), 9), None);
    }

    #[test]
    fn a_frame_prints_as_candump_prints_it() {
        let data = CanFrame::new(CanId::Standard(0x1), &[0xde, 0xad]).expect("a sound frame");
        assert_eq!(data.to_string(), "001#DEAD");
        let remote = CanFrame::remote(CanId::Extended(0x1), 8).expect("a sound frame");
        assert_eq!(remote.to_string(), "00000001#R8");
    }
}
