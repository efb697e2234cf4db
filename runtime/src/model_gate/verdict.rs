//! Is the candidate taken? Only when it is sane by itself, fast enough, and shown to be as good as the resident model on every
//! measure there is.

use serde::{Deserialize, Serialize};

use super::{FrameScore, Paired, PoseBin, compare, parallax_bin};

/// What the gate asks for. Each number is a limit that the default states and the operator may not loosen.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct GateLimits {
    /// Held-out pictures that a comparison needs.
    pub min_pictures: usize,
    /// Places (pose bins) that they must come from: fewer say too little about homes.
    pub min_places: usize,
    /// A photometric error may be larger by this share of the resident's.
    pub photometric_margin: f64,
    /// The mean of |d - z| / z on the LiDAR line may be larger by this.
    pub abs_rel_margin: f64,
    /// The share of wrong depths on the LiDAR line may be larger by this.
    pub delta1_margin: f64,
    /// The Brier score of the confidence may be larger by this.
    pub brier_margin: f64,
    /// Without a resident model, the least share of right depths on the LiDAR line.
    pub least_delta1: f64,
    /// 99th percentile of one inference, milliseconds.
    pub p99_ms: f64,
    /// A candidate above `p99_ms` is still taken when it is at most this many times as slow as the resident model, measured
    /// by turns in the same process: the robot lives with that one.
    pub p99_over_resident: f64,
}

impl Default for GateLimits {
    fn default() -> Self {
        Self {
            min_pictures: 20,
            min_places: 3,
            photometric_margin: 0.05,
            abs_rel_margin: 0.03,
            delta1_margin: 0.03,
            brier_margin: 0.03,
            least_delta1: 0.3,
            p99_ms: 60.0,
            p99_over_resident: 1.1,
        }
    }
}

/// One held-out picture and how both models did on it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ScoredFrame {
    /// Turn of its run.
    pub tick: u64,
    /// Where it was taken.
    pub bin: PoseBin,
    /// To the farthest source, pixels of something 2.5 m away.
    pub parallax_px: f64,
    /// `None`: the candidate's output was NaN or out of range.
    pub candidate: Option<FrameScore>,
    /// `None`: no resident model, or its output was worthless.
    pub resident: Option<FrameScore>,
}

/// Time of one inference, milliseconds.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Latency {
    /// Half are faster.
    pub p50_ms: f64,
    /// One in a hundred is slower.
    pub p99_ms: f64,
    /// Inferences that were timed.
    pub runs: usize,
}

/// Everything that was measured.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Examination {
    /// Held-out pictures, in the order in which they were read.
    pub frames: Vec<ScoredFrame>,
    /// Of the candidate.
    pub latency: Latency,
    /// Of the resident model, if there is one.
    pub resident_latency: Option<Latency>,
    /// Largest difference from the golden output, of x in 0..1 or metres.
    pub golden_difference: f64,
}

/// What two models are compared by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Measure {
    /// Photometric error with little parallax.
    PhotometricNear,
    /// Photometric error with some parallax.
    PhotometricMiddle,
    /// Photometric error with much parallax.
    PhotometricFar,
    /// |d - z| / z on the LiDAR line.
    AbsRel,
    /// Share of wrong depths on the LiDAR line.
    Wrong,
    /// Brier score of the confidence on the LiDAR line.
    Calibration,
}

impl Measure {
    const PHOTOMETRIC: [Self; 3] =
        [Self::PhotometricNear, Self::PhotometricMiddle, Self::PhotometricFar];

    /// In words.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::PhotometricNear => "photometric error, parallax below 6 px",
            Self::PhotometricMiddle => "photometric error, parallax 6 to 16 px",
            Self::PhotometricFar => "photometric error, parallax above 16 px",
            Self::AbsRel => "|d - z| / z on the LiDAR line",
            Self::Wrong => "share of wrong depths on the LiDAR line",
            Self::Calibration => "Brier score of the confidence on the LiDAR line",
        }
    }
}

