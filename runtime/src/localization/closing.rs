//! Closes loops: finds where a finished submap overlaps earlier ones, and verifies it.
//!
//! The submap is searched for in pieces of the earlier path, each some ten submaps long, as far as the uncertainty of its pose
//! allows. A place counts as the same when the refined pose puts most of the submap's surfaces on known ones, and when no other
//! place of that piece does nearly as well: a corridor fits everywhere along itself.

use hal::Pose2;
use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};

use super::drift::Drift;
use super::local::found_prior;
use super::matcher::{Alignment, Surfaces, align};
use super::pose_graph::{Edge, PoseGraph};
use super::search_grid::{Search, SearchGrid, Window, is_same_place};
use super::submaps::Submaps;

/// Submaps before and behind the middle one that make a piece of path.
const PIECE: u32 = 4;
/// Submaps with fewer keyframes between them were matched with each other already.
const MIN_KEYFRAMES_APART: u32 = 40;
/// Submaps see the same surfaces when they are not further apart than this.
const REACH_M: f64 = 4.0;
/// Pieces that are searched for one submap, at most.
const MAX_PIECES: usize = 8;
/// Closures of one submap, at most: more say nothing new, and every one costs work in the pose graph.
const MAX_CLOSURES: usize = 4;
/// Share of the submap that must be near known surfaces, and the share of this that must lie on them.
const MIN_OVERLAP: f32 = 0.5;
const MIN_INLIERS: f32 = 0.8;
/// And how exactly.
const MAX_RMS_M: f32 = 0.035;
/// Largest standard deviation of the place, in the direction in which it is known least. A corridor with little in it fits at
/// several places along itself: without this bound, four loops of the Intel log were 0.3 to 0.7 m off (docs/localization.md).
const MAX_UNCERTAINTY_M: f64 = 0.06;
/// A rival with this share of the best one's inliers makes both doubtful.
const RIVAL_SHARE: f32 = 0.9;
/// What is searched beyond three standard deviations.
const MARGIN_M: f64 = 0.4;
const MARGIN_RAD: f64 = 0.08;
/// Errors that matches of one place have in common: furniture that moved, walls that are not straight.
const CLOSURE_M: f64 = 0.005;
const CLOSURE_RAD: f64 = 0.002;
/// Operations of making a piece, and of refining a place, about.
const PIECE_OPERATIONS: u64 = 400_000;
const REFINE_OPERATIONS: u64 = 100_000;

/// A piece of path to search in.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Piece {
    middle: u32,
    /// In the frame of the middle submap.
    window: Window,
}

/// The search for one submap.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Query {
    submap: u32,
    /// The pieces of the search that remain, the likeliest last.
    pieces: Vec<Piece>,
    search: Option<Search>,
    closures: Vec<Edge>,
}

impl Query {
    #[cfg(test)]
    pub(crate) fn is_searching(&self) -> bool {
        self.search.is_some()
    }

    /// What was found, when the search is over.
    pub(crate) fn closures(self) -> Vec<Edge> {
        self.closures
    }
}

/// The path that loops are searched for in.
#[derive(Clone, Copy)]
pub(crate) struct Path<'a> {
    pub submaps: &'a Submaps,
    pub graph: &'a PoseGraph,
    /// The map of each submap. Loops are closed within one map.
    pub map_of: &'a [u16],
}

impl Path<'_> {
    fn is_same_map(&self, one: u32, other: u32) -> bool {
        self.map_of.get(one as usize) == self.map_of.get(other as usize)
    }
}

/// Searches. Its memory follows from the query and the submaps.
pub(crate) struct Closing {
    grid: SearchGrid,
    surfaces: Surfaces,
    drift: Drift,
    /// Submap and piece that grid and surfaces were made for.
    made_for: Option<(u32, u32)>,
}

impl Closing {
    pub(crate) fn new() -> Self {
        Self {
            grid: SearchGrid::new(),
            surfaces: Surfaces::new(),
            drift: Drift::default(),
            made_for: None,
        }
    }

    /// The query has been restored: grid and surfaces belong to another one.
    pub(crate) fn forget(&mut self) {
        self.made_for = None;
    }

