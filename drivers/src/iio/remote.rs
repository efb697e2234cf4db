//! The connection to a unit in another program. See [`wire`](super::wire) for the protocol.

use std::os::fd::OwnedFd;
use std::path::Path;
use std::sync::Arc;

use rustix::io::Errno;
use rustix::net::{AddressFamily, SocketAddrUnix, SocketFlags, SocketType, socket_with};

use super::ImuError;
use super::attributes::failed;

/// Connects without waiting. A program that no longer accepts counts as absent.
pub(super) fn connect(path: &Path, device: &Arc<str>) -> Result<OwnedFd, ImuError> {
    try_connect(path).map_err(|errno| match errno {
        Errno::NOENT | Errno::CONNREFUSED | Errno::AGAIN => ImuError::Absent {
            device: Arc::clone(device),
            what: format!("no program accepts connections there ({errno})"),
        },
        Errno::ACCESS | Errno::PERM => ImuError::SocketDenied { path: path.to_owned() },
        errno => failed(path.to_owned(), "cannot be connected to".to_owned(), errno.into()),
    })
}

fn try_connect(path: &Path) -> Result<OwnedFd, Errno> {
    let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
    let socket = socket_with(AddressFamily::UNIX, SocketType::STREAM, flags, None)?;
    rustix::net::connect(&socket, &SocketAddrUnix::new(path)?)?;
    Ok(socket)
}