/// Why a model is refused, with the numbers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, thiserror::Error)]
#[serde(tag = "why", rename_all = "snake_case")]
#[non_exhaustive]
pub enum Why {
    /// NaN or out of range.
    #[error(
        "its output was NaN or out of range on {pictures} of {of} held-out pictures; look for overflow in training"
    )]
    BadOutput {
        /// On so many.
        pictures: usize,
        /// Of so many.
        of: usize,
    },
    /// Not enough to judge by.
    #[error(
        "only {pictures} held-out pictures of {places} places, needed: {min_pictures} of {min_places}; let the robot record more, or install with --unproven if it has no model yet"
    )]
    TooLittle {
        /// Pictures.
        pictures: usize,
        /// Places.
        places: usize,
        /// Wanted.
        min_pictures: usize,
        /// Wanted.
        min_places: usize,
    },
    /// Depth that explains nothing.
    #[error(
        "its depth explains earlier pictures no better ({error:.4}) than not moving at all ({unmoved:.4}); train it longer"
    )]
    NotSane {
        /// Photometric error where parallax is large enough to show.
        error: f64,
        /// Of unmoved pictures.
        unmoved: f64,
    },
    /// Depth that is wrong by itself.
    #[error(
        "only {delta1:.3} of its depths on the LiDAR line are right, least: {least:.3}; check units and camera height"
    )]
    NotMetric {
        /// Share of right depths.
        delta1: f64,
        /// Least.
        least: f64,
    },
    /// Worse than the resident model.
    #[error(
        "worse than the resident model: {} is {:.4}, the resident's {:.4}; the difference is {:.4} to {:.4} (90 %) over {} pictures of {} places, allowed: {margin:.4}; train it on more of this robot's recordings",
        measure.name(), paired.candidate, paired.resident, paired.lower, paired.upper, paired.pictures, paired.places
    )]
    Worse {
        /// By what.
        measure: Measure,
        /// The numbers.
        paired: Paired,
        /// Allowed.
        margin: f64,
    },
    /// Perhaps as good, perhaps not.
    #[error(
        "not shown to be as good as the resident model: {} differs by {:.4} to {:.4} (90 %) over {} pictures of {} places, allowed: {margin:.4}; let the robot record more places and install it again",
        measure.name(), paired.lower, paired.upper, paired.pictures, paired.places
    )]
    NotShown {
        /// By what.
        measure: Measure,
        /// The numbers.
        paired: Paired,
        /// Allowed.
        margin: f64,
    },
    /// Too slow.
    #[error(
        "too slow: p99 {p99_ms:.1} ms on this computer, allowed: {most_ms:.1} ms; train a smaller network or give it more threads"
    )]
    TooSlow {
        /// Measured.
        p99_ms: f64,
        /// Allowed.
        most_ms: f64,
    },
}

/// What the gate decided, and by which comparisons.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Verdict {
    /// Why not; none: it is taken.
    pub refused: Vec<Why>,
    /// What was compared.
    pub compared: Vec<(Measure, Paired)>,
    /// Held-out pictures.
    pub pictures: usize,
    /// Places that they come from.
    pub places: usize,
    /// Mean share of right depths on the LiDAR line.
    pub delta1: Option<f64>,
}

impl Verdict {
    /// Whether the model is taken.
    #[must_use]
    pub fn is_accepted(&self) -> bool {
        self.refused.is_empty()
    }
}

/// Judges what was measured. `unproven`: a first model may come without held-out pictures; with a resident one it changes nothing.
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
    let (pictures, places) = (frames.len(), bins.len());
    let mut refused = Vec::new();
    let bad = frames.iter().filter(|frame| frame.candidate.is_none()).count();
    if bad > 0 {
        refused.push(Why::BadOutput { pictures: bad, of: pictures });
    }
    let compared = if has_resident { compare_all(frames, limits) } else { Vec::new() };
    let enough = pictures >= limits.min_pictures
        && places >= limits.min_places
        && !(has_resident && compared.is_empty());
    if !enough && (has_resident || !unproven) {
        let GateLimits { min_pictures, min_places, .. } = *limits;
        refused.push(Why::TooLittle { pictures, places, min_pictures, min_places });
    }
    let delta1 = mean_of(frames, |score| Some(score.line?.delta1));
    refused.extend(insane(frames, delta1.filter(|_| !has_resident), limits));
    refused.extend(compared.iter().filter_map(|(measure, paired)| worse(*measure, paired, limits)));
    refused.extend(too_slow(examination, limits));
    Verdict { refused, compared, pictures, places, delta1 }
}

