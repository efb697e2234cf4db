//! The accuracy of a map, measured against the true home.

use hal::Pose2;
use runtime::mapping::{CellState, OccupancyGrid};
use simulator::floor::FloorPlan;

use crate::evaluation::Evaluation;
use crate::report::alignment;
use crate::report::coverage::Coverage;
use crate::report::summary::{MapError, Summary};

/// A cell of the map is right if the true home has the same state within this distance, metres.
const RIGHT_M: f64 = 0.15;
/// Occupied cells farther than this from any true obstacle are wrong, metres.
const OFF_M: f64 = 0.1;
/// Distances are searched up to this, metres. Farther ones count as this far.
const REACH_M: f64 = 1.0;

/// Number of cells that determine the fit. More do not change it by a millimetre.
const FIT_CELLS: usize = 1000;
/// Number of cells for the choice among the start poses.
const COARSE_FIT_CELLS: usize = 150;
/// Start poses of the fit, relative to the given one: x and y in metres, yaw in radians.
const FIT_STARTS: [[f64; 3]; 7] = [
    [0.0, 0.0, 0.0],
    [0.5, 0.0, 0.0],
    [-0.5, 0.0, 0.0],
    [0.0, 0.5, 0.0],
    [0.0, -0.5, 0.0],
    [0.0, 0.0, 0.15],
    [0.0, 0.0, -0.15],
];
/// The fit uses this share of the pairs, the nearest ones: the others have no true partner.
const FIT_SHARE: f64 = 0.8;
/// Maximum number of rounds of the fit, which converges slowly along walls.
const FIT_ROUNDS: usize = 100;
/// The fit ends when a round moves the map by less than this, metres and radians.
const FIT_STEP: f64 = 1e-4;
/// Largest distance of a pair in the fit, metres.
const FIT_REACH_M: f64 = 0.7;

/// The accuracy of a map. Obstacles are all surfaces between 6 cm and 1.5 m above the floor.
#[derive(Debug, Clone, Copy, PartialEq)]
struct MapAccuracy {
    /// Share of the reachable floor that the map shows correctly when only the start pose is aligned: as free, or as
    /// occupied with a true obstacle within 0.15 m. Unlike `coverage`, it falls when the map shows floor at a wrong
    /// position.
    coverage_true: f64,
    /// Share of the occupied cells that are more than 10 cm from any true obstacle, after the best
    /// rigid fit.
    off10: Option<f64>,
    /// Distances after the best rigid fit: of every occupied cell to the nearest true obstacle, and
    /// of every true obstacle beside mapped floor to the nearest occupied cell, together.
    error_m: Option<MapError>,
    /// Intersection over union of the floor after the best rigid fit: what the map calls free,
    /// against the true floor without obstacles. Reachable floor that was never mapped is left out.
    iou: Option<f64>,
}

/// Measures the map at the end of a run and fills in the summary's keys.
pub(super) fn summarise(
    evaluation: &Evaluation,
    map: &OccupancyGrid,
    plan: &FloorPlan,
    summary: &mut Summary,
) {
    let Some(coverage) = evaluation.coverage() else { return };
    let accuracy = Judge::new(map, plan, coverage).measure(&evaluation.t_world_map());
    summary.coverage_true = Some(accuracy.coverage_true);
    summary.map_off10 = accuracy.off10;
    summary.map_error_m = accuracy.error_m;
    summary.map_iou = accuracy.iou;
}

/// A rigid fit of the map.
struct Fit {
    t_world_map: Pose2,
    /// Mean distance of the pairs that it was made from.
    mean_m: f64,
}

/// An occupied cell, in the map, and the point of a true obstacle, in the world.
struct Pair {
    cell_m: [f64; 2],
    near_m: Option<[f64; 2]>,
    distance_m: f64,
}

/// The map and the true home.
struct Judge<'a> {
    map: &'a OccupancyGrid,
    plan: &'a FloorPlan,
    coverage: &'a Coverage,
    /// Centres of the occupied cells in the map, metres.
    occupied_m: Vec<[f64; 2]>,
}

impl<'a> Judge<'a> {
    pub fn new(map: &'a OccupancyGrid, plan: &'a FloorPlan, coverage: &'a Coverage) -> Self {
        let occupied_m = map
            .known_cells()
            .filter(|(cell, _)| map.state(*cell) == CellState::Occupied)
            .map(|(cell, _)| map.center_m(cell))
            .collect();
        Self { map, plan, coverage, occupied_m }
    }

