//! Encoding of answers.

/// An answer's descriptor.
pub(super) fn head(length: u8, repeats: bool, kind: u8) -> Vec<u8> {
    vec![0xa5, 0x5a, length, 0, 0, if repeats { 0x40 } else { 0 }, kind]
}

/// A measurement of a standard scan.
pub(super) fn node(is_start: bool, degrees: f64, distance_mm: u16) -> Vec<u8> {
    let angle = (degrees * 64.0) as u32 * 2 + 1;
    let quality: u8 = if distance_mm == 0 { 0 } else { 15 };
    let distance = u32::from(distance_mm) * 4;
    vec![
        quality * 4 + if is_start { 0b01 } else { 0b10 },
        (angle % 256) as u8,
        (angle / 256) as u8,
        (distance % 256) as u8,
        (distance / 256) as u8,
    ]
}

/// A capsule with this body of 80 bytes.
pub(super) fn capsule(is_new: bool, degrees: f64, body: &[u8]) -> Vec<u8> {
    let angle = (degrees * 64.0) as u32 + if is_new { 0x8000 } else { 0 };
    let mut out = vec![0, 0, (angle % 256) as u8, (angle / 256) as u8];
    out.extend(body);
    let sum = out.iter().skip(2).fold(0_u8, |sum, byte| sum ^ byte);
    out[0] = 0xa0 + sum % 16;
    out[1] = 0x50 + sum / 16;
    out
}

/// Five bytes of a capsule: two distances in millimetres with their corrections in eighths of a degree.
pub(super) fn cabin([first, second]: [(u16, u8); 2]) -> [u8; 5] {
    let [[a, b], [c, d]] = [first, second].map(|(distance_mm, correction)| {
        (distance_mm * 4 + u16::from(correction / 16)).to_le_bytes()
    });
    [a, b, c, d, first.1 % 16 + second.1 % 16 * 16]
}
