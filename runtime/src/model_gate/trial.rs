//! A model that passed the gate is on trial: it drives, and is watched against what the resident model did before it.
//!
//! Rolled back at once when one of these is shown:
//! - its output is worthless (NaN, out of range) [`TrialLimits::bad_outputs`] times;
//! - turns come late: at least 3, and more than the resident's share and `overrun_share` together;
//! - the bumper trips more often: with the resident's rate r per metre (at least `least_trips_per_m`) the probability of so many
//!   trips or more on m metres, a Poisson tail with mean r m, is below 1 %;
//! - on the LiDAR line a smaller share of depths is right, by more than `delta1_drop`, over `line_pictures` pictures.
//!
//! Kept when it has driven `turns` turns and `metres` metres, or ten times as many turns.

use serde::{Deserialize, Serialize};

/// What the trial asks for.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TrialLimits {
    /// Turns with a picture.
    pub turns: u64,
    /// Way, metres.
    pub metres: f64,
    /// So many worthless outputs end it.
    pub bad_outputs: u64,
    /// Late turns may be this much more of all turns than the resident's.
    pub overrun_share: f64,
    /// Trips per metre that are always forgiven.
    pub least_trips_per_m: f64,
    /// So much less of the depths on the LiDAR line may be right.
    pub delta1_drop: f64,
    /// Pictures with a LiDAR line before their mean counts.
    pub line_pictures: u64,
}

impl Default for TrialLimits {
    fn default() -> Self {
        Self {
            turns: 600,
            metres: 5.0,
            bad_outputs: 3,
            overrun_share: 0.02,
            least_trips_per_m: 0.2,
            delta1_drop: 0.1,
            line_pictures: 50,
        }
    }
}

/// One turn with a picture, as far as the trial is concerned.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct TrialTurn {
    /// It came late.
    pub overrun: bool,
    /// The network's output was worthless.
    pub bad_output: bool,
    /// Times when the bumper tripped.
    pub trips: u64,
    /// Way since the turn before, metres.
    pub moved_m: f64,
    /// Share of right depths on the LiDAR line, where there is one.
    pub delta1: Option<f64>,
}

/// What happened with one model.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct TrialCounts {
    /// Turns with a picture.
    pub turns: u64,
    /// Of these late.
    pub overruns: u64,
    /// Of these without output.
    pub bad_outputs: u64,
    /// Bumper trips.
    pub trips: u64,
    /// Way, metres.
    pub metres: f64,
    /// Pictures with a LiDAR line.
    pub line_pictures: u64,
    /// Sum of their shares of right depths.
    pub delta1_sum: f64,
}

impl TrialCounts {
    /// Counts one turn.
    pub fn add(&mut self, turn: &TrialTurn) {
        self.turns += 1;
        self.overruns += u64::from(turn.overrun);
        self.bad_outputs += u64::from(turn.bad_output);
        self.trips += turn.trips;
        self.metres += turn.moved_m;
        if let Some(delta1) = turn.delta1 {
            self.line_pictures += 1;
            self.delta1_sum += delta1;
        }
    }

    /// As [`add`](Self::add), but when there are `most` turns, all that was counts half.
    pub fn remember(&mut self, turn: &TrialTurn, most: u64) {
        if self.turns >= most {
            for count in [
                &mut self.turns,
                &mut self.overruns,
                &mut self.bad_outputs,
                &mut self.trips,
                &mut self.line_pictures,
            ] {
                *count /= 2;
            }
            self.metres /= 2.0;
            self.delta1_sum /= 2.0;
        }
        self.add(turn);
    }

    /// Mean share of right depths on the LiDAR line, from `least` pictures on.
    #[must_use]
    pub fn delta1(&self, least: u64) -> Option<f64> {
        (self.line_pictures >= least.max(1)).then(|| self.delta1_sum / self.line_pictures as f64)
    }

    fn overrun_share(&self) -> f64 {
        self.overruns as f64 / self.turns.max(1) as f64
    }

    fn trips_per_m(&self) -> f64 {
        if self.metres > 0.0 { self.trips as f64 / self.metres } else { 0.0 }
    }
}

/// Where a trial stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TrialState {
    /// Not decided.
    Running,
    /// Decided.
    Ended(TrialVerdict),
}

