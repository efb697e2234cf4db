//! Serialization of ROS 2 messages in OMG's Common Data Representation, version 1, little-endian (XCDR1, DDS-XTypes 1.3, 7.4.1).
//!
//! Every number is aligned to its own size, counted from the end of the four-byte encapsulation header.

/// The encapsulation header: `CDR_LE` without options.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// A message that is being serialized.
pub(super) struct Cdr {
    bytes: Vec<u8>,
}

impl Cdr {
    pub(super) fn new() -> Self {
        Self { bytes: ENCAPSULATION.to_vec() }
    }

    pub(super) fn into_bytes(self) -> Vec<u8> {
        self.bytes
    }

    fn aligned<const SIZE: usize>(&mut self, value: [u8; SIZE]) {
        let body = self.bytes.len() - ENCAPSULATION.len();
        self.bytes.resize(ENCAPSULATION.len() + body.next_multiple_of(SIZE), 0);
        self.bytes.extend_from_slice(&value);
    }

    pub(super) fn u8(&mut self, value: u8) {
        self.bytes.push(value);
    }

    pub(super) fn bool(&mut self, value: bool) {
        self.bytes.push(u8::from(value));
    }

    pub(super) fn i32(&mut self, value: i32) {
        self.aligned(value.to_le_bytes());
    }

    pub(super) fn u32(&mut self, value: u32) {
        self.aligned(value.to_le_bytes());
    }

    pub(super) fn f32(&mut self, value: f32) {
        self.aligned(value.to_le_bytes());
    }

    pub(super) fn f64(&mut self, value: f64) {
        self.aligned(value.to_le_bytes());
    }

    /// An array of fixed length; the length is not written.
    pub(super) fn array(&mut self, values: &[f64]) {
        values.iter().for_each(|value| self.f64(*value));
    }

    /// The number of elements of a sequence, which the caller writes afterwards.
    pub(super) fn length(&mut self, elements: usize) {
        // No sequence has 2^32 elements; the longest is the data of an image.
        self.u32(elements as u32);
    }

    pub(super) fn octets(&mut self, values: &[u8]) {
        self.length(values.len());
        self.bytes.extend_from_slice(values);
    }

    /// A string with its length and a terminating zero.
    pub(super) fn string(&mut self, text: &str) {
        self.length(text.len() + 1);
        self.bytes.extend_from_slice(text.as_bytes());
        self.bytes.push(0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_aligned_to_their_size_after_the_encapsulation_header() {
        let mut cdr = Cdr::new();
        cdr.u8(7);
        cdr.u32(1);
        cdr.string("ab");
        cdr.f64(1.0);
        let mut expected = vec![0, 1, 0, 0, 7, 0, 0, 0, 1, 0, 0, 0, 3, 0, 0, 0, b'a', b'b', 0];
        expected.extend([0; 1]);
        expected.extend(1.0_f64.to_le_bytes());
        assert_eq!(cdr.into_bytes(), expected);
    }
}
