//! The verdict of the gate. A candidate is accepted only if its output is plausible without a
//! comparison, it is fast enough, and it is shown to be as good as the resident model on every
//! measure.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::{FrameScore, NearRange, Paired, PoseBin, compare, parallax_bin};

/// Limits of the gate. The operator may make them stricter than the defaults, but not looser.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct GateLimits {
    /// Minimum number of held-out frames for a comparison.
    pub min_frames: usize,
    /// Minimum number of places (pose bins) that these frames come from, so that the result is not
    /// about one place only.
    pub min_places: usize,
    /// The candidate's photometric error may exceed the resident's by this share of it.
    pub photometric_margin: f64,
    /// The candidate's mean of |d - z| / z against the LiDAR may exceed the resident's by this.
    pub abs_rel_margin: f64,
    /// The candidate's share of wrong depths against the LiDAR may exceed the resident's by this.
    pub delta1_margin: f64,
    /// The candidate's Brier score of the confidence may exceed the resident's by this.
    pub brier_margin: f64,
    /// Number of this try: one more than the models that were compared with the resident since it is kept. The bounds of every
    /// further try are wider ([`error`](Self::error)), because of many equal tries one succeeds by chance.
    pub tries: u32,
    /// Without a resident model: the minimum share of right depths against the LiDAR.
    pub least_delta1: f64,
    /// Maximum share of the obstacles that coarse depth sees and the candidate loses, as the mean over the frames
    /// of each range nearer than 2 m and of the corridor ahead. It does not depend on the resident, so that no
    /// sequence of models slides away from it.
    pub lost_near: f64,
    /// The same as the mean over the frames of the worst place.
    pub lost_at_a_place: f64,
    /// Whether a model that is shown to be worse than dense depth is refused.
    pub must_reach_dense: bool,
    /// Maximum of the 99th percentile of one inference, milliseconds.
    pub p99_ms: f64,
    /// A candidate that is slower than `p99_ms` is still accepted if its 99th percentile is at most
    /// this factor of the resident's, because the robot already runs with that one, and at most twice
    /// `p99_ms`. Both are measured alternately in the same process.
    pub p99_over_resident: f64,
}

impl Default for GateLimits {
    fn default() -> Self {
        Self {
            min_frames: 20,
            min_places: 3,
            photometric_margin: 0.05,
            abs_rel_margin: 0.03,
            delta1_margin: 0.03,
            brier_margin: 0.03,
            tries: 1,
            least_delta1: 0.3,
            lost_near: 0.05,
            lost_at_a_place: 0.25,
            must_reach_dense: false,
            p99_ms: 60.0,
            p99_over_resident: 1.1,
        }
    }
}

/// Probability that a model at the margin passes one comparison at the first try.
const FIRST_ERROR: f64 = 0.05;

impl GateLimits {
    /// Probability that a model at the margin passes a comparison at this try: 5 % at the first one, 5 % / n^2 at the n-th. Over
    /// any number of tries that is at most 5 % pi^2 / 6 = 8.2 % (alpha spending).
    #[must_use]
    pub fn error(&self) -> f64 {
        FIRST_ERROR / f64::from(self.tries.max(1)).powi(2)
    }
}

/// One held-out frame with the scores of both models.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ScoredFrame {
    /// Tick of the frame in its run.
    pub tick: u64,
    pub bin: PoseBin,
    /// Parallax to the farthest source for a point 2.5 m away, pixels.
    pub parallax_px: f64,
    /// `None` if the candidate's output was NaN or out of range.
    pub candidate: Option<FrameScore>,
    /// `None` if there is no resident model, or its output was NaN or out of range.
    pub resident: Option<FrameScore>,
    /// Dense depth without a network and without the scan; `None` where there is none.
    #[serde(default)]
    pub without_network: Option<FrameScore>,
}

