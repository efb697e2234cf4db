use segment_store::{Finding, recover, verify};

/// Arbitrary bytes as a segment: what comes out of recovery is whole.
pub fn segment(bytes: &[u8]) {
    let _ = verify(bytes);
    let mut whole = Vec::new();
    if recover(bytes, &mut whole).is_ok() {
        assert_eq!(verify(&whole[..]).map(|verified| verified.finding).ok(), Some(Finding::Whole));
    }
}
