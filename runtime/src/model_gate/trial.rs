//! The trial of a model that passed the gate: it drives the robot, and its behaviour is compared
//! with that of the resident model before it.
//!
//! The model is rolled back as soon as one of these holds:
//! - its output was NaN or out of range [`TrialLimits::bad_outputs`] times;
//! - at least 3 ticks were late, and their share exceeds the resident's share by more than
//!   `overrun_share`;
//! - the safety plane trips more often. With the resident's rate r per metre (at least
//!   `least_trips_per_m`), the probability of this many trips or more on m metres is below 1 % (the
//!   tail of a Poisson distribution with mean r m);
//! - the share of right depths against the LiDAR is lower by more than `delta1_drop`, over
//!   `lidar_frames` frames.
//!
//! It is kept after `ticks` ticks and `metres` metres, or after ten times as many ticks.

use serde::{Deserialize, Serialize};

/// Limits of the trial.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TrialLimits {
    /// Minimum number of ticks with a frame before the model is kept.
    pub ticks: u64,
    /// Minimum driven distance before the model is kept, metres.
    pub metres: f64,
    /// The model is rolled back after this many outputs that are NaN or out of range.
    pub bad_outputs: u64,
    /// The share of late ticks may exceed the resident's share by this.
    pub overrun_share: f64,
    /// Trips per metre that are accepted even if the resident model had fewer.
    pub least_trips_per_m: f64,
    /// The share of right depths against the LiDAR may fall below the resident's by this.
    pub delta1_drop: f64,
    /// Minimum number of frames with LiDAR pixels before the share of right depths is compared.
    pub lidar_frames: u64,
}

impl Default for TrialLimits {
    fn default() -> Self {
        Self {
            ticks: 600,
            metres: 5.0,
            bad_outputs: 3,
            overrun_share: 0.02,
            least_trips_per_m: 0.2,
            delta1_drop: 0.1,
            lidar_frames: 50,
        }
    }
}

/// What the trial needs to know about one tick with a frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct TrialTick {
    /// The tick took longer than its period.
    pub overrun: bool,
    /// The network's output was NaN or out of range.
    pub bad_output: bool,
    /// Number of trips of the safety plane.
    pub trips: u64,
    /// Distance driven since the previous tick, metres.
    pub moved_m: f64,
    /// Share of right depths against the LiDAR; `None` without LiDAR pixels.
    pub delta1: Option<f64>,
}

/// Counts of what happened while one model drove the robot.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct TrialCounts {
    /// Number of ticks with a frame.
    pub ticks: u64,
    /// Number of late ticks.
    pub overruns: u64,
    /// Number of outputs that were NaN or out of range.
    pub bad_outputs: u64,
    /// Number of trips of the safety plane.
    pub trips: u64,
    /// Driven distance, metres.
    pub metres: f64,
    /// Number of frames with LiDAR pixels.
    pub lidar_frames: u64,
    /// Sum of the shares of right depths over these frames.
    pub delta1_sum: f64,
}

impl TrialCounts {
    /// Counts one tick.
    pub fn add(&mut self, tick: &TrialTick) {
        self.ticks += 1;
        self.overruns += u64::from(tick.overrun);
        self.bad_outputs += u64::from(tick.bad_output);
        self.trips += tick.trips;
        self.metres += tick.moved_m;
        if let Some(delta1) = tick.delta1 {
            self.lidar_frames += 1;
            self.delta1_sum += delta1;
        }
    }

    /// Counts one tick like [`add`](Self::add), but first halves all counts if they cover `most`
    /// ticks, so that old ticks count less.
    pub fn remember(&mut self, tick: &TrialTick, most: u64) {
        if self.ticks >= most {
            for count in [
                &mut self.ticks,
                &mut self.overruns,
                &mut self.bad_outputs,
                &mut self.trips,
                &mut self.lidar_frames,
            ] {
                *count /= 2;
            }
            self.metres /= 2.0;
            self.delta1_sum /= 2.0;
        }
        self.add(tick);
    }

    /// Mean share of right depths against the LiDAR; `None` with fewer than `least` frames.
    #[must_use]
    pub fn delta1(&self, least: u64) -> Option<f64> {
        (self.lidar_frames >= least.max(1)).then(|| self.delta1_sum / self.lidar_frames as f64)
    }

    fn overrun_share(&self) -> f64 {
        self.overruns as f64 / self.ticks.max(1) as f64
    }

