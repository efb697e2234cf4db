//! The probability that a depth is right.
//!
//! Right means a relative error below 25 %, the field's delta1. Both formulas are logistic regressions on sequences with ground
//! truth; `cargo xtask accuracy --fit` computes their weights.

use super::belief::Belief;
use super::surround::Surround;
use super::wta::Vote;

/// Features of the confidence of a vote: a constant, margin, logarithm of parallax, logarithm of texture, misfit.
#[must_use]
#[inline(always)]
pub fn vote_features(vote: &Vote) -> [f32; 5] {
    [1.0, vote.margin, (vote.parallax_px + 0.5).ln(), (vote.texture + 0.01).ln(), vote.misfit]
}

/// Features of the confidence of a belief: a constant, the mean confidence of its votes, the logarithm of their number, the
/// mean confidence around it, whether its neighbours agree.
#[must_use]
#[inline(always)]
pub fn belief_features(belief: &Belief, around: &Surround) -> [f32; 5] {
    [1.0, belief.mean_confidence(), belief.votes.max(1e-6).ln(), around.confidence, around.agreeing]
}

/// Probability that one frame's vote is right, when rotation errors displace its match by `jitter_px` (root mean square).
#[must_use]
#[inline(always)]
pub fn of_vote(weights: &[f32; 5], vote: &Vote, jitter_px: f32) -> f32 {
    if vote.parallax_px > 0.0 {
        logistic(weights, &vote_features(vote)) * robust_to_jitter(vote.parallax_px, jitter_px)
    } else {
        0.0
    }
}

/// Probability that jitter of `jitter_px` (root mean square) displaces a match by less than a quarter of its parallax; with a
/// larger displacement, depth is wrong. The displacement has a Rayleigh distribution, whose integral has a closed form.
#[inline(always)]
fn robust_to_jitter(parallax_px: f32, jitter_px: f32) -> f32 {
    let allowed = 0.25 * parallax_px / jitter_px;
    1.0 - (-allowed * allowed).exp()
}

/// Probability that a belief is right.
#[must_use]
#[inline(always)]
pub fn of_belief(weights: &[f32; 5], belief: &Belief, around: &Surround) -> f32 {
    if belief.evidence > 0.0 { logistic(weights, &belief_features(belief, around)) } else { 0.0 }
}

/// The inverse of the logistic function; probabilities nearer to 0 or 1 than 0.1 % count as 0.1 %.
pub(super) fn logit(probability: f32) -> f32 {
    let probability = probability.clamp(0.001, 0.999);
    (probability / (1.0 - probability)).ln()
}

#[inline(always)]
pub(super) fn logistic<const N: usize>(weights: &[f32; N], features: &[f32; N]) -> f32 {
    let sum: f32 = weights.iter().zip(features).map(|(weight, feature)| weight * feature).sum();
    1.0 / (1.0 + (-sum).exp())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::CoarseConfig;

    const BELIEF: Belief =
        Belief { inverse_depth: 0.5, evidence: 4.0, votes: 5.0, offset: [0.0; 2] };
    const AGREEING_NEIGHBOURS: Surround = Surround { confidence: 0.8, agreeing: 1.0 };

    fn weights() -> ([f32; 5], [f32; 5]) {
        let config = CoarseConfig::default();
        (config.vote_weights, config.belief_weights)
    }

    #[test]
    fn clearer_longer_and_better_textured_matches_have_more_confidence() {
        let vote =
            Vote { inverse_depth: 0.5, margin: 0.3, texture: 0.2, misfit: 0.3, parallax_px: 6.0 };
        let confidence = of_vote(&weights().0, &vote, 0.0);
        assert!(confidence > 0.0 && confidence < 1.0);
        assert!(of_vote(&weights().0, &Vote { margin: 0.6, ..vote }, 0.0) > confidence);
        assert!(of_vote(&weights().0, &Vote { parallax_px: 20.0, ..vote }, 0.0) > confidence);
        assert!(of_vote(&weights().0, &Vote { texture: 0.4, ..vote }, 0.0) > confidence);
        assert!(of_vote(&weights().0, &Vote { misfit: 0.8, ..vote }, 0.0) < confidence);
    }

    #[test]
    fn a_vote_without_a_reference_has_no_confidence() {
        assert_eq!(
            of_vote(&weights().0, &Vote { margin: 1.0, texture: 1.0, ..Vote::default() }, 0.0),
            0.0
        );
        assert_eq!(
            of_vote(&weights().0, &Vote { parallax_px: f32::NAN, ..Vote::default() }, 1.0),
            0.0
        );
        assert_eq!(of_belief(&weights().1, &Belief::default(), &AGREEING_NEIGHBOURS), 0.0);
    }

    /// Confidence with jitter as a share of the confidence without.
    fn kept(parallax_px: f32, jitter_px: f32) -> f32 {
        let vote = Vote { inverse_depth: 0.5, margin: 0.3, texture: 0.2, misfit: 0.3, parallax_px };
        of_vote(&weights().0, &vote, jitter_px) / of_vote(&weights().0, &vote, 0.0)
    }

    #[test]
    fn jitter_lowers_the_confidence_of_small_parallax() {
        assert_eq!(kept(0.1, 0.0), 1.0);
        assert!(kept(20.0, 1.0) > 0.999);
        // A quarter of 4 px is the root mean square: 1 - 1/e are right.
        assert!((kept(4.0, 1.0) - 0.632).abs() < 1e-3);
        assert!(kept(1.0, 1.0) < 0.1);
    }

    #[test]
    fn a_belief_that_is_contradicted_or_old_has_less_confidence() {
        let contradicted = Belief { evidence: 2.0, ..BELIEF };
        let old = Belief { evidence: 0.04, votes: 0.05, ..BELIEF };
        let [fresh, contradicted, old] = [BELIEF, contradicted, old]
            .map(|belief| of_belief(&weights().1, &belief, &AGREEING_NEIGHBOURS));
        assert!(contradicted < fresh && old < fresh);
    }

    #[test]
    fn a_belief_among_unlikely_or_contradicting_ones_has_less_confidence() {
        let unlikely = Surround { confidence: 0.3, ..AGREEING_NEIGHBOURS };
        let contradicting = Surround { agreeing: 0.25, ..AGREEING_NEIGHBOURS };
        let [best, unlikely, contradicting] = [AGREEING_NEIGHBOURS, unlikely, contradicting]
            .map(|around| of_belief(&weights().1, &BELIEF, &around));
        assert!(unlikely < best && contradicting < best);
    }
}
