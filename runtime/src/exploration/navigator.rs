//! The policy's view of the map: reachable places, goal candidates, and the path to a place.

use hal::Pose2;
use rand::RngExt;
use rand_pcg::Pcg64Mcg;

use super::blacklist::distance_m;
use super::choose::Candidate;
use super::unseen::unseen_m2;
use crate::mapping::{
    Cell, CellState, Frontier, FrontierFinder, OccupancyGrid, SingleFrameMap, inconsistencies,
};
use crate::planning::{
    ConfigError, Costmap, Follower, KeepOut, NoPath, PlanConfig, Planner, Reach,
};
use crate::snapshot::remembers;
use crate::task::AreaChange;

/// A frontier's approach cell may lie in an obstacle's margin. The nearest reachable cell within
/// this radius replaces it, metres.
const APPROACH_RADIUS_M: f64 = 0.5;
/// A frontier still exists while unknown floor meets free floor within this distance of its place, metres.
pub(super) const FRONTIER_RADIUS_M: f64 = 0.45;
/// An inconsistent place is observed from reachable floor at most this far away, metres.
const VIEWPOINT_RADIUS_M: f64 = 1.5;
/// Inconsistent places with fewer cells than this are noise.
const SMALLEST_INCONSISTENCY: usize = 4;
/// A goal that has become blocked is replaced by passable floor at most this far away, metres.
const GOAL_SHIFT_M: f64 = 0.3;
/// The robot stays on its path until another one costs less by this factor. In four simulated homes of 2,000 frames each it then
/// drove 115 m; with a new path every second, 99 m, because it rotated instead.
const KEEP_PATH_FACTOR: f64 = 1.15;
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
    map: &'a OccupancyGrid,
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
    pub(super) fn survey<'a>(
        &'a mut self,
        map: &'a OccupancyGrid,
        pose: &Pose2,
        doubtful_log_odds: f32,
    ) -> Result<Survey<'a>, NoPath> {
        self.costmap.update_with_doubt(map, doubtful_log_odds);
        self.finder.find(map, FrontierFinder::MIN_CELLS, &mut self.frontiers);
        let start = map.cell_at(pose.x_m, pose.y_m);
        let reach = self.planner.flood(&self.costmap, start)?;
        Ok(Survey {
            reach,
            frontiers: &self.frontiers,
            keep_out: self.costmap.keep_out(),
            map,
            cell_m: map.cell_m(),
        })
    }

    /// Closes or opens areas.
    pub(super) fn change_areas(&mut self, change: AreaChange) {
        self.costmap.change_areas(change);
    }

    /// The areas that a person has closed.
    pub(super) fn keep_out(&self) -> &KeepOut {
        self.costmap.keep_out()
    }

    /// Gives the follower a path to a place in `map`, metres; `doubtful_log_odds` as for
    /// [`survey`](Self::survey).
    ///
    /// The follower keeps its path while that one is passable and nearly as good as the best. Two
    /// ways of nearly the same cost would otherwise alternate in being the best, as the map changes, and the
    /// robot would rotate from one to the other without driving either.
    ///
    /// # Errors
    /// The reason why there is no path. The follower then keeps its path.
    pub(super) fn plan(
        &mut self,
        map: &OccupancyGrid,
        pose: &Pose2,
        goal_m: [f64; 2],
        doubtful_log_odds: f32,
        follower: &mut Follower,
    ) -> Result<(), NoPath> {
        self.costmap.update_with_doubt(map, doubtful_log_odds);
        let start = map.cell_at(pose.x_m, pose.y_m);
        let desired = map.cell_at(goal_m[0], goal_m[1]);
        let goal =
            self.costmap.nearest_passable(desired, GOAL_SHIFT_M).ok_or(NoPath::GoalBlocked)?;
        let best_m = self.costmap.shorten(self.planner.plan(&self.costmap, start, goal)?);
        let current_m = follower.rest_of_path_m([pose.x_m, pose.y_m]);
        if self.is_nearly_as_good(&current_m, &best_m) {
            return Ok(());
        }
        follower.set_path(&best_m).map_err(|_| NoPath::Unreachable)
    }

    /// Whether the current path still leads to the end of the best one, at nearly its cost.
    fn is_nearly_as_good(&self, current_m: &[[f64; 2]], best_m: &[[f64; 2]]) -> bool {
        let (Some(current_end_m), Some(best_end_m)) = (current_m.last(), best_m.last()) else {
            return false;
        };
        let same_end = distance_m(*current_end_m, *best_end_m) < self.costmap.cell_m();
        let current_cost_m = self.costmap.path_cost_m(current_m);
        let best_cost_m = self.costmap.path_cost_m(best_m);
        match (current_cost_m, best_cost_m) {
            (Some(current), Some(best)) => same_end && current <= best * KEEP_PATH_FACTOR,
            _ => false,
        }
    }
}

/// The place to observe of a frontier: its centroid, or where it is approached if it bends around its centroid.
fn place_of(frontier: &Frontier, cell_m: f64) -> [f64; 2] {
    let approach_m = frontier.approach.center_m(cell_m);
    let [x_m, y_m] = frontier.centroid_m;
    let apart_m = (x_m - approach_m[0]).hypot(y_m - approach_m[1]);
    if apart_m + cell_m < FRONTIER_RADIUS_M { frontier.centroid_m } else { approach_m }
}

