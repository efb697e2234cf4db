//! The two checksums that the CAN protocols use.

/// CRC-16/XMODEM of VESC's packets: polynomial 0x1021, initial value 0.
#[must_use]
pub fn crc16(bytes: impl IntoIterator<Item = u8>) -> u16 {
    bytes.into_iter().fold(0, |crc, byte| {
        (0..8).fold(crc ^ (u16::from(byte) << 8), |crc, _| {
            if crc & 0x8000 != 0 { (crc << 1) ^ 0x1021 } else { crc << 1 }
        })
    })
}

/// CRC-8/SAE-J1850 of the project's own frames: polynomial 0x1D, initial value and final XOR 0xFF.
/// The table is computed at compile time.
#[must_use]
pub fn crc8(bytes: impl IntoIterator<Item = u8>) -> u8 {
    !bytes.into_iter().fold(0xff, |crc: u8, byte| CRC8[usize::from(crc ^ byte)])
}

const CRC8: [u8; 256] = {
    let mut table = [0; 256];
    let mut at = 0;
    while at < 256 {
        let mut crc = at as u8;
        let mut bit = 0;
        while bit < 8 {
            crc = if crc & 0x80 != 0 { (crc << 1) ^ 0x1d } else { crc << 1 };
            bit += 1;
        }
        table[at] = crc;
        at += 1;
    }
    table
};

#[cfg(test)]
mod tests {
    use super::*;

    /// The check values of the catalogue of parametrised CRC algorithms: the CRC of the ASCII
    /// digits 1 to 9.
    #[test]
    fn both_checksums_have_the_check_values_of_the_crc_catalogue() {
        assert_eq!(crc16(*b"123456789"), 0x31c3);
        assert_eq!(crc8(*b"123456789"), 0x4b);
    }
}