    fn trips_per_m(&self) -> f64 {
        if self.metres > 0.0 { self.trips as f64 / self.metres } else { 0.0 }
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TrialState {
    Running,
    Ended(TrialVerdict),
}

/// The result of a trial, with the numbers that decided it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, thiserror::Error)]
#[serde(tag = "trial", rename_all = "snake_case")]
#[non_exhaustive]
pub enum TrialVerdict {
    /// The model is kept.
    #[error("kept after {ticks} ticks and {metres:.1} m")]
    Keep { ticks: u64, metres: f64 },
    /// The output was NaN or out of range too often.
    #[error("rolled back: its output was NaN or out of range {times} times in {ticks} ticks")]
    BadOutput { times: u64, ticks: u64 },
    /// Too many ticks were late. `resident` is the resident model's share of late ticks.
    #[error(
        "rolled back: {late} of {ticks} ticks were late, the resident model's share was {resident:.3}"
    )]
    Overruns { late: u64, ticks: u64, resident: f64 },
    /// The safety plane tripped too often.
    #[error(
        "rolled back: {trips} trips on {metres:.1} m, the resident model had {resident_per_m:.2} per metre"
    )]
    Trips { trips: u64, metres: f64, resident_per_m: f64 },
    /// The share of right depths against the LiDAR was too low.
    #[error(
        "rolled back: {delta1:.3} of its depths were right against the LiDAR over {frames} frames, minimum: {least:.3}"
    )]
    Accuracy { delta1: f64, frames: u64, least: f64 },
}

impl TrialVerdict {
    /// Whether the model is kept.
    #[must_use]
    pub fn keeps(&self) -> bool {
        matches!(self, Self::Keep { .. })
    }
}

/// The trial of one model.
#[derive(Debug, Clone, PartialEq)]
pub struct Trial {
    limits: TrialLimits,
    resident: TrialCounts,
    counts: TrialCounts,
}

impl Trial {
    /// A trial against the counts of the resident model; all counts are 0 if there was none.
    #[must_use]
    pub fn new(limits: TrialLimits, resident: TrialCounts) -> Self {
        Self { limits, resident, counts: TrialCounts::default() }
    }

    #[must_use]
    pub fn counts(&self) -> &TrialCounts {
        &self.counts
    }

    /// Counts a tick and decides whether the trial has ended.
    pub fn observe(&mut self, tick: &TrialTick) -> TrialState {
        self.counts.add(tick);
        self.fault().or_else(|| self.success()).map_or(TrialState::Running, TrialState::Ended)
    }

    fn fault(&self) -> Option<TrialVerdict> {
        let Self { limits, resident, counts } = self;
        let ticks = counts.ticks;
        let metres = counts.metres;
        if counts.bad_outputs >= limits.bad_outputs {
            return Some(TrialVerdict::BadOutput { times: counts.bad_outputs, ticks });
        }
        // At the start of a trial one late tick is a large share, so the share refers to at least
        // the whole trial.
        let allowed =
            (resident.overrun_share() + limits.overrun_share) * ticks.max(limits.ticks) as f64;
        if counts.overruns >= 3 && counts.overruns as f64 > allowed {
            let resident = resident.overrun_share();
            return Some(TrialVerdict::Overruns { late: counts.overruns, ticks, resident });
        }
        let expected = resident.trips_per_m().max(limits.least_trips_per_m) * metres;
        if counts.trips >= 3 && poisson_tail(counts.trips, expected) < 0.01 {
            let resident_per_m = resident.trips_per_m();
            return Some(TrialVerdict::Trips { trips: counts.trips, metres, resident_per_m });
        }
        let delta1 = counts.delta1(limits.lidar_frames)?;
        let least = resident.delta1(limits.lidar_frames)? - limits.delta1_drop;
        (delta1 < least).then_some(TrialVerdict::Accuracy {
            delta1,
            frames: counts.lidar_frames,
            least,
        })
    }

    fn success(&self) -> Option<TrialVerdict> {
        let TrialCounts { ticks, metres, .. } = self.counts;
        let done = ticks >= self.limits.ticks && metres >= self.limits.metres
            || ticks >= 10 * self.limits.ticks;
        done.then_some(TrialVerdict::Keep { ticks, metres })
    }
}

