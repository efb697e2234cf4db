use segment_store::export::viewer_of_bytes;
use segment_store::{Finding, verify};

use crate::recording::with_checksums;

/// The channels that the export for viewers reads, and one unknown channel.
const TOPICS: [&str; 10] = [
    "/robot/tick",
    "/tf",
    "/scan",
    "/map",
    "/depth",
    "/path",
    "/goal",
    "/events",
    "/camera/image",
    "/unknown",
];

/// Arbitrary bytes as the messages of a segment that is exported for viewers, in the form of [`recording`](crate::recording).
/// The result is a complete MCAP file.
pub fn viewer(bytes: &[u8]) {
    let segment = with_checksums(bytes, &TOPICS);
    let mut file = Vec::new();
    let done = viewer_of_bytes(&segment, &mut file).expect("writing to memory succeeds");
    assert_eq!(done.bad_chunks, 0);
    assert_eq!(verify(&file[..]).map(|verified| verified.finding).ok(), Some(Finding::Whole));
}