impl Survey<'_> {
    /// Every frontier outside of closed areas, with the length of the path to it.
    pub(super) fn frontiers(&self) -> Vec<Candidate> {
        self.frontiers
            .iter()
            .filter(|frontier| {
                let approach_m = frontier.approach.center_m(self.cell_m);
                !self.keep_out.forbids(frontier.centroid_m) && !self.keep_out.forbids(approach_m)
            })
            .map(|frontier| {
                let approach = self.reach.nearest(frontier.approach, APPROACH_RADIUS_M);
                let travel_m = approach.and_then(|cell| self.reach.distance_m(cell));
                let seen_from_m = frontier.approach.center_m(self.cell_m);
                Candidate {
                    target_m: approach.unwrap_or(frontier.approach).center_m(self.cell_m),
                    interest_m: place_of(frontier, self.cell_m),
                    size_m: frontier.cells as f64 * self.cell_m,
                    unseen_m2: travel_m.map_or(0.0, |_| unseen_m2(self.map, seen_from_m)),
                    travel_m,
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
                    unseen_m2: 0.0,
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

remembers!(Navigator: costmap);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mapping::{MapConfig, Sweep};
    use crate::planning::FollowerConfig;
    use hal::{LaserScan, Range, ScanGeometry};

    const GOAL_M: [f64; 2] = [1.8, 0.0];

    fn pillar_range_m(bearing_rad: f64, pillar_m: [f64; 3]) -> f32 {
        let [x_m, y_m, radius_m] = pillar_m;
        let along_m = x_m * bearing_rad.cos() + y_m * bearing_rad.sin();
        let off_m = (x_m * bearing_rad.sin() - y_m * bearing_rad.cos()).abs();
        if along_m > 0.0 && off_m < radius_m {
            (along_m - (radius_m.powi(2) - off_m.powi(2)).sqrt()) as f32
        } else {
            2.3
        }
    }

    /// A round hall with a pillar `[x, y, radius]`, seen several times from its middle.
    fn hall(pillar_m: [f64; 3]) -> OccupancyGrid {
        let mut map = OccupancyGrid::new(&MapConfig::default()).unwrap();
        let geometry = ScanGeometry::UTM_30LX;
        for yaw_rad in [0.0, std::f64::consts::PI].repeat(5) {
            let pose = Pose2 { x_m: 0.0, y_m: 0.0, yaw_rad };
            let ranges = (0..geometry.beams)
                .map(|beam| yaw_rad + geometry.angle_rad(beam))
                .map(|bearing_rad| Range::Hit(pillar_range_m(bearing_rad, pillar_m)))
                .collect();
            map.begin_update(&pose).unwrap();
            map.integrate_scan(&LaserScan { time_ns: 0, geometry, ranges }, &Sweep::at_rest(pose))
                .unwrap();
            map.finish_update();
        }
        map
    }

    fn plan(map: &OccupancyGrid, y_m: f64, follower: &mut Follower) {
        let mut navigator = Navigator::new(&PlanConfig::default()).unwrap();
        let pose = Pose2 { x_m: 0.0, y_m, yaw_rad: 0.0 };
        navigator.plan(map, &pose, GOAL_M, 0.0, follower).unwrap();
    }

    /// On which side of the pillar a path passes: the sign of its largest deviation from the x-axis.
    fn side(follower: &Follower) -> f64 {
        let widest = follower.path_m().iter().map(|point_m| point_m[1]);
        widest.max_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap().signum()
    }

    fn follower() -> Follower {
        Follower::new(&FollowerConfig::default()).unwrap()
    }

    #[test]
    fn of_two_ways_of_nearly_the_same_length_the_robot_stays_on_the_one_that_it_has() {
        // The pillar is a little to the right, then a little to the left, as noise moves its cells.
        let right = hall([0.9, -0.01, 0.2]);
        let left = hall([0.9, 0.01, 0.2]);
        let mut fresh = follower();
        plan(&right, 0.0, &mut fresh);
        assert_eq!(side(&fresh), 1.0);
        plan(&left, 0.0, &mut fresh);
        assert_eq!(side(&fresh), 1.0, "the path has flipped to the other side");
        // Without a path the robot takes the better side: the two maps do differ.
        let mut other = follower();
        plan(&left, 0.0, &mut other);
        assert_eq!(side(&other), -1.0);
    }

    #[test]
    fn a_path_that_is_blocked_is_replaced() {
        let mut follower = follower();
        plan(&hall([0.9, -0.05, 0.2]), 0.0, &mut follower);
        let before_m = follower.path_m().to_vec();
        plan(&hall([0.9, 0.25, 0.3]), 0.0, &mut follower);
        assert_eq!(side(&follower), -1.0, "{before_m:?} {:?}", follower.path_m());
    }

    #[test]
    fn a_path_is_replaced_when_a_clearly_shorter_one_opens() {
        let mut follower = follower();
        // A wide pillar forces a detour; then it is gone.
        plan(&hall([0.9, -0.3, 0.7]), 0.0, &mut follower);
        let detour = follower.path_m().len();
        plan(&hall([0.9, -2.0, 0.1]), 0.0, &mut follower);
        assert!(detour > 2 && follower.path_m().len() == 2, "{detour} {:?}", follower.path_m());
    }
}