/// How a trial ended, with the numbers.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, thiserror::Error)]
#[serde(tag = "trial", rename_all = "snake_case")]
#[non_exhaustive]
pub enum TrialVerdict {
    /// It stays.
    #[error("kept after {turns} turns and {metres:.1} m")]
    Keep {
        /// Turns.
        turns: u64,
        /// Way, metres.
        metres: f64,
    },
    /// Worthless output.
    #[error("rolled back: its output was NaN or out of range {times} times in {turns} turns")]
    BadOutput {
        /// How often.
        times: u64,
        /// In so many turns.
        turns: u64,
    },
    /// Late turns.
    #[error(
        "rolled back: {late} of {turns} turns came late, the resident model's share was {resident:.3}"
    )]
    Overruns {
        /// How many.
        late: u64,
        /// Of so many.
        turns: u64,
        /// Of the resident model.
        resident: f64,
    },
    /// Bumper trips.
    #[error(
        "rolled back: {trips} bumper trips on {metres:.1} m, the resident model had {resident_per_m:.2} a metre"
    )]
    Trips {
        /// How many.
        trips: u64,
        /// On this way, metres.
        metres: f64,
        /// Of the resident model.
        resident_per_m: f64,
    },
    /// Less right on the LiDAR line.
    #[error(
        "rolled back: {delta1:.3} of its depths on the LiDAR line were right over {pictures} pictures, least: {least:.3}"
    )]
    Accuracy {
        /// Share of right depths.
        delta1: f64,
        /// Pictures.
        pictures: u64,
        /// Least.
        least: f64,
    },
}

impl TrialVerdict {
    /// Whether the model stays.
    #[must_use]
    pub fn keeps(&self) -> bool {
        matches!(self, Self::Keep { .. })
    }
}

/// A model on trial.
#[derive(Debug, Clone, PartialEq)]
pub struct Trial {
    limits: TrialLimits,
    resident: TrialCounts,
    counts: TrialCounts,
}

impl Trial {
    /// A trial against what the resident model did; all zero where it did nothing.
    #[must_use]
    pub fn new(limits: TrialLimits, resident: TrialCounts) -> Self {
        Self { limits, resident, counts: TrialCounts::default() }
    }

    /// What happened so far.
    #[must_use]
    pub fn counts(&self) -> &TrialCounts {
        &self.counts
    }

    /// Counts a turn and decides.
    pub fn observe(&mut self, turn: &TrialTurn) -> TrialState {
        self.counts.add(turn);
        self.fault().or_else(|| self.success()).map_or(TrialState::Running, TrialState::Ended)
    }

    fn fault(&self) -> Option<TrialVerdict> {
        let Self { limits, resident, counts } = self;
        let (turns, metres) = (counts.turns, counts.metres);
        if counts.bad_outputs >= limits.bad_outputs {
            return Some(TrialVerdict::BadOutput { times: counts.bad_outputs, turns });
        }
        // Early on, one late turn is a large share: the trial's whole length counts.
        let allowed =
            (resident.overrun_share() + limits.overrun_share) * turns.max(limits.turns) as f64;
        if counts.overruns >= 3 && counts.overruns as f64 > allowed {
            let resident = resident.overrun_share();
            return Some(TrialVerdict::Overruns { late: counts.overruns, turns, resident });
        }
        let expected = resident.trips_per_m().max(limits.least_trips_per_m) * metres;
        if counts.trips >= 3 && poisson_tail(counts.trips, expected) < 0.01 {
            let resident_per_m = resident.trips_per_m();
            return Some(TrialVerdict::Trips { trips: counts.trips, metres, resident_per_m });
        }
        let delta1 = counts.delta1(limits.line_pictures)?;
        let least = resident.delta1(limits.line_pictures)? - limits.delta1_drop;
        (delta1 < least).then_some(TrialVerdict::Accuracy {
            delta1,
            pictures: counts.line_pictures,
            least,
        })
    }

    fn success(&self) -> Option<TrialVerdict> {
        let TrialCounts { turns, metres, .. } = self.counts;
        let done = turns >= self.limits.turns && metres >= self.limits.metres
            || turns >= 10 * self.limits.turns;
        done.then_some(TrialVerdict::Keep { turns, metres })
    }
}

