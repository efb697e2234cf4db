//! The protocol between a workstation and `firmware-host buffer serve`, over any pair of byte streams.
//!
//! The workstation sends one request at a time and the robot answers it. Every message is a frame: the length of the body (u32,
//! little-endian), one byte for the kind of message, and the body. `Hello` and `Welcome` are the same in every version, so that
//! programs of different releases can report that they have no version in common.
//!
//! | request | replies |
//! |---|---|
//! | `Hello` lowest and highest version | `Welcome` version, or `Refused` |
//! | `List` | `Entry` for each segment, from version 3 on `Unread` for each one that cannot be read, then `ListEnd` |
//! | `Fetch` name, length and digest of the local copy | `Comparing`..., `Start` from, length, `Data`..., `End` digest |
//! | `Mark` name, digest | `Marked` |
//! | `CpuFeatures`, from version 2 on | `CpuFeatures`: AES in hardware or not |
//!
//! Decoding is a pure function from bytes to messages: it does no I/O and never panics. A frame longer than the limit is refused
//! before memory is allocated for it.

mod frame;
mod reply;
mod request;

pub use frame::{HEAD, MAX_REPLY, MAX_REQUEST, WireError, read_frame, write_frame};
pub use reply::{Refusal, RefusalKind, Reply};
pub use request::Request;

/// The protocol versions that this program supports.
pub const VERSIONS: std::ops::RangeInclusive<u16> = 1..=3;

/// The highest version that both sides support, if there is one.
#[must_use]
pub fn common_version(theirs: (u16, u16)) -> Option<u16> {
    let version = theirs.1.min(*VERSIONS.end());
    (version >= theirs.0 && VERSIONS.contains(&version)).then_some(version)
}

/// The refusal that is sent when there is no common version.
#[must_use]
pub fn version_refusal(theirs: (u16, u16)) -> Refusal {
    Refusal {
        kind: RefusalKind::Version,
        text: format!(
            "this firmware-host {} supports versions {} to {} of the pull protocol, the peer {} to {}; install the \
             same release on the robot and on the workstation",
            env!("CARGO_PKG_VERSION"),
            VERSIONS.start(),
            VERSIONS.end(),
            theirs.0,
            theirs.1
        ),
    }
}
