//! Places that are not worth another try for now.

use serde::{Deserialize, Serialize};

/// A place and when it is forgiven.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Entry {
    place_m: [f64; 2],
    expires_ns: u64,
}

/// Places given up, each until its time is over: doors open, chairs move, maps get better.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Blacklist {
    entries: Vec<Entry>,
}

impl Blacklist {
    /// Lists a place in `odom`, metres, until `expires_ns`.
    pub fn add(&mut self, place_m: [f64; 2], expires_ns: u64) {
        self.entries.push(Entry { place_m, expires_ns });
    }

    /// Forgives what has expired at `now_ns`.
    pub fn forgive(&mut self, now_ns: u64) {
        self.entries.retain(|entry| entry.expires_ns > now_ns);
    }

    /// Whether a place lies within `radius_m` of a listed one.
    #[must_use]
    pub fn holds(&self, place_m: [f64; 2], radius_m: f64) -> bool {
        self.entries.iter().any(|entry| distance_m(entry.place_m, place_m) < radius_m)
    }

    /// Listed places.
    #[must_use]
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Whether nothing is listed.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }
}

/// Straight-line distance, metres.
pub(super) fn distance_m(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_listed_place_is_held_nearby_and_forgiven_when_its_time_is_over() {
        let mut list = Blacklist::default();
        list.add([1.0, 1.0], 100);
        assert!(list.holds([1.2, 1.0], 0.5));
        assert!(!list.holds([2.0, 1.0], 0.5));
        list.forgive(99);
        assert_eq!(list.len(), 1);
        list.forgive(100);
        assert!(list.is_empty());
    }
}
