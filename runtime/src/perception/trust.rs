//! How probable it is that a depth is right.
//!
//! Right means a relative error below 25 %, the field's delta1. Both formulas are logistic regressions on sequences with ground
//! truth; `cargo xtask accuracy --fit` makes their weights. At run time there is no ground truth.

use super::fusion::Belief;
use super::winner::Vote;

/// What the trust in one picture's vote depends on: a constant, margin, parallax, texture, misfit.
#[must_use]
#[inline(always)]
pub fn vote_features(vote: &Vote) -> [f32; 5] {
    [1.0, vote.margin, (vote.parallax_px + 0.5).ln(), (vote.texture + 0.01).ln(), vote.misfit]
}

/// What the trust in a belief depends on: a constant, the mean trust of its votes, how many there were.
#[must_use]
#[inline(always)]
pub fn belief_features(belief: &Belief) -> [f32; 3] {
    [1.0, belief.evidence / belief.votes.max(1e-6), belief.votes.max(1e-6).ln()]
}

/// Probability that one picture's vote is right.
#[must_use]
#[inline(always)]
pub fn of_vote(weights: &[f32; 5], vote: &Vote) -> f32 {
    if vote.parallax_px > 0.0 { logistic(weights, &vote_features(vote)) } else { 0.0 }
}

/// Probability that a belief is right.
#[must_use]
#[inline(always)]
pub fn of_belief(weights: &[f32; 3], belief: &Belief) -> f32 {
    if belief.evidence > 0.0 { logistic(weights, &belief_features(belief)) } else { 0.0 }
}

#[inline(always)]
fn logistic<const N: usize>(weights: &[f32; N], features: &[f32; N]) -> f32 {
    let sum: f32 = weights.iter().zip(features).map(|(weight, feature)| weight * feature).sum();
    1.0 / (1.0 + (-sum).exp())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::CoarseConfig;

    fn weights() -> ([f32; 5], [f32; 3]) {
        let config = CoarseConfig::default();
        (config.vote_weights, config.belief_weights)
    }

    #[test]
    fn clearer_longer_and_better_textured_matches_are_trusted_more() {
        let vote = Vote { inverse_depth: 0.5, margin: 0.3, texture: 0.2, misfit: 0.3, parallax_px: 6.0 };
        let trust = of_vote(&weights().0, &vote);
        assert!(trust > 0.0 && trust < 1.0);
        assert!(of_vote(&weights().0, &Vote { margin: 0.6, ..vote }) > trust);
        assert!(of_vote(&weights().0, &Vote { parallax_px: 20.0, ..vote }) > trust);
        assert!(of_vote(&weights().0, &Vote { texture: 0.4, ..vote }) > trust);
        assert!(of_vote(&weights().0, &Vote { misfit: 0.8, ..vote }) < trust);
    }

    #[test]
    fn nothing_to_compare_with_is_no_trust() {
        assert_eq!(of_vote(&weights().0, &Vote { margin: 1.0, texture: 1.0, ..Vote::default() }), 0.0);
        assert_eq!(of_belief(&weights().1, &Belief::default()), 0.0);
    }

    #[test]
    fn a_belief_that_is_contradicted_or_old_is_trusted_less() {
        let belief = Belief { inverse_depth: 0.5, evidence: 4.0, votes: 5.0, offset: [0.0; 2] };
        assert!(of_belief(&weights().1, &Belief { evidence: 2.0, ..belief }) < of_belief(&weights().1, &belief));
        let old = Belief { evidence: 0.04, votes: 0.05, ..belief };
        assert!(of_belief(&weights().1, &old) < of_belief(&weights().1, &belief));
    }
}
