//! A CAN bus between processes: a Unix seqpacket socket that forwards every record of one
//! connection to all others.

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

/// The hub of the bus. As a [`CanBus`] it is the connection of the nodes in its own process.
#[derive(Debug)]
pub struct Hub {
    path: PathBuf,
    name: String,
    listener: OwnedFd,
    connections: Vec<OwnedFd>,
    received: VecDeque<BusEvent>,
    /// Number of records that a connection did not accept because it does not read.
    pub dropped: u64,
}

impl Hub {
    /// Listens at `path`. A socket that an ended process left there is removed.
    ///
    /// # Errors
    /// Returns an error when the path cannot be used or another hub listens there.
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
        let connections = Vec::new();
        let received = VecDeque::new();
        Ok(Self { path: path.to_owned(), name, listener, connections, received, dropped: 0 })
    }

    #[must_use]
    pub fn connections(&self) -> usize {
        self.connections.len()
    }

    /// Reports to every connection that its controller is bus-off.
    pub fn inject_bus_off(&mut self) {
        let record = record::bus_off_record();
        for connection in &self.connections {
            let _ = send(connection, &record, SendFlags::DONTWAIT | SendFlags::NOSIGNAL);
        }
    }

    /// Accepts new connections and forwards the records of all connections.
    fn poll_connections(&mut self) {
        while let Ok(connection) =
            accept_with(&self.listener, SocketFlags::NONBLOCK | SocketFlags::CLOEXEC)
        {
            self.connections.push(connection);
        }
        let mut at = 0;
        while at < self.connections.len() {
            if self.receive_from(at) { at += 1 } else { drop(self.connections.swap_remove(at)) }
        }
    }

    /// Receives all records of one connection. Returns false when it is closed.
    fn receive_from(&mut self, at: usize) -> bool {
        loop {
            let mut bytes = [0; RECORD_BYTES];
            let Some(connection) = self.connections.get(at) else { return false };
            match recv(connection, &mut bytes, RecvFlags::DONTWAIT) {
                Ok((0, _)) => return false,
                Ok((length, _)) => {
                    if let Some(event) = bytes.get(..length).and_then(record::decode) {
                        self.forward(&bytes, Some(at));
                        self.received.push_back(event);
                    }
                }
                Err(Errno::AGAIN | Errno::INTR) => return true,
                Err(_) => return false,
            }
        }
    }

    fn forward(&mut self, record: &[u8; RECORD_BYTES], from: Option<usize>) {
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
        self.forward(&record::encode(frame), None);
        Ok(())
    }

    fn receive(&mut self, now_ns: u64) -> Option<Received> {
        if self.received.is_empty() {
            self.poll_connections();
        }
        self.received.pop_front().map(|event| Received { time_ns: now_ns, event })
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
        let mut a = UnixBus::new(text);
        let mut b = UnixBus::new(text);
        assert_eq!(a.receive(0).map(|received| received.event), Some(BusEvent::Gone));
        assert_eq!(a.receive(1), None, "reported once");
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
