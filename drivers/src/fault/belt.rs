//! Readings that come late, twice, or in the wrong order.

use super::injector::Injector;
use super::schedule::Kind;

/// The way of readings through these faults. Has its memory from the beginning.
pub(super) struct Belt<T> {
    /// A ring of readings that wait until they are late enough.
    late: Vec<T>,
    oldest: usize,
    waiting: usize,
    /// A reading that comes again, or that another one has overtaken.
    aside: T,
    next: Next,
}

/// What becomes of the reading that was put aside.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Next {
    /// There is none.
    Nothing,
    /// It waits until another one has overtaken it.
    Overtaken,
    /// It is handed out before any new one.
    Due,
}

impl<T: Clone> Belt<T> {
    pub fn new(injector: &Injector, make: impl Fn() -> T) -> Self {
        let room = injector.most(Kind::Delay) as usize + 1;
        Self {
            late: (0..room).map(|_| make()).collect(),
            oldest: 0,
            waiting: 0,
            aside: make(),
            next: Next::Nothing,
        }
    }

    /// Forgets what was on its way.
    pub fn clear(&mut self) {
        self.waiting = 0;
        self.next = Next::Nothing;
    }

    /// Whether an old reading comes now instead of a new one.
    pub fn due(&mut self, reading: &mut T) -> bool {
        let due = self.next == Next::Due;
        if due {
            std::mem::swap(reading, &mut self.aside);
            self.next = Next::Nothing;
        }
        due
    }

    /// Takes a new reading; whether it, or an older one in its place, comes now.
    pub fn pass(&mut self, reading: &mut T, injector: &mut Injector) -> bool {
        if !self.is_late_enough(reading, injector) {
            return false;
        }
        if self.next == Next::Overtaken {
            self.next = Next::Due;
            return true;
        }
        if injector.strikes(Kind::Reorder) {
            std::mem::swap(reading, &mut self.aside);
            self.next = Next::Overtaken;
            return false;
        }
        if injector.strikes(Kind::Duplicate) {
            self.aside.clone_from(reading);
            self.next = Next::Due;
        }
        true
    }

    fn is_late_enough(&mut self, reading: &mut T, injector: &Injector) -> bool {
        let Some(fault) = injector.on(Kind::Delay) else {
            self.waiting = 0;
            return true;
        };
        let room = self.late.len();
        if let Some(slot) = self.late.get_mut((self.oldest + self.waiting) % room) {
            std::mem::swap(reading, slot);
            self.waiting += 1;
        }
        let mut came = false;
        while self.waiting > fault.amount() as usize {
            if let Some(slot) = self.late.get_mut(self.oldest) {
                std::mem::swap(reading, slot);
                came = true;
            }
            self.oldest = (self.oldest + 1) % room;
            self.waiting -= 1;
        }
        came
    }
}
