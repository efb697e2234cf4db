//! From aggregated costs to one depth a pixel, and how far to trust it.

/// The best hypothesis of one pixel.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Winner {
    /// Index of the hypothesis, with its fraction.
    pub plane: f32,
    /// (second - best) / second, where second is the best hypothesis that is not a neighbour of the winner.
    pub margin: f32,
    /// Cost of the winner.
    pub cost: i16,
}

/// Takes the smallest of `sums`, refines it by a parabola through its neighbours and looks for a rival.
pub fn winner(sums: &[i16], guard: usize) -> Winner {
    let mut best = (i16::MAX, 0);
    for (plane, &sum) in sums.iter().enumerate() {
        if sum < best.0 {
            best = (sum, plane);
        }
    }
    let (cost, plane) = best;
    let rival = |sums: &[i16]| sums.iter().copied().min().unwrap_or(i16::MAX);
    let second = rival(&sums[..plane.saturating_sub(guard)]).min(rival(&sums[(plane + guard + 1).min(sums.len())..]));
    let margin = if second == i16::MAX { 0.0 } else { f32::from(second - cost) / f32::from(second.max(1)) };
    let mut fraction = 0.0;
    if plane > 0 && plane + 1 < sums.len() {
        let (before, after) = (f32::from(sums[plane - 1] - cost), f32::from(sums[plane + 1] - cost));
        if before + after > 0.0 {
            fraction = 0.5 * (before - after) / (before + after);
        }
    }
    Winner { plane: plane as f32 + fraction, margin, cost }
}
