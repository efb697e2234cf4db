//! The client of a simulated camera in another process, at `unix:/path`. See [`wire`]
//! for the protocol.

use std::collections::VecDeque;
use std::os::fd::{AsFd, OwnedFd};
use std::path::Path;
use std::time::Duration;

use rustix::io::Errno;
use rustix::net::sockopt::{Timeout, set_socket_timeout};
use rustix::net::{AddressFamily, SocketAddrUnix, SocketFlags, SocketType, connect, socket_with};

use super::node::{Capability, Control, Filled, FourCc, Interval, Layout, VideoNode};
use super::sys::Buffers;
use super::wire::{self, InWords, Message, Words};

/// Time-out of a response. Setting up a real camera may take about as long.
const RESPONSE_TIMEOUT: Duration = Duration::from_secs(2);

/// A connection to a simulated camera. Closing it stops the stream and frees the buffers.
#[derive(Debug)]
pub struct RemoteNode {
    socket: OwnedFd,
    filled: VecDeque<Message>,
    files: Vec<OwnedFd>,
    buffers: Buffers,
}

impl RemoteNode {
    ///
    /// # Errors
    /// `ENOENT` or `ECONNREFUSED` when no process listens there.
    pub fn open(path: &Path) -> Result<Self, Errno> {
        let socket =
            socket_with(AddressFamily::UNIX, SocketType::SEQPACKET, SocketFlags::CLOEXEC, None)?;
        // The send time-out also applies to `connect`, which would otherwise wait for ever for a
        // process that no longer accepts.
        set_socket_timeout(&socket, Timeout::Recv, Some(RESPONSE_TIMEOUT))?;
        set_socket_timeout(&socket, Timeout::Send, Some(RESPONSE_TIMEOUT))?;
        connect(&socket, &SocketAddrUnix::new(path)?)?;
        Ok(Self { socket, filled: VecDeque::new(), files: Vec::new(), buffers: Buffers::default() })
    }

    fn call(&mut self, operation: u32, words: &[u32]) -> Result<Words, Errno> {
        self.call_for_file(operation, words).map(|(words, _)| words)
    }

    fn call_for_file(
        &mut self,
        operation: u32,
        words: &[u32],
    ) -> Result<(Words, Option<OwnedFd>), Errno> {
        Message::new(operation, words).send(&self.socket, None)?;
        loop {
            // After a time-out the camera counts as gone, because a late response would be taken
            // for the next one.
            let (message, file) = match Message::receive(&self.socket, true) {
                Err(Errno::AGAIN) => return Err(Errno::NODEV),
                received => received?,
            };
            if message.operation == operation {
                return message.outcome().map(|words| (words, file));
            }
            self.filled.push_back(message);
        }
    }
}

impl VideoNode for RemoteNode {
    fn capability(&mut self) -> Result<Capability, Errno> {
        self.call(wire::CAPABILITY, &[]).map(|words| Capability::from_words(&words))
    }

    fn format(&mut self, index: u32) -> Result<FourCc, Errno> {
        self.call(wire::FORMAT, &[index]).map(|words| FourCc(words[0]))
    }

    fn set_layout(&mut self, requested: Layout) -> Result<Layout, Errno> {
        self.call(wire::SET_LAYOUT, &requested.to_words()).map(|words| Layout::from_words(&words))
    }

    fn interval(&mut self, desired: Option<Interval>) -> Result<Interval, Errno> {
        let Interval { numerator, denominator } =
            desired.unwrap_or(Interval { numerator: 0, denominator: 0 });
        let words =
            self.call(wire::INTERVAL, &[u32::from(desired.is_some()), numerator, denominator])?;
        Ok(Interval::from_words(&words))
    }

    fn control(&mut self, id: u32) -> Result<Control, Errno> {
        self.call(wire::CONTROL, &[id]).map(|words| Control::from_words(&words))
    }

    fn control_value(&mut self, id: u32) -> Result<i32, Errno> {
        self.call(wire::CONTROL_VALUE, &[id]).map(|words| words[0].cast_signed())
    }

    fn set_control(&mut self, id: u32, value: i32) -> Result<(), Errno> {
        self.call(wire::SET_CONTROL, &[id, value.cast_unsigned()]).map(|_| ())
    }

    fn allocate(&mut self, count: u32) -> Result<u32, Errno> {
        self.buffers.clear();
        self.files.clear();
        let count = self.call(wire::ALLOCATE, &[count])?[0];
        for index in 0..count {
            let (words, file) = self.call_for_file(wire::BUFFER, &[index])?;
            let file = file.ok_or(Errno::BADMSG)?;
            self.buffers.map_shared(file.as_fd(), words[0] as usize)?;
            self.files.push(file);
        }
        Ok(count)
    }

    fn queue(&mut self, index: u32) -> Result<(), Errno> {
        self.buffers.lend(index);
        Message::new(wire::QUEUE, &[index]).send(&self.socket, None)
    }

    fn dequeue(&mut self) -> Result<Filled, Errno> {
        // At most one message per buffer can be pending. The limit of 64 ends the loop for a camera
        // that sends without end.
        for _ in 0..64 {
            match Message::receive(&self.socket, false) {
                Ok((message, _)) => self.filled.push_back(message),
                Err(Errno::AGAIN) => break,
                Err(errno) => {
                    self.filled.push_back(Message::error(wire::FILLED, errno));
                    break;
                }
            }
        }
        let filled = Filled::from_words(&self.filled.pop_front().ok_or(Errno::AGAIN)?.outcome()?);
        self.buffers.take_back(filled.index)?;
        Ok(filled)
    }

    fn start(&mut self) -> Result<(), Errno> {
        self.call(wire::START, &[]).map(|_| ())
    }

    fn stop(&mut self) -> Result<(), Errno> {
        self.call(wire::STOP, &[])?;
        self.filled.clear();
        self.buffers.take_all_back();
        Ok(())
    }

    fn export(&mut self, index: u32) -> Result<OwnedFd, Errno> {
        let file = self.files.get(index as usize).ok_or(Errno::INVAL)?;
        rustix::io::fcntl_dupfd_cloexec(file, 0)
    }

    fn bytes(&self, index: u32) -> &[u8] {
        self.buffers.bytes(index)
    }
}
