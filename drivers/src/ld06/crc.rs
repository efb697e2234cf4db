//! The checksum of a packet: CRC-8 with the polynomial 0x4D, from the highest bit, starting at 0.

/// The checksum's polynomial, x^8 + x^6 + x^3 + x^2 + 1, without its highest term.
const POLYNOMIAL: u8 = 0x4d;

const TABLE: [u8; 256] = table();

const fn table() -> [u8; 256] {
    let mut table = [0; 256];
    let mut index = 0;
    while index < 256 {
        let mut crc = index as u8;
        let mut bit = 0;
        while bit < 8 {
            crc = if crc & 0x80 == 0 { crc << 1 } else { (crc << 1) ^ POLYNOMIAL };
            bit += 1;
        }
        table[index] = crc;
        index += 1;
    }
    table
}

/// The checksum of these bytes.
#[must_use]
pub fn crc8(bytes: &[u8]) -> u8 {
    bytes
        .iter()
        .fold(0, |crc, byte| TABLE.get(usize::from(crc ^ byte)).copied().unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_table_begins_like_the_makers() {
        // LDROBOT, LD06 development manual: the table of CrcTable.
        assert_eq!(TABLE[..8], [0x00, 0x4d, 0x9a, 0xd7, 0x79, 0x34, 0xe3, 0xae]);
    }

    proptest! {
        #[test]
        fn every_single_flipped_bit_changes_the_checksum(
            bytes in proptest::collection::vec(any::<u8>(), 46),
            bit in 0..46_usize * 8,
        ) {
            let mut flipped = bytes.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            prop_assert_ne!(crc8(&bytes), crc8(&flipped));
        }
    }
}