fn mean_of(frames: &[ScoredFrame], value: impl Fn(&FrameScore) -> Option<f64>) -> Option<f64> {
    let values: Vec<f64> =
        frames.iter().filter_map(|frame| value(frame.candidate.as_ref()?)).collect();
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// What no comparison is needed for.
fn insane(frames: &[ScoredFrame], delta1: Option<f64>, limits: &GateLimits) -> Vec<Why> {
    let mut why = Vec::new();
    let shows: Vec<ScoredFrame> =
        frames.iter().filter(|frame| parallax_bin(frame.parallax_px) > 0).copied().collect();
    if let (Some(error), Some(unmoved)) =
        (mean_of(&shows, |s| s.photometric), mean_of(&shows, |s| s.unmoved))
        && error >= unmoved
    {
        why.push(Why::NotSane { error, unmoved });
    }
    if let Some(delta1) = delta1.filter(|delta1| *delta1 < limits.least_delta1) {
        why.push(Why::NotMetric { delta1, least: limits.least_delta1 });
    }
    why
}

/// By every measure that enough pictures speak of: a few pictures would refuse good models as often as bad ones.
fn compare_all(frames: &[ScoredFrame], limits: &GateLimits) -> Vec<(Measure, Paired)> {
    let by = |measure: Measure, error: &dyn Fn(&FrameScore) -> Option<f64>, bin: Option<usize>| {
        let counted = frames
            .iter()
            .filter(|frame| bin.is_none_or(|bin| parallax_bin(frame.parallax_px) == bin));
        let pair = |frame: &ScoredFrame| {
            Some((frame.bin, error(frame.candidate.as_ref()?)?, error(frame.resident.as_ref()?)?))
        };
        let paired = compare(&counted.filter_map(pair).collect::<Vec<_>>())?;
        let enough = paired.pictures >= limits.min_pictures && paired.places >= limits.min_places;
        enough.then_some((measure, paired))
    };
    let photometric = Measure::PHOTOMETRIC.into_iter().enumerate();
    photometric
        .filter_map(|(bin, measure)| by(measure, &|score| score.photometric, Some(bin)))
        .chain(by(Measure::AbsRel, &|score| Some(score.line?.abs_rel), None))
        .chain(by(Measure::Wrong, &|score| Some(1.0 - score.line?.delta1), None))
        .chain(by(Measure::Calibration, &|score| Some(score.line?.brier), None))
        .collect()
}

fn worse(measure: Measure, paired: &Paired, limits: &GateLimits) -> Option<Why> {
    let margin = match measure {
        Measure::PhotometricNear | Measure::PhotometricMiddle | Measure::PhotometricFar => {
            limits.photometric_margin * paired.resident
        }
        Measure::AbsRel => limits.abs_rel_margin,
        Measure::Wrong => limits.delta1_margin,
        Measure::Calibration => limits.brier_margin,
    };
    let (measure, paired) = (measure, *paired);
    // NaN is within no margin.
    if paired.upper <= margin {
        None
    } else if paired.lower > 0.0 {
        Some(Why::Worse { measure, paired, margin })
    } else {
        Some(Why::NotShown { measure, paired, margin })
    }
}

fn too_slow(examination: &Examination, limits: &GateLimits) -> Option<Why> {
    let of_resident = examination
        .resident_latency
        .map_or(0.0, |latency| latency.p99_ms * limits.p99_over_resident);
    let (p99_ms, most_ms) = (examination.latency.p99_ms, limits.p99_ms.max(of_resident));
    // NaN is too slow.
    if p99_ms <= most_ms { None } else { Some(Why::TooSlow { p99_ms, most_ms }) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model_gate::LineScore;

    /// A model whose errors are those of an even one times `factor`, on pictures of 10 places.
    fn scored(candidate: f64, resident: Option<f64>) -> Examination {
        let score = |factor: f64, noise: f64| FrameScore {
            photometric: Some(0.1 * factor + noise),
            unmoved: Some(0.3),
            line: Some(LineScore {
                points: 100,
                abs_rel: 0.1 * factor + noise,
                delta1: 1.0 - 0.15 * factor - noise,
                brier: 0.1 * factor,
            }),
        };
        let frames = (0..60).map(|tick| {
            let noise = 0.002 * (tick % 7) as f64;
            ScoredFrame {
                tick,
                bin: PoseBin { x: tick as i64 / 6, y: 0, sector: 0 },
                parallax_px: (tick % 3) as f64 * 10.0,
                candidate: Some(score(candidate, noise)),
                resident: resident.map(|factor| score(factor, 0.01 - noise)),
            }
        });
        let latency = Latency { p50_ms: 5.0, p99_ms: 8.0, runs: 100 };
        let resident_latency = resident.map(|_| latency);
        Examination { frames: frames.collect(), latency, resident_latency, golden_difference: 0.0 }
    }

    fn why(examination: &Examination, has_resident: bool) -> Vec<Why> {
        judge(examination, has_resident, false, &GateLimits::default()).refused
    }

    #[test]
    fn a_better_and_an_equal_model_are_taken() {
        assert_eq!(why(&scored(0.7, Some(1.0)), true), []);
        assert_eq!(why(&scored(1.0, Some(1.0)), true), []);
        let verdict = judge(&scored(0.7, Some(1.0)), true, false, &GateLimits::default());
        assert_eq!((verdict.compared.len(), verdict.places, verdict.pictures), (6, 10, 60));
    }

    #[test]
    fn a_worse_model_is_refused_by_every_measure_with_its_numbers() {
        let refused = why(&scored(1.5, Some(1.0)), true);
        assert_eq!(refused.len(), 6, "{refused:?}");
        assert!(refused.iter().all(|why| matches!(why, Why::Worse { .. })), "{refused:?}");
        let text = refused[3].to_string();
        assert!(
            text.contains("|d - z| / z")
                && text.contains("0.15")
                && text.contains("60 pictures of 10"),
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
            [Why::Worse { measure: Measure::Calibration, .. }]
        ));
    }

    #[test]
    fn a_difference_that_may_be_chance_is_not_enough_to_take_a_model() {
        let mut examination = scored(1.0, Some(1.0));
        for frame in &mut examination.frames {
            let line = frame.candidate.as_mut().unwrap().line.as_mut().unwrap();
            line.abs_rel += if frame.bin.x % 2 == 0 { 0.15 } else { -0.15 };
        }
        assert!(matches!(
            why(&examination, true)[..],
            [Why::NotShown { measure: Measure::AbsRel, .. }]
        ));
    }

    #[test]
    fn nan_output_is_refused_whatever_the_rest_says() {
        let mut examination = scored(0.5, Some(1.0));
        examination.frames[17].candidate = None;
        assert_eq!(why(&examination, true), [Why::BadOutput { pictures: 1, of: 60 }]);
        let mut nan = scored(0.5, Some(1.0));
        nan.frames[0].candidate.as_mut().unwrap().photometric = Some(f64::NAN);
        assert!(!why(&nan, true).is_empty());
    }

    #[test]
    fn too_few_pictures_are_no_proof_and_only_a_first_model_may_do_without() {
        let mut examination = scored(0.5, None);
        examination.frames.truncate(15);
        assert!(matches!(
            why(&examination, false)[..],
            [Why::TooLittle { pictures: 15, places: 3, .. }]
        ));
        assert!(judge(&examination, false, true, &GateLimits::default()).is_accepted());
        assert!(!judge(&examination, true, true, &GateLimits::default()).is_accepted());
    }

    #[test]
    fn a_measure_that_few_pictures_speak_of_decides_nothing() {
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
    fn a_first_model_must_explain_pictures_and_be_metric() {
        assert_eq!(why(&scored(1.0, None), false), []);
        let mut blind = scored(1.0, None);
        for frame in &mut blind.frames {
            frame.candidate.as_mut().unwrap().photometric = Some(0.31);
        }
        assert!(matches!(why(&blind, false)[..], [Why::NotSane { .. }]));
        assert!(matches!(
            why(&scored(5.0, None), false)[..],
            [Why::NotSane { .. }, Why::NotMetric { .. }]
        ));
    }

    #[test]
    fn a_slow_model_is_refused_unless_the_resident_one_is_as_slow() {
        let mut examination = scored(1.0, Some(1.0));
        examination.latency.p99_ms = 90.0;
        assert_eq!(why(&examination, true), [Why::TooSlow { p99_ms: 90.0, most_ms: 60.0 }]);
        examination.resident_latency.as_mut().unwrap().p99_ms = 85.0;
        assert_eq!(why(&examination, true), []);
        examination.latency.p99_ms = f64::NAN;
        assert!(!why(&examination, true).is_empty());
    }

    #[test]
    fn a_verdict_travels_as_json() {
        let verdict = judge(&scored(1.5, Some(1.0)), true, false, &GateLimits::default());
        let text = serde_json::to_string(&verdict).unwrap();
        assert_eq!(serde_json::from_str::<Verdict>(&text).unwrap(), verdict);
    }
}
