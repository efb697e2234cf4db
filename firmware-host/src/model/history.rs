//! The history of every model that was offered to the robot. It explains decisions to the operator,
//! prevents a model that was rolled back from being installed again, and counts the tries.

use serde::{Deserialize, Serialize};

/// Maximum number of entries. Of more, the oldest of refused models that were not compared are dropped first.
const MAX_ENTRIES: usize = 1000;

/// What happened to a model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum What {
    /// The gate accepted it, and its trial begins.
    Installed,
    /// The gate refused it.
    Refused,
    /// Its trial ended well.
    Kept,
    /// The trial or the operator rolled it back.
    RolledBack,
}

/// One event in the life of a model.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Entry {
    /// Unix time, seconds, by the robot's clock at that time.
    pub unix_s: u64,
    pub what: What,
    /// BLAKE3 digest of the model, hexadecimal.
    pub digest: String,
    /// Name in the signature; empty if it is unknown.
    #[serde(default)]
    pub name: String,
    /// Reason, as a sentence.
    #[serde(default)]
    pub why: String,
    /// Whether a refused model was compared with the resident one.
    #[serde(default)]
    pub was_compared: bool,
}

impl Entry {
    /// An entry with the current time.
    #[must_use]
    pub fn now(what: What, digest: &str, name: &str, why: impl Into<String>) -> Self {
        let since =
            std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
        Self {
            unix_s: since.as_secs(),
            what,
            digest: digest.to_owned(),
            name: name.to_owned(),
            why: why.into(),
            was_compared: false,
        }
    }

    /// Whether the entry can be dropped before others: a model that was never compared, as anyone who can write into the store's
    /// folder can push in any number.
    fn is_minor(&self) -> bool {
        self.what == What::Refused && !self.was_compared
    }
}

/// All entries, oldest first.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct History {
    pub entries: Vec<Entry>,
}

impl History {
    pub(super) fn add(&mut self, entry: Entry) {
        self.entries.push(entry);
        while self.entries.len() > MAX_ENTRIES {
            let minor = self.entries.iter().position(Entry::is_minor);
            self.entries.remove(minor.unwrap_or(0));
        }
    }

    /// Number of models that were compared with the resident one since it passed its trial.
    #[must_use]
    pub fn tries(&self) -> u32 {
        let since = self.entries.iter().rev().take_while(|entry| entry.what != What::Kept);
        let tried = since.filter(|entry| entry.was_compared || entry.what == What::Installed);
        u32::try_from(tried.count()).unwrap_or(u32::MAX)
    }

    /// The rollback of this model, if that is its last entry apart from refusals.
    #[must_use]
    pub fn rolled_back(&self, digest: &str) -> Option<&Entry> {
        self.entries
            .iter()
            .rev()
            .find(|entry| entry.digest == digest && entry.what != What::Refused)
            .filter(|entry| entry.what == What::RolledBack)
    }

    /// Name of a model in its signature; empty if it is unknown.
    #[must_use]
    pub fn name(&self, digest: &str) -> &str {
        self.entries
            .iter()
            .rev()
            .find(|entry| entry.digest == digest && !entry.name.is_empty())
            .map_or("", |entry| &entry.name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn history(events: &[(What, bool)]) -> History {
        let mut history = History::default();
        for (index, (what, was_compared)) in events.iter().enumerate() {
            let entry = Entry::now(*what, &index.to_string(), "", "");
            history.add(Entry { was_compared: *was_compared, ..entry });
        }
        history
    }

    #[test]
    fn models_count_as_tries_when_they_were_compared_and_until_one_is_kept() {
        assert_eq!(history(&[]).tries(), 0);
        let refused = [(What::Refused, true), (What::Refused, false), (What::Refused, true)];
        assert_eq!(history(&refused).tries(), 2);
        let rolled_back = [(What::Installed, false), (What::RolledBack, false)];
        assert_eq!(history(&[&refused[..], &rolled_back].concat()).tries(), 3);
        let kept = [(What::Installed, false), (What::Kept, false)];
        assert_eq!(history(&[&refused[..], &kept].concat()).tries(), 0);
        assert_eq!(history(&[&kept[..], &refused].concat()).tries(), 2);
    }

    #[test]
    fn any_number_of_models_that_were_not_compared_hides_neither_a_rollback_nor_a_try() {
        let mut history = history(&[(What::RolledBack, false), (What::Refused, true)]);
        for index in 0..2 * MAX_ENTRIES {
            history.add(Entry::now(What::Refused, &format!("unsigned {index}"), "", ""));
        }
        assert_eq!(history.entries.len(), MAX_ENTRIES);
        assert!(history.rolled_back("0").is_some());
        assert_eq!(history.tries(), 1);
    }
}
