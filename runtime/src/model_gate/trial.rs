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
//! - the share of right depths against the LiDAR, over `lidar_frames` frames of a moving robot, is
//!   below `least_delta1`, or lower than the resident's by more than `delta1_drop`;
//! - that share is below `nonsense_delta1` over as many frames of any kind. A robot that stands sees
//!   one scene, so only depth that is nearly always wrong counts there;
//! - over `near_frames` frames of a moving robot it misses near obstacles that coarse depth sees: a
//!   share of more than `lost_near`, or more than the resident's share by `lost_near_rise`.
//!
//! It is kept after `metres` metres and `ticks` ticks of plans that moved the robot, and not before
//! its accuracy was measured over `lidar_frames` of them. Standing, motion without a plan and a robot
//! that is carried never count, so a model that never drives stays on trial.

use serde::{Deserialize, Serialize};

/// Limits of the trial.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TrialLimits {
    /// Minimum number of ticks in which a plan moved the robot before the model is kept.
    pub ticks: u64,
    /// Minimum distance that plans drove before the model is kept, metres.
    pub metres: f64,
    /// The model is rolled back after this many outputs that are NaN or out of range.
    pub bad_outputs: u64,
    /// The share of late ticks may exceed the resident's share by this.
    pub overrun_share: f64,
    /// Trips per metre that are accepted even if the resident model had fewer.
    pub least_trips_per_m: f64,
    /// The share of right depths against the LiDAR may fall below the resident's by this.
    pub delta1_drop: f64,
    /// Minimum share of right depths against the LiDAR while the robot moves, whatever the
    /// resident's was.
    pub least_delta1: f64,
    /// The same for all frames, those of a robot that stands included.
    pub nonsense_delta1: f64,
    /// Minimum number of frames with LiDAR pixels before the share of right depths is compared.
    pub lidar_frames: u64,
    /// Maximum share of near obstacles that the model misses.
    pub lost_near: f64,
    /// This share may exceed the resident's by this.
    pub lost_near_rise: f64,
    /// Minimum number of frames with near obstacles before this share is compared.
    pub near_frames: u64,
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
            least_delta1: 0.3,
            nonsense_delta1: 0.1,
            lidar_frames: 50,
            lost_near: 0.3,
            lost_near_rise: 0.1,
            near_frames: 50,
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
    /// A plan moved the robot: it is armed, the safety plane is not in charge, and the command that
    /// was sent is not zero.
    pub moving: bool,
    /// Distance driven since the previous tick, metres. It counts only with `moving`.
    pub moved_m: f64,
    /// Share of right depths against the LiDAR; `None` without LiDAR pixels.
    pub delta1: Option<f64>,
    /// Share of lost obstacles nearer than 2 m ([`LostShares::near`](super::LostShares)); `None`
    /// without any.
    pub lost_near: Option<f64>,
}

/// Counts of what happened while one model drove the robot. They are kept on disk between runs.
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
    /// Number of ticks in which a plan moved the robot.
    pub moving_ticks: u64,
    /// Distance that plans drove, metres.
    pub metres: f64,
    /// Accuracy against the LiDAR over the frames of a moving robot.
    pub moving: FrameMean,
    /// The same over all frames.
    pub all: FrameMean,
    /// Share of near obstacles that were missed, over the frames of a moving robot.
    pub lost_near: FrameMean,
}

/// A mean over frames that grows frame by frame.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct FrameMean {
    pub frames: u64,
    /// Sum of the frames' values.
    pub sum: f64,
}

impl FrameMean {
    fn add(&mut self, value: Option<f64>) {
        if let Some(value) = value {
            self.frames += 1;
            self.sum += value;
        }
    }

    fn halve(&mut self) {
        self.frames /= 2;
        self.sum /= 2.0;
    }

    /// The mean; `None` with fewer than `least` frames.
    #[must_use]
    pub fn mean(&self, least: u64) -> Option<f64> {
        (self.frames >= least.max(1)).then(|| self.sum / self.frames as f64)
    }
}