/// Time of one inference, milliseconds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Latency {
    pub p50_ms: f64,
    pub p99_ms: f64,
    /// Number of timed inferences.
    pub runs: usize,
}

/// All measurements that the verdict is based on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Examination {
    /// The held-out frames in the order in which they were read.
    pub frames: Vec<ScoredFrame>,
    /// Latency of the candidate.
    pub latency: Latency,
    /// Latency of the resident model, if there is one.
    pub resident_latency: Option<Latency>,
    /// Largest difference between the candidate's output and the golden output, in the output's
    /// unit: 0..1 or metres.
    pub golden_difference: f64,
}

/// A measure that two models are compared by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Measure {
    /// Photometric error of frames in the first parallax bin.
    PhotometricNear,
    /// Photometric error of frames in the second parallax bin.
    PhotometricMiddle,
    /// Photometric error of frames in the third parallax bin.
    PhotometricFar,
    /// Mean of |d - z| / z against the LiDAR.
    AbsRel,
    /// Share of wrong depths against the LiDAR.
    Wrong,
    /// Brier score of the confidence against the LiDAR.
    Calibration,
}

impl Measure {
    const ALL: [Self; 6] = [
        Self::PhotometricNear,
        Self::PhotometricMiddle,
        Self::PhotometricFar,
        Self::AbsRel,
        Self::Wrong,
        Self::Calibration,
    ];

    /// The errors of the candidate and of `other` on a frame as (pose bin, candidate's error, error of the other); `None` if the
    /// measure does not apply to the frame or one of the scores is missing.
    fn errors(
        self,
        frame: &ScoredFrame,
        other: Option<&FrameScore>,
    ) -> Option<(PoseBin, f64, f64)> {
        let bin = parallax_bin(frame.parallax_px);
        if self.parallax_bin().is_some_and(|required| bin != required) {
            return None;
        }
        let candidate = self.error(frame.candidate.as_ref()?)?;
        Some((frame.bin, candidate, self.error(other?)?))
    }

    /// The parallax bin whose frames this measure compares; `None` if it compares all frames.
    fn parallax_bin(self) -> Option<usize> {
        match self {
            Self::PhotometricNear => Some(0),
            Self::PhotometricMiddle => Some(1),
            Self::PhotometricFar => Some(2),
            Self::AbsRel | Self::Wrong | Self::Calibration => None,
        }
    }

    fn error(self, score: &FrameScore) -> Option<f64> {
        match self {
            Self::PhotometricNear | Self::PhotometricMiddle | Self::PhotometricFar => {
                score.photometric
            }
            Self::AbsRel => Some(score.line?.abs_rel),
            Self::Wrong => Some(1.0 - score.line?.delta1),
            Self::Calibration => Some(score.line?.brier),
        }
    }

    /// The measure's name in messages.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::PhotometricNear => "photometric error, parallax below 6 px",
            Self::PhotometricMiddle => "photometric error, parallax 6 to 16 px",
            Self::PhotometricFar => "photometric error, parallax above 16 px",
            Self::AbsRel => "|d - z| / z against the LiDAR",
            Self::Wrong => "share of wrong depths against the LiDAR",
            Self::Calibration => "Brier score of the confidence against the LiDAR",
        }
    }
}

