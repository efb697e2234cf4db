//! Where to go next: the policies.

mod blacklist;
mod blind;
mod seeker;

pub use blacklist::Blacklist;
pub use blind::BlindPolicy;
