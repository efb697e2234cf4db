//! The head of every answer: `A5 5A`, length and mode of the data packets that follow, and their kind.

/// Length of a descriptor, bytes.
pub const DESCRIPTOR_BYTES: usize = 7;

/// What follows a descriptor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Descriptor {
    /// Length of each data packet, bytes.
    pub length: u32,
    /// Whether packets follow until the next request, instead of one.
    pub repeats: bool,
    pub kind: u8,
}

impl Descriptor {
    pub const INFO: Self = Self { length: 20, repeats: false, kind: 0x04 };
    pub const HEALTH: Self = Self { length: 3, repeats: false, kind: 0x06 };
    pub const SCAN: Self = Self { length: 5, repeats: true, kind: 0x81 };
    pub const CAPSULES: Self = Self { length: 84, repeats: true, kind: 0x82 };
    pub const DENSE_CAPSULES: Self = Self { length: 84, repeats: true, kind: 0x85 };

    /// Reads a descriptor; `None` if these bytes are none.
    #[must_use]
    pub fn read(bytes: &[u8; DESCRIPTOR_BYTES]) -> Option<Self> {
        let [0xa5, 0x5a, a, b, c, d, kind] = *bytes else { return None };
        let word = u32::from_le_bytes([a, b, c, d]);
        Some(Self { length: word & 0x3fff_ffff, repeats: word >> 30 == 1, kind })
    }

    /// Writes the descriptor as the scanner sends it.
    #[must_use]
    pub fn write(&self) -> [u8; DESCRIPTOR_BYTES] {
        let [a, b, c, d] =
            (self.length & 0x3fff_ffff | u32::from(self.repeats) << 30).to_le_bytes();
        [0xa5, 0x5a, a, b, c, d, self.kind]
    }
}

/// Whether these bytes may be the beginning of a descriptor.
#[must_use]
pub fn may_begin(bytes: &[u8]) -> bool {
    bytes.first() == Some(&0xa5) && bytes.get(1).is_none_or(|byte| *byte == 0x5a)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn descriptors_are_those_of_the_makers_protocol_notes() {
        assert_eq!(Descriptor::SCAN.write(), [0xa5, 0x5a, 0x05, 0, 0, 0x40, 0x81]);
        assert_eq!(Descriptor::CAPSULES.write(), [0xa5, 0x5a, 0x54, 0, 0, 0x40, 0x82]);
        assert_eq!(Descriptor::INFO.write(), [0xa5, 0x5a, 0x14, 0, 0, 0, 0x04]);
        assert_eq!(Descriptor::HEALTH.write(), [0xa5, 0x5a, 0x03, 0, 0, 0, 0x06]);
    }

    proptest! {
        #[test]
        fn what_is_written_is_read_again(length in 0..1_u32 << 30, repeats: bool, kind: u8) {
            let descriptor = Descriptor { length, repeats, kind };
            prop_assert_eq!(Descriptor::read(&descriptor.write()), Some(descriptor));
        }
    }
}