/// Why a model is refused, with the numbers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, thiserror::Error)]
#[serde(tag = "why", rename_all = "snake_case")]
#[non_exhaustive]
pub enum RefusalReason {
    /// The output was NaN or out of range on `bad` of `of` frames.
    #[error(
        "its output was NaN or out of range on {bad} of {of} held-out frames; check the training for overflow"
    )]
    BadOutput { bad: usize, of: usize },
    /// There are too few held-out frames or places for a verdict.
    #[error(
        "only {frames} held-out frames of {places} places, needed: {min_frames} of {min_places}; let the robot record more, or install with --unproven if it has no model yet"
    )]
    TooLittle { frames: usize, places: usize, min_frames: usize, min_places: usize },
    /// On frames with enough parallax, sources warped by the depth match no better than sources
    /// without a warp.
    #[error(
        "its depth explains earlier frames no better ({error:.4}) than the assumption of no motion ({unmoved:.4}); train it longer"
    )]
    NotSane { error: f64, unmoved: f64 },
    /// Without a resident model: too few depths are right against the LiDAR.
    #[error(
        "only {delta1:.3} of its depths are right against the LiDAR, minimum: {least:.3}; check units and camera height"
    )]
    NotMetric { delta1: f64, least: f64 },
    /// Obstacles near the robot, which coarse depth sees, are lost: the map would clear them.
    #[error(
        "it loses {lost:.3} of the obstacles {what}{}, allowed: {most:.3}; the map would clear what stands there. Train it on more near views",
        if *at_a_place { " at one place" } else { "" }
    )]
    LosesNear { what: NearRange, at_a_place: bool, lost: f64, most: f64 },
    /// The candidate is shown to be worse than the resident model by this measure.
    #[error(
        "worse than the resident model: {} is {:.4}, the resident's {:.4}; the difference is {:.4} to {:.4} ({:.1} %) over {} frames of {} places, allowed: {margin:.4}; train it on more of this robot's recordings",
        measure.name(), paired.candidate, paired.resident, paired.lower, paired.upper, 100.0 * paired.coverage, paired.frames, paired.places
    )]
    Worse { measure: Measure, paired: Paired, margin: f64 },
    /// The difference to the resident model may exceed the margin, but the candidate is not shown
    /// to be worse.
    #[error(
        "not shown to be as good as the resident model: {} differs by {:.4} to {:.4} ({:.1} %) over {} frames of {} places, allowed: {margin:.4}; let the robot record more places and install it again",
        measure.name(), paired.lower, paired.upper, 100.0 * paired.coverage, paired.frames, paired.places
    )]
    NotShown { measure: Measure, paired: Paired, margin: f64 },
    /// The candidate is shown to be worse than dense depth, which needs no network.
    #[error(
        "worse than dense depth, which needs no network: {} is {:.4} instead of {:.4}; the difference is {:.4} to {:.4} ({:.1} %) over {} frames of {} places; train it longer or on more recordings, or use none",
        measure.name(), paired.candidate, paired.resident, paired.lower, paired.upper, 100.0 * paired.coverage, paired.frames, paired.places
    )]
    WorseThanDense { measure: Measure, paired: Paired },
    /// Inference takes longer than allowed.
    #[error(
        "too slow: p99 {p99_ms:.1} ms on this computer, allowed: {most_ms:.1} ms; train a smaller network or give it more threads"
    )]
    TooSlow { p99_ms: f64, most_ms: f64 },
}

/// The decision of the gate, with the comparisons that it is based on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Verdict {
    /// The reasons for a refusal. Without any, the model is accepted.
    pub refused: Vec<RefusalReason>,
    pub compared: Vec<(Measure, Paired)>,
    /// The same comparisons with dense depth without a network in the place of the resident model.
    #[serde(default)]
    pub beside_dense: Vec<(Measure, Paired)>,
    /// Number of held-out frames.
    pub frames: usize,
    /// Number of pose bins that the frames come from.
    pub places: usize,
    /// Mean share of right depths against the LiDAR.
    pub delta1: Option<f64>,
    /// How many obstacles are lost near the robot, with coarse depth as evidence.
    #[serde(default)]
    pub near: Vec<NearEvidence>,
}

/// What the held-out frames say about obstacles in one range.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct NearEvidence {
    pub what: NearRange,
    /// Number of frames with enough coarse depth in this range.
    pub frames: usize,
    /// Mean share of lost obstacles over these frames; `None` when there are too few: nothing can be said.
    pub lost: Option<f64>,
    /// The largest mean over the frames of one place; `None` without a place with enough frames.
    pub worst_place: Option<f64>,
}

