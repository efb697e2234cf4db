//! From aggregated costs to one inverse depth a pixel, and how clearly it won.

use super::sweep::{PLANES, WORST_COST};

/// Hypotheses this near to the winner are not its rivals.
const GUARD: usize = 2;

/// What one picture says about one cell.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Vote {
    /// Inverse z-depth of the best hypothesis, 1/m.
    pub inverse_depth: f32,
    /// (rival - best) / rival after aggregation, 0 to 1: 0 when another hypothesis is as good.
    pub margin: f32,
    /// Share of differing bits at the best hypothesis, 0 to 1: large where the match is wrong or the thing has moved.
    pub residual: f32,
    /// By how much that is less than for the mean hypothesis: 0 where the cell itself has no texture and only follows its
    /// neighbours.
    pub contrast: f32,
    /// Largest parallax among the references, full-size pixels; 0: there was nothing to compare with.
    pub parallax_px: f32,
}

/// Takes the smallest of `sums`, refines it by two lines of opposite slope through it and its neighbours (costs that count
/// bits have a V at the right place, not a parabola; Shimizu and Okutomi 2005) and looks for a rival. `costs` are those of
/// the cell alone. The parallax is left at 0.
#[inline(always)]
pub fn winner(sums: &[i16; PLANES], costs: &[u8; PLANES], inverse_depth: &[f32; PLANES]) -> Vote {
    let least = sums.iter().copied().fold(i16::MAX, i16::min);
    let plane = sums.iter().position(|sum| *sum == least).unwrap_or_default();
    let smallest = |sums: &[i16]| sums.iter().copied().fold(i16::MAX, i16::min);
    let rival = smallest(&sums[..plane.saturating_sub(GUARD)]).min(smallest(&sums[(plane + GUARD + 1).min(PLANES)..]));
    let margin = f32::from(rival - least) / f32::from(rival.max(1));
    let mut refined = inverse_depth[plane];
    if plane > 0 && plane + 1 < PLANES {
        let (before, after) = (f32::from(sums[plane - 1] - least), f32::from(sums[plane + 1] - least));
        if before.max(after) > 0.0 {
            let fraction = 0.5 * (before - after) / before.max(after);
            let neighbour = if fraction < 0.0 { inverse_depth[plane - 1] } else { inverse_depth[plane + 1] };
            refined += fraction.abs() * (neighbour - refined);
        }
    }
    let mean = costs.iter().map(|cost| u32::from(*cost)).sum::<u32>() as f32 / PLANES as f32;
    let own = f32::from(costs[plane]);
    let contrast = (mean - own).max(0.0) / f32::from(WORST_COST);
    Vote { inverse_depth: refined, margin, residual: own / f32::from(WORST_COST), contrast, parallax_px: 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::perception::sweep::hypotheses;

    const COSTS: [u8; PLANES] = [48; PLANES];

    #[test]
    fn the_tip_of_a_v_is_found_between_two_hypotheses() {
        let w = hypotheses(0.3, 20.0);
        let sums = std::array::from_fn(|i| ((i as f32 - 20.3).abs() * 100.0) as i16 + 7);
        let winner = winner(&sums, &COSTS, &w);
        let want = w[20] + 0.3 * (w[21] - w[20]);
        assert!((winner.inverse_depth - want).abs() < 0.02 * (w[21] - w[20]), "{}", winner.inverse_depth);
        assert!(winner.margin > 0.8);
    }

    #[test]
    fn two_equal_minima_have_no_margin() {
        let mut sums = [500_i16; PLANES];
        (sums[10], sums[40]) = (100, 100);
        assert_eq!(winner(&sums, &COSTS, &hypotheses(0.3, 20.0)).margin, 0.0);
    }

    #[test]
    fn the_first_and_last_hypothesis_can_win() {
        let w = hypotheses(0.3, 20.0);
        for plane in [0, PLANES - 1] {
            let mut sums = [500_i16; PLANES];
            sums[plane] = 1;
            assert_eq!(winner(&sums, &COSTS, &w).inverse_depth, w[plane]);
        }
        assert_eq!(winner(&[0; PLANES], &COSTS, &w).margin, 0.0);
    }

    #[test]
    fn contrast_is_how_much_better_the_cell_itself_fits_than_on_average() {
        let mut sums = [500_i16; PLANES];
        sums[30] = 100;
        let mut costs = COSTS;
        costs[30] = 0;
        let w = hypotheses(0.3, 20.0);
        let vote = winner(&sums, &costs, &w);
        assert!((vote.contrast - 0.5 * 63.0 / 64.0).abs() < 1e-6 && vote.residual == 0.0);
        let flat = winner(&sums, &COSTS, &w);
        assert!(flat.contrast == 0.0 && flat.residual == 0.5 && flat.margin == vote.margin);
    }
}
