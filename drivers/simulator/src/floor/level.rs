//! Detection of the floor's height.

use std::collections::BTreeMap;

use super::components::Components;
use super::distance::distance_to;
use super::raster::{Raster, is_stray, region};
use super::{Corners, Footprint, LEAST_FREE_M2, STEP_M, corners, seen_from_above};
use crate::scene::Scene;

/// Bin width of the height histogram, metres.
const BIN_M: f64 = 0.02;

/// Number of candidate levels that are evaluated, largest surface first.
const CANDIDATES: usize = 16;

/// Storeys whose score is at least this fraction of the best score count as equally good; the
/// lowest of them is chosen.
const AS_GOOD: f64 = 0.95;

/// Finds the height of the floor with the largest free, enclosed area for this robot; of equally
/// good storeys, the lowest. The orientation of triangles is ignored because exporters reverse it.
///
/// # Errors
/// Describes the criterion that no surface met, for
/// [`SceneError::NoFloor`](crate::error::SceneError::NoFloor).
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
        // Candidates are sorted by area, which bounds their score.
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
        let radius = footprint.radius_m;
        let height = footprint.height_m;
        format!("no level surface has enough free space for a robot of {radius} m radius and {height} m height")
    })
}

/// Computes for every height bin the area-weighted height and the area seen from above of the
/// surfaces within 25 degrees of level.
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

/// Heights with the most surface within one step of them, at least a step apart, with the area of
/// that surface; largest first.
fn candidates(bins: &BTreeMap<i64, (f64, f64)>) -> Vec<(f64, f64)> {
    let reach = (STEP_M / BIN_M).floor() as i64;
    let mut windows: Vec<(i64, f64)> = bins
        .keys()
        .map(|&bin| (bin, bins.range(bin - reach..=bin + reach).map(|(_, (_, area))| area).sum()))
        .collect();
    // The sort is stable: of windows with the same area, the lowest comes first.
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
    chosen.into_iter().map(|(bin, area)| (fullest_height(bin, bins, reach), area)).collect()
}

/// Height of the fullest bin and its neighbours: the floor itself, not the mean of floor and
/// carpets.
fn fullest_height(bin: i64, bins: &BTreeMap<i64, (f64, f64)>, reach: i64) -> f64 {
    let window = bins.range(bin - reach..=bin + reach);
    let fullest =
        window.max_by(|a, b| a.1.1.total_cmp(&b.1.1)).map_or(bin, |(&fullest, _)| fullest);
    let near = bins.range(fullest - 1..=fullest + 1);
    let (moment, area) = near.fold((0.0, 0.0), |sum, (_, bin)| (sum.0 + bin.0, sum.1 + bin.1));
    moment / area
}