impl Verdict {
    #[must_use]
    pub fn is_accepted(&self) -> bool {
        self.refused.is_empty()
    }
}

/// Decides about a candidate. `unproven` allows a first model without enough held-out frames; it
/// has no effect if there is a resident model.
#[must_use]
pub fn judge(
    examination: &Examination,
    has_resident: bool,
    unproven: bool,
    limits: &GateLimits,
) -> Verdict {
    let frames = &examination.frames;
    let mut bins: Vec<PoseBin> = frames.iter().map(|frame| frame.bin).collect();
    bins.sort_unstable();
    bins.dedup();
    let count = frames.len();
    let places = bins.len();
    let mut refused = Vec::new();
    let bad = frames.iter().filter(|frame| frame.candidate.is_none()).count();
    if bad > 0 {
        refused.push(RefusalReason::BadOutput { bad, of: count });
    }
    let compared = compare_all(
        frames,
        |frame| frame.resident.filter(|_| has_resident),
        limits.error(),
        limits,
    );
    // A worse model does not become better by trying again: this bound is the same at every try.
    let beside_dense = compare_all(frames, |frame| frame.without_network, FIRST_ERROR, limits);
    let enough = count >= limits.min_frames
        && places >= limits.min_places
        && !(has_resident && compared.is_empty());
    if !enough && (has_resident || !unproven) {
        refused.push(RefusalReason::TooLittle {
            frames: count,
            places,
            min_frames: limits.min_frames,
            min_places: limits.min_places,
        });
    }
    let delta1 = mean_of(frames, |score| Some(score.line?.delta1));
    let near = NearRange::ALL.map(|what| near_evidence(frames, what)).to_vec();
    refused.extend(near.iter().flat_map(|evidence| loses_near(evidence, limits)));
    refused.extend(implausible(frames, delta1.filter(|_| !has_resident), limits));
    refused.extend(compared.iter().filter_map(|(measure, paired)| worse(*measure, paired, limits)));
    if limits.must_reach_dense {
        refused.extend(beside_dense.iter().filter_map(|(measure, paired)| {
            let (measure, paired) = (*measure, *paired);
            // NaN fails this comparison and is refused.
            let reaches = paired.lower <= 0.0;
            (!reaches).then_some(RefusalReason::WorseThanDense { measure, paired })
        }));
    }
    refused.extend(too_slow(examination, limits));
    Verdict { refused, compared, beside_dense, frames: count, places, delta1, near }
}

/// Frames with near coarse depth from which on a range is judged.
const LEAST_NEAR_FRAMES: usize = 5;
/// A place with at least this number of frames counts as a place of its own.
const LEAST_PLACE_FRAMES: usize = 3;

