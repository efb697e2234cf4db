//! Splits a stream of bytes into frames of one fixed length.

/// Splits a stream into frames of `N` bytes whose beginning is recognizable. It does no I/O and
/// allocates nothing.
///
/// Bytes that cannot begin a frame are skipped. A frame that fails its check is given up by one byte
/// only, because a good frame may begin inside it.
#[derive(Debug, Clone)]
pub struct FixedFramer<const N: usize> {
    bytes: [u8; N],
    length: usize,
    skipped: u64,
    /// Whether these bytes, at least one, may be the beginning of a frame.
    may_begin: fn(&[u8]) -> bool,
}

impl<const N: usize> FixedFramer<N> {
    /// A framer that has received nothing yet.
    #[must_use]
    pub const fn new(may_begin: fn(&[u8]) -> bool) -> Self {
        Self { bytes: [0; N], length: 0, skipped: 0, may_begin }
    }

    /// Takes the next byte. With the last byte of a frame, returns what `check` makes of the frame.
    pub fn push<T, E>(
        &mut self,
        byte: u8,
        check: impl FnOnce(&[u8; N]) -> Result<T, E>,
    ) -> Option<Result<T, E>> {
        *self.bytes.get_mut(self.length)? = byte;
        self.length += 1;
        self.find_begin();
        if self.length < N {
            return None;
        }
        let checked = check(&self.bytes);
        if checked.is_ok() {
            self.length = 0;
        } else {
            self.skip_one();
            self.find_begin();
        }
        Some(checked)
    }

    /// Number of bytes so far that belonged to no accepted frame.
    #[must_use]
    pub fn skipped(&self) -> u64 {
        self.skipped
    }

    fn skip_one(&mut self) {
        self.bytes.copy_within(1..self.length, 0);
        self.length -= 1;
        self.skipped += 1;
    }

    fn find_begin(&mut self) {
        while self
            .bytes
            .get(..self.length)
            .is_some_and(|got| !got.is_empty() && !(self.may_begin)(got))
        {
            self.skip_one();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Frames `<`, two bytes, and their sum.
    fn framer() -> FixedFramer<4> {
        FixedFramer::new(|got| got[0] == b'<')
    }

    fn sum_is_right(frame: &[u8; 4]) -> Result<[u8; 2], ()> {
        let [_, a, b, sum] = *frame;
        if a.wrapping_add(b) == sum { Ok([a, b]) } else { Err(()) }
    }

    fn frames(bytes: &[u8]) -> Vec<[u8; 2]> {
        let mut framer = framer();
        bytes.iter().filter_map(|byte| framer.push(*byte, sum_is_right)?.ok()).collect()
    }

    #[test]
    fn noise_between_frames_is_skipped() {
        assert_eq!(frames(&[9, 9, b'<', 1, 2, 3, 7, b'<', 4, 5, 9]), [[1, 2], [4, 5]]);
        let mut framer = framer();
        for byte in [9, 9, b'<', 1, 2, 3, 7] {
            _ = framer.push(byte, sum_is_right);
        }
        assert_eq!(framer.skipped(), 3);
    }

    #[test]
    fn a_frame_that_begins_inside_a_broken_one_is_found() {
        assert_eq!(frames(&[b'<', 1, b'<', 4, 5, 9]), [[4, 5]]);
    }

    proptest! {
        #[test]
        fn whole_frames_are_found_after_any_noise_that_holds_no_beginning(
            noise in proptest::collection::vec(0_u8..b'<', 0..20),
            pairs in proptest::collection::vec((0_u8..20, 0_u8..20), 1..10),
        ) {
            let mut stream = noise;
            for (a, b) in &pairs {
                stream.extend([b'<', *a, *b, a + b]);
            }
            let expected: Vec<[u8; 2]> = pairs.iter().map(|(a, b)| [*a, *b]).collect();
            prop_assert_eq!(frames(&stream), expected);
        }
    }
}
