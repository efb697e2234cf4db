//! Places that the robot gave up recently and does not try again yet.

use serde::{Deserialize, Serialize};

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Entry {
    place_m: [f64; 2],
    expires_ns: u64,
}

/// Places that were given up, each with an expiry time: a door may open, a chair may move, the map
/// may improve.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Blacklist {
    entries: Vec<Entry>,
}

impl Blacklist {
    /// Adds a place in `odom`, metres, until `expires_ns`.
    pub fn add(&mut self, place_m: [f64; 2], expires_ns: u64) {
        self.entries.push(Entry { place_m, expires_ns });
    }

    /// Applies `moved`, the correction of the map, to every listed place.
    pub fn move_places(&mut self, moved: impl Fn([f64; 2]) -> [f64; 2]) {
        for entry in &mut self.entries {
            entry.place_m = moved(entry.place_m);
        }
    }

    /// Removes the places that have expired at `now_ns`.
    pub fn expire(&mut self, now_ns: u64) {
        self.entries.retain(|entry| entry.expires_ns > now_ns);
    }

    /// Whether a place lies within `radius_m` of a listed one.
    #[must_use]
    pub fn is_listed(&self, place_m: [f64; 2], radius_m: f64) -> bool {
        self.entries.iter().any(|entry| distance_m(entry.place_m, place_m) < radius_m)
    }

    #[must_use]
    pub fn len(&self) -> usize {
        self.entries.len()
    }

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
    fn a_place_near_a_listed_one_is_listed_until_the_entry_expires() {
        let mut list = Blacklist::default();
        list.add([1.0, 1.0], 100);
        assert!(list.is_listed([1.2, 1.0], 0.5));
        assert!(!list.is_listed([2.0, 1.0], 0.5));
        list.expire(99);
        assert_eq!(list.len(), 1);
        list.expire(100);
        assert!(list.is_empty());
    }
}