    /// Measures the map. `t_world_map` aligns the start pose.
    pub fn measure(&self, t_world_map: &Pose2) -> MapAccuracy {
        let fitted = self.fit(t_world_map);
        let to_truth = self.errors_of_cells(&fitted);
        let off = to_truth.iter().filter(|distance| **distance > OFF_M).count();
        let off10 = (!to_truth.is_empty()).then(|| off as f64 / to_truth.len() as f64);
        let errors = [to_truth, self.errors_of_walls(&fitted)].concat();
        MapAccuracy {
            coverage_true: self.coverage_true(t_world_map),
            off10,
            error_m: MapError::of(errors),
            iou: self.iou(&fitted),
        }
    }

    /// The pose `t_world_map` in which the occupied cells are nearest to true obstacles. A fit ends in a local minimum,
    /// so it is started from several poses around `start`.
    fn fit(&self, start: &Pose2) -> Pose2 {
        let coarse = FIT_STARTS
            .iter()
            .map(|[x_m, y_m, yaw_rad]| start.compose(&Pose2::new(*x_m, *y_m, *yaw_rad)))
            .map(|start| self.fit_from(start, COARSE_FIT_CELLS))
            .min_by(|a, b| a.mean_m.total_cmp(&b.mean_m));
        let nearest = coarse.map_or(*start, |fit| fit.t_world_map);
        self.fit_from(nearest, FIT_CELLS).t_world_map
    }

    /// Iterated closest points (Besl and McKay 1992), trimmed (Chetverikov et al. 2002).
    fn fit_from(&self, start: Pose2, cells: usize) -> Fit {
        let stride = self.occupied_m.len().div_ceil(cells).max(1);
        let mut fit = Fit { t_world_map: start, mean_m: f64::INFINITY };
        for _ in 0..FIT_ROUNDS {
            let mut pairs: Vec<_> = self
                .occupied_m
                .iter()
                .step_by(stride)
                .map(|cell| self.pair(&fit.t_world_map, *cell))
                .collect();
            pairs.sort_by(|a, b| a.distance_m.total_cmp(&b.distance_m));
            pairs.truncate((FIT_SHARE * pairs.len() as f64).ceil() as usize);
            fit.mean_m = pairs.iter().map(|pair| pair.distance_m).sum::<f64>() / pairs.len() as f64;
            let points: Vec<_> =
                pairs.iter().filter_map(|pair| Some((pair.near_m?, pair.cell_m))).collect();
            let Some(next) = alignment::fit(&points) else { break };
            let step = fit.t_world_map.inverse().compose(&next);
            fit.t_world_map = next;
            if step.x_m.hypot(step.y_m) < FIT_STEP && step.yaw_rad.abs() < FIT_STEP {
                break;
            }
        }
        fit
    }

    /// An occupied cell and the true obstacle nearest to it.
    fn pair(&self, t_world_map: &Pose2, cell_m: [f64; 2]) -> Pair {
        let (x_m, y_m) = t_world_map.transform(cell_m[0], cell_m[1]);
        match self.plan.nearest_surface(x_m, y_m, FIT_REACH_M) {
            Some((near_m, distance_m)) => Pair { cell_m, near_m: Some(near_m), distance_m },
            None => Pair { cell_m, near_m: None, distance_m: FIT_REACH_M },
        }
    }

    fn errors_of_cells(&self, t_world_map: &Pose2) -> Vec<f64> {
        self.occupied_m
            .iter()
            .map(|cell| {
                let (x_m, y_m) = t_world_map.transform(cell[0], cell[1]);
                self.plan.nearest_surface(x_m, y_m, REACH_M).map_or(REACH_M, |(_, d)| d)
            })
            .collect()
    }

    /// True obstacles beside mapped floor: the obstacle point nearest to the centre of each mapped
    /// cell that touches a blocked one.
    fn errors_of_walls(&self, t_world_map: &Pose2) -> Vec<f64> {
        let t_map_world = t_world_map.inverse();
        let beside_m = 1.5 * self.plan.grid().resolution_m;
        self.mapped_floor()
            .filter_map(|[x_m, y_m]| {
                let ([x_m, y_m], _) = self.plan.nearest_surface(x_m, y_m, beside_m)?;
                Some(self.to_occupied_m(t_map_world.transform(x_m, y_m)))
            })
            .collect()
    }

    /// Distance from a point of the map to the centre of the nearest occupied cell, metres.
    fn to_occupied_m(&self, (x_m, y_m): (f64, f64)) -> f64 {
        let reach = (REACH_M / self.map.cell_m()).ceil() as i32;
        let center = self.map.cell_at(x_m, y_m);
        let mut nearest_m = REACH_M;
        for ring in 0..=reach {
            // Cells of this ring and beyond are at least this far.
            if (f64::from(ring) - 0.5) * self.map.cell_m() > nearest_m {
                break;
            }
            for (dx, dy) in ring_offsets(ring) {
                let cell = center.offset(dx, dy);
                if self.map.state(cell) == CellState::Occupied {
                    let [cx, cy] = self.map.center_m(cell);
                    nearest_m = nearest_m.min((cx - x_m).hypot(cy - y_m));
                }
            }
        }
        nearest_m
    }

