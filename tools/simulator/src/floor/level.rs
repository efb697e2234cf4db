//! At which height is the floor? Worlds have geometry below it, several storeys, tables, roofs and stray vertices.

use super::raster::Frame;
use super::{BAND_M, STEP_M};
use crate::scene::{Scene, Triangle};

/// Heights are counted in bins of this size, metres.
const BIN_M: f64 = 0.02;
/// A surface is level when its normal leans by less than 18 degrees.
const LEVEL: f64 = 0.95;
/// The largest level areas are looked at more closely.
const CANDIDATES: usize = 12;
/// Cells of that closer look, metres.
const CELL_M: f64 = 0.1;
/// A place is inside when it sees an obstacle within this many metres ...
const ROOM_M: f64 = 15.0;
/// ... in at least this many of 8 directions: a roof and the ground around a house are not a room.
const WALLS: usize = 6;
/// Of storeys that are nearly as large as the largest, the lowest is taken.
const NEARLY: f64 = 0.6;
/// Less room than this is no floor, square metres.
const SMALLEST_M2: f64 = 0.5;
/// Share of triangles on each side of an axis that may be stray.
const STRAY: f64 = 0.002;
/// A floor is not longer than this, metres: 2000 x 2000 cells of 5 cm and some.
const LARGEST_M: f64 = 120.0;

/// The rectangle that holds nearly all triangles, metres.
pub(super) fn bounds(scene: &Scene) -> Option<([f64; 2], [f64; 2])> {
    let mut low = [0.0; 2];
    let mut high = [0.0; 2];
    for axis in 0..2 {
        let middle = |t: &Triangle| t.vertices.iter().map(|v| f64::from(v.position_m[axis])).sum::<f64>() / 3.0;
        let mut middles: Vec<f64> = scene.triangles.iter().map(middle).collect();
        middles.sort_by(f64::total_cmp);
        let stray = (middles.len() as f64 * STRAY) as usize;
        let kept = middles.get(stray..middles.len().checked_sub(stray)?)?;
        let (first, last) = (kept.first()?, kept.last()?);
        // Large triangles reach beyond their middles: take in the corners of those whose middles are kept, within reason.
        let slack = (last - first).max(4.0);
        let corners = scene.triangles.iter().filter(|t| (*first..=*last).contains(&middle(t)));
        let values = corners.flat_map(|t| t.vertices.iter().map(|v| f64::from(v.position_m[axis])));
        let within = values.filter(|value| (first - slack..=last + slack).contains(value));
        let (from, to) = within.fold((*first, *last), |(from, to), value| (from.min(value), to.max(value)));
        low[axis] = from - 0.2;
        high[axis] = (to + 0.2).min(low[axis] + LARGEST_M);
    }
    Some((low, high))
}

/// Height of the floor that a robot of the given radius has most room on, inside. `None`: there is no such floor.
pub(super) fn find(scene: &Scene, radius_m: f64) -> Option<f64> {
    let (low, high) = bounds(scene)?;
    let frame = Frame::covering(low, high, CELL_M);
    let rooms: Vec<(f64, f64)> =
        candidates(scene).into_iter().map(|height| (height, room_m2(scene, &frame, height, radius_m))).collect();
    let largest = rooms.iter().map(|(_, room)| *room).fold(0.0, f64::max);
    if largest < SMALLEST_M2 {
        return None;
    }
    let wide_enough = rooms.iter().filter(|(_, room)| *room >= NEARLY * largest);
    wide_enough.map(|(height, _)| *height).min_by(f64::total_cmp)
}

/// Heights with much level surface, most first.
fn candidates(scene: &Scene) -> Vec<f64> {
    let mut surfaces: Vec<(f64, f64)> = scene.triangles.iter().filter_map(level_surface).collect();
    surfaces.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut peaks: Vec<(f64, f64)> = Vec::new();
    let mut bins: Vec<(i64, f64, f64)> = Vec::new();
    for (height, area) in surfaces {
        let bin = (height / BIN_M).floor() as i64;
        match bins.last_mut() {
            Some((last, sum, moment)) if *last == bin => {
                *sum += area;
                *moment += area * height;
            }
            _ => bins.push((bin, area, area * height)),
        }
    }
    for (bin, ..) in &bins {
        let near = bins.iter().filter(|other| (other.0 - bin).abs() <= 1);
        let (area, moment) = near.fold((0.0, 0.0), |sum, other| (sum.0 + other.1, sum.1 + other.2));
        peaks.push((moment / area, area));
    }
    peaks.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut chosen: Vec<f64> = Vec::new();
    for (height, _) in peaks {
        if chosen.iter().all(|other| (other - height).abs() > 2.0 * BIN_M) {
            chosen.push(height);
        }
        if chosen.len() == CANDIDATES {
            break;
        }
    }
    chosen
}

/// Height and area of a level triangle.
fn level_surface(triangle: &Triangle) -> Option<(f64, f64)> {
    let [a, b, c] = triangle.vertices.map(|vertex| nalgebra::Vector3::from(vertex.position_m.map(f64::from)));
    let normal = (b - a).cross(&(c - a));
    let doubled = normal.norm();
    let level = doubled > 0.0 && doubled.is_finite() && (normal.z / doubled).abs() > LEVEL;
    level.then(|| ((a.z + b.z + c.z) / 3.0, doubled / 2.0))
}

/// The largest connected room that a robot has inside at this height, square metres.
fn room_m2(scene: &Scene, frame: &Frame, height: f64, radius_m: f64) -> f64 {
    let mut supported = vec![false; frame.cells()];
    let mut blocked = vec![false; frame.cells()];
    for triangle in &scene.triangles {
        frame.mark(triangle, [height - STEP_M, height + STEP_M], false, &mut supported);
        frame.mark(triangle, [height + BAND_M[0], height + BAND_M[1]], true, &mut blocked);
    }
    let open: Vec<bool> = supported.iter().zip(&blocked).map(|(floor, wall)| *floor && !*wall).collect();
    let clearance = super::distance::to_closed(&open, frame);
    let inside: Vec<bool> = (0..frame.cells())
        .map(|index| f64::from(clearance[index]) * CELL_M > radius_m && is_inside(frame, &blocked, index))
        .collect();
    let largest = super::components(&inside, frame).into_iter().map(|cells| cells.len()).max().unwrap_or(0);
    largest as f64 * CELL_M * CELL_M
}

fn is_inside(frame: &Frame, blocked: &[bool], index: usize) -> bool {
    let [x_m, y_m] = frame.center_m(index);
    let sees_wall = |eighth: usize| {
        let (sin, cos) = (eighth as f64 * std::f64::consts::FRAC_PI_4).sin_cos();
        let steps = (ROOM_M / CELL_M) as usize;
        (1..steps)
            .map(|step| step as f64 * CELL_M)
            .map_while(|way| frame.index(x_m + way * cos, y_m + way * sin))
            .any(|cell| blocked[cell])
    };
    (0..8).filter(|eighth| sees_wall(*eighth)).count() >= WALLS
}
