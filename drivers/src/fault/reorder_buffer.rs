//! Injects readings that arrive late, twice, or in the wrong order.

use super::injector::Injector;
use super::kind::Kind;

/// Passes readings through these faults. All of its memory is allocated when it is made.
pub(super) struct ReorderBuffer<T> {
    /// A ring of readings that are held back until their delay is over.
    delayed: Vec<T>,
    oldest: usize,
    waiting: usize,
    /// A reading to return a second time, or to return after the one that follows it.
    held: T,
    held_state: Held,
}

/// The state of the reading in `held`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Held {
    /// No reading is held.
    None,
    /// It waits until the next reading has been returned.
    Overtaken,
    /// It is returned before any new reading.
    Due,
}

impl<T: Clone> ReorderBuffer<T> {
    pub fn new(injector: &Injector, make: impl Fn() -> T) -> Self {
        let capacity = injector.max_amount(Kind::Delay) as usize + 1;
        Self {
            delayed: (0..capacity).map(|_| make()).collect(),
            oldest: 0,
            waiting: 0,
            held: make(),
            held_state: Held::None,
        }
    }

    /// Drops every reading that is delayed or held.
    pub fn clear(&mut self) {
        self.waiting = 0;
        self.held_state = Held::None;
    }

    /// Moves the held reading into `reading` if it is due, and returns whether it was.
    pub fn take_due(&mut self, reading: &mut T) -> bool {
        let due = self.held_state == Held::Due;
        if due {
            std::mem::swap(reading, &mut self.held);
            self.held_state = Held::None;
        }
        due
    }

    /// Takes a new reading. Returns true when `reading` now holds a reading to return: this one, or
    /// an older one in its place.
    pub fn push(&mut self, reading: &mut T, injector: &mut Injector) -> bool {
        if !self.delay(reading, injector) {
            return false;
        }
        if self.held_state == Held::Overtaken {
            self.held_state = Held::Due;
            return true;
        }
        if injector.triggers(Kind::Reorder) {
            std::mem::swap(reading, &mut self.held);
            self.held_state = Held::Overtaken;
            return false;
        }
        if injector.triggers(Kind::Duplicate) {
            self.held.clone_from(reading);
            self.held_state = Held::Due;
        }
        true
    }

    /// Exchanges `reading` for the one that has waited long enough. Returns false when there is
    /// none.
    fn delay(&mut self, reading: &mut T, injector: &Injector) -> bool {
        let Some(fault) = injector.active(Kind::Delay) else {
            self.waiting = 0;
            return true;
        };
        let capacity = self.delayed.len();
        if let Some(slot) = self.delayed.get_mut((self.oldest + self.waiting) % capacity) {
            std::mem::swap(reading, slot);
            self.waiting += 1;
        }
        let mut is_due = false;
        while self.waiting > fault.amount() as usize {
            if let Some(slot) = self.delayed.get_mut(self.oldest) {
                std::mem::swap(reading, slot);
                is_due = true;
            }
            self.oldest = (self.oldest + 1) % capacity;
            self.waiting -= 1;
        }
        is_due
    }
}
