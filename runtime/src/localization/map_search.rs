//! Where in the whole map a scan was taken, without any idea of the pose.
//!
//! The map is divided into squares that the search grid covers. In each, branch and bound finds the poses where the scan fits
//! best; each is then refined against the surfaces and examined for contradictions: surfaces that the scan has seen through, and
//! parts of the scan where the map was seen through. The work is divided into small steps.

use hal::{Pose2, wrap_angle};
use serde::{Deserialize, Serialize};

use super::local::found_prior;
use super::matcher::{Alignment, Surfaces, align};
use super::scan_points::Stretch;
use super::search_grid::{Search, SearchGrid, Window};
use super::seen_through::Sight;
use super::submaps::Submap;

/// Side of a square at most, metres. The search grid reaches 8 m beyond it.
const SQUARE_M: f64 = 22.0;
/// How far from the path of its submaps the robot may stand, metres.
const REACH_M: f64 = 3.0;
/// Submaps further from a square than this have no surfaces in the grid, metres.
const OUTSIDE_M: f64 = 27.0;
/// Submaps that one step enters.
const SUBMAPS_PER_STEP: usize = 50;
/// Operations of entering a submap, and of refining a place, about.
const SUBMAP_OPERATIONS: u64 = 20_000;
const REFINE_OPERATIONS: u64 = 300_000;
/// The surfaces that the scan lies on are off by this much at most, root mean square.
const MAX_RMS_M: f32 = 0.04;
/// Submaps further from the pose than this did not see much of what the scan shows, metres. Of more than 40, only some are asked.
const SIGHT_M: f64 = 6.0;
const MOST_SIGHTS: usize = 40;
/// A pose whose position along some direction is less certain than this is one of many, metres: a corridor.
const MAX_DEVIATION_M: f64 = 0.08;
/// A rival with this share of the best one's score makes both doubtful. It is another pose if it is further away than this.
pub(crate) const RIVAL_SHARE: f32 = 0.85;
const RIVAL_M: f64 = 0.2;
const RIVAL_RAD: f64 = 0.08;

/// One map: those of the submaps that belong to it, with their poses.
#[derive(Clone, Copy)]
pub(crate) struct KnownMap<'a> {
    pub submaps: &'a [Submap],
    pub poses: &'a [Pose2],
    /// The map of each submap.
    pub map_of: &'a [u16],
    /// The map that is searched in.
    pub map: u16,
}

impl KnownMap<'_> {
    /// The poses of its submaps.
    fn poses(&self) -> impl Iterator<Item = &Pose2> {
        let all = self.poses.iter().zip(self.map_of);
        all.filter(|(_, map)| **map == self.map).map(|(pose, _)| pose)
    }
}

/// How well a scan must fit a place. Moved furniture and people cost some of each.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FitLimits {
    /// Share of the scan near known surfaces.
    pub overlap: f32,
    /// Share of these on the surfaces.
    pub inliers: f32,
    /// The share of the surfaces in sight that the scan saw through, and the share of the scan where the map was seen through, together.
    pub contradictions: f32,
}

/// A pose in `map` where the scan fits.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct Candidate {
    pub pose: Pose2,
    is_good: bool,
    /// Share of the scan on known surfaces, less for contradictions.
    score: f32,
}

/// The result of a search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Outcome {
    /// One pose fits, with this score, and no other does nearly as well.
    Here(Pose2, f32),
    /// Several poses fit.
    Several,
    /// No pose fits well enough.
    Nowhere,
}

/// A search in progress.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct MapQuery {
    /// The scan, in the robot's frame.
    stretches: Vec<Stretch>,
    square: u32,
    /// Submaps that have been entered into the square.
    entered: u32,
    search: Option<Search>,
    candidates: Vec<Candidate>,
    is_done: bool,
}

impl MapQuery {
    pub(crate) fn new(stretches: &[Stretch]) -> Self {
        Self {
            stretches: stretches.to_vec(),
            square: 0,
            entered: 0,
            search: None,
            candidates: Vec::new(),
            is_done: false,
        }
    }

    /// The same scan, to be searched for in another map.
    pub(crate) fn again(&mut self) {
        self.square = 0;
        self.entered = 0;
        self.search = None;
        self.candidates.clear();
        self.is_done = false;
    }

    pub(crate) fn is_done(&self) -> bool {
        self.is_done
    }

