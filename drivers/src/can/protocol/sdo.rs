//! Expedited SDO transfers of CANopen (CiA 301, 7.2.4): one request and one response of up to four
//! bytes.

use crate::can::frame::CanFrame;

/// An entry of a node's object dictionary with its desired value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Entry {
    pub index: u16,
    pub sub: u8,
    /// The value as sign-extended bits.
    pub value: u32,
    /// Size of the value in bytes: 1, 2 or 4.
    pub bytes: u8,
}

impl Entry {
    /// An entry of 8 bits.
    #[must_use]
    pub const fn u8(index: u16, sub: u8, value: u8) -> Self {
        Self { index, sub, value: value as u32, bytes: 1 }
    }

    /// An entry of 16 bits.
    #[must_use]
    pub const fn u16(index: u16, sub: u8, value: u16) -> Self {
        Self { index, sub, value: value as u32, bytes: 2 }
    }

    /// An entry of 32 bits.
    #[must_use]
    pub const fn u32(index: u16, sub: u8, value: u32) -> Self {
        Self { index, sub, value, bytes: 4 }
    }

    /// Whether the entry has this index and sub-index.
    #[must_use]
    pub fn is_at(&self, index: u16, sub: u8) -> bool {
        (self.index, self.sub) == (index, sub)
    }

    /// The request that writes this entry.
    #[must_use]
    pub fn download(&self, node: u8) -> CanFrame {
        let [i0, i1] = self.index.to_le_bytes();
        let [a, b, c, d] = self.value.to_le_bytes();
        // Client command 1, expedited, size indicated: bits 2 and 3 hold the number of bytes
        // without data.
        let command = 0x23 | (4 - self.bytes.clamp(1, 4)) << 2;
        CanFrame::standard(0x600 + u16::from(node & 0x7f), [command, i0, i1, self.sub, a, b, c, d])
    }

    /// The request that reads this entry.
    #[must_use]
    pub fn upload(&self, node: u8) -> CanFrame {
        let [i0, i1] = self.index.to_le_bytes();
        CanFrame::standard(0x600 + u16::from(node & 0x7f), [0x40, i0, i1, self.sub, 0, 0, 0, 0])
    }
}

/// A node's response to an SDO request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Response {
    /// The entry was written.
    Written { index: u16, sub: u8 },
    /// The entry was read.
    Value {
        index: u16,
        sub: u8,
        /// The value; bytes that were not sent are zero.
        value: u32,
    },
    /// The node refused the request.
    Abort {
        index: u16,
        sub: u8,
        /// Abort code of CiA 301, table 22.
        code: u32,
    },
}

/// Decodes a frame of a node's SDO channel. `None` for segmented and block transfers, which this
/// driver never requests.
#[must_use]
pub fn decode(data: &[u8; 8]) -> Option<Response> {
    let [command, i0, i1, sub, a, b, c, d] = *data;
    let index = u16::from_le_bytes([i0, i1]);
    let value = u32::from_le_bytes([a, b, c, d]);
    match command {
        0x60 => Some(Response::Written { index, sub }),
        0x80 => Some(Response::Abort { index, sub, code: value }),
        // Expedited upload: 0x43 indicates the size, 0x42 does not.
        0x43 | 0x42 => Some(Response::Value { index, sub, value }),
        0x47 => Some(Response::Value { index, sub, value: value & 0x00ff_ffff }),
        0x4b => Some(Response::Value { index, sub, value: value & 0xffff }),
        0x4f => Some(Response::Value { index, sub, value: value & 0xff }),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_have_the_bytes_of_the_standard() {
        assert_eq!(Entry::u16(0x1017, 0, 500).download(5).to_string(), "605#2B171000F4010000");
        assert_eq!(Entry::u8(0x6060, 0, 3).download(5).to_string(), "605#2F60600003000000");
        assert_eq!(
            Entry::u32(0x1016, 1, 0x007f_0064).download(5).to_string(),
            "605#2316100164007F00"
        );
        assert_eq!(Entry::u32(0x1016, 1, 0).upload(5).to_string(), "605#4016100100000000");
    }

    #[test]
    fn responses_hold_only_the_bytes_that_were_sent() {
        assert_eq!(
            decode(&[0x4f, 0x61, 0x60, 0, 3, 9, 9, 9]),
            Some(Response::Value { index: 0x6061, sub: 0, value: 3 })
        );
        let abort = Response::Abort { index: 0x1016, sub: 1, code: 0x0602_0000 };
        assert_eq!(decode(&[0x80, 0x16, 0x10, 1, 0, 0, 2, 6]), Some(abort));
        assert_eq!(decode(&[0x41, 0, 0, 0, 0, 0, 0, 0]), None);
    }
}
