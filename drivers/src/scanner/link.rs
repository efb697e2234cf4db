//! Reading from and writing to a scanner's port, with deadlines. Uses `rustix` and not the crate
//! `serialport`, whose `read` may block past its time-out
//! (<https://github.com/serialport/serialport-rs/issues/7>), and which gives its descriptor only to
//! unsafe code.

use std::io;
use std::net::{TcpStream, ToSocketAddrs};
use std::os::fd::{AsFd, OwnedFd};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{FlockOperation, Mode, OFlags, flock, open};
use rustix::io::Errno;
use rustix::termios::{ControlModes, OptionalActions, QueueSelector};
use rustix::termios::{ioctl_tiocexcl, tcflush, tcgetattr, tcsetattr};

use super::{LinkError, Port};
use monotonic_clock::monotonic_ns;

/// Time-out of a TCP connection: longer than any switch on the way to the scanner takes.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(1);

/// An event descriptor that becomes readable when the driver is dropped, which ends every wait.
pub(crate) type Stop = Arc<OwnedFd>;

#[derive(Debug)]
pub(crate) struct Link {
    fd: OwnedFd,
    stop: Stop,
    port: Arc<str>,
}

/// The result of reading until a deadline.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Received {
    /// This number of bytes, at least one.
    Bytes(usize),
    /// No byte arrived before the deadline.
    Nothing,
    /// The driver is being dropped.
    Stopped,
}

impl Link {
    /// Opens a port and drops the bytes that are already in its buffers.
    pub(crate) fn open(
        port: &Port,
        baud: u32,
        name: &Arc<str>,
        stop: &Stop,
    ) -> Result<Self, LinkError> {
        let fd = match port {
            Port::Serial(path) => open_serial(path, baud),
            Port::Tcp { host, port } => connect(host, *port),
        };
        let fd = fd.map_err(|source| LinkError::Open { port: name.clone(), source })?;
        Ok(Self { fd, stop: stop.clone(), port: name.clone() })
    }

    /// A link over a file that does not block and is already set up.
    pub(crate) fn of(fd: OwnedFd, name: &Arc<str>, stop: &Stop) -> Self {
        Self { fd, stop: stop.clone(), port: name.clone() }
    }

    /// Waits for bytes until the monotonic deadline.
    pub(crate) fn read(&self, buffer: &mut [u8], deadline_ns: u64) -> Result<Received, LinkError> {
        loop {
            let ready = self.wait(PollFlags::IN, deadline_ns)?;
            match ready {
                Ready::Stopped => return Ok(Received::Stopped),
                Ready::Timeout => return Ok(Received::Nothing),
                Ready::Port(events) => match rustix::io::read(&self.fd, &mut *buffer) {
                    Ok(0) => return Err(self.gone(Errno::PIPE)),
                    Ok(count) => return Ok(Received::Bytes(count)),
                    // A port that hung up may report it only here.
                    Err(Errno::AGAIN) if !events.contains(PollFlags::IN) => {
                        return Err(self.gone(Errno::PIPE));
                    }
                    Err(Errno::AGAIN | Errno::INTR) => {}
                    Err(error) => return Err(self.gone(error)),
                },
            }
        }
    }

    /// Sends all bytes until the deadline. A scanner that does not accept them in time counts as
    /// gone.
    pub(crate) fn write(&self, mut bytes: &[u8], deadline_ns: u64) -> Result<(), LinkError> {
        while !bytes.is_empty() {
            match rustix::io::write(&self.fd, bytes) {
                Ok(count) => bytes = bytes.get(count..).unwrap_or_default(),
                Err(Errno::AGAIN) => match self.wait(PollFlags::OUT, deadline_ns)? {
                    Ready::Port(_) => {}
                    Ready::Timeout | Ready::Stopped => return Err(self.gone(Errno::TIMEDOUT)),
                },
                Err(Errno::INTR) => {}
                Err(error) => return Err(self.gone(error)),
            }
        }
        Ok(())
    }

    /// Switches the port's DTR line, which stops the motor of some scanners. Ports without this line
    /// have no such motor behind them, so their error is not one of the scanner.
    pub(crate) fn set_dtr(&self, on: bool) {
        _ = super::sys::set_dtr(&self.fd, on);
    }

    fn wait(&self, what: PollFlags, deadline_ns: u64) -> Result<Ready, LinkError> {
        wait(&self.stop, Some((&self.fd, what)), deadline_ns).map_err(|error| self.gone(error))
    }

    fn gone(&self, error: Errno) -> LinkError {
        LinkError::Gone { port: self.port.clone(), source: error.into() }
    }
}

enum Ready {
    Port(PollFlags),
    Timeout,
    Stopped,
}

/// Waits until the deadline. Returns true when the driver is being dropped.
pub(crate) fn wait_for_stop(stop: &Stop, deadline_ns: u64) -> bool {
    !matches!(wait(stop, None, deadline_ns), Ok(Ready::Timeout))
}

fn wait(
    stop: &Stop,
    port: Option<(&OwnedFd, PollFlags)>,
    deadline_ns: u64,
) -> Result<Ready, Errno> {
    let (fd, what) = port.unwrap_or((stop, PollFlags::IN));
    loop {
        let left_ns = deadline_ns.saturating_sub(monotonic_ns());
        let timeout = Timespec {
            tv_sec: (left_ns / 1_000_000_000) as i64,
            tv_nsec: (left_ns % 1_000_000_000) as i64,
        };
        let mut fds = [PollFd::new(stop, PollFlags::IN), PollFd::new(fd, what)];
        match poll(&mut fds, Some(&timeout)) {
            Ok(0) => return Ok(Ready::Timeout),
            Ok(_) if !fds[0].revents().is_empty() => return Ok(Ready::Stopped),
            Ok(_) => return Ok(Ready::Port(fds[1].revents())),
            Err(Errno::INTR) => {}
            Err(error) => return Err(error),
        }
    }
}

fn open_serial(path: &Path, baud: u32) -> io::Result<OwnedFd> {
    // Without NONBLOCK, open would wait for a modem's carrier.
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
    let fd = open(path, flags, Mode::empty())?;
    // Two programs on one port would take each other's bytes. The lock also excludes processes of
    // root, which TIOCEXCL does not.
    ioctl_tiocexcl(fd.as_fd())?;
    flock(&fd, FlockOperation::NonBlockingLockExclusive)?;
    let mut settings = tcgetattr(&fd)?;
    settings.make_raw();
    settings.control_modes |= ControlModes::CLOCAL | ControlModes::CREAD;
    settings.control_modes -= ControlModes::CRTSCTS | ControlModes::CSTOPB;
    settings.set_speed(baud)?;
    tcsetattr(&fd, OptionalActions::Now, &settings)?;
    tcflush(&fd, QueueSelector::IOFlush)?;
    Ok(fd)
}

fn connect(host: &str, port: u16) -> io::Result<OwnedFd> {
    let mut last = io::Error::new(io::ErrorKind::NotFound, "no address was found for this name");
    for address in (host, port).to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, CONNECT_TIMEOUT) {
            Ok(stream) => {
                stream.set_nodelay(true)?;
                stream.set_nonblocking(true)?;
                return Ok(stream.into());
            }
            Err(error) => last = error,
        }
    }
    Err(last)
}
