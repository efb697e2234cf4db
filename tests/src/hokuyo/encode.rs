//! Encoding of SCIP messages.

/// The checksum character of a line.
fn sum(text: &[u8]) -> u8 {
    let total: u32 = text.iter().map(|byte| u32::from(*byte)).sum();
    (total % 64) as u8 + b'0'
}

/// Appends text, its checksum and LF.
pub(super) fn line(out: &mut Vec<u8>, text: &[u8]) {
    out.extend_from_slice(text);
    out.push(sum(text));
    out.push(b'\n');
}

/// Appends `KEY:value;`, its checksum, which excludes the semicolon, and LF.
pub(super) fn field(out: &mut Vec<u8>, key: &str, value: &str) {
    let text = format!("{key}:{value}");
    out.extend_from_slice(text.as_bytes());
    out.extend_from_slice(&[b';', sum(text.as_bytes()), b'\n']);
}

/// Appends a number in the given number of characters, six bits each.
pub(super) fn number(out: &mut Vec<u8>, value: u32, characters: u32) {
    for place in (0..characters).rev() {
        out.push(((value >> (6 * place)) & 63) as u8 + b'0');
    }
}

/// Appends characters in lines of 64.
pub(super) fn block(out: &mut Vec<u8>, characters: &[u8]) {
    characters.chunks(64).for_each(|part| line(out, part));
}
