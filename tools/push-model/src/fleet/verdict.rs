//! How a robot's answers change its verdict.

use super::answer::{Event, Judged, Listed, Trial, What};
use super::robots::{Asked, Sent};
use super::state::{Record, Verdict};

const REPLACED: &str = "the robot was given another model before the trial ended";

impl Record {
    /// Takes over what the robot says about its models.
    pub fn take_over(&mut self, asked: &Asked, now_unix_s: u64) {
        match asked {
            Asked::Listed(listed) => {
                self.problem = None;
                self.runs.clone_from(&listed.runs);
                self.learn(listed, now_unix_s);
            }
            // The first model of a robot creates its store.
            Asked::NoList { .. } if self.verdict == Verdict::Waiting => self.problem = None,
            Asked::NoList { why } | Asked::Unreachable { why } => self.problem = Some(why.clone()),
        }
    }

    fn learn(&mut self, listed: &Listed, now_unix_s: u64) {
        let before = *self.entries_before.get_or_insert(listed.events.len());
        let new = listed.events.get(before..).unwrap_or_default();
        let is_lost = self.verdict == Verdict::OnTrial;
        let is_kept = self.verdict == Verdict::Kept;
        match (listed.current, ended(new)) {
            // Its trial is over; only an operator can still roll it back.
            (None, Some((Verdict::RolledBack, why))) if is_kept => {
                self.set(Verdict::RolledBack, why, now_unix_s);
            }
            _ if is_kept => {}
            (Some(Trial::Runs), _) => self.set(Verdict::OnTrial, "", now_unix_s),
            (Some(Trial::Ended), _) => {
                self.set(Verdict::Kept, why_kept(&listed.events), now_unix_s);
            }
            (None, Some((verdict, why))) => self.set(verdict, why, now_unix_s),
            (None, None) if is_lost => self.set(Verdict::Replaced, REPLACED, now_unix_s),
            (None, None) => {}
        }
    }

    /// Takes over what came of sending the model.
    pub fn learn_of_sending(&mut self, sent: &Sent, now_unix_s: u64) {
        self.problem = None;
        match sent {
            // The next list says whether its trial has ended already.
            Sent::Judged(Judged::Accepted | Judged::Current) => {
                self.set(Verdict::OnTrial, "", now_unix_s);
            }
            Sent::Judged(Judged::Refused { why }) => self.set(Verdict::Refused, why, now_unix_s),
            Sent::NotArrived { why } => {
                self.set(Verdict::Waiting, "", now_unix_s);
                self.problem = Some(why.clone());
            }
            Sent::Unknown { why } => self.problem = Some(why.clone()),
        }
    }

    /// Sets the verdict. Its time is when it became known first, and its reason the first one that was given.
    fn set(&mut self, verdict: Verdict, reason: &str, now_unix_s: u64) {
        if self.verdict != verdict {
            self.verdict = verdict;
            self.unix_s = now_unix_s;
            self.reason.clear();
        }
        // It was given the model again, and may fail again.
        self.is_excused &= verdict.has_failed();
        if self.reason.is_empty() {
            reason.clone_into(&mut self.reason);
        }
    }
}

/// What the history says about a model that the robot does not use. Refusals count only if nothing else happened: a model that was
/// rolled back may have been refused again since.
fn ended(events: &[Event]) -> Option<(Verdict, &str)> {
    let not_refused = events
        .iter()
        .rev()
        .find(|event| matches!(event.what, What::Installed | What::Kept | What::RolledBack));
    let event = not_refused.or_else(|| events.iter().rfind(|event| event.what == What::Refused))?;
    Some(match event.what {
        What::RolledBack => (Verdict::RolledBack, event.why.as_str()),
        What::Kept => (Verdict::Kept, event.why.as_str()),
        What::Installed => (Verdict::Replaced, REPLACED),
        What::Refused | What::Other => (Verdict::Refused, event.why.as_str()),
    })
}