fn near_evidence(frames: &[ScoredFrame], what: NearRange) -> NearEvidence {
    let mut lost: BTreeMap<PoseBin, Vec<f64>> = BTreeMap::new();
    for frame in frames {
        if let Some(share) = frame.candidate.as_ref().and_then(|score| score.lost.at(what)) {
            lost.entry(frame.bin).or_default().push(share);
        }
    }
    let all: Vec<f64> = lost.values().flatten().copied().collect();
    let places = lost.values().filter(|values| values.len() >= LEAST_PLACE_FRAMES);
    NearEvidence {
        what,
        frames: all.len(),
        lost: (all.len() >= LEAST_NEAR_FRAMES).then(|| mean(&all)),
        worst_place: places.map(|values| mean(values)).max_by(f64::total_cmp),
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

fn loses_near(evidence: &NearEvidence, limits: &GateLimits) -> Vec<RefusalReason> {
    let NearEvidence { what, lost, worst_place, .. } = *evidence;
    let judged = [(lost, limits.lost_near, false), (worst_place, limits.lost_at_a_place, true)];
    let too_many = judged.into_iter().filter_map(|(lost, most, at_a_place)| {
        let lost = lost?;
        // NaN fails this comparison and is refused.
        let few = lost <= most;
        (!few).then_some(RefusalReason::LosesNear { what, at_a_place, lost, most })
    });
    too_many.collect()
}

fn mean_of(frames: &[ScoredFrame], value: impl Fn(&FrameScore) -> Option<f64>) -> Option<f64> {
    let values: Vec<f64> =
        frames.iter().filter_map(|frame| value(frame.candidate.as_ref()?)).collect();
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Reasons for a refusal that need no comparison with a resident model.
fn implausible(
    frames: &[ScoredFrame],
    delta1: Option<f64>,
    limits: &GateLimits,
) -> Vec<RefusalReason> {
    let mut reasons = Vec::new();
    let with_parallax: Vec<ScoredFrame> =
        frames.iter().filter(|frame| parallax_bin(frame.parallax_px) > 0).copied().collect();
    if let Some(error) = mean_of(&with_parallax, |score| score.photometric)
        && let Some(unmoved) = mean_of(&with_parallax, |score| score.unmoved)
        && error >= unmoved
    {
        reasons.push(RefusalReason::NotSane { error, unmoved });
    }
    if let Some(delta1) = delta1.filter(|delta1| *delta1 < limits.least_delta1) {
        reasons.push(RefusalReason::NotMetric { delta1, least: limits.least_delta1 });
    }
    reasons
}

/// Compares the candidate with the scores of `other` by every measure for which there are enough frames: with few frames, a
/// comparison would refuse good models as often as bad ones.
fn compare_all(
    frames: &[ScoredFrame],
    other: impl Fn(&ScoredFrame) -> Option<FrameScore>,
    error: f64,
    limits: &GateLimits,
) -> Vec<(Measure, Paired)> {
    Measure::ALL
        .into_iter()
        .filter_map(|measure| {
            let errors: Vec<(PoseBin, f64, f64)> = frames
                .iter()
                .filter_map(|frame| measure.errors(frame, other(frame).as_ref()))
                .collect();
            let paired = compare(&errors, error)?;
            let enough = paired.frames >= limits.min_frames && paired.places >= limits.min_places;
            enough.then_some((measure, paired))
        })
        .collect()
}

fn worse(measure: Measure, paired: &Paired, limits: &GateLimits) -> Option<RefusalReason> {
    let margin = match measure {
        Measure::PhotometricNear | Measure::PhotometricMiddle | Measure::PhotometricFar => {
            limits.photometric_margin * paired.resident
        }
        Measure::AbsRel => limits.abs_rel_margin,
        Measure::Wrong => limits.delta1_margin,
        Measure::Calibration => limits.brier_margin,
    };
    let paired = *paired;
    // NaN fails this comparison and is refused.
    if paired.upper <= margin {
        None
    } else if paired.lower > 0.0 {
        Some(RefusalReason::Worse { measure, paired, margin })
    } else {
        Some(RefusalReason::NotShown { measure, paired, margin })
    }
}

/// However slow the resident is, a candidate may take at most this many times the limit: with a factor of the
/// resident's time alone, a sequence of models could become slower without end.
const MOST_SLOWER: f64 = 2.0;

fn too_slow(examination: &Examination, limits: &GateLimits) -> Option<RefusalReason> {
    let resident_limit_ms = examination
        .resident_latency
        .map_or(0.0, |latency| latency.p99_ms * limits.p99_over_resident)
        .min(MOST_SLOWER * limits.p99_ms);
    let most_ms = limits.p99_ms.max(resident_limit_ms);
    let p99_ms = examination.latency.p99_ms;
    // NaN fails this comparison and is refused.
    if p99_ms <= most_ms { None } else { Some(RefusalReason::TooSlow { p99_ms, most_ms }) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model_gate::{LidarScore, LostShares};

    /// The score of a model whose errors are those of an average model times `factor`.
    fn score(factor: f64, noise: f64) -> FrameScore {
        FrameScore {
            photometric: Some(0.1 * factor + noise),
            unmoved: Some(0.3),
            line: Some(LidarScore {
                points: 100,
                abs_rel: 0.1 * factor + noise,
                delta1: 1.0 - 0.15 * factor - noise,
                brier: 0.1 * factor,
            }),
            lost: LostShares::default(),
        }
    }

    /// An examination on frames of 10 places with these factors of both models' errors.
    fn scored(candidate: f64, resident: Option<f64>) -> Examination {
        let frames = (0..60).map(|tick| {
            let noise = 0.002 * (tick % 7) as f64;
            ScoredFrame {
                tick,
                bin: PoseBin { x: tick as i64 / 6, y: 0, sector: 0 },
                parallax_px: (tick % 3) as f64 * 10.0,
                candidate: Some(score(candidate, noise)),
                resident: resident.map(|factor| score(factor, 0.01 - noise)),
                without_network: None,
            }
        });
        let latency = Latency { p50_ms: 5.0, p99_ms: 8.0, runs: 100 };
        let resident_latency = resident.map(|_| latency);
        Examination { frames: frames.collect(), latency, resident_latency, golden_difference: 0.0 }
    }

    fn why(examination: &Examination, has_resident: bool) -> Vec<RefusalReason> {
        judge(examination, has_resident, false, &GateLimits::default()).refused
    }

    #[test]
    fn a_better_and_an_equal_model_are_accepted() {
        assert_eq!(why(&scored(0.7, Some(1.0)), true), []);
        assert_eq!(why(&scored(1.0, Some(1.0)), true), []);
        let verdict = judge(&scored(0.7, Some(1.0)), true, false, &GateLimits::default());
        assert_eq!((verdict.compared.len(), verdict.places, verdict.frames), (6, 10, 60));
    }

    #[test]
    fn a_worse_model_is_refused_by_every_measure_with_its_numbers() {
        let refused = why(&scored(1.5, Some(1.0)), true);
        assert_eq!(refused.len(), 6, "{refused:?}");
        assert!(
            refused.iter().all(|why| matches!(why, RefusalReason::Worse { .. })),
            "{refused:?}"
        );
        let text = refused[3].to_string();
        assert!(
            text.contains("|d - z| / z")
                && text.contains("0.15")
                && text.contains("60 frames of 10"),
            "{text}"
        );
    }

    #[test]
    fn one_measure_that_is_worse_is_enough() {
        let mut examination = scored(0.7, Some(1.0));
        for frame in &mut examination.frames {
            frame.candidate.as_mut().unwrap().line.as_mut().unwrap().brier = 0.2;
        }
        assert!(matches!(
            why(&examination, true)[..],
            [RefusalReason::Worse { measure: Measure::Calibration, .. }]
        ));
    }

    #[test]
    fn a_difference_that_may_be_chance_is_not_enough_to_accept_a_model() {
        let mut examination = scored(1.0, Some(1.0));
        for frame in &mut examination.frames {
            let line = frame.candidate.as_mut().unwrap().line.as_mut().unwrap();
            line.abs_rel += if frame.bin.x % 2 == 0 { 0.15 } else { -0.15 };
        }
        assert!(matches!(
            why(&examination, true)[..],
            [RefusalReason::NotShown { measure: Measure::AbsRel, .. }]
        ));
    }

    #[test]
    fn each_further_try_needs_a_clearer_result_and_all_tries_together_err_in_less_than_a_tenth() {
        let mut examination = scored(1.0, Some(1.0));
        for frame in &mut examination.frames {
            frame.resident = frame.candidate;
            let line = frame.candidate.as_mut().unwrap().line.as_mut().unwrap();
            line.abs_rel += if frame.bin.x % 2 == 0 { 0.03 } else { -0.03 };
        }
        assert!(at_try(&examination, 1).is_accepted());
        let refused = at_try(&examination, 8).refused;
        assert!(
            matches!(refused[..], [RefusalReason::NotShown { measure: Measure::AbsRel, .. }]),
            "{refused:?}"
        );
        assert!(refused[0].to_string().contains("(99.8 %)"), "{}", refused[0]);
        let all: f64 =
            (1..10_000).map(|tries| GateLimits { tries, ..GateLimits::default() }.error()).sum();
        assert!(all < 0.1, "{all}");
    }

    fn at_try(examination: &Examination, tries: u32) -> Verdict {
        judge(examination, true, false, &GateLimits { tries, ..GateLimits::default() })
    }

    #[test]
    fn nan_output_is_refused_whatever_the_other_scores_are() {
        let mut examination = scored(0.5, Some(1.0));
        examination.frames[17].candidate = None;
        assert_eq!(why(&examination, true), [RefusalReason::BadOutput { bad: 1, of: 60 }]);
        let mut nan = scored(0.5, Some(1.0));
        nan.frames[0].candidate.as_mut().unwrap().photometric = Some(f64::NAN);
        assert!(!why(&nan, true).is_empty());
    }

    #[test]
    fn too_few_frames_refuse_a_model_unless_it_is_the_first_and_marked_unproven() {
        let mut examination = scored(0.5, None);
        examination.frames.truncate(15);
        assert!(matches!(
            why(&examination, false)[..],
            [RefusalReason::TooLittle { frames: 15, places: 3, .. }]
        ));
        assert!(judge(&examination, false, true, &GateLimits::default()).is_accepted());
        assert!(!judge(&examination, true, true, &GateLimits::default()).is_accepted());
    }

    #[test]
    fn a_measure_with_too_few_frames_decides_nothing() {
        let mut examination = scored(0.7, Some(1.0));
        for frame in examination
            .frames
            .iter_mut()
            .filter(|frame| parallax_bin(frame.parallax_px) == 2)
            .skip(10)
        {
            frame.parallax_px = 0.0;
        }
        for frame in
            examination.frames.iter_mut().filter(|frame| parallax_bin(frame.parallax_px) == 2)
        {
            frame.candidate.as_mut().unwrap().photometric = Some(0.25);
        }
        let verdict = judge(&examination, true, false, &GateLimits::default());
        assert_eq!(
            (verdict.refused.len(), verdict.compared.len()),
            (0, 5),
            "{:?}",
            verdict.refused
        );
    }

    #[test]
    fn a_first_model_must_match_earlier_frames_and_be_metric() {
        assert_eq!(why(&scored(1.0, None), false), []);
        let mut blind = scored(1.0, None);
        for frame in &mut blind.frames {
            frame.candidate.as_mut().unwrap().photometric = Some(0.31);
        }
        assert!(matches!(why(&blind, false)[..], [RefusalReason::NotSane { .. }]));
        assert!(matches!(
            why(&scored(5.0, None), false)[..],
            [RefusalReason::NotSane { .. }, RefusalReason::NotMetric { .. }]
        ));
    }

    #[test]
    fn a_slow_model_is_refused_unless_the_resident_one_is_as_slow() {
        let mut examination = scored(1.0, Some(1.0));
        examination.latency.p99_ms = 90.0;
        assert_eq!(
            why(&examination, true),
            [RefusalReason::TooSlow { p99_ms: 90.0, most_ms: 60.0 }]
        );
        examination.resident_latency.as_mut().unwrap().p99_ms = 85.0;
        assert_eq!(why(&examination, true), []);
        examination.latency.p99_ms = f64::NAN;
        assert!(!why(&examination, true).is_empty());
    }

    /// Ten places, 60 frames, with near obstacles of which these shares are lost at each place.
    fn with_lost(lost: impl Fn(i64) -> f64) -> Examination {
        let mut examination = scored(0.7, Some(1.0));
        for frame in &mut examination.frames {
            let share = Some(lost(frame.bin.x));
            let shares = &mut frame.candidate.as_mut().unwrap().lost;
            *shares = LostShares { second: share, corridor: share, ..*shares };
        }
        examination
    }

    #[test]
    fn a_model_that_loses_near_obstacles_is_refused_however_good_it_is_otherwise() {
        assert_eq!(why(&with_lost(|_| 0.04), true), []);
        let refused = why(&with_lost(|_| 0.06), true);
        assert!(
            matches!(
                refused[..],
                [
                    RefusalReason::LosesNear { what: NearRange::Second, at_a_place: false, .. },
                    RefusalReason::LosesNear { what: NearRange::Corridor, at_a_place: false, .. }
                ]
            ),
            "{refused:?}"
        );
        assert!(refused[0].to_string().contains("loses 0.060 of the obstacles at 1 to 2 m"));
        assert!(!why(&with_lost(|_| f64::NAN), true).is_empty());
    }

    #[test]
    fn a_model_that_fails_at_one_place_of_ten_is_refused_although_its_mean_is_low() {
        let refused = why(&with_lost(|place| if place == 3 { 0.4 } else { 0.0 }), true);
        assert!(
            refused
                .iter()
                .all(|why| matches!(why, RefusalReason::LosesNear { at_a_place: true, .. })),
            "{refused:?}"
        );
        assert!(refused[0].to_string().contains("at one place"), "{}", refused[0]);
    }

    #[test]
    fn a_model_that_is_worse_than_dense_depth_is_named_and_refused_where_the_operator_asks_for_that()
     {
        let mut examination = scored(1.2, None);
        for frame in &mut examination.frames {
            frame.without_network = Some(score(1.0, 0.001));
        }
        let verdict = judge(&examination, false, false, &GateLimits::default());
        assert_eq!((verdict.refused.len(), verdict.beside_dense.len()), (0, 6));
        let strict = GateLimits { must_reach_dense: true, ..GateLimits::default() };
        let refused = judge(&examination, false, false, &strict).refused;
        assert!(matches!(refused[0], RefusalReason::WorseThanDense { .. }), "{refused:?}");
        assert!(refused[0].to_string().contains("needs no network"), "{}", refused[0]);
        for frame in &mut examination.frames {
            frame.candidate = frame.without_network;
        }
        assert_eq!(judge(&examination, false, false, &strict).refused, []);
    }

    #[test]
    fn a_range_without_evidence_is_named_and_not_judged() {
        let verdict = judge(&with_lost(|_| 0.0), true, false, &GateLimits::default());
        let lost: Vec<_> =
            verdict.near.iter().map(|evidence| (evidence.frames, evidence.lost)).collect();
        assert_eq!(lost, [(0, None), (60, Some(0.0)), (60, Some(0.0))]);
    }

    #[test]
    fn the_limit_of_lost_obstacles_does_not_slide_with_the_resident() {
        // The resident loses as many.
        let mut examination = with_lost(|_| 0.06);
        for frame in &mut examination.frames {
            frame.resident = frame.candidate;
        }
        assert_eq!(why(&examination, true).len(), 2);
    }

    #[test]
    fn a_sequence_of_slow_models_ends_at_twice_the_limit() {
        let mut examination = scored(1.0, Some(1.0));
        examination.latency.p99_ms = 125.0;
        examination.resident_latency.as_mut().unwrap().p99_ms = 119.0;
        assert_eq!(
            why(&examination, true),
            [RefusalReason::TooSlow { p99_ms: 125.0, most_ms: 120.0 }]
        );
    }

    #[test]
    fn a_verdict_survives_a_round_trip_through_json() {
        let verdict = judge(&scored(1.5, Some(1.0)), true, false, &GateLimits::default());
        let text = serde_json::to_string(&verdict).unwrap();
        assert_eq!(serde_json::from_str::<Verdict>(&text).unwrap(), verdict);
    }
}
