//! The policy's view of the map: what can be reached, what is worth looking at, and the way there.

use hal::Pose2;
use rand::RngExt;
use rand_pcg::Pcg64Mcg;

use super::choose::Candidate;
use crate::mapping::{
    Cell, CellState, Frontier, FrontierFinder, OccupancyGrid, SingleFrameMap, inconsistencies,
};
use crate::planning::{ConfigError, Costmap, NoPath, PlanConfig, Planner, Reach};

/// A frontier's approach cell may lie in an obstacle's margin: the reachable cell nearest to it within this is taken, metres.
const APPROACH_WITHIN_M: f64 = 0.5;
/// An inconsistent place is looked at from floor at most this far away, metres.
const LOOK_FROM_M: f64 = 1.5;
/// Inconsistent places smaller than this are noise, cells.
const SMALLEST_INCONSISTENCY: usize = 4;
/// A goal that has become blocked is moved to passable floor at most this far away, metres.
const GOAL_MOVES_M: f64 = 0.3;
/// Cells drawn at random to find one reachable place.
const DRAWS_PER_PLACE: usize = 32;

/// Costmap, search and frontier finder with their memory.
pub(super) struct Navigator {
    costmap: Costmap,
    planner: Planner,
    finder: FrontierFinder,
    frontiers: Vec<Frontier>,
}

/// What can be reached from where the robot stands.
pub(super) struct Survey<'a> {
    reach: Reach<'a>,
    frontiers: &'a [Frontier],
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

    /// Looks at the whole map: costs, frontiers, and the distance to everywhere. Marks of at most `doubt` log-odds are in
    /// nobody's way.
    pub(super) fn survey(
        &mut self,
        map: &OccupancyGrid,
        pose: &Pose2,
        doubt: f32,
    ) -> Result<Survey<'_>, NoPath> {
        self.costmap.update_doubting(map, doubt);
        self.finder.find(map, FrontierFinder::MIN_CELLS, &mut self.frontiers);
        let start = map.cell_at(pose.x_m, pose.y_m);
        let reach = self.planner.flood(&self.costmap, start)?;
        Ok(Survey { reach, frontiers: &self.frontiers, cell_m: map.cell_m() })
    }

    /// The way to a place in `odom`, as corner points, metres; `doubt` as for [`survey`](Self::survey).
    pub(super) fn plan(
        &mut self,
        map: &OccupancyGrid,
        pose: &Pose2,
        goal_m: [f64; 2],
        doubt: f32,
    ) -> Result<Vec<[f64; 2]>, NoPath> {
        self.costmap.update_doubting(map, doubt);
        let start = map.cell_at(pose.x_m, pose.y_m);
        let wanted = map.cell_at(goal_m[0], goal_m[1]);
        let goal =
            self.costmap.nearest_passable(wanted, GOAL_MOVES_M).ok_or(NoPath::GoalBlocked)?;
        let path = self.planner.plan(&self.costmap, start, goal)?;
        Ok(self.costmap.shorten(path))
    }
}

impl Survey<'_> {
    /// Every frontier with the way to it.
    pub(super) fn frontiers(&self) -> Vec<Candidate> {
        self.frontiers
            .iter()
            .map(|frontier| {
                let approach = self.reach.nearest(frontier.approach, APPROACH_WITHIN_M);
                Candidate {
                    target_m: approach.unwrap_or(frontier.approach).center_m(self.cell_m),
                    interest_m: frontier.centroid_m,
                    size_m: frontier.cells as f64 * self.cell_m,
                    travel_m: approach.and_then(|cell| self.reach.distance_m(cell)),
                }
            })
            .collect()
    }

    /// Places that two looks disagree about, largest first, each with the way to floor from where it can be looked at.
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
                let look_from = self.reach.nearest(cell, LOOK_FROM_M);
                Candidate {
                    target_m: look_from.unwrap_or(cell).center_m(self.cell_m),
                    interest_m: place.centroid_m,
                    size_m: place.cells as f64 * self.cell_m,
                    travel_m: look_from.and_then(|cell| self.reach.distance_m(cell)),
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
