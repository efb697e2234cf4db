//! Where to go next: the policies.

mod blacklist;

pub use blacklist::Blacklist;
