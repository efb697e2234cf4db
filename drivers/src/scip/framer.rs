//! Splits the received bytes into messages.

/// Length of the first complete message in the received bytes, including its empty line. `None`
/// while it is incomplete.
#[must_use]
pub fn message_length(received: &[u8]) -> Option<usize> {
    end_of_message(received, 0)
}

/// As [`message_length`], if it is known that no message ends in the first `known` bytes.
fn end_of_message(received: &[u8], known: usize) -> Option<usize> {
    const STRIDE: usize = 64;
    let mut at = known.saturating_sub(1);
    // Strides of 64 byte pairs without an empty line are skipped by a loop without branches.
    while let Some(stride) = received.get(at..at + STRIDE + 1) {
        let pairs = stride[..STRIDE].iter().zip(&stride[1..]);
        if pairs.fold(0, |found, (a, b)| found | u8::from(*a == b'\n') & u8::from(*b == b'\n')) != 0
        {
            break;
        }
        at += STRIDE;
    }
    let rest = received.get(at..)?;
    rest.windows(2).position(|pair| pair == b"\n\n").map(|found| at + found + 2)
}

/// Splits a stream of bytes into messages. Buffers up to `N` bytes; a longer message is not from a
/// scanner and is dropped.
#[derive(Debug)]
pub struct Framer<const N: usize> {
    bytes: [u8; N],
    /// Length of the message that was returned last, which is dropped next.
    taken: usize,
    length: usize,
    /// No message ends before this position.
    known: usize,
}

impl<const N: usize> Default for Framer<N> {
    fn default() -> Self {
        Self { bytes: [0; N], taken: 0, length: 0, known: 0 }
    }
}

impl<const N: usize> Framer<N> {
    /// The free part of the buffer, never empty. The caller writes bytes into it and passes their
    /// number to [`received`](Self::received).
    pub fn free_space(&mut self) -> &mut [u8] {
        self.drop_taken();
        if self.length == N {
            self.clear();
        }
        self.bytes.get_mut(self.length..).unwrap_or_default()
    }

    /// Records that `count` bytes were written into the free space.
    pub fn received(&mut self, count: usize) {
        self.length = (self.length + count).min(N);
    }

    /// Returns the next complete message, including its empty line.
    pub fn message(&mut self) -> Option<&[u8]> {
        self.drop_taken();
        let received = self.bytes.get(..self.length)?;
        let end = end_of_message(received, self.known);
        self.known = self.length;
        self.taken = end?;
        received.get(..self.taken)
    }

    /// Drops everything that was received.
    pub fn clear(&mut self) {
        self.taken = 0;
        self.length = 0;
        self.known = 0;
    }

    fn drop_taken(&mut self) {
        if self.taken > 0 {
            self.bytes.copy_within(self.taken..self.length, 0);
            self.length -= self.taken;
            self.taken = 0;
            self.known = 0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_message_is_complete_with_its_empty_line() {
        assert_eq!(message_length(b"MD\n00P\n"), None);
        assert_eq!(message_length(b"MD\n00P\n\nMD\n99b\n"), Some(8));
        assert_eq!(message_length(b"\n\n"), Some(2));
    }

    #[test]
    fn a_message_longer_than_the_buffer_is_dropped_and_the_next_one_is_found() {
        let mut framer = Framer::<8>::default();
        for byte in *b"endless\nendless\nshort\n\n" {
            assert!(framer.message().is_none());
            framer.free_space()[0] = byte;
            framer.received(1);
        }
        assert!(framer.message().is_some_and(|message| message.ends_with(b"\n\n")));
    }

    fn any_lines() -> impl Strategy<Value = Vec<u8>> {
        proptest::collection::vec(prop_oneof![9 => Just(b'x'), 1 => Just(b'\n')], 0..300)
    }

    proptest! {
        #[test]
        fn the_length_equals_that_of_a_simple_search(
            bytes in any_lines(),
        ) {
            let simple = bytes.windows(2).position(|pair| pair == b"\n\n").map(|at| at + 2);
            prop_assert_eq!(message_length(&bytes), simple);
        }

        #[test]
        fn messages_do_not_depend_on_how_the_bytes_are_split(
            messages in proptest::collection::vec("[a-z]{1,30}(\n[a-z]{1,30}){0,3}\n\n", 0..6),
            pieces in proptest::collection::vec(1..40_usize, 1..20),
        ) {
            let mut rest = messages.concat().into_bytes();
            let mut pieces = pieces.iter().cycle();
            let mut framer = Framer::<256>::default();
            let mut found = Vec::new();
            while !rest.is_empty() {
                let space = framer.free_space();
                let count = rest.len().min(space.len()).min(*pieces.next().unwrap());
                space[..count].copy_from_slice(&rest[..count]);
                rest.drain(..count);
                framer.received(count);
                while let Some(message) = framer.message() {
                    found.push(String::from_utf8(message.to_vec()).unwrap());
                }
            }
            prop_assert_eq!(found, messages);
        }
    }
}
