//! One pass of a rollout: ask the robots of the rings that have begun, send to those that are due, begin the next ring.

use std::collections::HashSet;

use anyhow::Result;

use super::file::Rules;
use super::parallel::in_parallel;
use super::robots::Robots;
use super::rollout::{Standing, robots_in_words};
use super::state::{Record, Rollout, Verdict};

/// What a pass works with.
pub struct Pass<'a> {
    pub robots: &'a dyn Robots,
    pub rules: &'a Rules,
    /// Number of robots that are asked or sent to at once.
    pub parallel: usize,
    pub now_unix_s: &'a dyn Fn() -> u64,
    /// Writes the state to the disk.
    pub save: &'a dyn Fn(&Rollout) -> Result<()>,
    /// Prints one line about what happened.
    pub tell: &'a dyn Fn(&str),
}

impl Pass<'_> {
    /// Makes one pass. A rollout that has halted only asks; one that is complete does nothing.
    ///
    /// # Errors
    /// When the state cannot be written. Nothing is sent then any more.
    pub fn run(&self, rollout: &mut Rollout) -> Result<()> {
        // A pass that was ended between the last answer and this decision left it to the next one.
        self.halt_if_needed(rollout);
        let mut asked = HashSet::new();
        while rollout.standing() != Standing::Complete {
            self.ask(rollout, &mut asked)?;
            self.halt_if_needed(rollout);
            self.send(rollout)?;
            self.halt_if_needed(rollout);
            if !rollout.begin_next_ring(self.rules) {
                break;
            }
            let counts = rollout.counts(rollout.open);
            if counts.all > 0 {
                let name = rollout.ring_name(rollout.open);
                (self.tell)(&format!("ring {name} begins: {}", robots_in_words(counts.all)));
            }
        }
        (self.save)(rollout)
    }

    /// Asks every robot whose ring has begun once in a pass.
    fn ask(&self, rollout: &mut Rollout, asked: &mut HashSet<String>) -> Result<()> {
        let mut names = rollout.to_ask();
        names.retain(|name| asked.insert(name.clone()));
        let robots = self.robots;
        in_parallel(
            names,
            self.parallel,
            rollout,
            |_, _| Ok(true),
            |name| robots.ask(name),
            |rollout, name, answer| {
                self.note(rollout, name, |record, now| record.take_over(&answer, now));
                Ok(())
            },
        )?;
        (self.save)(rollout)
    }

    /// Sends to the robots that are due. That sending begins is on the disk before it begins, and the answer as soon as it is there,
    /// so that a pass which is ended at any moment sends to no robot twice.
    fn send(&self, rollout: &mut Rollout) -> Result<()> {
        if rollout.halted.is_some() {
            return Ok(());
        }
        let due = rollout.to_send(self.rules, (self.now_unix_s)());
        let robots = self.robots;
        in_parallel(
            due,
            self.parallel,
            rollout,
            |rollout, name| {
                if rollout.must_stop(self.rules) {
                    return Ok(false);
                }
                let now_unix_s = (self.now_unix_s)();
                if let Some(record) = rollout.robot_mut(name) {
                    record.verdict = Verdict::Sent;
                    record.unix_s = now_unix_s;
                    record.entries_before.get_or_insert(0);
                }
                (self.save)(rollout)?;
                Ok(true)
            },
            |name| robots.send(name),
            |rollout, name, sent| {
                self.note(rollout, name, |record, now| record.learn_of_sending(&sent, now));
                (self.save)(rollout)
            },
        )
    }

    /// Changes a robot's record, and says what changed.
    fn note(&self, rollout: &mut Rollout, name: &str, change: impl FnOnce(&mut Record, u64)) {
        let Some(record) = rollout.robot_mut(name) else { return };
        let before = record.clone();
        change(record, (self.now_unix_s)());
        if (record.verdict, &record.problem) == (before.verdict, &before.problem) {
            return;
        }
        match (&record.problem, record.reason.as_str()) {
            (Some(problem), _) => (self.tell)(&format!("{name}: not reached: {problem}")),
            (None, "") => (self.tell)(&format!("{name}: {}", record.verdict.words())),
            (None, why) => (self.tell)(&format!("{name}: {}: {why}", record.verdict.words())),
        }
    }

    fn halt_if_needed(&self, rollout: &mut Rollout) {
        if rollout.halt_if_needed(self.rules, (self.now_unix_s)())
            && let Some(halt) = &rollout.halted
        {
            (self.tell)(&format!("halted: {}", halt.why));
        }
    }
}
