//! Pauses a robot that was watched and is not any more, where the configuration asks for it.

use std::time::{Duration, Instant};

/// When some client has watched last.
#[derive(Debug)]
pub struct Watchers {
    /// The robot pauses after this time; `None`: never.
    limit: Option<Duration>,
    watched: Option<Instant>,
}

impl Watchers {
    /// With `live.pause_when_unwatched_s`, of which 0 means never.
    pub fn new(limit_s: f64) -> Self {
        let limit = (limit_s > 0.0).then(|| Duration::from_secs_f64(limit_s));
        Self { limit, watched: None }
    }

    /// Whether the robot pauses now: once, when the time since a client has watched is over.
    pub fn are_gone(&mut self, is_watched: bool, now: Instant) -> bool {
        if is_watched {
            self.watched = Some(now);
            return false;
        }
        let since = self.watched.map(|then| now - then);
        let are_gone = self.limit.zip(since).is_some_and(|(limit, since)| since >= limit);
        if are_gone {
            self.watched = None;
        }
        are_gone
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::after_ms;
    use super::*;

    #[test]
    fn a_robot_pauses_once_when_its_last_watcher_has_been_gone_for_the_time_and_never_before_one_came()
     {
        let began = Instant::now();
        let mut watchers = Watchers::new(2.0);
        assert!(!watchers.are_gone(false, after_ms(began, 9000)));
        assert!(!watchers.are_gone(true, after_ms(began, 10_000)));
        assert!(!watchers.are_gone(false, after_ms(began, 11_999)));
        assert!(watchers.are_gone(false, after_ms(began, 12_000)));
        assert!(!watchers.are_gone(false, after_ms(began, 60_000)));
        assert!(!watchers.are_gone(true, after_ms(began, 61_000)));
        assert!(watchers.are_gone(false, after_ms(began, 63_000)));
    }

    #[test]
    fn without_a_limit_it_never_pauses() {
        let began = Instant::now();
        let mut watchers = Watchers::new(0.0);
        watchers.are_gone(true, began);
        assert!(!watchers.are_gone(false, began + Duration::from_secs(1_000_000)));
    }
}