    /// Chooses the pieces of path where a finished submap may be.
    pub(crate) fn query(&mut self, submap: u32, path: &Path<'_>) -> Query {
        let Path { submaps, graph, .. } = *path;
        let poses = graph.poses();
        let here = poses[submap as usize];
        let keyframe = submaps.all()[submap as usize].keyframe;
        let covariances = self.drift.from(graph, submap);
        let mut likely: Vec<(f64, u32)> = Vec::new();
        for (index, covariance) in covariances.iter().enumerate() {
            let Some(covariance) = covariance else { continue };
            let other = &submaps.all()[index];
            let apart = keyframe.saturating_sub(other.keyframe);
            let is_near = apart < MIN_KEYFRAMES_APART || other.stretches.is_empty();
            if is_near || !path.is_same_map(submap, index as u32) {
                continue;
            }
            let drift_m = (covariance[(0, 0)] + covariance[(1, 1)]).sqrt();
            let distance_m = poses[index].distance_m(&here);
            if distance_m < REACH_M + 3.0 * drift_m {
                likely.push((distance_m / (drift_m + 1.0), index as u32));
            }
        }
        likely.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let mut middles: Vec<u32> = Vec::new();
        for (_, index) in likely {
            let is_covered = middles.iter().any(|middle| middle.abs_diff(index) <= PIECE);
            if !is_covered && middles.len() < MAX_PIECES {
                middles.push(index);
            }
        }
        let mut pieces = Vec::with_capacity(middles.len());
        for middle in middles.iter().rev() {
            let Some(covariance) = covariances[*middle as usize] else { continue };
            let window = window(*middle, &here, &covariance, path);
            pieces.push(Piece { middle: *middle, window });
        }
        Query { submap, pieces, search: None, closures: Vec::new() }
    }

    /// Goes on with a query. Returns the operations it took; 0 when the query is over.
    pub(crate) fn step(&mut self, query: &mut Query, path: &Path<'_>) -> u64 {
        let Some(Piece { middle, window }) = query.pieces.last().cloned() else { return 0 };
        if self.made_for != Some((query.submap, middle)) {
            self.make(query.submap, middle, path);
        }
        // Counted with the search and not with the work: a restored localizer makes the piece again.
        let mut operations = if query.search.is_none() { PIECE_OPERATIONS } else { 0 };
        let search = query.search.get_or_insert_with(|| Search::new(window));
        if !search.is_done() {
            return operations + self.grid.step(search) + 1000;
        }
        operations += REFINE_OPERATIONS * search.places().len() as u64 + 1;
        let found = self.refine(search, query.submap, path.submaps);
        if let Some(alignment) = found {
            query.closures.push(closure(middle, query.submap, &alignment));
        }
        query.search = None;
        query.pieces.pop();
        if query.closures.len() >= MAX_CLOSURES {
            query.pieces.clear();
        }
        operations
    }

    /// Puts a piece of path into grid and surfaces, in the frame of its middle.
    fn make(&mut self, submap: u32, middle: u32, path: &Path<'_>) {
        let Path { submaps, graph, .. } = *path;
        self.made_for = Some((submap, middle));
        self.grid.clear();
        self.surfaces.clear([0.0; 2]);
        let poses = graph.poses();
        let to_middle = poses[middle as usize].inverse();
        let keyframe = submaps.all()[submap as usize].keyframe;
        for index in middle.saturating_sub(PIECE)..=middle + PIECE {
            let Some(other) = submaps.all().get(index as usize) else { continue };
            let is_near = other.keyframe + MIN_KEYFRAMES_APART > keyframe;
            if is_near || !path.is_same_map(submap, index) {
                continue;
            }
            let pose = to_middle.compose(&poses[index as usize]);
            self.grid.insert(&other.stretches, &pose);
            self.surfaces.insert(&other.stretches, &pose);
        }
        self.grid.finish();
        self.grid.set_query(&submaps.all()[submap as usize].stretches);
    }

    /// The refined pose of the best place, if it is good and has no rival.
    fn refine(&self, search: &Search, submap: u32, submaps: &Submaps) -> Option<Alignment> {
        let stretches = &submaps.all()[submap as usize].stretches;
        let places = search.places().iter();
        let refined =
            places.filter_map(|place| align(&self.surfaces, stretches, &found_prior(&place.pose)));
        let refined: Vec<Alignment> = refined.collect();
        let best = refined.iter().max_by(|a, b| a.fit.share().total_cmp(&b.fit.share()))?;
        let is_good = best.fit.inliers >= MIN_INLIERS
            && best.fit.overlap >= MIN_OVERLAP
            && best.fit.rms_m <= MAX_RMS_M
            && uncertainty_m(&covariance(best)) <= MAX_UNCERTAINTY_M;
        let has_rival = refined.iter().any(|other| {
            other.fit.share() > RIVAL_SHARE * best.fit.share()
                && !is_same_place(&other.pose, &best.pose)
        });
        (is_good && !has_rival).then_some(*best)
    }
}