    fn coverage_true(&self, t_world_map: &Pose2) -> f64 {
        let t_map_world = t_world_map.inverse();
        let right = self
            .mapped_floor()
            .filter(|[x_m, y_m]| {
                let (map_x_m, map_y_m) = t_map_world.transform(*x_m, *y_m);
                match self.map.state_at(map_x_m, map_y_m) {
                    CellState::Unknown => false,
                    CellState::Free => true,
                    CellState::Occupied => self.plan.nearest_surface(*x_m, *y_m, RIGHT_M).is_some(),
                }
            })
            .count();
        right as f64 / self.coverage.reachable_cells().max(1) as f64
    }

    fn iou(&self, t_world_map: &Pose2) -> Option<f64> {
        let t_map_world = t_world_map.inverse();
        let grid = self.plan.grid();
        let mut both = 0_u64;
        let mut either = 0_u64;
        for index in 0..grid.cells() {
            let [x_m, y_m] = grid.center(index);
            let (map_x_m, map_y_m) = t_map_world.transform(x_m, y_m);
            let mapped_free = self.map.state_at(map_x_m, map_y_m) == CellState::Free;
            let truly_free = self.plan.is_supported(x_m, y_m) && !self.plan.is_blocked(x_m, y_m);
            both += u64::from(mapped_free && truly_free);
            either += u64::from(mapped_free || self.coverage.is_mapped(index));
        }
        (either > 0).then(|| both as f64 / either as f64)
    }

    /// Centres of the cells of reachable floor that were mapped, in the world, metres.
    fn mapped_floor(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        let grid = self.plan.grid();
        (0..grid.cells())
            .filter(|index| self.coverage.is_mapped(*index))
            .map(|index| grid.center(index))
    }
}

/// The cells of a square ring around a cell.
fn ring_offsets(ring: i32) -> impl Iterator<Item = (i32, i32)> {
    (-ring..=ring).flat_map(move |dy| {
        let step = if dy.abs() == ring { 1 } else { (2 * ring).max(1) };
        (-ring..=ring).step_by(step as usize).map(move |dx| (dx, dy))
    })
}

#[cfg(test)]
mod tests {
    use hal::{Base, Clock, DriveCommand, LaserScan, Lidar, ScanGeometry, Twist2};
    use runtime::mapping::{LidarUse, MapConfig, Sweep};
    use simulator::laser::LaserModel;
    use simulator::{OpenOptions, RobotOptions, SimulatedRobot, World};
    use std::sync::{Arc, LazyLock};

    use super::*;

    static HOME: LazyLock<Arc<World>> = LazyLock::new(|| {
        Arc::new(World::open("builtin:apartment?seed=1", &OpenOptions::default()).unwrap())
    });

    /// Exact scans from places all over the home, with the true poses of their middles, while the robots rotate.
    fn scans(geometry: ScanGeometry, angular_radps: f64) -> Vec<(Pose2, LaserScan)> {
        (0..40)
            .map(|seed| {
                let start = HOME.floor_plan().random_pose(seed);
                let options = RobotOptions {
                    laser: LaserModel { geometry, ..LaserModel::IDEAL },
                    start: Some(start),
                    ..RobotOptions::default()
                };
                let mut devices = SimulatedRobot::new(HOME.clone(), options).unwrap().devices();
                let twist = Twist2 { linear_mps: 0.0, angular_radps };
                devices.base.drive(&DriveCommand { twist, counter: 1, plan_age_ns: 0 }).unwrap();
                devices.clock.sleep_until_ns(200_000_000);
                let mut scan = LaserScan::empty(geometry);
                devices.lidar.poll_scan(&mut scan).unwrap();
                (devices.truth.pose_at(scan.middle_ns()), scan)
            })
            .collect()
    }

    /// The map of the scans with this velocity at the poses that `believe` makes of the true ones, and the coverage.
    fn mapped(
        scans: &[(Pose2, LaserScan)],
        twist: &Twist2,
        believe: impl Fn(usize, &Pose2) -> Pose2,
    ) -> (OccupancyGrid, Coverage) {
        let config = MapConfig { lidar: LidarUse::HitsAndFree, decay: 1.0, ..MapConfig::default() };
        let mut map = OccupancyGrid::new(&config).unwrap();
        let plan = HOME.floor_plan();
        let grid = plan.grid();
        let reachable = super::super::map_plot::reachable_cells(plan);
        let mut coverage =
            Coverage::new(reachable, grid.width, grid.origin_m, grid.resolution_m).unwrap();
        for (index, (truth, scan)) in scans.iter().enumerate() {
            let believed = believe(index, truth);
            let t_world_map = truth.compose(&believed.inverse());
            for _ in 0..4 {
                map.begin_update(&believed).unwrap();
                let sweep = Sweep::new(&believed, &Pose2::IDENTITY, twist);
                map.integrate_scan(scan, &sweep).unwrap();
                map.finish_update();
                for cell in map.newly_known() {
                    let [x_m, y_m] = map.center_m(*cell);
                    let (x_m, y_m) = t_world_map.transform(x_m, y_m);
                    coverage.mark(x_m, y_m, map.cell_m());
                }
            }
        }
        (map, coverage)
    }

