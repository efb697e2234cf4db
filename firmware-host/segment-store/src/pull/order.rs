//! What comes first.

use std::cmp::Reverse;

use crate::catalogue::Entry;

/// In which order segments are pulled.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Order {
    /// As they were recorded: a trainer that follows sees time go forward.
    #[default]
    Oldest,
    /// The other way round: what the robot does now.
    Newest,
    /// Marked to be kept, then those with the most events (stops, refusals, choices) per byte, then the newest. Only what
    /// the index tells: the pictures are not looked at.
    Valuable,
}

impl Order {
    /// Sorts segments.
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
    use crate::catalogue::State;
    use crate::marks::Pulled;
    use crate::name::Name;

    fn entry(name: &str, modified_ns: u64, events: u64, keep: bool) -> Entry {
        let name = Name::parse(name).unwrap();
        let (state, pulled) = (State::Closed, Pulled::No);
        Entry {
            name,
            bytes: 1000,
            modified_ns,
            state,
            times: None,
            turns: None,
            events: Some(events),
            keep,
            pulled,
        }
    }

    #[test]
    fn segments_come_as_asked() {
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
