//! What became of every model that was offered: for people, and so that a model that was rolled back is not taken again.

use serde::{Deserialize, Serialize};

/// Entries that are kept; the oldest go first.
const MOST: usize = 1000;

/// What happened to a model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum What {
    /// The gate took it; its trial begins.
    Installed,
    /// The gate refused it.
    Refused,
    /// Its trial ended well.
    Kept,
    /// It was given up, by its trial or by an operator.
    RolledBack,
}

/// One line of the history.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Entry {
    /// Seconds since 1970, by the computer's clock at that time.
    pub unix_s: u64,
    /// What happened.
    pub what: What,
    /// BLAKE3 digest of the model, in hex.
    pub digest: String,
    /// What its signer called it; empty where nobody knows.
    #[serde(default)]
    pub name: String,
    /// Why.
    #[serde(default)]
    pub why: String,
}

impl Entry {
    /// Now.
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

/// Everything that happened, oldest first.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct History {
    /// The entries.
    pub entries: Vec<Entry>,
}

impl History {
    pub(super) fn add(&mut self, entry: Entry) {
        self.entries.push(entry);
        let surplus = self.entries.len().saturating_sub(MOST);
        self.entries.drain(..surplus);
    }

    /// Why this model was rolled back, if that is the last that happened to it.
    #[must_use]
    pub fn rolled_back(&self, digest: &str) -> Option<&Entry> {
        let of_it = |entry: &&Entry| entry.digest == digest && entry.what != What::Refused;
        self.entries.iter().rev().find(of_it).filter(|entry| entry.what == What::RolledBack)
    }

    /// What its signer called a model.
    #[must_use]
    pub fn name(&self, digest: &str) -> &str {
        let named = |entry: &&Entry| entry.digest == digest && !entry.name.is_empty();
        self.entries.iter().rev().find(named).map_or("", |entry| &entry.name)
    }
}
