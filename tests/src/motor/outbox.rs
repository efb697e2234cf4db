//! Frames of the controllers that the bus has not accepted yet.

use std::collections::VecDeque;

use drivers::can::{CanBus, CanFrame, SendProblem};

/// More than the configurations of two VESCs, which are the longest messages that controllers send
/// at once.
const MAX_WAITING: usize = 256;

/// Keeps frames in order while the bus refuses them because its transmit queue is full (ten frames
/// on Linux), like a controller's own memory. Frames for a bus that has disappeared are dropped.
#[derive(Debug, Default)]
pub struct Outbox {
    waiting: VecDeque<CanFrame>,
    /// Number of frames that were never sent.
    pub dropped: u64,
}

impl Outbox {
    /// Sends the waiting frames and then these, as far as the bus accepts them.
    pub fn send(&mut self, frames: &[CanFrame], bus: &mut impl CanBus) {
        self.waiting.extend(frames);
        while let Some(frame) = self.waiting.front() {
            match bus.send(frame) {
                Ok(()) => _ = self.waiting.pop_front(),
                Err(SendProblem::Full) => break,
                Err(_) => return self.keep(0),
            }
        }
        self.keep(MAX_WAITING);
    }

    fn keep(&mut self, most: usize) {
        self.dropped += self.waiting.len().saturating_sub(most) as u64;
        self.waiting.truncate(most);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motor::{LineFaults, MemoryBus};
    use drivers::can::BusEvent;

    fn frames(numbers: std::ops::Range<usize>) -> Vec<CanFrame> {
        numbers.map(|number| CanFrame::standard_short(0x100, [number as u8; 8], 1)).collect()
    }

    fn received_frames(bus: &mut MemoryBus) -> Vec<CanFrame> {
        std::iter::from_fn(|| bus.receive(0))
            .filter_map(|received| match received.event {
                BusEvent::Frame(frame) => Some(frame),
                _ => None,
            })
            .collect()
    }

    #[test]
    fn frames_that_a_full_queue_refuses_arrive_later_and_in_order() {
        let mut bus = MemoryBus::new(1);
        let mut other = bus.connect();
        let mut outbox = Outbox::default();
        bus.set_faults(LineFaults { full: true, ..LineFaults::default() });
        outbox.send(&frames(0..100), &mut bus);
        assert_eq!(received_frames(&mut other), []);
        bus.set_faults(LineFaults::default());
        outbox.send(&frames(100..101), &mut bus);
        assert_eq!((received_frames(&mut other), outbox.dropped), (frames(0..101), 0));
    }

    #[test]
    fn a_queue_that_stays_full_drops_the_newest_frames_and_stays_bounded() {
        let mut bus = MemoryBus::new(1);
        let mut other = bus.connect();
        let mut outbox = Outbox::default();
        bus.set_faults(LineFaults { full: true, ..LineFaults::default() });
        (0..10).for_each(|_| outbox.send(&frames(0..100), &mut bus));
        assert_eq!(
            (outbox.waiting.len(), outbox.dropped),
            (MAX_WAITING, 1000 - MAX_WAITING as u64)
        );
        bus.set_faults(LineFaults::default());
        outbox.send(&[], &mut bus);
        assert_eq!(received_frames(&mut other).len(), MAX_WAITING);
    }

    #[test]
    fn frames_that_wait_for_a_bus_that_disappears_are_dropped() {
        let mut bus = MemoryBus::new(1);
        let mut other = bus.connect();
        let mut outbox = Outbox::default();
        bus.set_faults(LineFaults { gone: true, ..LineFaults::default() });
        outbox.send(&frames(0..3), &mut bus);
        bus.set_faults(LineFaults::default());
        outbox.send(&frames(3..4), &mut bus);
        assert_eq!((received_frames(&mut other), outbox.dropped), (frames(3..4), 3));
    }
}