    fn measure(
        t_world_map: &Pose2,
        believe: impl Fn(usize, &Pose2) -> Pose2,
    ) -> (MapAccuracy, f64) {
        let scans = scans(ScanGeometry::UTM_30LX, 0.0);
        let (map, coverage) = mapped(&scans, &Twist2::ZERO, believe);
        let accuracy = Judge::new(&map, HOME.floor_plan(), &coverage).measure(t_world_map);
        (accuracy, coverage.share())
    }

    #[test]
    fn a_map_of_true_scans_at_true_poses_is_right() {
        let (accuracy, coverage) = measure(&Pose2::IDENTITY, |_, truth| *truth);
        assert!(coverage > 0.5, "{coverage}");
        assert!(accuracy.coverage_true > 0.99 * coverage, "{accuracy:?}");
        assert!(accuracy.off10.unwrap() < 0.01, "{accuracy:?}");
        assert!(accuracy.error_m.unwrap().p50 < 0.03, "{accuracy:?}");
        assert!(accuracy.iou.unwrap() > 0.85, "{accuracy:?}");
    }

    /// At 40 degrees per second an LD06 measures its last beam .035 rad after the middle of a scan.
    #[test]
    fn a_robot_that_rotates_with_a_slow_scanner_has_the_map_of_one_that_stands() {
        let rotates = Twist2 { linear_mps: 0.0, angular_radps: 0.7 };
        let scans = scans(ScanGeometry::LD06, rotates.angular_radps);
        let error_m = |twist: &Twist2| {
            let (map, coverage) = mapped(&scans, twist, |_, truth| *truth);
            let judge = Judge::new(&map, HOME.floor_plan(), &coverage);
            judge.measure(&Pose2::IDENTITY).error_m.unwrap()
        };
        let right = error_m(&rotates);
        assert!(right.p50 < 0.007 && right.p90 < 0.027, "{right:?}");
        let motion_left_in = error_m(&Twist2::ZERO);
        assert!(motion_left_in.p50 > 0.009 && motion_left_in.p90 > 0.03, "{motion_left_in:?}");
    }

    #[test]
    fn the_frame_of_the_map_does_not_matter() {
        let t_map_world = Pose2::new(3.0, -1.0, 0.8);
        let (moved, _) = measure(&t_map_world.inverse(), |_, truth| t_map_world.compose(truth));
        let (still, _) = measure(&Pose2::IDENTITY, |_, truth| *truth);
        assert!((moved.coverage_true - still.coverage_true).abs() < 0.01);
        assert!((moved.error_m.unwrap().p50 - still.error_m.unwrap().p50).abs() < 0.005);
    }

    #[test]
    fn a_wrong_start_pose_costs_true_coverage_only() {
        // The shape of the map is right, but it lies 0.6 m beside the home.
        let beside = Pose2::new(0.35, 0.5, 0.0);
        let (accuracy, coverage) = measure(&beside, |_, truth| *truth);
        assert!(accuracy.coverage_true < coverage - 0.03, "{accuracy:?} of {coverage}");
        assert!(accuracy.error_m.unwrap().p50 < 0.03, "the fit moves it back: {accuracy:?}");
        assert!(accuracy.off10.unwrap() < 0.02, "{accuracy:?}");
    }

    #[test]
    fn rooms_at_wrong_places_are_wrong_after_any_fit() {
        let (accuracy, coverage) = measure(&Pose2::IDENTITY, |index, truth| {
            let drift = if index % 2 == 0 { 0.0 } else { 0.5 };
            Pose2::new(truth.x_m + drift, truth.y_m - drift, truth.yaw_rad)
        });
        assert!(accuracy.off10.unwrap() > 0.2, "{accuracy:?}");
        assert!(accuracy.error_m.unwrap().p90 > 0.2, "{accuracy:?}");
        assert!(accuracy.coverage_true < coverage - 0.04, "{accuracy:?} of {coverage}");
        assert!(accuracy.iou.unwrap() < 0.85, "{accuracy:?}");
    }
}
