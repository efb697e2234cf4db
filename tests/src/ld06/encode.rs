//! Encoding of packets.

/// Appends a packet of 12 points, each with a distance in millimetres and a confidence. Angles are in
/// hundredths of a degree.
pub(super) fn packet(
    degrees_per_second: u16,
    [start, end]: [u16; 2],
    points: &[(u16, u8); 12],
    milliseconds: u16,
) -> Vec<u8> {
    let mut out = vec![0x54, 0x2c];
    for number in [degrees_per_second, start] {
        out.extend(number.to_le_bytes());
    }
    for (distance_mm, confidence) in points {
        out.extend(distance_mm.to_le_bytes());
        out.push(*confidence);
    }
    for number in [end, milliseconds] {
        out.extend(number.to_le_bytes());
    }
    let crc = remainder(&out);
    out.push(crc);
    out
}

/// The remainder of the bytes, as one long polynomial over GF(2), after division by 0x14d.
fn remainder(bytes: &[u8]) -> u8 {
    let mut rest: u16 = 0;
    for byte in bytes.iter().chain(&[0]) {
        for bit in (0..8).rev() {
            rest = (rest << 1) | u16::from((byte >> bit) & 1);
            if rest & 0x100 != 0 {
                rest ^= 0x14d;
            }
        }
    }
    rest as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_makers_example_has_the_makers_checksum() {
        let near = [224, 220, 217, 213, 211, 208, 205, 202, 199, 197, 194, 192];
        let confidence = [228, 226, 229, 227, 228, 233, 228, 226, 233, 229, 229, 229];
        let points = std::array::from_fn(|index| (near[index], confidence[index]));
        let bytes = packet(2152, [32427, 33470], &points, 6714);
        assert_eq!((bytes.len(), bytes[46]), (47, 0x50));
    }
}
