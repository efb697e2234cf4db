//! Checksums and characters of the lines of a message.

use super::ScipError;

/// The checksum character of a line: the low six bits of the sum of its bytes, plus `0`.
pub(super) fn checksum(bytes: &[u8]) -> u8 {
    (bytes.iter().fold(0_u8, |sum, byte| sum.wrapping_add(*byte)) & 0x3f) + 0x30
}

/// Whether a byte is a data character, which encodes six bits.
#[inline(always)]
pub(super) fn is_data(byte: u8) -> bool {
    byte.wrapping_sub(0x30) < 0x40
}

/// Returns a line without its checksum if its characters and its checksum are valid. `number` is
/// the line number for the error.
pub(super) fn checked(line: &[u8], number: usize) -> Result<&[u8], ScipError> {
    if let Some(&byte) = line.iter().find(|byte| !is_data(**byte)) {
        return Err(ScipError::Character { line: number, byte });
    }
    let (&found, content) = line.split_last().ok_or(ScipError::Shape { missing: "checksum" })?;
    let computed = checksum(content);
    if found == computed {
        Ok(content)
    } else {
        Err(ScipError::Checksum { line: number, found, computed })
    }
}

/// Decodes a number from characters minus `0`, six bits each, most significant first. Up to five
/// characters fit.
#[inline(always)]
pub(super) fn value(characters: &[u8]) -> u32 {
    characters.iter().fold(0, |value, character| value << 6 | u32::from(*character))
}

/// Decodes a number from characters that were already checked.
pub(super) fn decode(characters: &[u8]) -> u32 {
    characters.iter().fold(0, |value, byte| value << 6 | u32::from(byte.wrapping_sub(0x30) & 0x3f))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_examples_of_the_specification_decode() {
        assert_eq!(decode(b"CB"), 1234);
        assert_eq!(decode(b"1Dh"), 5432);
        assert_eq!(decode(b"m2@0"), 16_000_000);
        assert_eq!((checksum(b"00"), checksum(b"99")), (b'P', b'b'));
        assert_eq!((checksum(b"DMIN:20"), checksum(b"AFRT:384")), (b'4', b'6'));
    }

    #[test]
    fn a_change_of_any_byte_of_a_line_is_detected() {
        let mut line = b"0oPCB1Dhm2@0".to_vec();
        line.push(checksum(&line));
        assert!(checked(&line, 0).is_ok());
        for place in 0..line.len() {
            for byte in (0..=255).filter(|byte| *byte != line[place]) {
                let mut changed = line.clone();
                changed[place] = byte;
                assert!(checked(&changed, 0).is_err(), "byte {place} changed to {byte:#04x}");
            }
        }
    }

    #[test]
    fn an_empty_line_has_no_checksum() {
        assert!(checked(b"", 3).is_err());
    }
}
