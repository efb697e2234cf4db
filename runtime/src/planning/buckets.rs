//! A bucket priority queue for priorities that grow in small integer steps (Dial 1969).

/// Number of buckets in the ring; it exceeds the largest difference of two queued priorities.
const RING: usize = 2048;

/// Entries ordered by priority. A priority is never less than the last one popped and exceeds it by
/// less than [`RING`], so a ring of buckets holds all of them. One bit for each bucket finds the
/// next filled bucket. Entries of equal priority are popped newest first, which in A* prefers the
/// entry nearest to the goal.
#[derive(Debug, Clone)]
pub(super) struct Buckets {
    ring: Vec<Vec<Entry>>,
    filled: [u64; RING / 64],
    now: u32,
    len: usize,
}

/// A cell (column and row in memory) with the cost at which it was queued. The entry is stale if
/// the cell was reached at a lower cost since then.
#[derive(Debug, Clone, Copy)]
pub(super) struct Entry {
    pub x: u16,
    pub y: u16,
    pub cost: u32,
}

impl Default for Buckets {
    fn default() -> Self {
        Self { ring: vec![Vec::new(); RING], filled: [0; RING / 64], now: 0, len: 0 }
    }
}

impl Buckets {
    /// Empties the queue. All entries that follow have a priority of at least `now`.
    pub fn restart(&mut self, now: u32) {
        if self.len > 0 {
            self.ring.iter_mut().for_each(Vec::clear);
        }
        self.filled = [0; RING / 64];
        self.now = now;
        self.len = 0;
    }

    #[inline]
    pub fn push(&mut self, priority: u32, entry: Entry) {
        debug_assert!(priority >= self.now && priority - self.now < RING as u32);
        let slot = priority as usize % RING;
        self.ring[slot].push(entry);
        self.filled[slot / 64] |= 1 << (slot % 64);
        self.len += 1;
    }

    /// The priority of the last entry popped.
    #[inline]
    pub fn now(&self) -> u32 {
        self.now
    }

    /// The newest entry of the lowest priority.
    #[inline]
    pub fn pop(&mut self) -> Option<Entry> {
        if self.len == 0 {
            return None;
        }
        loop {
            let slot = self.now as usize % RING;
            if let Some(entry) = self.ring[slot].pop() {
                self.len -= 1;
                return Some(entry);
            }
            self.filled[slot / 64] &= !(1 << (slot % 64));
            self.now += self.next_filled(slot);
        }
    }

    /// Distance from `slot` to the next filled bucket, around the ring.
    fn next_filled(&self, slot: usize) -> u32 {
        let first = self.filled[slot / 64] >> (slot % 64);
        if first != 0 {
            return first.trailing_zeros();
        }
        let mut steps = 64 - (slot % 64) as u32;
        for word in 1..=RING / 64 {
            let bits = self.filled[(slot / 64 + word) % (RING / 64)];
            if bits != 0 {
                return steps + bits.trailing_zeros();
            }
            steps += 64;
        }
        // This is not reached, because `len` is the number of entries in the ring and is not 0
        // here.
        RING as u32
    }
}
