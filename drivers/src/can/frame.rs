//! One classic CAN frame.

use std::fmt;

/// A frame's identifier. The smaller number wins the bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum CanId {
    /// 11 bits.
    Standard(u16),
    /// 29 bits.
    Extended(u32),
}

impl CanId {
    /// Whether the number fits its format.
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

/// A data or remote frame. Bytes behind its length are always zero, so that two frames are equal when what they say is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct CanFrame {
    id: CanId,
    remote: bool,
    length: u8,
    data: [u8; 8],
}

impl CanFrame {
    /// A data frame; `None` for an id out of its format or more than 8 bytes.
    #[must_use]
    pub fn new(id: CanId, payload: &[u8]) -> Option<Self> {
        let mut data = [0; 8];
        data.get_mut(..payload.len())?.copy_from_slice(payload);
        id.is_valid().then_some(Self { id, remote: false, length: payload.len() as u8, data })
    }

    /// Asks for a frame of this id and length; carries no data.
    #[must_use]
    pub fn remote(id: CanId, length: u8) -> Option<Self> {
        (id.is_valid() && length <= 8).then_some(Self { id, remote: true, length, data: [0; 8] })
    }

    /// A data frame of 8 bytes with an 11-bit id, of which only the lowest 11 bits are taken: for protocols whose ids are
    /// computed from checked node numbers.
    #[must_use]
    pub fn standard(id: u16, data: [u8; 8]) -> Self {
        Self { id: CanId::Standard(id & 0x7ff), remote: false, length: 8, data }
    }

    /// As [`standard`](Self::standard), shorter: `length` above 8 is 8.
    #[must_use]
    pub fn standard_short(id: u16, mut data: [u8; 8], length: usize) -> Self {
        let length = length.min(8);
        data.iter_mut().skip(length).for_each(|byte| *byte = 0);
        Self { id: CanId::Standard(id & 0x7ff), remote: false, length: length as u8, data }
    }

    /// As [`standard_short`](Self::standard_short) with a 29-bit id.
    #[must_use]
    pub fn extended_short(id: u32, data: [u8; 8], length: usize) -> Self {
        Self { id: CanId::Extended(id & 0x1fff_ffff), ..Self::standard_short(0, data, length) }
    }

    /// Who it is for, or what it says.
    #[must_use]
    pub fn id(&self) -> CanId {
        self.id
    }

    /// Whether it asks for data.
    #[must_use]
    pub fn is_remote(&self) -> bool {
        self.remote
    }

    /// Its length code, 0 to 8; of a remote frame the length asked for.
    #[must_use]
    pub fn length(&self) -> u8 {
        self.length
    }

    /// Its data, none for a remote frame.
    #[must_use]
    pub fn data(&self) -> &[u8] {
        let length = if self.remote { 0 } else { usize::from(self.length) };
        self.data.get(..length).unwrap_or(&[])
    }

    /// Its data if it is a data frame of 8 bytes.
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
    fn frames_are_equal_when_they_say_the_same() {
        let short = CanFrame::standard_short(0x123, [1, 2, 3, 4, 5, 6, 7, 8], 2);
        assert_eq!(Some(short), CanFrame::new(CanId::Standard(0x123), &[1, 2]));
        assert_ne!(Some(short), CanFrame::new(CanId::Standard(0x123), &[1, 2, 0]));
        assert_ne!(Some(short), CanFrame::new(CanId::Extended(0x123), &[1, 2]));
    }

    #[test]
    fn ids_and_lengths_out_of_their_format_make_no_frame() {
        assert_eq!(CanFrame::new(CanId::Standard(0x800), &[]), None);
        assert_eq!(CanFrame::new(CanId::Extended(0x2000_0000), &[]), None);
        assert_eq!(CanFrame::new(CanId::Standard(1), &[0; 9]), None);
        assert_eq!(CanFrame::remote(CanId::Standard(1), 9), None);
    }

    #[test]
    fn a_frame_prints_as_candump_prints_it() {
        let text = |frame: Option<CanFrame>| frame.map(|frame| frame.to_string());
        assert_eq!(
            text(CanFrame::new(CanId::Standard(0x1), &[0xde, 0xad])).as_deref(),
            Some("001#DEAD")
        );
        assert_eq!(text(CanFrame::remote(CanId::Extended(0x1), 8)).as_deref(), Some("00000001#R8"));
    }
}
