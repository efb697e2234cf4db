//! From samples of the line to pressed or released.

use super::{Level, StopLineConfig};

/// Decides whether the emergency stop is pressed. It begins as pressed.
#[derive(Debug, Clone)]
pub struct Debounce {
    released: Level,
    debounce_ns: u64,
    is_pressed: bool,
    /// Since when the samples have said the opposite.
    differs_since_ns: Option<u64>,
}

impl Debounce {
    /// A decision that has seen no sample.
    #[must_use]
    pub fn new(config: &StopLineConfig) -> Self {
        Self {
            released: config.released_level,
            debounce_ns: u64::from(config.debounce_ms) * 1_000_000,
            is_pressed: true,
            differs_since_ns: None,
        }
    }

    /// Takes a sample of the line at `now_ns`; `None` if it could not be read. Returns whether the
    /// stop is pressed. A line that cannot be read is pressed at once.
    pub fn sample(&mut self, now_ns: u64, level: Option<Level>) -> bool {
        let reads_pressed = level != Some(self.released);
        if reads_pressed == self.is_pressed {
            self.differs_since_ns = None;
            return self.is_pressed;
        }
        let since_ns = *self.differs_since_ns.get_or_insert(now_ns);
        if level.is_none() || now_ns.saturating_sub(since_ns) >= self.debounce_ns {
            self.is_pressed = reads_pressed;
            self.differs_since_ns = None;
        }
        self.is_pressed
    }

    /// Whether the newest sample says the same as the decision.
    #[must_use]
    pub fn is_settled(&self) -> bool {
        self.differs_since_ns.is_none()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;
    const CLOSED: Option<Level> = Some(Level::Low);
    const OPEN: Option<Level> = Some(Level::High);

    fn released() -> Debounce {
        let mut stop = Debounce::new(&StopLineConfig::default());
        stop.sample(0, CLOSED);
        assert!(!stop.sample(10 * MS, CLOSED));
        stop
    }

    #[test]
    fn a_stop_is_pressed_until_its_contact_was_closed_for_the_whole_debounce_time() {
        let mut stop = Debounce::new(&StopLineConfig::default());
        assert!(stop.sample(0, CLOSED) && !stop.is_settled());
        assert!(stop.sample(9 * MS, CLOSED));
        assert!(!stop.sample(10 * MS, CLOSED) && stop.is_settled());
    }

    #[test]
    fn a_contact_that_opens_is_a_press_and_one_that_bounces_is_none() {
        let mut stop = released();
        assert!(!stop.sample(100 * MS, OPEN));
        assert!(!stop.sample(105 * MS, CLOSED), "it bounced");
        assert!(!stop.sample(109 * MS, OPEN));
        assert!(!stop.sample(118 * MS, OPEN), "open for 9 ms");
        assert!(stop.sample(119 * MS, OPEN));
        assert!(stop.sample(120 * MS, CLOSED), "a release lasts as long");
    }

    #[test]
    fn a_line_that_cannot_be_read_is_pressed_at_once() {
        let mut stop = released();
        assert!(stop.sample(100 * MS, None));
        assert!(stop.sample(101 * MS, CLOSED));
        assert!(!stop.sample(111 * MS, CLOSED));
    }

    #[test]
    fn a_contact_to_the_supply_reads_high_while_it_is_released() {
        let config = StopLineConfig { released_level: Level::High, ..StopLineConfig::default() };
        let mut stop = Debounce::new(&config);
        stop.sample(0, Some(Level::High));
        assert!(!stop.sample(10 * MS, Some(Level::High)));
        stop.sample(20 * MS, Some(Level::Low));
        assert!(stop.sample(30 * MS, Some(Level::Low)), "pulled down where the wire is broken");
    }

    #[test]
    fn time_that_goes_back_neither_releases_nor_panics() {
        let mut stop = Debounce::new(&StopLineConfig::default());
        stop.sample(100 * MS, CLOSED);
        assert!(stop.sample(50 * MS, CLOSED));
    }
}
