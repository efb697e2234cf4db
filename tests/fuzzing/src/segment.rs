use segment_store::{Finding, KnownRobots, Signed, check_signature, recover, verify};

/// Arbitrary bytes as a segment. The result of recovery is a complete segment, and it is not signed.
pub fn segment(bytes: &[u8]) {
    let _ = verify(bytes);
    let _ = check_signature(bytes);
    if let Ok(text) = std::str::from_utf8(bytes) {
        let _ = KnownRobots::parse(text);
    }
    let mut whole = Vec::new();
    if recover(bytes, &mut whole).is_ok() {
        assert_eq!(verify(&whole[..]).map(|verified| verified.finding).ok(), Some(Finding::Whole));
        assert_eq!(check_signature(&whole[..]).ok(), Some(Signed::No));
    }
}
