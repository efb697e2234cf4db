//! What the trial has counted, on disk, so that a restart neither ends a trial nor forgets what the
//! candidate is compared with.

use runtime::model_gate::TrialCounts;
use serde::{Deserialize, Serialize};

/// The counts of one model.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Counted {
    /// BLAKE3 digest of the model, hexadecimal; `None` without a network.
    pub digest: Option<String>,
    pub counts: TrialCounts,
}

/// The content of the store's file `counts.json`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct SavedCounts {
    /// The model that a candidate is compared with.
    pub resident: Counted,
    /// The model on trial.
    pub trial: Option<Counted>,
}

impl SavedCounts {
    /// The counts of the resident model, or of the robot without one for `None`; all 0 if another
    /// one was counted.
    #[must_use]
    pub fn of_resident(&self, digest: Option<&str>) -> TrialCounts {
        let same = self.resident.digest.as_deref() == digest;
        if same { self.resident.counts } else { TrialCounts::default() }
    }

    /// The counts of the trial of this model; all 0 if it has none.
    #[must_use]
    pub fn of_trial(&self, digest: &str) -> TrialCounts {
        let trial = self.trial.as_ref().filter(|trial| trial.digest.as_deref() == Some(digest));
        trial.map_or_else(TrialCounts::default, |trial| trial.counts)
    }
}
