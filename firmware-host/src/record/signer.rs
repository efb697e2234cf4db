//! Signs the segments of a run, each with the digest of the one before it.

use std::collections::BTreeMap;

use segment_store::signature::{RobotKey, Statement};

/// Signs the segments of one run.
pub(super) struct Signer {
    key: RobotKey,
    run: String,
    /// Digest of the segment that was signed last; empty before the first.
    previous: String,
}

impl Signer {
    pub(super) fn new(key: RobotKey, run: &str) -> Self {
        Self { key, run: run.to_owned(), previous: String::new() }
    }

    /// The signature of segment number `segment`, whose bytes have the SHA-256 `digest`.
    pub(super) fn sign(&mut self, segment: u32, digest: String) -> BTreeMap<String, String> {
        let statement = Statement {
            robot: self.key.public(),
            run: self.run.clone(),
            segment,
            previous: std::mem::replace(&mut self.previous, digest.clone()),
            digest,
        };
        self.key.sign(&statement)
    }
}
