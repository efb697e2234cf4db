//! Fits the probabilities of dense depth, and visits its cells with their truth for other fits.

use anyhow::Result;
use hal::{CameraModel, ImageView};
use runtime::perception::confidence::belief_features;
use runtime::perception::dense::{Candidates, agree, joint_features};
use runtime::perception::{CoarseConfig, CoarseDepth, DenseConfig, DenseDepth};

use crate::disturbance::Disturbance;
use crate::fit::Samples;
use crate::sequence::Sequence;

/// Fits recalled depth first, then, with these weights, what follows from it.
///
/// # Errors
/// When the sequences do not determine the weights.
pub fn fit(
    sequences: &[Sequence],
    coarse: &CoarseConfig,
    dense: &DenseConfig,
) -> Result<DenseConfig> {
    let mut dense = dense.clone();
    dense.recall_weights = fit_part(sequences, coarse, &dense, |cell, is_right| {
        let (belief, around, probability) = cell.recalled;
        (probability > 0.0)
            .then(|| (belief_features(&belief, &around), is_right(belief.inverse_depth)))
    })?;
    dense.joint_weights = fit_part(sequences, coarse, &dense, |cell, is_right| {
        let (coarse, p_coarse) = cell.coarse;
        let (recalled, _, p_recalled) = cell.recalled;
        let both = p_coarse > 0.0 && p_recalled > 0.0 && p_coarse.max(p_recalled) >= 0.5;
        both.then(|| {
            let agree = agree(coarse.inverse_depth, recalled.inverse_depth);
            let features =
                joint_features(p_coarse.max(p_recalled), p_coarse.min(p_recalled), agree);
            let chosen = if p_coarse >= p_recalled { coarse } else { recalled };
            (features, is_right(chosen.inverse_depth))
        })
    })?;
    dense.fill_weights = fit_part(sequences, coarse, &dense, |cell, is_right| {
        let is_hole = cell.coarse.1.max(cell.recalled.2) < 0.5 && cell.filled.inverse_depth > 0.0;
        is_hole.then(|| (cell.filled.features(), is_right(cell.filled.inverse_depth)))
    })?;
    dense.wall_weights = fit_part(sequences, coarse, &dense, |cell, is_right| {
        let (wall, share) = cell.wall;
        let is_known = wall.inverse_depth > 0.0;
        is_known.then(|| (wall.features(share), is_right(wall.inverse_depth)))
    })?;
    dense.seen_wall_weights = fit_walls(sequences, coarse, &dense, true)?;
    dense.filled_wall_weights = fit_walls(sequences, coarse, &dense, false)?;
    Ok(dense)
}

/// The weights of walls beside depth that was seen, or beside depth that was filled.
fn fit_walls(
    sequences: &[Sequence],
    coarse: &CoarseConfig,
    dense: &DenseConfig,
    seen: bool,
) -> Result<[f32; 5]> {
    fit_part(sequences, coarse, dense, |cell, is_right| {
        let (inverse_depth, p) = cell.without_walls;
        let (wall, _) = cell.wall;
        let p_wall = dense.of_wall(&cell.wall);
        let counts = cell.filled.is_seen() == seen && wall.inverse_depth > 0.0 && p > 0.0;
        counts.then(|| {
            let agree = agree(inverse_depth, wall.inverse_depth);
            let chosen = if p_wall > p { wall.inverse_depth } else { inverse_depth };
            (joint_features(p.max(p_wall), p.min(p_wall), agree), is_right(chosen))
        })
    })
}

type IsRight<'a> = &'a dyn Fn(f32) -> bool;

fn fit_part<const N: usize>(
    sequences: &[Sequence],
    coarse: &CoarseConfig,
    dense: &DenseConfig,
    sample: impl Fn(&Candidates, IsRight<'_>) -> Option<([f32; N], bool)>,
) -> Result<[f32; N]> {
    let mut all = Samples::<N>::default();
    for sequence in sequences {
        for disturbance in [Disturbance::None, Disturbance::Pose] {
            all.add_sequence(samples(sequence, disturbance, coarse, dense, &sample)?);
        }
    }
    Ok(all.fit()?.map(|weight| weight as f32))
}

fn samples<const N: usize>(
    sequence: &Sequence,
    disturbance: Disturbance,
    coarse: &CoarseConfig,
    dense: &DenseConfig,
    sample: &impl Fn(&Candidates, IsRight<'_>) -> Option<([f32; N], bool)>,
) -> Result<Samples<N>> {
    let mut samples = Samples::default();
    let sparse = Sparse { every_frame: 1, every_cell: 17 };
    visit(sequence, disturbance, coarse, dense, sparse, |cell, truth_m| {
        let right = |inverse_depth| is_right(inverse_depth, truth_m);
        if let Some((features, right)) = sample(cell, &right) {
            samples.add(features, right);
        }
    })?;
    Ok(samples)
}

/// Which cells of a sequence are visited: neighbouring frames and cells are correlated.
#[derive(Debug, Clone, Copy)]
pub struct Sparse {
    pub every_frame: usize,
    pub every_cell: usize,
}

/// Computes dense depth of a sequence, and visits cells that have a truth, which is in metres.
///
/// # Errors
/// When the camera cannot be used.
pub fn visit(
    sequence: &Sequence,
    disturbance: Disturbance,
    coarse: &CoarseConfig,
    dense: &DenseConfig,
    sparse: Sparse,
    mut each: impl FnMut(&Candidates, f32),
) -> Result<()> {
    let CameraModel { width, height, .. } = sequence.camera;
    let columns = width / 4;
    let mut engine =
        CoarseDepth::new(coarse.clone(), sequence.camera)?.with_floor(sequence.mount.is_some());
    let mut dense =
        DenseDepth::new(dense.clone(), &sequence.camera, &engine, sequence.mount.as_ref());
    for (index, view) in sequence.views.iter().enumerate() {
        let (rgb, pose) = disturbance.apply(index, view);
        let frame = ImageView::rgb8(width, height, &rgb)?;
        if engine.estimate(frame, &pose).is_err_and(|why| !why.has_image()) {
            continue;
        }
        if let Some((scan, t_odom_laser)) = &view.scan {
            dense.see(scan, t_odom_laser);
        }
        dense.complete(&engine, &view.moment);
        let Some(truth) = view.truth.as_ref().filter(|_| index % sparse.every_frame == 0) else {
            continue;
        };
        let first = index % sparse.every_cell;
        let cells = dense.candidates().enumerate().skip(first).step_by(sparse.every_cell);
        for (cell, candidates) in cells {
            let row = cell / columns * 4 + 1;
            let column = cell % columns * 4 + 1;
            let truth_m = truth.values()[row * width + column];
            if truth_m > 0.0 {
                each(&candidates, truth_m);
            }
        }
    }
    Ok(())
}

/// Whether the depth is within a factor of 1.25 of the truth, as in delta1.
#[must_use]
pub fn is_right(inverse_depth: f32, truth_m: f32) -> bool {
    let ratio = inverse_depth * truth_m;
    ratio > 0.8 && ratio < 1.25
}