    /// What was found, when the search is done.
    pub(crate) fn outcome(&self) -> Outcome {
        let good = self.candidates.iter().filter(|candidate| candidate.is_good);
        let Some(best) = good.max_by(|a, b| a.score.total_cmp(&b.score)) else {
            return Outcome::Nowhere;
        };
        let has_rival = self.candidates.iter().any(|other| {
            other.score > RIVAL_SHARE * best.score && !is_same_pose(&other.pose, &best.pose)
        });
        if has_rival { Outcome::Several } else { Outcome::Here(best.pose, best.score) }
    }
}

/// Searches. Its memory follows from the query and the submaps.
pub(crate) struct MapSearch {
    t_base_laser: Pose2,
    grid: SearchGrid,
    surfaces: Surfaces,
    /// Map and square that grid and surfaces hold, and the number of submaps that were gone through.
    made: Option<(u16, u32, usize)>,
    is_finished: bool,
    /// What each submap saw from where it began, once it was needed.
    sights: Vec<Option<Box<Sight>>>,
}

impl MapSearch {
    pub(crate) fn new(t_base_laser: Pose2) -> Self {
        Self {
            t_base_laser,
            grid: SearchGrid::new(),
            surfaces: Surfaces::new(),
            made: None,
            is_finished: false,
            sights: Vec::new(),
        }
    }

    /// The map has changed, or the query was restored: grid and surfaces are of another one.
    pub(crate) fn forget(&mut self) {
        self.made = None;
        self.sights.clear();
    }

    /// Continues a query. Returns the number of operations that it took.
    pub(crate) fn step(
        &mut self,
        query: &mut MapQuery,
        map: &KnownMap<'_>,
        limits: &FitLimits,
    ) -> u64 {
        let Some(squares) = Squares::of(map) else {
            query.is_done = true;
            return 1;
        };
        if query.square >= squares.count() {
            query.is_done = true;
            return 1;
        }
        let window = squares.window(query.square);
        if (query.entered as usize) < map.submaps.len() {
            let until = (query.entered as usize + SUBMAPS_PER_STEP).min(map.submaps.len());
            let before = query.entered as usize;
            query.entered = until as u32;
            self.enter(query.square, &window.middle, until, map);
            return (until - before) as u64 * SUBMAP_OPERATIONS;
        }
        self.enter(query.square, &window.middle, map.submaps.len(), map);
        self.finish();
        self.search(query, &window, map, limits)
    }

    /// Enters submaps into grid and surfaces until they hold the first `until`.
    fn enter(&mut self, square: u32, middle: &Pose2, until: usize, map: &KnownMap<'_>) {
        let mut from = match self.made {
            Some((of_map, of_square, entered)) if of_map == map.map && of_square == square => {
                entered
            }
            _ => 0,
        };
        if from == 0 {
            self.grid.clear();
            self.surfaces.clear([middle.x_m, middle.y_m]);
        }
        let to_middle = Pose2::new(-middle.x_m, -middle.y_m, 0.0);
        while from < until {
            let pose = map.poses[from];
            if map.map_of[from] == map.map && pose.distance_m(middle) < OUTSIDE_M {
                let stretches = &map.submaps[from].stretches;
                self.grid.insert(stretches, &to_middle.compose(&pose));
                self.surfaces.insert(stretches, &pose);
            }
            from += 1;
            self.is_finished = false;
        }
        self.made = Some((map.map, square, from));
    }

    fn finish(&mut self) {
        if !self.is_finished {
            self.grid.finish();
            self.is_finished = true;
        }
    }

    fn search(
        &mut self,
        query: &mut MapQuery,
        window: &Window,
        map: &KnownMap<'_>,
        limits: &FitLimits,
    ) -> u64 {
        let Pose2 { x_m, y_m, .. } = window.middle;
        let in_grid = Window { middle: Pose2::IDENTITY, ..*window };
        let search = query.search.get_or_insert_with(|| Search::new(in_grid));
        if !search.is_done() {
            self.grid.set_query(&query.stretches);
            return self.grid.step(search) + 1000;
        }
        let sight = Sight::new(&query.stretches, &self.t_base_laser);
        let mut operations = 1;
        for place in search.places() {
            let pose = Pose2::new(x_m, y_m, 0.0).compose(&place.pose);
            let refined = align(&self.surfaces, &query.stretches, &found_prior(&pose));
            if let Some(alignment) = refined {
                let seen_through = sight.contradicted(&self.surfaces.fine, &alignment.pose);
                let intruding = self.intruding(&query.stretches, &alignment.pose, map);
                let contradictions = seen_through + intruding;
                query.candidates.push(candidate(&alignment, contradictions, limits));
            }
            operations += REFINE_OPERATIONS;
        }
        query.search = None;
        query.entered = 0;
        query.square += 1;
        operations
    }