/// P(N >= n) for N Poisson with this mean.
fn poisson_tail(n: u64, mean: f64) -> f64 {
    let mut term = (-mean).exp();
    let mut below = 0.0;
    for k in 0..n {
        below += term;
        term *= mean / (k + 1) as f64;
    }
    1.0 - below
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const GOOD: TrialTurn =
        TrialTurn { overrun: false, bad_output: false, trips: 0, moved_m: 0.02, delta1: Some(0.8) };

    fn resident() -> TrialCounts {
        let mut counts = TrialCounts::default();
        (0..1000)
            .for_each(|turn| counts.add(&TrialTurn { trips: u64::from(turn % 200 == 0), ..GOOD }));
        counts
    }

    fn run(turn: impl Fn(u64) -> TrialTurn) -> (u64, TrialVerdict) {
        let mut trial = Trial::new(TrialLimits::default(), resident());
        for index in 0.. {
            if let TrialState::Ended(verdict) = trial.observe(&turn(index)) {
                return (index + 1, verdict);
            }
        }
        unreachable!()
    }

    #[test]
    fn a_model_that_behaves_is_kept_when_its_time_and_way_are_over() {
        assert_eq!(run(|_| GOOD).0, 600);
        assert!(run(|_| GOOD).1.keeps());
        assert_eq!(run(|_| TrialTurn { moved_m: 0.005_001, ..GOOD }).0, 1000, "5 m at 5 mm a turn");
        assert_eq!(
            run(|_| TrialTurn { moved_m: 0.0, ..GOOD }).0,
            6000,
            "standing still is no reason for ever"
        );
    }

    #[test]
    fn worthless_outputs_end_it_at_the_third() {
        let (turns, verdict) = run(|turn| TrialTurn { bad_output: turn >= 40, ..GOOD });
        assert_eq!((turns, verdict), (43, TrialVerdict::BadOutput { times: 3, turns: 43 }));
    }

    #[test]
    fn late_turns_end_it_once_they_are_more_than_the_whole_trial_may_have() {
        let (turns, verdict) = run(|turn| TrialTurn { overrun: turn % 2 == 0, ..GOOD });
        assert!(
            turns <= 30 && matches!(verdict, TrialVerdict::Overruns { .. }),
            "{turns} {verdict}"
        );
        assert!(run(|turn| TrialTurn { overrun: turn % 100 == 0, ..GOOD }).1.keeps());
    }

    #[test]
    fn a_model_that_runs_into_things_is_rolled_back_and_one_that_does_it_as_often_as_before_is_kept()
     {
        let (turns, verdict) = run(|turn| TrialTurn { trips: u64::from(turn % 20 == 19), ..GOOD });
        assert!(turns <= 200 && matches!(verdict, TrialVerdict::Trips { .. }), "{turns} {verdict}");
        assert!(run(|turn| TrialTurn { trips: u64::from(turn % 200 == 0), ..GOOD }).1.keeps());
    }

    #[test]
    fn a_model_that_is_less_right_on_the_lidar_line_is_rolled_back_as_soon_as_that_is_known() {
        let (turns, verdict) = run(|_| TrialTurn { delta1: Some(0.6), ..GOOD });
        assert_eq!(turns, 50);
        assert!(matches!(verdict, TrialVerdict::Accuracy { .. }) && !verdict.keeps(), "{verdict}");
        assert!(run(|_| TrialTurn { delta1: Some(0.72), ..GOOD }).1.keeps());
    }

    #[test]
    fn without_a_resident_model_only_what_is_bad_by_itself_counts() {
        let mut trial = Trial::new(TrialLimits::default(), TrialCounts::default());
        let ended = (0..600)
            .map(|_| trial.observe(&TrialTurn { delta1: Some(0.1), ..GOOD }))
            .last()
            .unwrap();
        assert!(matches!(ended, TrialState::Ended(TrialVerdict::Keep { .. })));
    }

    #[test]
    fn the_poisson_tail_is_the_textbooks() {
        assert!((poisson_tail(3, 1.0) - 0.080_301_4).abs() < 1e-6);
        assert!((poisson_tail(10, 3.0) - 0.001_102_49).abs() < 1e-6);
        assert_eq!(poisson_tail(0, 2.0), 1.0);
    }

    proptest! {
        #[test]
        fn every_trial_ends(late in 0.0..1.0f64, trips in 0..3u64, delta1 in 0.0..1.0f64, moved in 0.0..0.1f64) {
            let mut trial = Trial::new(TrialLimits::default(), resident());
            let ended = (0..6000).any(|turn| {
                let turn = TrialTurn {
                    overrun: f64::from(turn % 100) < 100.0 * late, bad_output: false, trips, moved_m: moved,
                    delta1: Some(delta1),
                };
                trial.observe(&turn) != TrialState::Running
            });
            prop_assert!(ended);
        }
    }
}
