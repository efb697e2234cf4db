//! The history of every model that was offered to the robot. It explains decisions to the operator,
//! and prevents a model that was rolled back from being installed again.

use serde::{Deserialize, Serialize};

/// Maximum number of entries; the oldest are dropped first.
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
        }
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
        let surplus = self.entries.len().saturating_sub(MAX_ENTRIES);
        self.entries.drain(..surplus);
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
