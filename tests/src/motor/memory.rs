//! A CAN bus in memory, in virtual time, on which everything may go wrong.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use drivers::can::{BusEvent, CanBus, CanFrame, ErrorState, Received, SendProblem};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// What Linux keeps for an interface that cannot send: `txqueuelen` of a CAN interface.
const QUEUE: usize = 10;

/// What is wrong with the connection of one node.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LineFaults {
    /// The transmit queue is full: `ENOBUFS`.
    pub full: bool,
    /// Frames stay in the queue of the operating system until this ends, and then all go out.
    pub jammed: bool,
    /// The interface is not there.
    pub gone: bool,
    /// Share of frames from and to this node that are lost.
    pub lost_share: f64,
    /// Share of frames that arrive here twice.
    pub doubled_share: f64,
    /// How late frames arrive here.
    pub late_ns: u64,
}

#[derive(Debug, Default)]
struct Line {
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
    lines: Vec<Line>,
}

impl Network {
    fn deliver(&mut self, from: usize, frame: CanFrame) {
        let now_ns = self.now_ns;
        let lost_here = self.lines.get(from).map_or(0.0, |line| line.faults.lost_share);
        if let Some(line) = self.lines.get_mut(from) {
            line.sent.push((now_ns, frame));
        }
        if self.rng.random::<f64>() < lost_here {
            return;
        }
        for (_, line) in self.lines.iter_mut().enumerate().filter(|(at, _)| *at != from) {
            let copies = 1 + usize::from(self.rng.random::<f64>() < line.faults.doubled_share);
            let lost = self.rng.random::<f64>() < line.faults.lost_share;
            if lost || line.off || line.faults.gone {
                continue;
            }
            for _ in 0..copies {
                line.inbox.push_back((now_ns + line.faults.late_ns, BusEvent::Frame(frame)));
            }
        }
    }
}

/// One node's connection. Clones are the same connection: one for the node, one for the test that spoils it.
#[derive(Debug, Clone)]
pub struct MemoryBus {
    network: Arc<Mutex<Network>>,
    line: usize,
}

impl MemoryBus {
    /// A new bus with one connection. The seed decides which frames are lost.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        let network =
            Network { now_ns: 0, rng: Pcg64Mcg::seed_from_u64(seed), lines: vec![Line::default()] };
        Self { network: Arc::new(Mutex::new(network)), line: 0 }
    }

    /// Another connection to the same bus.
    #[must_use]
    pub fn connect(&self) -> Self {
        let mut network = self.lock();
        network.lines.push(Line::default());
        Self { network: Arc::clone(&self.network), line: network.lines.len() - 1 }
    }

    /// What time it is, for all connections.
    pub fn set_now(&self, now_ns: u64) {
        self.lock().now_ns = now_ns;
    }

    /// Spoils this connection. What was jammed goes out when the jam ends.
    pub fn set_faults(&self, faults: LineFaults) {
        let mut queue = self.with(|line| {
            line.faults = faults;
            if faults.jammed { VecDeque::new() } else { std::mem::take(&mut line.queue) }
        });
        let mut network = self.lock();
        queue.drain(..).for_each(|frame| network.deliver(self.line, frame));
    }

    /// The controller leaves the bus; what is being sent stays in the queue.
    pub fn bus_off(&self) {
        self.tell(BusEvent::BusOff);
        self.with(|line| line.off = true);
    }

    /// The controller comes back; what is still in its queue goes out first.
    pub fn restart(&self) {
        self.tell(BusEvent::Restarted);
        let mut queue = self.with(|line| {
            line.off = false;
            std::mem::take(&mut line.queue)
        });
        let mut network = self.lock();
        queue.drain(..).for_each(|frame| network.deliver(self.line, frame));
    }

    /// The controller's error counters have risen or fallen.
    pub fn errors(&self, state: ErrorState, transmit: u8, receive: u8) {
        self.tell(BusEvent::Errors { state, transmit, receive });
    }

    /// Any news of the bus.
    pub fn tell(&self, event: BusEvent) {
        let now_ns = self.lock().now_ns;
        self.with(|line| line.inbox.push_back((now_ns, event)));
    }

    /// What this connection has put on the bus, and when. Empty again afterwards.
    #[must_use]
    pub fn take_sent(&self) -> Vec<(u64, CanFrame)> {
        self.with(|line| std::mem::take(&mut line.sent))
    }

    fn lock(&self) -> MutexGuard<'_, Network> {
        self.network.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn with<T: Default>(&self, change: impl FnOnce(&mut Line) -> T) -> T {
        self.lock().lines.get_mut(self.line).map_or_else(T::default, change)
    }
}

impl CanBus for MemoryBus {
    fn send(&mut self, frame: &CanFrame) -> Result<(), SendProblem> {
        let (waits, result) = self.with(|line| {
            let waits = line.off || line.faults.jammed;
            let result = match line.faults {
                LineFaults { gone: true, .. } => Err(SendProblem::Gone),
                LineFaults { full: true, .. } => Err(SendProblem::Full),
                _ if waits && line.queue.len() >= QUEUE => Err(SendProblem::Full),
                _ => Ok(()),
            };
            if waits && result.is_ok() {
                line.queue.push_back(*frame);
            }
            (waits, Some(result))
        });
        let result = result.unwrap_or(Err(SendProblem::Gone));
        if result.is_ok() && !waits {
            self.lock().deliver(self.line, *frame);
        }
        result
    }

    fn receive(&mut self, now_ns: u64) -> Option<Received> {
        self.with(|line| {
            let gone = line.faults.gone;
            if std::mem::replace(&mut line.was_gone, gone) != gone {
                let event = if gone { BusEvent::Gone } else { BusEvent::Back };
                return Some(Received { time_ns: now_ns, event });
            }
            let (time_ns, event) = *line.inbox.front()?;
            if time_ns > now_ns {
                return None;
            }
            line.inbox.pop_front();
            Some(Received { time_ns, event })
        })
    }

    fn drop_pending(&mut self) {
        self.with(|line| line.queue.clear());
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
    fn everybody_hears_a_frame_but_its_sender() {
        let mut a = MemoryBus::new(1);
        let (mut b, mut c) = (a.connect(), a.connect());
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
    fn what_waits_during_a_bus_off_goes_out_after_it_unless_it_is_dropped() {
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