    /// Share of a scan's stretches that lie where the map's submaps saw through, if the scan was taken at `pose`.
    fn intruding(&mut self, scan: &[Stretch], pose: &Pose2, map: &KnownMap<'_>) -> f32 {
        self.sights.resize_with(map.submaps.len(), || None);
        let near = map.poses.iter().enumerate().filter(|(index, submap)| {
            map.map_of[*index] == map.map && submap.distance_m(pose) < SIGHT_M
        });
        // Spread over all that are near.
        let stride = near.clone().count().div_ceil(MOST_SIGHTS).max(1);
        let mut is_through = vec![false; scan.len()];
        for (index, submap) in near.step_by(stride) {
            let stretches = &map.submaps[index].stretches;
            let sight = self.sights[index]
                .get_or_insert_with(|| Box::new(Sight::new(stretches, &self.t_base_laser)));
            let Pose2 { x_m, y_m, yaw_rad } = submap.inverse().compose(pose);
            let (sin, cos) = yaw_rad.sin_cos();
            let [x, y, sin, cos] = [x_m, y_m, sin, cos].map(|value| value as f32);
            for (is_through, stretch) in is_through.iter_mut().zip(scan) {
                let moved = stretch.moved(x, y, sin, cos);
                *is_through |= sight.is_through(moved.x, moved.y);
            }
        }
        let through = is_through.iter().filter(|is_through| **is_through).count();
        through as f32 / scan.len().max(1) as f32
    }
}

fn candidate(alignment: &Alignment, contradictions: f32, limits: &FitLimits) -> Candidate {
    let fit = &alignment.fit;
    let covariance = alignment.information.try_inverse();
    let is_certain = covariance.is_some_and(|covariance| {
        let variance = covariance[(0, 0)] + covariance[(1, 1)];
        (0.0..MAX_DEVIATION_M * MAX_DEVIATION_M).contains(&variance)
    });
    let is_good = is_certain
        && fit.overlap >= limits.overlap
        && fit.inliers >= limits.inliers
        && fit.rms_m <= MAX_RMS_M
        && contradictions <= limits.contradictions;
    let score = fit.share() * (1.0 - contradictions).max(0.0);
    Candidate { pose: alignment.pose, is_good, score }
}

fn is_same_pose(a: &Pose2, b: &Pose2) -> bool {
    a.distance_m(b) < RIVAL_M && wrap_angle(a.yaw_rad - b.yaw_rad).abs() < RIVAL_RAD
}

/// The squares that cover the map.
struct Squares {
    low: [f64; 2],
    sides: [f64; 2],
    counts: [u32; 2],
}

impl Squares {
    /// `None` without submaps.
    fn of(map: &KnownMap<'_>) -> Option<Self> {
        let first = map.poses().next()?;
        let mut low = [first.x_m, first.y_m];
        let mut high = low;
        for pose in map.poses() {
            for (axis, value) in [pose.x_m, pose.y_m].into_iter().enumerate() {
                low[axis] = low[axis].min(value);
                high[axis] = high[axis].max(value);
            }
        }
        let extents = [0, 1].map(|axis| high[axis] - low[axis] + 2.0 * REACH_M);
        let counts = extents.map(|extent_m| (extent_m / SQUARE_M).ceil() as u32);
        let sides = [0, 1].map(|axis| extents[axis] / f64::from(counts[axis]));
        Some(Self { low: low.map(|low| low - REACH_M), sides, counts })
    }

    fn count(&self) -> u32 {
        self.counts[0] * self.counts[1]
    }

    /// In `map`, with every heading.
    fn window(&self, square: u32) -> Window {
        let place = [square % self.counts[0], square / self.counts[0]].map(f64::from);
        let [x, y] = [0, 1].map(|axis| self.low[axis] + (place[axis] + 0.5) * self.sides[axis]);
        Window {
            middle: Pose2::new(x, y, 0.0),
            half_m: self.sides.map(|side_m| 0.5 * side_m),
            radians: std::f64::consts::PI,
        }
    }
}
