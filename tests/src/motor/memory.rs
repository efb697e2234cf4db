//! A CAN bus in memory, in virtual time, with injectable faults.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use drivers::can::stamp::ReceiveClock;
use drivers::can::{BusEvent, CanBus, CanFrame, ErrorState, Received, SendProblem};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// Frames that Linux queues for an interface that cannot send: the default `txqueuelen` of a CAN
/// interface.
const QUEUE: usize = 10;
/// The adapter's own clock minus the monotonic clock: it began to count at another moment.
const ADAPTER_AHEAD_NS: u64 = 77_000_000;

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

/// What a connection has received and its node has not read yet.
#[derive(Debug, Clone, Copy)]
struct Arrival {
    /// Time of arrival, monotonic nanoseconds.
    time_ns: u64,
    /// The same time by the realtime clock of that moment, as the kernel stamps frames.
    realtime_ns: u64,
    event: BusEvent,
}

#[derive(Debug, Default)]
struct Port {
    faults: LineFaults,
    inbox: VecDeque<Arrival>,
    /// The clock of the driver's socket, which reads an adapter with hardware timestamps.
    clock: Option<ReceiveClock>,
    queue: VecDeque<CanFrame>,
    off: bool,
    was_gone: bool,
    sent: Vec<(u64, CanFrame)>,
}

#[derive(Debug)]
struct Network {
    now_ns: u64,
    /// The realtime clock minus the monotonic clock.
    realtime_ahead_ns: u64,
    rng: Pcg64Mcg,
    ports: Vec<Port>,
}

impl Network {
    fn deliver(&mut self, from: usize, frame: CanFrame) {
        let now_ns = self.now_ns;
        let realtime_ahead_ns = self.realtime_ahead_ns;
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
                let time_ns = now_ns + port.faults.late_ns;
                let realtime_ns = time_ns + realtime_ahead_ns;
                let event = BusEvent::Frame(frame);
                port.inbox.push_back(Arrival { time_ns, realtime_ns, event });
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
        let network = Network {
            now_ns: 0,
            realtime_ahead_ns: 0,
            rng: Pcg64Mcg::seed_from_u64(seed),
            ports: vec![Port::default()],
        };
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

    /// Sets the realtime clock forward. Frames that wait to be read keep the stamps of before.
    pub fn set_realtime_forward(&self, nanoseconds: u64) {
        self.lock().realtime_ahead_ns += nanoseconds;
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
        let network = self.lock();
        let time_ns = network.now_ns;
        let realtime_ns = time_ns + network.realtime_ahead_ns;
        drop(network);
        self.with(|port| port.inbox.push_back(Arrival { time_ns, realtime_ns, event }));
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
        let realtime_ahead_ns = self.lock().realtime_ahead_ns;
        self.with(|port| {
            let gone = port.faults.gone;
            if std::mem::replace(&mut port.was_gone, gone) != gone {
                let event = if gone { BusEvent::Gone } else { BusEvent::Back };
                return Some(Received { time_ns: now_ns, event });
            }
            let clock = port.clock.get_or_insert_with(|| ReceiveClock::new(0, true));
            let Some(arrival) = port.inbox.pop_front_if(|arrival| arrival.time_ns <= now_ns) else {
                clock.emptied(now_ns);
                return None;
            };
            let software_ns = arrival.realtime_ns.saturating_sub(realtime_ahead_ns);
            let hardware_ns = arrival.time_ns + ADAPTER_AHEAD_NS;
            let time_ns = clock.time_ns(software_ns, Some(hardware_ns), now_ns);
            Some(Received { time_ns, event: arrival.event })
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
