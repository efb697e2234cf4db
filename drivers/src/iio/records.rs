//! Splits a stream of bytes into records of one length.

/// Room for this many records, so that one read takes what has accumulated.
const ROOM: usize = 64;

/// Collects bytes until they are whole records.
#[derive(Debug, Clone)]
pub struct Records {
    bytes: Vec<u8>,
    record_bytes: usize,
    filled: usize,
}

impl Records {
    /// A buffer for records of `record_bytes` bytes.
    #[must_use]
    pub fn new(record_bytes: usize) -> Self {
        let record_bytes = record_bytes.max(1);
        Self { bytes: vec![0; record_bytes * ROOM], record_bytes, filled: 0 }
    }

    /// Where the next bytes belong; never empty.
    pub fn free_space(&mut self) -> &mut [u8] {
        self.bytes.get_mut(self.filled..).unwrap_or_default()
    }

    /// Takes `count` bytes that were written into the free space, and calls `take` with each whole record.
    pub fn received(&mut self, count: usize, mut take: impl FnMut(&[u8])) {
        self.filled = (self.filled + count).min(self.bytes.len());
        let records = self.bytes.get(..self.filled).unwrap_or_default();
        let whole = records.chunks_exact(self.record_bytes);
        let rest = whole.remainder().len();
        whole.for_each(&mut take);
        self.bytes.copy_within(self.filled - rest..self.filled, 0);
        self.filled = rest;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_pieces_in_which_records_come_do_not_matter(
            bytes in proptest::collection::vec(any::<u8>(), 0..500),
            pieces in proptest::collection::vec(1_usize..90, 1..40),
            record_bytes in 1_usize..20,
        ) {
            let mut records = Records::new(record_bytes);
            let mut found = Vec::new();
            let mut rest = bytes.as_slice();
            for piece in pieces.iter().cycle() {
                let room = records.free_space();
                let count = rest.len().min(*piece).min(room.len());
                room[..count].copy_from_slice(&rest[..count]);
                rest = &rest[count..];
                records.received(count, |record| found.push(record.to_vec()));
                if rest.is_empty() {
                    break;
                }
            }
            prop_assert!(!records.free_space().is_empty());
            let expected: Vec<_> = bytes.chunks_exact(record_bytes).map(<[u8]>::to_vec).collect();
            prop_assert_eq!(found, expected);
        }
    }
}