/// Where the submap at `here` may be in the frame of the middle of a piece: within three standard deviations of where it is
/// believed to be, and so near the piece's path that they see the same.
fn window(middle: u32, here: &Pose2, covariance: &Matrix3<f64>, path: &Path<'_>) -> Window {
    let poses = path.graph.poses();
    let to_middle = poses[middle as usize].inverse();
    let believed = to_middle.compose(here);
    let yaw = covariance[(2, 2)].sqrt();
    let lever_m = believed.x_m.hypot(believed.y_m);
    let drift_m = (covariance[(0, 0)] + covariance[(1, 1)]).sqrt() + lever_m * yaw;
    let reach_m = 3.0 * drift_m + MARGIN_M;
    let mut low = [f64::INFINITY; 2];
    let mut high = [f64::NEG_INFINITY; 2];
    let end = (middle + PIECE).min(poses.len() as u32 - 1);
    let piece = middle.saturating_sub(PIECE)..=end;
    for index in piece.filter(|index| path.is_same_map(middle, *index)) {
        let there = to_middle.compose(&poses[index as usize]);
        for (axis, value) in [there.x_m, there.y_m].into_iter().enumerate() {
            low[axis] = low[axis].min(value - REACH_M);
            high[axis] = high[axis].max(value + REACH_M);
        }
    }
    let mut middle_m = [0.0; 2];
    let mut half_m = [0.0; 2];
    for (axis, value) in [believed.x_m, believed.y_m].into_iter().enumerate() {
        let from = low[axis].max(value - reach_m);
        let to = high[axis].min(value + reach_m).max(from);
        middle_m[axis] = 0.5 * (from + to);
        half_m[axis] = 0.5 * (to - from);
    }
    Window {
        middle: Pose2::new(middle_m[0], middle_m[1], believed.yaw_rad),
        half_m,
        radians: 3.0 * yaw + MARGIN_RAD,
    }
}

/// Covariance of x, y and yaw of an alignment.
fn covariance(alignment: &Alignment) -> Matrix3<f64> {
    // Along a corridor the information is nothing, and its inverse 30 m.
    let floor = Matrix3::from_diagonal_element(1e-3);
    (alignment.information + floor).try_inverse().unwrap_or_else(Matrix3::zeros)
}

/// The standard deviation of the position in the direction in which it is largest, metres.
fn uncertainty_m(covariance: &Matrix3<f64>) -> f64 {
    let half_sum = 0.5 * (covariance[(0, 0)] + covariance[(1, 1)]);
    let half_difference = 0.5 * (covariance[(0, 0)] - covariance[(1, 1)]);
    (half_sum + half_difference.hypot(covariance[(0, 1)])).sqrt()
}

fn closure(from: u32, to: u32, alignment: &Alignment) -> Edge {
    let slack = nalgebra::Vector3::new(
        CLOSURE_M * CLOSURE_M,
        CLOSURE_M * CLOSURE_M,
        CLOSURE_RAD * CLOSURE_RAD,
    );
    let covariance = covariance(alignment) + Matrix3::from_diagonal(&slack);
    let information = covariance.try_inverse().unwrap_or_else(Matrix3::zeros);
    Edge { from, to, t_from_to: alignment.pose, information, weight: 1.0 }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Rotation2, Vector2};
    use proptest::prelude::*;

    use super::super::matcher::ScanFit;
    use super::*;

    proptest! {
        #[test]
        fn the_uncertainty_is_that_along_the_corridor_whichever_way_it_leads(
            heading_rad in -4.0..4.0, along_m in 0.01..2.0_f64, across_m in 0.001..0.01_f64
        ) {
            let rotation = Rotation2::new(heading_rad).matrix().clone_owned();
            let sigma = nalgebra::Matrix2::from_diagonal(&Vector2::new(along_m.powi(2), across_m.powi(2)));
            let position = rotation * sigma * rotation.transpose();
            let mut covariance = Matrix3::identity();
            covariance.fixed_view_mut::<2, 2>(0, 0).copy_from(&position);
            prop_assert!((uncertainty_m(&covariance) - along_m).abs() < 1e-6);
        }
    }

    #[test]
    fn where_nothing_is_known_along_a_corridor_the_uncertainty_is_tens_of_metres() {
        let information = Matrix3::from_diagonal(&nalgebra::Vector3::new(0.0, 1e6, 1e6));
        let fit = ScanFit::default();
        let alignment = Alignment { pose: Pose2::IDENTITY, information, fit };
        assert!(uncertainty_m(&covariance(&alignment)) > 30.0);
    }
}
