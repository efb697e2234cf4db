//! The order in which segments are pulled.

use std::cmp::Reverse;

use crate::entry::Entry;

/// The order in which segments are pulled.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Order {
    /// The order of recording, so that a trainer that follows the robot sees time increase.
    #[default]
    Oldest,
    /// The latest segments first: what the robot does now.
    Newest,
    /// Segments with a `.keep` marker first, then those with the most events (stops, refusals, choices) per byte, then the
    /// newest. The events are counted from the index; the images are not analysed.
    Valuable,
}

impl Order {
    pub fn sort(self, entries: &mut [Entry]) {
        match self {
            Self::Oldest => entries.sort_by_key(|entry| (entry.modified_ns, entry.name.clone())),
            Self::Newest => {
                entries.sort_by_key(|entry| Reverse((entry.modified_ns, entry.name.clone())));
            }
            Self::Valuable => entries.sort_by_key(|entry| {
                let per_gigabyte =
                    entry.events.unwrap_or(0).saturating_mul(1 << 30) / entry.bytes.max(1);
                Reverse((entry.keep, per_gigabyte, entry.modified_ns, entry.name.clone()))
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::name::Name;

    fn entry(name: &str, modified_ns: u64, events: u64, keep: bool) -> Entry {
        let entry = Entry::new(Name::parse(name).unwrap(), 1000, modified_ns);
        Entry { events: Some(events), keep, ..entry }
    }

    #[test]
    fn each_order_sorts_by_its_own_criterion() {
        let all = [
            entry("a/recording_0000.mcap", 1, 5, false),
            entry("a/recording_0001.mcap", 2, 0, true),
            entry("b/recording_0000.mcap", 3, 1, false),
        ];
        for (order, expected) in
            [(Order::Oldest, [1, 2, 3]), (Order::Newest, [3, 2, 1]), (Order::Valuable, [2, 1, 3])]
        {
            let mut entries = all.clone();
            order.sort(&mut entries);
            assert_eq!(entries.map(|entry| entry.modified_ns), expected, "{order:?}");
        }
    }
}
