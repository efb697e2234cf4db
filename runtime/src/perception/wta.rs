//! Winner takes all: selects one inverse depth per cell from the aggregated costs, and measures how clearly it won.

use multiversion::multiversion;

use super::sweep::{PLANES, WORST_COST};

/// Hypotheses at most this far from the winner do not count as rivals.
const GUARD: usize = 2;

/// The winner-take-all result of one frame for one cell.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Vote {
    /// Inverse z-depth of the best hypothesis, 1/m.
    pub inverse_depth: f32,
    /// (rival - best) / rival after aggregation, 0 to 1: 0 when another hypothesis is as good.
    pub margin: f32,
    /// Share of differing bits, mean over the hypotheses, 0 to 1: 0 where the cell has no texture and only follows its
    /// neighbours.
    pub texture: f32,
    /// Share of the brightness pattern in the references that this frame does not explain, 0 to 1: near 1 where the match is
    /// wrong or the object has moved.
    pub misfit: f32,
    /// Largest parallax among the references, full-size pixels; 0 where no reference sees the cell, where something moves,
    /// and behind the floor where the floor explains the image as well: the vote does not count.
    pub parallax_px: f32,
}

/// Fills the votes of a row of cells.
#[multiversion(targets("x86_64+avx2"))]
pub fn winner_takes_all(
    sums: &[[i16; PLANES]],
    costs: &[[u8; PLANES]],
    inverse_depth: &[f32; PLANES],
    votes: &mut [Vote],
) {
    for ((vote, sums), costs) in votes.iter_mut().zip(sums).zip(costs) {
        *vote = winner(sums, costs, inverse_depth);
    }
}

/// Takes the smallest of `sums`, refines it by two lines of opposite slope through it and its neighbours (costs that count
/// bits have a V-shaped minimum, not a parabola; Shimizu and Okutomi 2005) and finds its rival. `costs` are those of
/// the cell alone. Misfit and parallax are left at 0.
#[inline(always)]
fn winner(sums: &[i16; PLANES], costs: &[u8; PLANES], inverse_depth: &[f32; PLANES]) -> Vote {
    let least = smallest(sums);
    let plane = sums.iter().position(|sum| *sum == least).unwrap_or_default();
    let mut rivals = *sums;
    rivals[plane.saturating_sub(GUARD)..(plane + GUARD + 1).min(PLANES)].fill(i16::MAX);
    let rival = smallest(&rivals);
    let margin = f32::from(rival - least) / f32::from(rival.max(1));
    let mut refined = inverse_depth[plane];
    if plane > 0 && plane + 1 < PLANES {
        let before = f32::from(sums[plane - 1] - least);
        let after = f32::from(sums[plane + 1] - least);
        if before.max(after) > 0.0 {
            let fraction = 0.5 * (before - after) / before.max(after);
            let neighbour =
                if fraction < 0.0 { inverse_depth[plane - 1] } else { inverse_depth[plane + 1] };
            refined += fraction.abs() * (neighbour - refined);
        }
    }
    let mean = costs.iter().map(|cost| u32::from(*cost)).sum::<u32>() as f32 / PLANES as f32;
    Vote {
        inverse_depth: refined,
        margin,
        texture: mean / f32::from(WORST_COST),
        ..Vote::default()
    }
}

#[inline(always)]
fn smallest(sums: &[i16; PLANES]) -> i16 {
    let mut least = [i16::MAX; 16];
    for sums in sums.chunks_exact(16) {
        for (least, sum) in least.iter_mut().zip(sums) {
            *least = (*least).min(*sum);
        }
    }
    least.into_iter().fold(i16::MAX, i16::min)
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
        assert!(
            (winner.inverse_depth - want).abs() < 0.02 * (w[21] - w[20]),
            "{}",
            winner.inverse_depth
        );
        assert!(winner.margin > 0.8);
    }

    #[test]
    fn two_equal_minima_have_no_margin() {
        let mut sums = [500_i16; PLANES];
        sums[10] = 100;
        sums[40] = 100;
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
    fn a_cell_without_texture_reports_none_whatever_its_neighbours_are() {
        let mut sums = [500_i16; PLANES];
        sums[30] = 100;
        let mut costs = COSTS;
        costs[30] = 12;
        let w = hypotheses(0.3, 20.0);
        let vote = winner(&sums, &costs, &w);
        let mean = (63.0 * 48.0 + 12.0) / 64.0;
        assert!((vote.texture - mean / 96.0).abs() < 1e-6);
        let flat = winner(&sums, &[0; PLANES], &w);
        assert!(flat.texture == 0.0 && flat.margin == vote.margin);
    }
}
