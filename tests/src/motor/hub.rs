//! A CAN bus between processes: a Unix seqpacket socket at which every record that one connection sends goes to all others.

use std::collections::VecDeque;
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};

use drivers::can::record::{self, RECORD_BYTES};
use drivers::can::{BusEvent, CanBus, CanFrame, Received, SendProblem};
use rustix::io::Errno;
use rustix::net::{
    AddressFamily, RecvFlags, SendFlags, SocketAddrUnix, SocketFlags, SocketType, accept_with,
    bind, listen, recv, send, socket_with,
};

/// The hub. As a [`CanBus`] it is the connection of those who live in its own process.
#[derive(Debug)]
pub struct Hub {
    path: PathBuf,
    name: String,
    listener: OwnedFd,
    connections: Vec<OwnedFd>,
    heard: VecDeque<BusEvent>,
    /// Records that a connection did not take because it does not read.
    pub dropped: u64,
}

impl Hub {
    /// Listens at `path`; a socket that somebody left there is removed.
    ///
    /// # Errors
    /// When the path cannot be used, or another hub listens there.
    pub fn bind(path: &Path) -> std::io::Result<Self> {
        let flags = SocketFlags::NONBLOCK | SocketFlags::CLOEXEC;
        let address = SocketAddrUnix::new(path)?;
        let probe = socket_with(AddressFamily::UNIX, SocketType::SEQPACKET, flags, None)?;
        match rustix::net::connect(&probe, &address) {
            Ok(()) => {
                return Err(std::io::Error::other(format!(
                    "another hub listens at {}; end it first",
                    path.display()
                )));
            }
            Err(Errno::CONNREFUSED) => std::fs::remove_file(path)?,
            Err(_) => {}
        }
        let listener = socket_with(AddressFamily::UNIX, SocketType::SEQPACKET, flags, None)?;
        bind(&listener, &address)?;
        listen(&listener, 16)?;
        let name = format!("unix:{}", path.display());
        let (connections, heard) = (Vec::new(), VecDeque::new());
        Ok(Self { path: path.to_owned(), name, listener, connections, heard, dropped: 0 })
    }

    /// How many are connected.
    #[must_use]
    pub fn connections(&self) -> usize {
        self.connections.len()
    }

    /// Every connection is told that its controller is bus-off.
    pub fn inject_bus_off(&mut self) {
        let record = record::bus_off_record();
        for connection in &self.connections {
            let _ = send(connection, &record, SendFlags::DONTWAIT | SendFlags::NOSIGNAL);
        }
    }

    /// Takes in who waits at the door, and hands on what the connections sent.
    fn turn(&mut self) {
        while let Ok(connection) =
            accept_with(&self.listener, SocketFlags::NONBLOCK | SocketFlags::CLOEXEC)
        {
            self.connections.push(connection);
        }
        let mut at = 0;
        while at < self.connections.len() {
            if self.fetch(at) { at += 1 } else { drop(self.connections.swap_remove(at)) }
        }
    }

    /// All that one connection has sent; false when it is gone.
    fn fetch(&mut self, at: usize) -> bool {
        loop {
            let mut bytes = [0; RECORD_BYTES];
            let Some(connection) = self.connections.get(at) else { return false };
            match recv(connection, &mut bytes, RecvFlags::DONTWAIT) {
                Ok((0, _)) => return false,
                Ok((length, _)) => {
                    if let Some(event) = bytes.get(..length).and_then(record::decode) {
                        self.hand_on(&bytes, Some(at));
                        self.heard.push_back(event);
                    }
                }
                Err(Errno::AGAIN | Errno::INTR) => return true,
                Err(_) => return false,
            }
        }
    }

    fn hand_on(&mut self, record: &[u8; RECORD_BYTES], from: Option<usize>) {
        for (_, connection) in
            self.connections.iter().enumerate().filter(|(at, _)| Some(*at) != from)
        {
            if send(connection, record, SendFlags::DONTWAIT | SendFlags::NOSIGNAL).is_err() {
                self.dropped += 1;
            }
        }
    }
}

impl CanBus for Hub {
    fn send(&mut self, frame: &CanFrame) -> Result<(), SendProblem> {
        self.hand_on(&record::encode(frame), None);
        Ok(())
    }

    fn receive(&mut self, now_ns: u64) -> Option<Received> {
        if self.heard.is_empty() {
            self.turn();
        }
        self.heard.pop_front().map(|event| Received { time_ns: now_ns, event })
    }

    fn drop_pending(&mut self) {}

    fn name(&self) -> &str {
        &self.name
    }
}

impl Drop for Hub {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.path);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use drivers::can::UnixBus;

    #[test]
    fn frames_cross_the_hub_both_ways_and_a_lost_hub_is_found_again() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("can");
        let text = path.to_str().expect("a plain path");
        let (mut a, mut b) = (UnixBus::new(text), UnixBus::new(text));
        assert_eq!(a.receive(0).map(|received| received.event), Some(BusEvent::Gone));
        assert_eq!(a.receive(1), None, "told once");
        let mut hub = Hub::bind(&path).expect("a hub");
        assert!(Hub::bind(&path).is_err(), "one hub at a time");
        let retry_ns = 200_000_000;
        assert_eq!(a.receive(retry_ns).map(|received| received.event), Some(BusEvent::Back));
        assert_eq!(b.receive(retry_ns).map(|received| received.event), Some(BusEvent::Back));
        let frame = CanFrame::standard(0x123, [1, 2, 3, 4, 5, 6, 7, 8]);
        assert_eq!(hub.receive(0), None);
        assert_eq!(a.send(&frame), Ok(()));
        assert_eq!(hub.receive(0).map(|received| received.event), Some(BusEvent::Frame(frame)));
        assert_eq!(b.receive(0).map(|received| received.event), Some(BusEvent::Frame(frame)));
        assert_eq!(a.receive(0), None);
        assert_eq!(hub.send(&frame), Ok(()));
        assert_eq!(a.receive(0).map(|received| received.event), Some(BusEvent::Frame(frame)));
        drop(hub);
        assert_eq!(a.receive(0).map(|received| received.event), Some(BusEvent::Gone));
        assert_eq!(a.send(&frame), Err(SendProblem::Gone));
        let _hub = Hub::bind(&path).expect("a hub");
        assert_eq!(a.receive(retry_ns).map(|received| received.event), Some(BusEvent::Back));
    }
}
