//! The decisions of a rollout, from the verdicts alone: which robots are sent the model, when the next ring begins, when to halt.

use super::file::Rules;
use super::state::{Halt, Record, Rollout, Verdict};

/// Longest list of robots in a sentence.
const MAX_NAMED: usize = 5;

/// How far a rollout is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Standing {
    /// Robots have not answered yet, or their trials run.
    Waiting,
    /// Every robot has kept the model, or refused or rolled it back within the limits.
    Complete,
    /// Too many robots refused the model or rolled it back.
    Halted,
}

/// How many robots of a ring are how far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    pub all: usize,
    pub on_trial: usize,
    pub kept: usize,
    /// That refused the model or rolled it back and count.
    pub failed: usize,
    /// As `failed`, before an operator resumed the rollout.
    pub excused: usize,
}

impl Counts {
    /// Robots whose answer counts.
    #[must_use]
    pub fn answered(&self) -> usize {
        self.on_trial + self.kept + self.failed
    }

    #[must_use]
    pub fn unanswered(&self) -> usize {
        self.all - self.answered() - self.excused
    }
}

impl Rollout {
    #[must_use]
    pub fn counts(&self, ring: usize) -> Counts {
        let mut counts = Counts::default();
        for robot in self.robots.iter().filter(|robot| robot.ring == ring) {
            counts.all += 1;
            match robot.verdict {
                Verdict::OnTrial => counts.on_trial += 1,
                Verdict::Kept => counts.kept += 1,
                verdict if !verdict.has_failed() => {}
                _ if robot.is_excused => counts.excused += 1,
                _ => counts.failed += 1,
            }
        }
        counts
    }

    #[must_use]
    pub fn standing(&self) -> Standing {
        if self.halted.is_some() {
            return Standing::Halted;
        }
        if self.robots.iter().all(|robot| robot.verdict.is_final()) {
            Standing::Complete
        } else {
            Standing::Waiting
        }
    }

    /// All robots of the rings that have begun. Also those that have answered: an operator may have rolled back a model that was
    /// kept, or sent it again to a robot that had refused it.
    #[must_use]
    pub fn to_ask(&self) -> Vec<String> {
        let asked = self.robots.iter().filter(|robot| robot.ring <= self.open);
        asked.map(|robot| robot.name.clone()).collect()
    }

    /// Robots to send the model to, if they could be asked: those that were never sent it, and those that have not answered for so
    /// long that they cannot be judging it any more.
    #[must_use]
    pub fn to_send(&self, rules: &Rules, now_unix_s: u64) -> Vec<String> {
        let is_due = |robot: &Record| match robot.verdict {
            Verdict::Waiting => true,
            Verdict::Sent => now_unix_s.saturating_sub(robot.unix_s) >= rules.resend_after_s,
            _ => false,
        };
        let due = self
            .robots
            .iter()
            .filter(|robot| robot.ring <= self.open && robot.problem.is_none() && is_due(robot));
        due.map(|robot| robot.name.clone()).collect()
    }

    /// Whether no answer that is still to come can keep a ring within its limit, so that sending stops in the middle of a pass.
    #[must_use]
    pub fn must_stop(&self, rules: &Rules) -> bool {
        (0..=self.open).any(|ring| {
            let counts = self.counts(ring);
            is_beyond(ring, counts.failed, counts.all - counts.excused, rules)
        })
    }

    /// Halts the rollout if too many of a ring's answered robots refused the model or rolled it back. Returns whether it halted
    /// now.
    pub fn halt_if_needed(&mut self, rules: &Rules, now_unix_s: u64) -> bool {
        if self.halted.is_some() {
            return false;
        }
        let beyond = (0..=self.open).find(|ring| {
            let counts = self.counts(*ring);
            is_beyond(*ring, counts.failed, counts.answered(), rules)
        });
        self.halted =
            beyond.map(|ring| Halt { why: self.why_beyond(ring, rules), unix_s: now_unix_s });
        self.halted.is_some()
    }

    fn why_beyond(&self, ring: usize, rules: &Rules) -> String {
        let counts = self.counts(ring);
        let limit = if ring == 0 {
            rules.max_failed_canaries.to_string()
        } else {
            format!("{} %", rules.max_failed_percent)
        };
        let failed: Vec<&Record> = self
            .robots
            .iter()
            .filter(|robot| robot.ring == ring && robot.counts_as_failed())
            .collect();
        let named = failed
            .iter()
            .take(MAX_NAMED)
            .map(|robot| format!("{} ({}: {})", robot.name, robot.verdict.words(), robot.reason));
        let more = match failed.len().saturating_sub(MAX_NAMED) {
            0 => String::new(),
            more => format!(", and {more} more"),
        };
        format!(
            "{} of {} answered robots in ring {} refused the model or rolled it back, allowed: {limit}: {}{more}",
            counts.failed,
            counts.answered(),
            self.ring_name(ring),
            named.collect::<Vec<_>>().join(", "),
        )
    }

    /// What the last ring that has begun lacks before the next one may begin; `None` if nothing.
    #[must_use]
    pub fn lacks(&self, rules: &Rules) -> Option<String> {
        let counts = self.counts(self.open);
        // The file always names a canary; a state without one judged nothing.
        if self.open == 0 && counts.all == 0 {
            return Some("no robot is in the ring of canaries".to_owned());
        }
        let others = counts.all - counts.failed - counts.excused;
        let needed = (others * rules.kept_percent).div_ceil(100);
        (counts.kept < needed).then(|| {
            format!(
                "kept in ring {}: {}, needed before the next ring: {needed}",
                self.ring_name(self.open),
                counts.kept
            )
        })
    }

    /// Begins the next ring if this one has what it needs. Returns whether it did.
    pub fn begin_next_ring(&mut self, rules: &Rules) -> bool {
        let may = self.halted.is_none()
            && self.open + 1 < self.rings.len()
            && self.lacks(rules).is_none();
        if may {
            self.open += 1;
        }
        may
    }

    /// Goes on after a halt, on the order of an operator: the robots that refused the model or rolled it back count no more. Without
    /// a halt it changes nothing.
    pub fn resume(&mut self) {
        if self.halted.take().is_none() {
            return;
        }
        for robot in &mut self.robots {
            robot.is_excused |= robot.verdict.has_failed();
        }
    }

    #[must_use]
    pub fn ring_name(&self, ring: usize) -> &str {
        self.rings.get(ring).map_or("?", String::as_str)
    }
}

/// A number of robots in words.
#[must_use]
pub fn robots_in_words(count: usize) -> String {
    if count == 1 { "1 robot".to_owned() } else { format!("{count} robots") }
}

/// Whether a ring with this number of failed robots is beyond its limit. `of` is what the share of a later ring refers to.
fn is_beyond(ring: usize, failed: usize, of: usize, rules: &Rules) -> bool {
    if ring == 0 {
        failed > rules.max_failed_canaries
    } else {
        100 * failed > rules.max_failed_percent * of
    }
}