impl TrialCounts {
    /// Counts one tick.
    pub fn add(&mut self, tick: &TrialTick) {
        self.ticks += 1;
        self.overruns += u64::from(tick.overrun);
        self.bad_outputs += u64::from(tick.bad_output);
        self.trips += tick.trips;
        self.all.add(tick.delta1);
        if tick.moving {
            self.moving_ticks += 1;
            self.metres += tick.moved_m;
            self.moving.add(tick.delta1);
            self.lost_near.add(tick.lost_near);
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
                &mut self.moving_ticks,
            ] {
                *count /= 2;
            }
            for mean in [&mut self.moving, &mut self.all, &mut self.lost_near] {
                mean.halve();
            }
            self.metres /= 2.0;
        }
        self.add(tick);
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
    /// The model is kept. `ticks` are those in which a plan moved the robot.
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
    /// Too many near obstacles were missed.
    #[error(
        "rolled back: it missed {lost:.3} of the near obstacles over {frames} frames, maximum: {most:.3}"
    )]
    LostNear { lost: f64, frames: u64, most: f64 },
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
    /// `counts` are those of the same trial before a restart.
    #[must_use]
    pub fn new(limits: TrialLimits, resident: TrialCounts, counts: TrialCounts) -> Self {
        Self { limits, resident, counts }
    }

    #[must_use]
    pub fn counts(&self) -> &TrialCounts {
        &self.counts
    }

    #[must_use]
    pub fn resident(&self) -> &TrialCounts {
        &self.resident
    }

    /// Counts a tick and decides whether the trial has ended.
    pub fn observe(&mut self, tick: &TrialTick) -> TrialState {
        self.counts.add(tick);
        self.fault()
            .or_else(|| self.wrong_depth())
            .or_else(|| self.lost_near())
            .or_else(|| self.success())
            .map_or(TrialState::Running, TrialState::Ended)
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
        let is_explained = counts.trips < 3 || poisson_tail(counts.trips, expected) >= 0.01;
        (!is_explained).then(|| TrialVerdict::Trips {
            trips: counts.trips,
            metres,
            resident_per_m: resident.trips_per_m(),
        })
    }

    fn wrong_depth(&self) -> Option<TrialVerdict> {
        let Self { limits, resident, counts } = self;
        let resident = resident.moving.mean(limits.lidar_frames).unwrap_or(0.0);
        let least = (resident - limits.delta1_drop).max(limits.least_delta1);
        [(counts.moving, least), (counts.all, limits.nonsense_delta1)].into_iter().find_map(
            |(measured, least)| {
                let delta1 = measured.mean(limits.lidar_frames)?;
                let frames = measured.frames;
                // NaN fails this comparison and ends the trial.
                let enough = delta1 >= least;
                (!enough).then_some(TrialVerdict::Accuracy { delta1, frames, least })
            },
        )
    }

    fn lost_near(&self) -> Option<TrialVerdict> {
        let Self { limits, resident, counts } = self;
        let lost = counts.lost_near.mean(limits.near_frames)?;
        let resident = resident.lost_near.mean(limits.near_frames).unwrap_or(f64::INFINITY);
        let most = (resident + limits.lost_near_rise).min(limits.lost_near);
        let few = lost <= most;
        let frames = counts.lost_near.frames;
        (!few).then_some(TrialVerdict::LostNear { lost, frames, most })
    }

    fn success(&self) -> Option<TrialVerdict> {
        let Self { limits, counts, .. } = self;
        let TrialCounts { moving_ticks: ticks, metres, .. } = *counts;
        let done = ticks >= limits.ticks
            && metres >= limits.metres
            && counts.moving.frames >= limits.lidar_frames;
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

    const GOOD: TrialTick = TrialTick {
        overrun: false,
        bad_output: false,
        trips: 0,
        moving: true,
        moved_m: 0.02,
        delta1: Some(0.8),
        lost_near: Some(0.02),
    };
    const STANDING: TrialTick = TrialTick { moving: false, moved_m: 0.0, ..GOOD };

    fn resident() -> TrialCounts {
        let mut counts = TrialCounts::default();
        (0..1000)
            .for_each(|tick| counts.add(&TrialTick { trips: u64::from(tick % 200 == 0), ..GOOD }));
        counts
    }

    fn trial() -> Trial {
        Trial::new(TrialLimits::default(), resident(), TrialCounts::default())
    }

    /// The number of ticks after which the trial ends, and how; `None` if it still runs after an
    /// hour.
    fn end_of(mut trial: Trial, tick: impl Fn(u64) -> TrialTick) -> Option<(u64, TrialVerdict)> {
        (0..36_000).find_map(|index| match trial.observe(&tick(index)) {
            TrialState::Ended(verdict) => Some((index + 1, verdict)),
            TrialState::Running => None,
        })
    }

    fn run(tick: impl Fn(u64) -> TrialTick) -> (u64, TrialVerdict) {
        end_of(trial(), tick).unwrap()
    }

    #[test]
    fn a_model_without_faults_is_kept_after_the_ticks_and_metres_of_the_trial() {
        assert_eq!(run(|_| GOOD), (600, TrialVerdict::Keep { ticks: 600, metres: run_metres() }));
        assert_eq!(
            run(|_| TrialTick { moved_m: 0.005_001, ..GOOD }).0,
            1000,
            "5 m at 5 mm per tick"
        );
    }

    /// The sum of 600 steps of 0.02 m, with its rounding.
    fn run_metres() -> f64 {
        (0..600).map(|_| 0.02).sum()
    }

    #[test]
    fn a_model_is_never_kept_by_standing_by_rotating_or_by_being_carried() {
        assert_eq!(end_of(trial(), |_| STANDING), None);
        assert_eq!(end_of(trial(), |_| TrialTick { moved_m: 0.0, ..GOOD }), None);
        // A person pushes the disarmed robot.
        assert_eq!(end_of(trial(), |_| TrialTick { moved_m: 0.05, ..STANDING }), None);
        // Every second tick stands: only the others count.
        assert_eq!(run(|tick| if tick % 2 == 0 { GOOD } else { STANDING }).0, 1199);
    }

    #[test]
    fn a_model_whose_accuracy_was_never_measured_is_not_kept() {
        assert_eq!(end_of(trial(), |_| TrialTick { delta1: None, ..GOOD }), None);
    }

    #[test]
    fn a_model_whose_depth_is_never_right_is_rolled_back_while_the_robot_stands() {
        for resident in [resident(), TrialCounts::default()] {
            let trial = Trial::new(TrialLimits::default(), resident, TrialCounts::default());
            let (ticks, verdict) =
                end_of(trial, |_| TrialTick { delta1: Some(0.0), ..STANDING }).unwrap();
            assert!(matches!(verdict, TrialVerdict::Accuracy { .. }), "{verdict}");
            assert_eq!(ticks, 50);
        }
    }

    #[test]
    fn a_trial_continues_after_a_restart_with_the_counts_from_before_it() {
        let mut first = trial();
        assert!((0..400).all(|_| first.observe(&GOOD) == TrialState::Running));
        let second = Trial::new(TrialLimits::default(), resident(), *first.counts());
        assert_eq!(end_of(second, |_| GOOD).unwrap().0, 200);
        // Accuracy is compared with that of the resident from before the restart.
        let mut first = trial();
        let worse = TrialTick { delta1: Some(0.6), ..GOOD };
        assert!((0..49).all(|_| first.observe(&worse) == TrialState::Running));
        let second = Trial::new(TrialLimits::default(), *first.resident(), *first.counts());
        let (ticks, verdict) = end_of(second, |_| TrialTick { delta1: Some(0.6), ..GOOD }).unwrap();
        assert!(ticks == 1 && matches!(verdict, TrialVerdict::Accuracy { .. }), "{verdict}");
    }

    #[test]
    fn a_model_that_misses_near_obstacles_is_rolled_back() {
        let (ticks, verdict) = run(|_| TrialTick { lost_near: Some(0.2), ..GOOD });
        assert_eq!(ticks, 50);
        assert!(matches!(verdict, TrialVerdict::LostNear { .. }), "{verdict}");
        assert!(run(|_| TrialTick { lost_near: Some(0.1), ..GOOD }).1.keeps());
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
        let nan = run(|_| TrialTick { delta1: Some(f64::NAN), ..GOOD }).1;
        assert!(matches!(nan, TrialVerdict::Accuracy { .. }), "{nan}");
    }

    #[test]
    fn without_a_resident_model_the_absolute_limits_hold() {
        assert!(end_of_first(0.35, 0.25).keeps());
        assert!(matches!(end_of_first(0.25, 0.25), TrialVerdict::Accuracy { .. }));
        assert!(matches!(end_of_first(0.35, 0.35), TrialVerdict::LostNear { .. }));
    }

    fn end_of_first(delta1: f64, lost_near: f64) -> TrialVerdict {
        let first =
            Trial::new(TrialLimits::default(), TrialCounts::default(), TrialCounts::default());
        let tick = TrialTick { delta1: Some(delta1), lost_near: Some(lost_near), ..GOOD };
        end_of(first, |_| tick).unwrap().1
    }

    #[test]
    fn the_poisson_tail_matches_textbook_values() {
        assert!((poisson_tail(3, 1.0) - 0.080_301_4).abs() < 1e-6);
        assert!((poisson_tail(10, 3.0) - 0.001_102_49).abs() < 1e-6);
        assert_eq!(poisson_tail(0, 2.0), 1.0);
    }

    proptest! {
        #[test]
        fn every_trial_of_a_robot_that_drives_ends(
            late in 0.0..1.0f64, trips in 0..3u64, delta1 in 0.0..1.0f64, lost in 0.0..1.0f64,
            moved in 0.001..0.1f64,
        ) {
            let ended = end_of(trial(), |tick| TrialTick {
                overrun: (tick % 100) as f64 / 100.0 < late, trips, moved_m: moved,
                delta1: Some(delta1), lost_near: Some(lost), ..GOOD
            });
            prop_assert!(ended.is_some());
        }

        #[test]
        fn no_trial_ends_well_before_plans_have_driven_its_metres(
            moving in prop::collection::vec(any::<bool>(), 1..40), moved in 0.0..0.2f64,
        ) {
            let mut driven = 0.0;
            let mut trial = trial();
            for moving in moving.into_iter().cycle().take(3000) {
                let state = trial.observe(&TrialTick { moving, moved_m: moved, ..GOOD });
                driven += if moving { moved } else { 0.0 };
                if let TrialState::Ended(verdict) = state {
                    prop_assert!(!verdict.keeps() || driven >= TrialLimits::default().metres);
                    break;
                }
            }
        }
    }
}
