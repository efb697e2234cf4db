//! Where segments are pulled from.

mod directory;
mod interface;
mod remote;
mod spec;
mod ssh;
mod ssh_config;

pub use directory::Directory;
pub use interface::{Listing, Source};
pub use remote::Remote;
pub use spec::{Location, Spec, is_store};
pub use ssh::{Ssh, SshOptions};
