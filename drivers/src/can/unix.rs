//! A CAN bus for kernels without CAN: records of `struct can_frame` over a Unix seqpacket socket. A
//! hub accepts the connections and forwards every record to all other connections. Simulated
//! devices in another process connect to it in the same way.
//!
//! Such a socket has no kernel timestamps, so the time of reception is the time at which a frame is
//! read.

use std::os::fd::OwnedFd;

use rustix::io::Errno;
use rustix::net::{
    AddressFamily, RecvFlags, SendFlags, SocketAddrUnix, SocketFlags, SocketType, connect, recv,
    send, socket_with,
};

use super::bus::{Backoff, BusEvent, CanBus, Received, SendProblem};
use super::frame::CanFrame;
use super::record::{self, RECORD_BYTES};

/// A connection to a hub, reconnected after it was lost.
#[derive(Debug)]
pub struct UnixBus {
    path: String,
    name: String,
    socket: Option<OwnedFd>,
    retry: Backoff,
    was_open: bool,
}

impl UnixBus {
    /// Connects to the hub that listens at `path`, which may appear later.
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

    /// Uses an existing connection, and does not reconnect.
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
        // The loss is reported once.
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
        // As with SocketCAN, frames in the receiver's queue cannot be recalled.
        self.socket = None;
        self.retry.reset();
    }

    fn name(&self) -> &str {
        &self.name
    }
}
