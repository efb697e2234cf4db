//! The bytes of an object, in pieces.

use std::ops::Range;

use crate::{Have, State};
use futures_util::{Stream, StreamExt};
use object_store::{Error, ObjectStore};

use super::look::{Looked, Seen};

/// A request's bytes: large enough that its round trip does not count, small enough to be lost.
const PIECE: u64 = 4 << 20;

/// Pieces under way; with the memory of TLS this stays below 64 MiB.
const AHEAD: usize = 4;

/// Bytes that are handed over at once, so that a limit on the speed is smooth.
pub(crate) const HANDED_OVER: usize = 256 << 10;

/// So much of a segment must still be missing for its own checksums to vouch for a beginning that came earlier: the checksum
/// of all data stands before the index at its end, and an index takes some 20 KB.
const VOUCHING_END: u64 = 1 << 20;

/// Where to go on.
pub(crate) fn first_byte(looked: &Looked, have: &Have) -> u64 {
    let length = looked.entry.bytes;
    let goes_on = match looked.digest {
        // Compared as a whole in the end; what is complete can be compared now.
        Some(digest) => have.bytes < length || have.bytes == length && have.digest == digest,
        None => {
            looked.entry.state != State::Cut && have.bytes.saturating_add(VOUCHING_END) <= length
        }
    };
    if goes_on { have.bytes } else { 0 }
}

/// Everything from byte `from` on.
pub(crate) fn pieces<'a>(
    store: &'a dyn ObjectStore,
    seen: &'a Seen,
    from: u64,
) -> impl Stream<Item = Result<bytes::Bytes, Error>> + 'a {
    futures_util::stream::iter(ranges(from..seen.bytes()))
        .map(move |range| seen.get(store, range))
        .buffered(AHEAD)
}

fn ranges(all: Range<u64>) -> impl Iterator<Item = Range<u64>> {
    let starts = std::iter::successors(Some(all.start), |start| start.checked_add(PIECE));
    let end = all.end;
    starts.take_while(move |start| *start < end).map(move |start| start..end.min(start + PIECE))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_are_next_to_each_other_and_end_with_the_object() {
        for (all, count) in
            [(0..1, 1), (0..PIECE, 1), (7..PIECE + 8, 2), (5..5, 0), (0..3 * PIECE + 1, 4)]
        {
            let pieces: Vec<_> = ranges(all.clone()).collect();
            assert_eq!(pieces.len(), count);
            assert!(pieces.windows(2).all(|pair| pair[0].end == pair[1].start));
            assert_eq!(
                pieces.iter().map(|piece| piece.end - piece.start).sum::<u64>(),
                all.end - all.start
            );
        }
    }
}
