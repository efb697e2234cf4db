//! Reading of an object in several requests.

use std::ops::Range;

use crate::{LocalCopy, State};
use futures_util::{Stream, StreamExt};
use object_store::{Error, ObjectStore};

use super::object::{InspectedSegment, ObjectVersion};

/// The size of one request: large enough that the round trip does not matter, small enough to repeat after an error.
const PIECE: u64 = 4 << 20;

/// Requests in flight; together with the buffers of TLS they stay below 64 MiB.
const AHEAD: usize = 4;

/// The size of the pieces passed to the receiver, small enough for a rate limit to be smooth.
pub(crate) const SINK_PIECE: usize = 256 << 10;

/// Without a digest, a local copy is continued only when at least this much of the segment is still missing. The checksum of all
/// data, which verifies the copy, is before the index at the end, and an index has about 20 KB.
const UNVERIFIED_END: u64 = 1 << 20;

/// The offset at which to continue a local copy.
pub(crate) fn first_byte(segment: &InspectedSegment, local: &LocalCopy) -> u64 {
    let length = segment.entry.bytes;
    let continues = match segment.digest {
        // An incomplete copy is verified when it is complete; a complete one is compared now.
        Some(digest) => local.bytes < length || local.bytes == length && local.digest == digest,
        None => {
            segment.entry.state != State::Cut
                && local.bytes.saturating_add(UNVERIFIED_END) <= length
        }
    };
    if continues { local.bytes } else { 0 }
}

/// The bytes of an object version from offset `from` on.
pub(crate) fn pieces<'a>(
    store: &'a dyn ObjectStore,
    version: &'a ObjectVersion,
    from: u64,
) -> impl Stream<Item = Result<bytes::Bytes, Error>> + 'a {
    futures_util::stream::iter(ranges(from..version.bytes()))
        .map(move |range| version.get(store, range))
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
    fn requests_cover_the_object_without_gaps_or_overlaps() {
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
