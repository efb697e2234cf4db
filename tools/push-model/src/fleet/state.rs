//! The state of a rollout: what each robot has answered so far. It is a small file that every pass reads and replaces.

use serde::{Deserialize, Serialize};

/// Version of the file's layout.
pub const FORMAT: u32 = 1;

/// What a robot has made of the model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// It was not sent the model.
    Waiting,
    /// Sending began, and no answer is known: this program or the connection ended before it.
    Sent,
    /// Its gate accepted the model, and the trial runs.
    OnTrial,
    /// The trial ended well.
    Kept,
    /// Its gate refused the model.
    Refused,
    /// The trial or an operator rolled the model back.
    RolledBack,
    /// The trial did not end, because the robot was given another model.
    Replaced,
}

impl Verdict {
    /// The verdict in words, for tables and messages.
    #[must_use]
    pub fn words(self) -> &'static str {
        match self {
            Self::Waiting => "waiting",
            Self::Sent => "sent",
            Self::OnTrial => "on trial",
            Self::Kept => "kept",
            Self::Refused => "refused",
            Self::RolledBack => "rolled back",
            Self::Replaced => "replaced",
        }
    }

    /// Whether the robot does not use the model although it was offered.
    #[must_use]
    pub fn has_failed(self) -> bool {
        matches!(self, Self::Refused | Self::RolledBack | Self::Replaced)
    }

    /// Whether nothing more is expected of the robot.
    #[must_use]
    pub fn is_final(self) -> bool {
        self == Self::Kept || self.has_failed()
    }
}

/// What is known of one robot.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Record {
    pub name: String,
    /// Index of its ring; the canaries are ring 0.
    pub ring: usize,
    pub verdict: Verdict,
    /// Why the robot refused, rolled back or kept the model, in its words.
    #[serde(default)]
    pub reason: String,
    /// When the verdict became known, Unix time in seconds.
    pub unix_s: u64,
    /// Why the robot could not be asked in the last pass.
    #[serde(default)]
    pub problem: Option<String>,
    /// The model that it ran when it was asked last.
    #[serde(default)]
    pub runs: String,
    /// Number of entries about this model in the robot's history before it was sent the model: later ones are its answer.
    #[serde(default)]
    pub entries_before: Option<usize>,
    /// Whether an operator resumed the rollout after the robot had refused the model or rolled it back. It does not count then.
    #[serde(default)]
    pub is_excused: bool,
}

impl Record {
    #[must_use]
    pub fn new(name: &str, ring: usize, now_unix_s: u64) -> Self {
        Self {
            name: name.to_owned(),
            ring,
            verdict: Verdict::Waiting,
            reason: String::new(),
            unix_s: now_unix_s,
            problem: None,
            runs: String::new(),
            entries_before: None,
            is_excused: false,
        }
    }

    /// Whether the robot counts as one that refused the model or rolled it back.
    #[must_use]
    pub fn counts_as_failed(&self) -> bool {
        self.verdict.has_failed() && !self.is_excused
    }
}

/// Why and when a rollout halted.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Halt {
    pub why: String,
    pub unix_s: u64,
}

/// The rollout of one model to a fleet.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rollout {
    pub format: u32,
    /// BLAKE3 digest of the model, hexadecimal.
    pub digest: String,
    /// Name of the model.
    pub model: String,
    pub begun_unix_s: u64,
    /// Names of the rings, in their order.
    pub rings: Vec<String>,
    /// Index of the last ring that has begun.
    pub open: usize,
    #[serde(default)]
    pub halted: Option<Halt>,
    pub robots: Vec<Record>,
}

impl Rollout {
    /// Why this is not a state that this program writes; `None` if it is one.
    #[must_use]
    pub fn flaw(&self) -> Option<String> {
        if self.format != FORMAT {
            return Some(format!("its format is {}, this program's is {FORMAT}", self.format));
        }
        if self.open >= self.rings.len() {
            return Some(format!("ring {} of {} is open", self.open + 1, self.rings.len()));
        }
        let mut names = std::collections::HashSet::new();
        for robot in &self.robots {
            if robot.ring >= self.rings.len() {
                return Some(format!("robot `{}` is in a ring that does not exist", robot.name));
            }
            if !names.insert(&robot.name) {
                return Some(format!("robot `{}` is in it twice", robot.name));
            }
        }
        None
    }

    pub fn robot_mut(&mut self, name: &str) -> Option<&mut Record> {
        self.robots.iter_mut().find(|robot| robot.name == name)
    }
}
