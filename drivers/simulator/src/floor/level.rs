//! At which height the floor is.

use std::collections::BTreeMap;

use super::components::Components;
use super::distance::distance_to;
use super::raster::{Raster, is_stray, region};
use super::{Corners, Footprint, LEAST_FREE_M2, STEP_M, corners, seen_from_above};
use crate::scene::Scene;

/// Thickness of a bin of the histogram of heights, metres.
const BIN_M: f64 = 0.02;

/// Levels that are tried, those with the most surface first.
const CANDIDATES: usize = 16;

/// A storey whose score is at least this share of the best one's is as good, and the lowest of them is taken.
const AS_GOOD: f64 = 0.95;

/// Finds the height of the floor that has the largest free, enclosed area for this robot; of storeys that are as good, the
/// lowest. Which side of a surface faces up does not matter: exports turn triangles around.
///
/// # Errors
/// What was looked for and not found, for [`SceneError::NoFloor`](crate::error::SceneError::NoFloor).
pub fn find_floor(scene: &Scene, footprint: &Footprint) -> Result<f64, String> {
    let triangles: Vec<Corners> = scene.triangles.iter().map(corners).collect();
    let grid = region(&triangles);
    let levels = level_surfaces(&triangles, grid.cells() as f64 * grid.resolution_m.powi(2));
    let candidates = candidates(&levels);
    if candidates.is_empty() {
        return Err("there is no level surface".into());
    }
    let mut scored: Vec<(f64, f64)> = Vec::new();
    let mut best: f64 = 0.0;
    for (height_m, area_m2) in candidates {
        // Candidates come in the order of their area, which bounds their score.
        if area_m2 * 1.01 < AS_GOOD * best {
            break;
        }
        let raster = Raster::new(&triangles, grid, height_m, footprint.height_m);
        let clearance = distance_to(&grid, |cell| raster.is_obstacle(cell));
        let components =
            Components::new(&raster, |cell| f64::from(clearance[cell]) >= footprint.radius_m);
        if let Some((_, score)) = components.best(&raster, LEAST_FREE_M2) {
            scored.push((height_m, score));
            best = best.max(score);
        }
    }
    let good = scored
        .into_iter()
        .filter(|(_, score)| *score >= AS_GOOD * best)
        .map(|(height_m, _)| height_m);
    let lowest = good.min_by(f64::total_cmp);
    lowest.ok_or_else(|| {
        let (radius, height) = (footprint.radius_m, footprint.height_m);
        format!("no level surface has room for a robot of {radius} m radius and {height} m height")
    })
}

/// Height and area seen from above, by bin, of surfaces within 25 degrees of level.
fn level_surfaces(triangles: &[Corners], region_m2: f64) -> BTreeMap<i64, (f64, f64)> {
    let mut bins = BTreeMap::<i64, (f64, f64)>::new();
    for triangle in triangles {
        let (area, slope) = seen_from_above(triangle);
        if slope < 0.9 || is_stray(triangle) {
            continue;
        }
        let area = area.min(region_m2);
        let height = triangle.iter().map(|corner| corner[2]).sum::<f64>() / 3.0;
        let bin = bins.entry((height / BIN_M).floor() as i64).or_default();
        *bin = (bin.0 + area * height, bin.1 + area);
    }
    bins
}

/// Heights with the most surface within a step of them, at least a step apart, with that surface's area; most first.
fn candidates(bins: &BTreeMap<i64, (f64, f64)>) -> Vec<(f64, f64)> {
    let reach = (STEP_M / BIN_M).floor() as i64;
    let mut windows: Vec<(i64, f64)> = bins
        .keys()
        .map(|&bin| (bin, bins.range(bin - reach..=bin + reach).map(|(_, (_, area))| area).sum()))
        .collect();
    // Stable and by falling area: of windows with the same surface, the lowest comes first.
    windows.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut chosen: Vec<(i64, f64)> = Vec::new();
    for (bin, area) in windows {
        if chosen.len() < CANDIDATES
            && area > LEAST_FREE_M2
            && chosen.iter().all(|(c, _)| (c - bin).abs() > reach)
        {
            chosen.push((bin, area));
        }
    }
    // The floor itself, not the mean of floor and carpets: the fullest bin and those beside it.
    let mode = |bin: i64| {
        let window = bins.range(bin - reach..=bin + reach);
        let fullest =
            window.max_by(|a, b| a.1.1.total_cmp(&b.1.1)).map_or(bin, |(&fullest, _)| fullest);
        let near = bins.range(fullest - 1..=fullest + 1);
        let (moment, area) = near.fold((0.0, 0.0), |sum, (_, bin)| (sum.0 + bin.0, sum.1 + bin.1));
        moment / area
    };
    chosen.into_iter().map(|(bin, area)| (mode(bin), area)).collect()
}
