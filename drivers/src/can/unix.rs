//! A CAN bus without a kernel that has one: records of `struct can_frame` over a Unix seqpacket socket. A hub accepts the
//! connections and hands every record to all others; simulated devices in another process connect to it as this driver does.
//!
//! There are no kernel time stamps on such a socket: a frame counts as received when it is read.

use std::os::fd::OwnedFd;

use rustix::io::Errno;
use rustix::net::{
    AddressFamily, RecvFlags, SendFlags, SocketAddrUnix, SocketFlags, SocketType, connect, recv,
    send, socket_with,
};

use super::bus::{Backoff, BusEvent, CanBus, Received, SendProblem};
use super::frame::CanFrame;
use super::record::{self, RECORD_BYTES};

/// One connection to a hub, made again whenever it had gone.
#[derive(Debug)]
pub struct UnixBus {
    path: String,
    name: String,
    socket: Option<OwnedFd>,
    retry: Backoff,
    was_open: bool,
}

impl UnixBus {
    /// The hub that listens at `path`. It need not be there yet.
    #[must_use]
    pub fn new(path: &str) -> Self {
        Self {
            path: path.to_owned(),
            name: format!("unix:{path}"),
            socket: None,
            retry: Backoff::new(),
            was_open: true,
        }
    }

    /// Uses a connection that somebody else made, and makes no other.
    #[must_use]
    pub fn from_fd(socket: OwnedFd) -> Self {
        Self {
            path: String::new(),
            name: "unix:".to_owned(),
            socket: Some(socket),
            retry: Backoff::new(),
            was_open: true,
        }
    }

    fn reopen(&mut self, now_ns: u64) -> Option<Received> {
        if self.retry.is_over(now_ns) {
            match open(&self.path) {
                Ok(socket) => {
                    self.socket = Some(socket);
                    self.retry.reset();
                    self.was_open = true;
                    return Some(Received { time_ns: now_ns, event: BusEvent::Back });
                }
                Err(_) => self.retry.wait(now_ns),
            }
        }
        // Told once.
        std::mem::take(&mut self.was_open)
            .then_some(Received { time_ns: now_ns, event: BusEvent::Gone })
    }
}

fn open(path: &str) -> Result<OwnedFd, Errno> {
    let flags = SocketFlags::NONBLOCK | SocketFlags::CLOEXEC;
    let socket = socket_with(AddressFamily::UNIX, SocketType::SEQPACKET, flags, None)?;
    connect(&socket, &SocketAddrUnix::new(path)?)?;
    Ok(socket)
}

impl CanBus for UnixBus {
    fn send(&mut self, frame: &CanFrame) -> Result<(), SendProblem> {
        let socket = self.socket.as_ref().ok_or(SendProblem::Gone)?;
        match send(socket, &record::encode(frame), SendFlags::DONTWAIT | SendFlags::NOSIGNAL) {
            Ok(_) => Ok(()),
            Err(Errno::AGAIN | Errno::NOBUFS) => Err(SendProblem::Full),
            Err(Errno::PIPE | Errno::CONNRESET | Errno::NOTCONN) => Err(SendProblem::Gone),
            Err(code) => Err(SendProblem::Code(code.raw_os_error())),
        }
    }

    fn receive(&mut self, now_ns: u64) -> Option<Received> {
        let Some(socket) = &self.socket else { return self.reopen(now_ns) };
        let mut bytes = [0; RECORD_BYTES];
        let event = match recv(socket, &mut bytes, RecvFlags::DONTWAIT) {
            Ok((0, _)) | Err(Errno::CONNRESET | Errno::PIPE | Errno::NOTCONN) => {
                self.socket = None;
                self.was_open = false;
                self.retry.wait(now_ns);
                BusEvent::Gone
            }
            Ok((read, _)) => bytes.get(..read).and_then(record::decode).unwrap_or(BusEvent::Noise),
            Err(_) => return None,
        };
        Some(Received { time_ns: now_ns, event })
    }

    fn drop_pending(&mut self) {
        // As with SocketCAN, what the other side's queue took already is not recalled.
        self.socket = None;
        self.retry.reset();
    }

    fn name(&self) -> &str {
        &self.name
    }
}
