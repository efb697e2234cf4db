//! Arbitrary bytes as a segment: verified and recovered. What comes out of recovery is whole.
#![no_main]

use buffer::{Finding, recover, verify};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let _ = verify(bytes);
    let mut whole = Vec::new();
    if recover(bytes, &mut whole).is_ok() {
        assert_eq!(verify(&whole[..]).map(|verified| verified.finding).ok(), Some(Finding::Whole));
    }
});
