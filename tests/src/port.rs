//! Transports: a pty with a symbolic link as its stable path, a serial port that is wired to
//! another one, or a TCP port.

use std::ffi::OsStr;
use std::fs;
use std::io;
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{Mode, OFlags, open};
use rustix::io::Errno;
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{ControlModes, OptionalActions, tcgetattr, tcsetattr};

/// Address of a simulated device.
#[derive(Debug, Clone)]
pub(crate) enum Endpoint {
    /// Symbolic link to a pty.
    Pty(PathBuf),
    Serial(PathBuf),
    /// Address to listen at.
    Tcp(SocketAddr),
}

/// An open transport.
#[derive(Debug)]
pub(crate) enum Connection {
    Pty { master: OwnedFd, link: PathBuf },
    Serial { port: OwnedFd },
    Tcp { listener: TcpListener, client: Option<TcpStream> },
}

impl Connection {
    pub(crate) fn open(endpoint: &Endpoint) -> io::Result<Self> {
        match endpoint {
            Endpoint::Pty(link) => {
                let master =
                    openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
                grantpt(&master)?;
                unlockpt(&master)?;
                rustix::io::ioctl_fionbio(&master, true)?;
                let name = ptsname(&master, Vec::new())?;
                replace_link(Path::new(OsStr::from_bytes(name.to_bytes())), link)?;
                Ok(Self::Pty { master, link: link.clone() })
            }
            Endpoint::Serial(path) => Ok(Self::Serial { port: open_raw(path)? }),
            Endpoint::Tcp(address) => {
                let listener = TcpListener::bind(address)?;
                listener.set_nonblocking(true)?;
                Ok(Self::Tcp { listener, client: None })
            }
        }
    }

    /// Local address, for TCP.
    pub(crate) fn address(&self) -> Option<SocketAddr> {
        match self {
            Self::Pty { .. } | Self::Serial { .. } => None,
            Self::Tcp { listener, .. } => listener.local_addr().ok(),
        }
    }

    /// Reads received bytes. Also returns whether a client has just disconnected (TCP only: the
    /// others do not report it).
    pub(crate) fn read(&mut self, buffer: &mut [u8]) -> (usize, bool) {
        match self {
            Self::Pty { master, .. } => (rustix::io::read(&*master, buffer).unwrap_or(0), false),
            Self::Serial { port } => (rustix::io::read(&*port, buffer).unwrap_or(0), false),
            Self::Tcp { listener, client } => {
                if let Ok((stream, _)) = listener.accept() {
                    _ = (stream.set_nonblocking(true), stream.set_nodelay(true));
                    *client = Some(stream);
                }
                let Some(stream) = client else { return (0, false) };
                match rustix::io::read(stream.as_fd(), buffer) {
                    Ok(count) if count > 0 => (count, false),
                    Err(Errno::AGAIN | Errno::INTR) => (0, false),
                    _ => {
                        *client = None;
                        (0, true)
                    }
                }
            }
        }
    }

    /// Sends as many bytes as the host accepts; the rest is lost, as in a device whose buffer is
    /// full. On a serial port it waits for the port's own rate.
    pub(crate) fn write(&mut self, mut bytes: &[u8]) {
        while !bytes.is_empty() {
            let written = match self {
                Self::Pty { master, .. } => rustix::io::write(&*master, bytes),
                Self::Serial { port } => {
                    wait_until_writable(port).and_then(|()| rustix::io::write(&*port, bytes))
                }
                Self::Tcp { client: Some(client), .. } => rustix::io::write(client.as_fd(), bytes),
                Self::Tcp { .. } => return,
            };
            match written {
                Ok(count) => bytes = &bytes[count..],
                Err(_) => return,
            }
        }
    }

    /// The bit rate that the host has set, where there is one.
    pub(crate) fn baud(&self) -> Option<u32> {
        match self {
            Self::Pty { master, .. } => {
                tcgetattr(master).ok().map(|settings| settings.output_speed())
            }
            // The rate of these is not set by the host.
            Self::Serial { .. } | Self::Tcp { .. } => None,
        }
    }
}

/// Opens a serial port in raw mode.
fn open_raw(path: &Path) -> io::Result<OwnedFd> {
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let port = open(path, flags, Mode::empty())?;
    let mut settings = tcgetattr(&port)?;
    settings.make_raw();
    settings.control_modes |= ControlModes::CLOCAL | ControlModes::CREAD;
    settings.set_speed(115_200)?;
    tcsetattr(&port, OptionalActions::Now, &settings)?;
    Ok(port)
}

/// Waits until the port accepts bytes: its buffer is smaller than a scan. After 100 ms the
/// remaining bytes are lost.
fn wait_until_writable(port: &OwnedFd) -> Result<(), Errno> {
    let limit = Timespec { tv_sec: 0, tv_nsec: 100_000_000 };
    match poll(&mut [PollFd::new(port, PollFlags::OUT)], Some(&limit))? {
        0 => Err(Errno::TIMEDOUT),
        _ => Ok(()),
    }
}

impl Drop for Connection {
    fn drop(&mut self) {
        if let Self::Pty { link, .. } = self {
            _ = fs::remove_file(link);
        }
    }
}

/// Creates the link. It replaces a link of an earlier run, but no other file.
fn replace_link(target: &Path, link: &Path) -> io::Result<()> {
    if fs::symlink_metadata(link).is_ok_and(|found| found.file_type().is_symlink()) {
        fs::remove_file(link)?;
    }
    std::os::unix::fs::symlink(target, link)
}