fn why_kept(events: &[Event]) -> &str {
    events.iter().rfind(|event| event.what == What::Kept).map_or("", |event| &event.why)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn listed(current: Option<Trial>, whats: &[What]) -> Asked {
        let event = |what: &What| Event { what: *what, why: format!("{what:?}") };
        let events = whats.iter().map(event).collect();
        Asked::Listed(Listed { current, events, runs: "some model".to_owned() })
    }

    fn sent_after(asked: &Asked) -> Record {
        let mut record = Record::new("r", 0, 1);
        record.take_over(asked, 2);
        record.set(Verdict::Sent, "", 3);
        record
    }

    #[test]
    fn the_verdict_follows_the_robots_list() {
        use What::{Installed, Kept, Refused, RolledBack};
        let cases = [
            (None, &[][..], Verdict::Sent),
            (Some(Trial::Runs), &[Installed], Verdict::OnTrial),
            (Some(Trial::Ended), &[Installed, Kept], Verdict::Kept),
            // The last entry of the history may be missing after a crash.
            (Some(Trial::Runs), &[], Verdict::OnTrial),
            (Some(Trial::Ended), &[Installed], Verdict::Kept),
            (None, &[Installed, RolledBack], Verdict::RolledBack),
            (None, &[Installed, RolledBack, Refused], Verdict::RolledBack),
            (None, &[Installed, Kept, RolledBack], Verdict::RolledBack),
            (None, &[Installed, Kept], Verdict::Kept),
            (None, &[Installed], Verdict::Replaced),
            (None, &[Refused], Verdict::Refused),
            (None, &[What::Other], Verdict::Sent),
        ];
        for (current, whats, expected) in cases {
            let mut record = sent_after(&listed(None, &[]));
            record.take_over(&listed(current, whats), 9);
            assert_eq!(record.verdict, expected, "{current:?} {whats:?}");
            assert_eq!(record.unix_s, if expected == Verdict::Sent { 3 } else { 9 });
            assert_eq!(record.runs, "some model");
        }
    }

    #[test]
    fn what_happened_before_the_robot_was_sent_the_model_is_no_answer() {
        let old = [What::Installed, What::RolledBack];
        let mut record = sent_after(&listed(None, &old));
        record.take_over(&listed(None, &old), 9);
        assert_eq!(record.verdict, Verdict::Sent);
        record.take_over(&listed(None, &[old[0], old[1], What::Refused]), 10);
        assert_eq!((record.verdict, record.reason.as_str()), (Verdict::Refused, "Refused"));
    }

    #[test]
    fn a_robot_that_uses_the_model_already_has_answered_before_it_is_sent_it() {
        for (trial, expected) in [(Trial::Runs, Verdict::OnTrial), (Trial::Ended, Verdict::Kept)] {
            let mut record = Record::new("r", 0, 1);
            record.take_over(&listed(Some(trial), &[What::Installed]), 2);
            assert_eq!(record.verdict, expected);
        }
    }

    #[test]
    fn a_verdict_that_is_given_again_keeps_its_time_and_its_reason() {
        let mut record = sent_after(&listed(None, &[]));
        let why = "judged: too slow".to_owned();
        record.learn_of_sending(&Sent::Judged(Judged::Refused { why: why.clone() }), 4);
        record.take_over(&listed(None, &[What::Refused]), 9);
        assert_eq!((record.verdict, record.reason, record.unix_s), (Verdict::Refused, why, 4));
    }

    #[test]
    fn a_trial_that_the_store_forgot_or_another_model_ended_is_replaced() {
        let mut record = sent_after(&listed(None, &[]));
        record.learn_of_sending(&Sent::Judged(Judged::Accepted), 4);
        assert_eq!(record.verdict, Verdict::OnTrial);
        record.take_over(&listed(None, &[]), 5);
        assert_eq!(record.verdict, Verdict::Replaced);
    }

    #[test]
    fn a_robot_that_has_kept_the_model_can_only_be_rolled_back_by_an_operator() {
        use What::{Installed, Kept, RolledBack};
        for (whats, expected) in [
            (&[Installed][..], Verdict::Kept),
            (&[Installed, Kept], Verdict::Kept),
            (&[Installed, Kept, RolledBack], Verdict::RolledBack),
        ] {
            let mut record = sent_after(&listed(None, &[]));
            record.take_over(&listed(Some(Trial::Ended), &[Installed]), 4);
            record.take_over(&listed(None, whats), 5);
            assert_eq!(record.verdict, expected, "{whats:?}");
        }
    }

    #[test]
    fn an_excused_robot_that_is_given_the_model_again_counts_when_it_fails_again() {
        let mut record = sent_after(&listed(None, &[]));
        record.learn_of_sending(&Sent::Judged(Judged::Refused { why: "too slow".into() }), 4);
        record.is_excused = true;
        record.take_over(&listed(None, &[What::Refused]), 5);
        assert!(!record.counts_as_failed());
        record.take_over(&listed(Some(Trial::Runs), &[What::Refused, What::Installed]), 6);
        let whats = [What::Refused, What::Installed, What::RolledBack];
        record.take_over(&listed(None, &whats), 7);
        assert!(record.counts_as_failed());
    }

    #[test]
    fn a_robot_that_cannot_be_asked_keeps_its_verdict_and_shows_the_problem() {
        let why = "no route to host".to_owned();
        let mut record = sent_after(&listed(None, &[]));
        record.learn_of_sending(&Sent::Judged(Judged::Accepted), 4);
        record.take_over(&Asked::Unreachable { why: why.clone() }, 5);
        assert_eq!((record.verdict, record.problem.clone()), (Verdict::OnTrial, Some(why)));
        record.take_over(&listed(Some(Trial::Runs), &[What::Installed]), 6);
        assert_eq!((record.problem.as_ref(), record.unix_s), (None, 4));
    }

    #[test]
    fn a_model_that_did_not_arrive_is_sent_again_and_an_unknown_answer_is_awaited() {
        let why = "connection reset".to_owned();
        let mut record = sent_after(&listed(None, &[]));
        record.learn_of_sending(&Sent::Unknown { why: why.clone() }, 4);
        assert_eq!((record.verdict, record.unix_s), (Verdict::Sent, 3));
        record.learn_of_sending(&Sent::NotArrived { why: why.clone() }, 4);
        assert_eq!((record.verdict, record.problem), (Verdict::Waiting, Some(why)));
    }
}