/// P(N >= n) for a Poisson distribution with this mean.
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

    const GOOD: TrialTick =
        TrialTick { overrun: false, bad_output: false, trips: 0, moved_m: 0.02, delta1: Some(0.8) };

    fn resident() -> TrialCounts {
        let mut counts = TrialCounts::default();
        (0..1000)
            .for_each(|tick| counts.add(&TrialTick { trips: u64::from(tick % 200 == 0), ..GOOD }));
        counts
    }

    fn run(tick: impl Fn(u64) -> TrialTick) -> (u64, TrialVerdict) {
        let mut trial = Trial::new(TrialLimits::default(), resident());
        for index in 0.. {
            if let TrialState::Ended(verdict) = trial.observe(&tick(index)) {
                return (index + 1, verdict);
            }
        }
        unreachable!()
    }

    #[test]
    fn a_model_without_faults_is_kept_after_the_ticks_and_metres_of_the_trial() {
        assert_eq!(run(|_| GOOD).0, 600);
        assert!(run(|_| GOOD).1.keeps());
        assert_eq!(
            run(|_| TrialTick { moved_m: 0.005_001, ..GOOD }).0,
            1000,
            "5 m at 5 mm per tick"
        );
        assert_eq!(
            run(|_| TrialTick { moved_m: 0.0, ..GOOD }).0,
            6000,
            "a robot that does not move ends the trial as well"
        );
    }

    #[test]
    fn the_third_bad_output_ends_the_trial() {
        let (ticks, verdict) = run(|tick| TrialTick { bad_output: tick >= 40, ..GOOD });
        assert_eq!(ticks, 43);
        assert_eq!(verdict, TrialVerdict::BadOutput { times: 3, ticks: 43 });
    }

    #[test]
    fn late_ticks_end_the_trial_once_they_exceed_the_share_of_the_whole_trial() {
        let (ticks, verdict) = run(|tick| TrialTick { overrun: tick % 2 == 0, ..GOOD });
        assert!(
            ticks <= 30 && matches!(verdict, TrialVerdict::Overruns { .. }),
            "{ticks} {verdict}"
        );
        assert!(run(|tick| TrialTick { overrun: tick % 100 == 0, ..GOOD }).1.keeps());
    }

    #[test]
    fn a_model_with_more_trips_is_rolled_back_and_one_with_as_many_as_before_is_kept() {
        let (ticks, verdict) = run(|tick| TrialTick { trips: u64::from(tick % 20 == 19), ..GOOD });
        assert!(ticks <= 200 && matches!(verdict, TrialVerdict::Trips { .. }), "{ticks} {verdict}");
        assert!(run(|tick| TrialTick { trips: u64::from(tick % 200 == 0), ..GOOD }).1.keeps());
    }

    #[test]
    fn a_model_with_fewer_right_depths_is_rolled_back_after_the_minimum_number_of_frames() {
        let (ticks, verdict) = run(|_| TrialTick { delta1: Some(0.6), ..GOOD });
        assert_eq!(ticks, 50);
        assert!(matches!(verdict, TrialVerdict::Accuracy { .. }) && !verdict.keeps(), "{verdict}");
        assert!(run(|_| TrialTick { delta1: Some(0.72), ..GOOD }).1.keeps());
    }

    #[test]
    fn without_a_resident_model_the_depths_are_not_compared() {
        let mut trial = Trial::new(TrialLimits::default(), TrialCounts::default());
        let ended = (0..600)
            .map(|_| trial.observe(&TrialTick { delta1: Some(0.1), ..GOOD }))
            .last()
            .unwrap();
        assert!(matches!(ended, TrialState::Ended(TrialVerdict::Keep { .. })));
    }

    #[test]
    fn the_poisson_tail_matches_textbook_values() {
        assert!((poisson_tail(3, 1.0) - 0.080_301_4).abs() < 1e-6);
        assert!((poisson_tail(10, 3.0) - 0.001_102_49).abs() < 1e-6);
        assert_eq!(poisson_tail(0, 2.0), 1.0);
    }

    proptest! {
        #[test]
        fn every_trial_ends(late in 0.0..1.0f64, trips in 0..3u64, delta1 in 0.0..1.0f64, moved in 0.0..0.1f64) {
            let mut trial = Trial::new(TrialLimits::default(), resident());
            let ended = (0..6000).any(|tick| {
                let tick = TrialTick {
                    overrun: f64::from(tick % 100) < 100.0 * late, bad_output: false, trips, moved_m: moved,
                    delta1: Some(delta1),
                };
                trial.observe(&tick) != TrialState::Running
            });
            prop_assert!(ended);
        }
    }
}
