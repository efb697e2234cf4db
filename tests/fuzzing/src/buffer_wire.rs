use std::io::Cursor;

use segment_store::source::{Remote, Source};
use segment_store::wire::{Reply, Request};
use segment_store::{CpuFeatures, Root};

/// Arbitrary bytes as input of both sides of `pull-buffer`: a robot that serves its buffer, and a
/// workstation that pulls.
pub fn buffer_wire(bytes: &[u8]) {
    if let Some((kind, body)) = bytes.split_first() {
        if let Ok(request) = Request::decode(*kind, body) {
            let mut again = Vec::new();
            assert_eq!(request.encode(&mut again), *kind);
            assert_eq!(again, body);
        }
        if let Ok(reply) = Reply::decode(*kind, body) {
            let mut again = Vec::new();
            assert_eq!(reply.encode(&mut again), *kind);
        }
    }
    // A directory that exists on every Linux and does not accept files.
    if let Ok(root) = Root::open("/proc/self/task".as_ref()) {
        let mut answer = Vec::new();
        let _ = segment_store::serve(
            &root,
            CpuFeatures { aes: true },
            &mut |_| (),
            &mut Cursor::new(bytes),
            &mut answer,
        );
    }
    if let Ok(mut remote) = Remote::greet("fuzz", Cursor::new(bytes), Vec::new(), 1) {
        let _ = remote.cpu_features();
        while let Ok(listing) = remote.list() {
            for entry in &listing.entries {
                let name = entry.name.as_str();
                assert!(
                    !name.starts_with('/') && name.split('/').all(|part| part != ".."),
                    "{name}"
                );
            }
        }
    }
}
