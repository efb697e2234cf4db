//! The policy's view of the map: reachable places, goal candidates, and the path to a place.

use hal::Pose2;
use rand::RngExt;
use rand_pcg::Pcg64Mcg;

use super::choose::Candidate;
use crate::mapping::{
    Cell, CellState, Frontier, FrontierFinder, OccupancyGrid, SingleFrameMap, inconsistencies,
};
use crate::planning::{ConfigError, Costmap, KeepOut, NoPath, PlanConfig, Planner, Reach};

/// A frontier's approach cell may lie in an obstacle's margin. The nearest reachable cell within
/// this radius replaces it, metres.
const APPROACH_RADIUS_M: f64 = 0.5;
/// An inconsistent place is observed from reachable floor at most this far away, metres.
const VIEWPOINT_RADIUS_M: f64 = 1.5;
/// Inconsistent places with fewer cells than this are noise.
const SMALLEST_INCONSISTENCY: usize = 4;
/// A goal that has become blocked is replaced by passable floor at most this far away, metres.
const GOAL_SHIFT_M: f64 = 0.3;
/// At most this many cells are drawn at random for each reachable place.
const DRAWS_PER_PLACE: usize = 32;

/// Costmap, path search and frontier search with their buffers.
pub(super) struct Navigator {
    costmap: Costmap,
    planner: Planner,
    finder: FrontierFinder,
    frontiers: Vec<Frontier>,
}

/// The places that can be reached from the robot's pose.
pub(super) struct Survey<'a> {
    reach: Reach<'a>,
    frontiers: &'a [Frontier],
    keep_out: &'a KeepOut,
    cell_m: f64,
}

impl Navigator {
    pub(super) fn new(config: &PlanConfig) -> Result<Self, ConfigError> {
        Ok(Self {
            costmap: Costmap::new(config)?,
            planner: Planner::new(config.max_expanded),
            finder: FrontierFinder::default(),
            frontiers: Vec::new(),
        })
    }

    /// Computes the costmap, the frontiers and the distance to every reachable cell. Occupied cells
    /// with at most `doubtful_log_odds` count as unknown.
    pub(super) fn survey(
        &mut self,
        map: &OccupancyGrid,
        pose: &Pose2,
        doubtful_log_odds: f32,
    ) -> Result<Survey<'_>, NoPath> {
        self.costmap.update_with_doubt(map, doubtful_log_odds);
        self.finder.find(map, FrontierFinder::MIN_CELLS, &mut self.frontiers);
        let start = map.cell_at(pose.x_m, pose.y_m);
        let reach = self.planner.flood(&self.costmap, start)?;
        Ok(Survey {
            reach,
            frontiers: &self.frontiers,
            keep_out: self.costmap.keep_out(),
            cell_m: map.cell_m(),
        })
    }

    /// The areas that a person has closed.
    pub(super) fn keep_out(&self) -> &KeepOut {
        self.costmap.keep_out()
    }

    /// The path to a place in `odom` as corner points, metres; `doubtful_log_odds` as for
    /// [`survey`](Self::survey).
    pub(super) fn plan(
        &mut self,
        map: &OccupancyGrid,
        pose: &Pose2,
        goal_m: [f64; 2],
        doubtful_log_odds: f32,
    ) -> Result<Vec<[f64; 2]>, NoPath> {
        self.costmap.update_with_doubt(map, doubtful_log_odds);
        let start = map.cell_at(pose.x_m, pose.y_m);
        let desired = map.cell_at(goal_m[0], goal_m[1]);
        let goal =
            self.costmap.nearest_passable(desired, GOAL_SHIFT_M).ok_or(NoPath::GoalBlocked)?;
        let path = self.planner.plan(&self.costmap, start, goal)?;
        Ok(self.costmap.shorten(path))
    }
}

impl Survey<'_> {
    /// Every frontier outside of closed areas, with the length of the path to it.
    pub(super) fn frontiers(&self) -> Vec<Candidate> {
        self.frontiers
            .iter()
            .filter(|frontier| {
                let approach_m = frontier.approach.center_m(self.cell_m);
                !self.keep_out.contains(frontier.centroid_m) && !self.keep_out.contains(approach_m)
            })
            .map(|frontier| {
                let approach = self.reach.nearest(frontier.approach, APPROACH_RADIUS_M);
                Candidate {
                    target_m: approach.unwrap_or(frontier.approach).center_m(self.cell_m),
                    interest_m: frontier.centroid_m,
                    size_m: frontier.cells as f64 * self.cell_m,
                    travel_m: approach.and_then(|cell| self.reach.distance_m(cell)),
                }
            })
            .collect()
    }

    /// Places about which two single-frame maps disagree, the largest first, each with a viewpoint
    /// and the length of the path to it.
    pub(super) fn inconsistencies(
        &self,
        new: &SingleFrameMap,
        old: &SingleFrameMap,
    ) -> Vec<Candidate> {
        inconsistencies(new, old, self.cell_m)
            .iter()
            .filter(|place| place.cells >= SMALLEST_INCONSISTENCY)
            .map(|place| {
                let cell = Cell::containing(place.centroid_m[0], place.centroid_m[1], self.cell_m);
                let viewpoint = self.reach.nearest(cell, VIEWPOINT_RADIUS_M);
                Candidate {
                    target_m: viewpoint.unwrap_or(cell).center_m(self.cell_m),
                    interest_m: place.centroid_m,
                    size_m: place.cells as f64 * self.cell_m,
                    travel_m: viewpoint.and_then(|cell| self.reach.distance_m(cell)),
                }
            })
            .collect()
    }

    /// Reachable places drawn at random, at most `count`.
    pub(super) fn random_places(
        &self,
        count: usize,
        map: &OccupancyGrid,
        rng: &mut Pcg64Mcg,
    ) -> Vec<[f64; 2]> {
        let Some(known) = map.known_box() else { return Vec::new() };
        let mut places = Vec::with_capacity(count);
        for _ in 0..count * DRAWS_PER_PLACE {
            let x = rng.random_range(0..known.width() as i32);
            let y = rng.random_range(0..known.height() as i32);
            let cell = known.min.offset(x, y);
            if map.state(cell) == CellState::Free && self.reach.distance_m(cell).is_some() {
                places.push(cell.center_m(self.cell_m));
                if places.len() == count {
                    break;
                }
            }
        }
        places
    }
}
