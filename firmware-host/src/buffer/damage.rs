//! What an export of a damaged or unfinished run leaves out, in words.

use segment_store::{Catalogue, Entry, State};

/// What an export could not read in the segments that it opened.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Damage {
    pub chunks: u64,
    pub messages: u64,
    /// The number of segments that end early.
    pub cut: u64,
}

impl Damage {
    /// That of an export for which every damage but a missing end is an error.
    pub fn cut(cut: u64) -> Self {
        Self { cut, ..Self::default() }
    }

    /// What was left out, one phrase for each kind; empty if nothing was.
    pub fn left_out(self, catalogue: &Catalogue) -> Vec<String> {
        let mut phrases = Vec::new();
        if self.chunks > 0 {
            phrases.push(count(self.chunks, "damaged chunk", "damaged chunks"));
        }
        if self.messages > 0 {
            phrases.push(count(self.messages, "unreadable message", "unreadable messages"));
        }
        let cut = self.cut.saturating_sub(in_state(catalogue, State::Open).count() as u64);
        if cut > 0 {
            let which: Vec<String> = in_state(catalogue, State::Cut)
                .map(|entry| format!("{} is cut {}", entry.name, after(entry)))
                .collect();
            let which =
                if which.is_empty() { String::new() } else { format!(" ({})", which.join("; ")) };
            phrases.push(format!("the end of {}{which}", count(cut, "segment", "segments")));
        }
        phrases.extend(in_state(catalogue, State::Open).map(|entry| {
            format!("the rest of {}, which is still being written {}", entry.name, after(entry))
        }));
        phrases
    }
}

fn in_state(catalogue: &Catalogue, state: State) -> impl Iterator<Item = &Entry> {
    catalogue.entries.iter().filter(move |entry| entry.state == state)
}

fn count(number: u64, one: &str, several: &str) -> String {
    format!("{number} {}", if number == 1 { one } else { several })
}

/// Until when the complete chunks of a segment reach, on the run's clock.
fn after(entry: &Entry) -> String {
    entry.times.map_or_else(
        || "before its first tick".to_owned(),
        |times| format!("after {:.1} s", times.last_ns as f64 * 1e-9),
    )
}

#[cfg(test)]
mod tests {
    use segment_store::{Name, Times};

    use super::*;

    fn catalogue(segments: &[(u32, State)]) -> Catalogue {
        let entries = segments.iter().map(|(number, state)| Entry {
            state: *state,
            times: Some(Times { first_ns: 0, last_ns: 900_000_000 }),
            ..Entry::new(Name::parse(&format!("recording_{number:04}.mcap")).unwrap(), 1, 0)
        });
        Catalogue { entries: entries.collect(), unread: Vec::new() }
    }

    #[test]
    fn each_kind_of_loss_is_named_with_its_segment() {
        use State::{Closed, Cut, Open};
        let damage = Damage { chunks: 1, messages: 2, cut: 2 };
        let left_out = damage.left_out(&catalogue(&[(0, Closed), (1, Cut), (4, Open)]));
        assert_eq!(
            left_out,
            [
                "1 damaged chunk",
                "2 unreadable messages",
                "the end of 1 segment (recording_0001.mcap is cut after 0.9 s)",
                "the rest of recording_0004.mcap, which is still being written after 0.9 s",
            ]
        );
    }

    #[test]
    fn nothing_is_left_out_of_a_whole_run() {
        let whole = catalogue(&[(3, State::Closed), (4, State::Unindexed)]);
        assert!(Damage::default().left_out(&whole).is_empty());
    }

    #[test]
    fn a_segment_with_an_end_and_a_damaged_length_is_counted_as_one_without_its_end() {
        let whole = catalogue(&[(0, State::Closed)]);
        assert_eq!(Damage::cut(1).left_out(&whole), ["the end of 1 segment"]);
    }
}
