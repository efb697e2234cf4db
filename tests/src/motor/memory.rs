//! A CAN bus in memory, in virtual time, with injectable faults.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use drivers::can::{BusEvent, CanBus, CanFrame, ErrorState, Received, SendProblem};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// Frames that Linux queues for an interface that cannot send: the default `txqueuelen` of a CAN
/// interface.
const QUEUE: usize = 10;

/// Faults of the connection of one node.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LineFaults {
    /// The transmit queue is full: `ENOBUFS`.
    pub full: bool,
    /// Frames stay in the operating system's queue until this ends, and then are all sent.
    pub jammed: bool,
    /// The interface does not exist.
    pub gone: bool,
    /// Fraction of frames from and to this node that are lost.
    pub lost_share: f64,
    /// Fraction of frames that this node receives twice.
    pub doubled_share: f64,
    /// Delay of frames to this node.
    pub late_ns: u64,
}

#[derive(Debug, Default)]
struct Port {
    faults: LineFaults,
    inbox: VecDeque<(u64, BusEvent)>,
    queue: VecDeque<CanFrame>,
    off: bool,
    was_gone: bool,
    sent: Vec<(u64, CanFrame)>,
}

#[derive(Debug)]
struct Network {
    now_ns: u64,
    rng: Pcg64Mcg,
    ports: Vec<Port>,
}

impl Network {
    fn deliver(&mut self, from: usize, frame: CanFrame) {
        let now_ns = self.now_ns;
        let lost_here = self.ports.get(from).map_or(0.0, |port| port.faults.lost_share);
        if let Some(port) = self.ports.get_mut(from) {
            port.sent.push((now_ns, frame));
        }
        if self.rng.random::<f64>() < lost_here {
            return;
        }
        for (_, port) in self.ports.iter_mut().enumerate().filter(|(at, _)| *at != from) {
            let copies = 1 + usize::from(self.rng.random::<f64>() < port.faults.doubled_share);
            let lost = self.rng.random::<f64>() < port.faults.lost_share;
            if lost || port.off || port.faults.gone {
                continue;
            }
            for _ in 0..copies {
                port.inbox.push_back((now_ns + port.faults.late_ns, BusEvent::Frame(frame)));
            }
        }
    }
}

/// The connection of one node. Clones refer to the same connection: one for the node, one for the
/// test that injects faults.
#[derive(Debug, Clone)]
pub struct MemoryBus {
    network: Arc<Mutex<Network>>,
    port: usize,
}

impl MemoryBus {
    /// Creates a bus with one connection. The seed selects which frames are lost.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        let network =
            Network { now_ns: 0, rng: Pcg64Mcg::seed_from_u64(seed), ports: vec![Port::default()] };
        Self { network: Arc::new(Mutex::new(network)), port: 0 }
    }

    /// Adds a connection to the same bus.
    #[must_use]
    pub fn connect(&self) -> Self {
        let mut network = self.lock();
        network.ports.push(Port::default());
        Self { network: Arc::clone(&self.network), port: network.ports.len() - 1 }
    }

    /// Sets the time of all connections.
    pub fn set_now(&self, now_ns: u64) {
        self.lock().now_ns = now_ns;
    }

    /// Sets the faults of this connection. Jammed frames are sent when the jam ends.
    pub fn set_faults(&self, faults: LineFaults) {
        let mut queue = self.with(|port| {
            port.faults = faults;
            if faults.jammed { VecDeque::new() } else { std::mem::take(&mut port.queue) }
        });
        let mut network = self.lock();
        queue.drain(..).for_each(|frame| network.deliver(self.port, frame));
    }

    /// Takes the controller off the bus. Frames that are being sent stay in the queue.
    pub fn bus_off(&self) {
        self.notify(BusEvent::BusOff);
        self.with(|port| port.off = true);
    }

    /// Brings the controller back on the bus. Frames that are still in its queue are sent first.
    pub fn restart(&self) {
        self.notify(BusEvent::Restarted);
        let mut queue = self.with(|port| {
            port.off = false;
            std::mem::take(&mut port.queue)
        });
        let mut network = self.lock();
        queue.drain(..).for_each(|frame| network.deliver(self.port, frame));
    }

    /// Reports new error counters of the controller.
    pub fn errors(&self, state: ErrorState, transmit: u8, receive: u8) {
        self.notify(BusEvent::Errors { state, transmit, receive });
    }

    /// Reports a bus event to this connection.
    pub fn notify(&self, event: BusEvent) {
        let now_ns = self.lock().now_ns;
        self.with(|port| port.inbox.push_back((now_ns, event)));
    }

    /// Takes the frames that this connection has sent, with their times.
    #[must_use]
    pub fn take_sent(&self) -> Vec<(u64, CanFrame)> {
        self.with(|port| std::mem::take(&mut port.sent))
    }

    fn lock(&self) -> MutexGuard<'_, Network> {
        self.network.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn with<T: Default>(&self, change: impl FnOnce(&mut Port) -> T) -> T {
        self.lock().ports.get_mut(self.port).map_or_else(T::default, change)
    }
}

impl CanBus for MemoryBus {
    fn send(&mut self, frame: &CanFrame) -> Result<(), SendProblem> {
        let (waits, result) = self.with(|port| {
            let waits = port.off || port.faults.jammed;
            let result = match port.faults {
                LineFaults { gone: true, .. } => Err(SendProblem::Gone),
                LineFaults { full: true, .. } => Err(SendProblem::Full),
                _ if waits && port.queue.len() >= QUEUE => Err(SendProblem::Full),
                _ => Ok(()),
            };
            if waits && result.is_ok() {
                port.queue.push_back(*frame);
            }
            (waits, Some(result))
        });
        let result = result.unwrap_or(Err(SendProblem::Gone));
        if result.is_ok() && !waits {
            self.lock().deliver(self.port, *frame);
        }
        result
    }

    fn receive(&mut self, now_ns: u64) -> Option<Received> {
        self.with(|port| {
            let gone = port.faults.gone;
            if std::mem::replace(&mut port.was_gone, gone) != gone {
                let event = if gone { BusEvent::Gone } else { BusEvent::Back };
                return Some(Received { time_ns: now_ns, event });
            }
            let (time_ns, event) = *port.inbox.front()?;
            if time_ns > now_ns {
                return None;
            }
            port.inbox.pop_front();
            Some(Received { time_ns, event })
        })
    }

    fn drop_pending(&mut self) {
        self.with(|port| port.queue.clear());
    }

    fn name(&self) -> &str {
        "memory"
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(number: u8) -> CanFrame {
        CanFrame::standard_short(0x100, [number; 8], 1)
    }

    #[test]
    fn every_node_but_the_sender_receives_a_frame() {
        let mut a = MemoryBus::new(1);
        let mut b = a.connect();
        let mut c = a.connect();
        assert!(a.send(&frame(1)).is_ok());
        assert_eq!(a.receive(0), None);
        for other in [&mut b, &mut c] {
            assert_eq!(
                other.receive(0).map(|received| received.event),
                Some(BusEvent::Frame(frame(1)))
            );
        }
    }

    #[test]
    fn frames_queued_during_a_bus_off_are_sent_after_it_unless_dropped() {
        let mut a = MemoryBus::new(1);
        let mut b = a.connect();
        a.bus_off();
        assert!(a.send(&frame(1)).is_ok());
        assert_eq!(b.receive(0), None);
        a.restart();
        assert!(b.receive(0).is_some());
        a.bus_off();
        assert!(a.send(&frame(2)).is_ok());
        a.drop_pending();
        a.restart();
        assert_eq!(b.receive(0), None);
    }
}
