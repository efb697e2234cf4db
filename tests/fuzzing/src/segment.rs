use segment_store::{Finding, recover, verify};

/// Arbitrary bytes as a segment. The result of recovery is a complete segment.
pub fn segment(bytes: &[u8]) {
    let _ = verify(bytes);
    let mut whole = Vec::new();
    if recover(bytes, &mut whole).is_ok() {
        assert_eq!(verify(&whole[..]).map(|verified| verified.finding).ok(), Some(Finding::Whole));
    }
}
