//! The protocol between a workstation and `firmware-host buffer serve`, over any pair of byte streams.
//!
//! The workstation asks, the robot answers, one request at a time. Every message is a frame: the body's length (u32, little
//! endian), a byte that says which message it is, the body. `Hello` and `Welcome` are the same in every version, so that two
//! programs of different age can say so.
//!
//! | asks | answer |
//! |---|---|
//! | `Hello` versions from..to | `Welcome` version, or `Refused` |
//! | `List` | `Entry` for each file, then `ListEnd` |
//! | `Fetch` name, length and digest of what is there | `Working`..., `Start` from, length, `Data`..., `End` digest |
//! | `Mark` name, digest | `Marked` |
//! | `Computer`, from version 2 on | `Computer` with AES in hardware or not |
//!
//! Decoding takes bytes and gives messages; it never reads, waits or panics, and a length beyond the limit is refused before
//! anything is allocated for it.

mod frame;
mod reply;
mod request;

pub use frame::{HEAD, MAX_REPLY, MAX_REQUEST, WireError, read_frame, write_frame};
pub use reply::{Refusal, RefusalKind, Reply};
pub use request::Request;

/// Protocol versions that this program speaks.
pub const VERSIONS: std::ops::RangeInclusive<u16> = 1..=2;

/// The version that both speak, if there is one: the highest.
#[must_use]
pub fn common_version(theirs: (u16, u16)) -> Option<u16> {
    let version = theirs.1.min(*VERSIONS.end());
    (version >= theirs.0 && VERSIONS.contains(&version)).then_some(version)
}

/// In words, for a refusal.
#[must_use]
pub fn version_refusal(theirs: (u16, u16)) -> Refusal {
    Refusal {
        kind: RefusalKind::Version,
        text: format!(
            "this firmware-host {} speaks versions {} to {} of the buffer protocol, the other side {} to {}; install the \
             same release on the robot and on the workstation",
            env!("CARGO_PKG_VERSION"),
            VERSIONS.start(),
            VERSIONS.end(),
            theirs.0,
            theirs.1
        ),
    }
}
