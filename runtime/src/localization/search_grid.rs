//! Where a scan could have been taken: a correlative search over a grid of surfaces, by branch and bound.
//!
//! Every cell holds the directions of the surfaces in it, as one bit per sector of 45 degrees. A pose scores a point for each
//! stretch of the scan that falls into a cell with a surface of its direction. Coarser levels hold the union of the cells that
//! they cover, so that their score is never less than that of any pose inside, and whole areas are ruled out at once (Olson 2009;
//! Hess et al. 2016).

use hal::Pose2;
use serde::{Deserialize, Serialize};

use super::scan_points::Stretch;

/// Side of a cell, metres. A matcher that starts this near finds the exact pose.
const CELL_M: f32 = 0.15;
/// Cells along a side of the grid: 19 m in every direction.
const SIDE: usize = 256;
/// Surfaces fill the cells up to this far away: half a cell, because poses are tried a cell apart.
const SPREAD_M: f32 = 0.075;
/// Angle between tried headings: a point 8 m away moves by a cell.
const YAW_STEP_RAD: f64 = 0.02;
/// The coarsest level covers squares of 2^4 cells.
const TOP_LEVEL: usize = 4;
/// Stretches of a scan that are looked up.
const MAX_POINTS: usize = 120;
/// A pose with a smaller share of the stretches on surfaces is no place.
const MIN_SHARE: f32 = 0.45;
/// Places with less than this share of the best score are not kept.
const RIVAL_SHARE: f32 = 0.85;
/// Kept places at most.
const MAX_PLACES: usize = 6;
/// Poses nearer to each other are one place.
const SAME_PLACE_M: f64 = 0.7;
const SAME_PLACE_RAD: f64 = 0.25;

/// Where to search: a box around a pose.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct Window {
    pub middle: Pose2,
    /// Half of the extents along x, along y, and of the yaw.
    pub half_m: [f64; 2],
    pub radians: f64,
}

/// A pose where the scan fits, in the grid's frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) struct Place {
    pub pose: Pose2,
    /// Stretches on surfaces.
    pub score: u32,
}

/// The state of a search: one heading is searched per step.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Search {
    window: Window,
    next: u32,
    headings: u32,
    /// The places that were found, the best first.
    places: Vec<Place>,
}

/// A stretch of the scan to look up.
#[derive(Debug, Clone, Copy)]
struct Point {
    x: f32,
    y: f32,
    /// Angle of the normal, in sectors.
    sector: f32,
}

/// A square of translations, in cells.
#[derive(Debug, Clone, Copy)]
struct Square {
    x: i32,
    y: i32,
    level: usize,
    score: u32,
}

/// Surfaces in cells, and the scan that is searched for. It keeps its memory.
pub(crate) struct SearchGrid {
    /// Masks of directions for each level, row-major.
    levels: Vec<Vec<u8>>,
    points: Vec<Point>,
    /// The points of the current heading: cell without translation, and the bit of the direction.
    cells: Vec<(i32, i32, u8)>,
    stack: Vec<Square>,
}

impl SearchGrid {
    pub(crate) fn new() -> Self {
        Self {
            levels: (0..=TOP_LEVEL).map(|_| vec![0; SIDE * SIDE]).collect(),
            points: Vec::with_capacity(MAX_POINTS),
            cells: Vec::with_capacity(MAX_POINTS),
            stack: Vec::with_capacity(2048),
        }
    }

    /// Empties the grid. Its middle is the origin.
    pub(crate) fn clear(&mut self) {
        self.levels[0].fill(0);
    }

    /// Adds the surfaces of a scan or submap whose frame is at `pose`.
    pub(crate) fn insert(&mut self, stretches: &[Stretch], pose: &Pose2) {
        let (sin, cos) = pose.yaw_rad.sin_cos();
        let [x, y, sin, cos] = [pose.x_m, pose.y_m, sin, cos].map(|value| value as f32);
        for stretch in stretches.iter().filter(|stretch| stretch.has_normal()) {
            let there = stretch.moved(x, y, sin, cos);
            let mask = directions(sector(&there));
            let columns = cell(there.x - SPREAD_M)..=cell(there.x + SPREAD_M);
            for row in cell(there.y - SPREAD_M)..=cell(there.y + SPREAD_M) {
                for column in columns.clone() {
                    if let Some(index) = index(column, row) {
                        self.levels[0][index] |= mask;
                    }
                }
            }
        }
    }

    /// Makes the coarser levels. Call it after the last surface.
    pub(crate) fn finish(&mut self) {
        for level in 1..=TOP_LEVEL {
            let reach = 1 << (level - 1);
            let (finer, coarser) = self.levels.split_at_mut(level);
            pool(&finer[level - 1], &mut coarser[0], reach);
        }
    }

    /// The scan or submap to search for, in its own frame.
    pub(crate) fn set_query(&mut self, stretches: &[Stretch]) {
        self.points.clear();
        let count = stretches.iter().filter(|stretch| stretch.has_normal()).count();
        let every = count.div_ceil(MAX_POINTS).max(1);
        let chosen = stretches.iter().filter(|stretch| stretch.has_normal()).step_by(every);
        self.points.extend(chosen.map(|stretch| Point {
            x: stretch.x,
            y: stretch.y,
            sector: sector(stretch),
        }));
    }

    /// Searches the next heading of `search`. Returns the number of lookups.
    pub(crate) fn step(&mut self, search: &mut Search) -> u64 {
        let Some(yaw_rad) = search.next_heading() else { return 0 };
        self.rotate(yaw_rad);
        let points = self.cells.len() as u32;
        if points == 0 {
            return 0;
        }
        let least = ((points as f32 * MIN_SHARE) as u32).max(1);
        let [low_x, high_x] = range(search.window.middle.x_m, search.window.half_m[0]);
        let [low_y, high_y] = range(search.window.middle.y_m, search.window.half_m[1]);
        let mut lookups = 0;
        let stride = 1 << TOP_LEVEL;
        self.stack.clear();
        for y in (low_y..=high_y).step_by(stride) {
            for x in (low_x..=high_x).step_by(stride) {
                let score = self.score(x, y, TOP_LEVEL);
                lookups += u64::from(points);
                self.stack.push(Square { x, y, level: TOP_LEVEL, score });
            }
        }
        self.stack.sort_unstable_by_key(|square| square.score);
        while let Some(square) = self.stack.pop() {
            if square.score < least.max(search.worth()) {
                continue;
            }
            if square.level == 0 {
                let x_m = f64::from(square.x) * f64::from(CELL_M);
                let y_m = f64::from(square.y) * f64::from(CELL_M);
                search.add(Place { pose: Pose2::new(x_m, y_m, yaw_rad), score: square.score });
                continue;
            }
            let level = square.level - 1;
            let half = 1 << level;
            let begin = self.stack.len();
            for (x, y) in [(0, 0), (half, 0), (0, half), (half, half)] {
                let (x, y) = (square.x + x, square.y + y);
                if x <= high_x && y <= high_y {
                    let score = self.score(x, y, level);
                    lookups += u64::from(points);
                    self.stack.push(Square { x, y, level, score });
                }
            }
            self.stack[begin..].sort_by_key(|square| square.score);
        }
        lookups
    }

    fn rotate(&mut self, yaw_rad: f64) {
        let (sin, cos) = (yaw_rad.sin() as f32, yaw_rad.cos() as f32);
        let sectors = (yaw_rad / std::f64::consts::FRAC_PI_4) as f32;
        self.cells.clear();
        for point in &self.points {
            let column = cell(cos * point.x - sin * point.y);
            let row = cell(sin * point.x + cos * point.y);
            let bit = 1 << ((point.sector + sectors).floor() as i32).rem_euclid(8);
            self.cells.push((column, row, bit));
        }
    }

    #[inline]
    fn score(&self, x: i32, y: i32, level: usize) -> u32 {
        let masks = &self.levels[level];
        let mut score = 0;
        for (column, row, bit) in &self.cells {
            if let Some(index) = index(column + x, row + y) {
                score += u32::from(masks[index] & bit != 0);
            }
        }
        score
    }
}

impl Search {
    pub(crate) fn new(window: Window) -> Self {
        let radians = window.radians.min(std::f64::consts::PI);
        let headings = 2 * (radians / YAW_STEP_RAD).ceil() as u32 + 1;
        Self { window, next: 0, headings, places: Vec::new() }
    }

    pub(crate) fn is_done(&self) -> bool {
        self.next >= self.headings
    }

    /// The places that were found, the best first.
    pub(crate) fn places(&self) -> &[Place] {
        &self.places
    }

    /// From the middle outwards, because the middle is the likeliest.
    fn next_heading(&mut self) -> Option<f64> {
        if self.is_done() {
            return None;
        }
        let steps = f64::from(self.next.div_ceil(2));
        let sign = if self.next.is_multiple_of(2) { 1.0 } else { -1.0 };
        self.next += 1;
        Some(self.window.middle.yaw_rad + sign * steps * YAW_STEP_RAD)
    }

    /// The score that a pose needs to be kept.
    fn worth(&self) -> u32 {
        let rival = self.places.first().map_or(0.0, |best| RIVAL_SHARE * best.score as f32) as u32;
        if self.places.len() < MAX_PLACES {
            rival
        } else {
            rival.max(self.places[MAX_PLACES - 1].score + 1)
        }
    }

    fn add(&mut self, place: Place) {
        let same = self.places.iter().position(|other| is_same_place(&other.pose, &place.pose));
        if let Some(same) = same {
            if self.places[same].score >= place.score {
                return;
            }
            self.places.remove(same);
        }
        let at = self.places.partition_point(|other| other.score >= place.score);
        self.places.insert(at, place);
        let worth = self.worth();
        self.places.truncate(MAX_PLACES);
        self.places.retain(|other| other.score >= worth.min(place.score));
    }
}

/// Whether two poses are so near that they are one answer.
pub(crate) fn is_same_place(a: &Pose2, b: &Pose2) -> bool {
    a.distance_m(b) < SAME_PLACE_M && hal::wrap_angle(a.yaw_rad - b.yaw_rad).abs() < SAME_PLACE_RAD
}

/// Cells from the low to the high end of the window.
fn range(middle_m: f64, half_m: f64) -> [i32; 2] {
    let side = SIDE as f64;
    [-1.0, 1.0].map(|sign| {
        ((middle_m + sign * half_m) / f64::from(CELL_M)).round().clamp(-side, side) as i32
    })
}

fn cell(metres: f32) -> i32 {
    (metres / CELL_M).floor() as i32
}

#[inline]
fn index(column: i32, row: i32) -> Option<usize> {
    let half = SIDE as i32 / 2;
    // Negative numbers become huge ones.
    let column = (column + half) as usize;
    let row = (row + half) as usize;
    (column < SIDE && row < SIDE).then(|| row * SIDE + column)
}

/// Angle of the normal, in sectors from 0 to 8.
fn sector(stretch: &Stretch) -> f32 {
    stretch.ny.atan2(stretch.nx) / std::f32::consts::FRAC_PI_4
}

/// The sector and the one nearest to it.
fn directions(sector: f32) -> u8 {
    let own = sector.floor();
    let beside = if sector - own < 0.5 { own - 1.0 } else { own + 1.0 };
    (1 << (own as i32).rem_euclid(8)) | (1 << (beside as i32).rem_euclid(8))
}

/// Each coarser cell is the union of four finer ones: itself and those `reach` further on. Cells beyond the last are as the last.
fn pool(finer: &[u8], coarser: &mut [u8], reach: usize) {
    let mut both = [0; SIDE];
    for (row, to) in coarser.chunks_exact_mut(SIDE).enumerate() {
        let next = (row + reach).min(SIDE - 1);
        let upper = &finer[row * SIDE..(row + 1) * SIDE];
        let lower = &finer[next * SIDE..(next + 1) * SIDE];
        for (both, (upper, lower)) in both.iter_mut().zip(upper.iter().zip(lower)) {
            *both = upper | lower;
        }
        let (inner, edge) = to.split_at_mut(SIDE - reach);
        for (to, (both, right)) in inner.iter_mut().zip(both.iter().zip(&both[reach..])) {
            *to = both | right;
        }
        for (to, here) in edge.iter_mut().zip(&both[SIDE - reach..]) {
            *to = here | both[SIDE - 1];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The walls of an L-shaped room, seen from inside: it looks the same from no two poses.
    fn room() -> Vec<Stretch> {
        let walls = [
            ([-3.0, -2.0], [4.0, -2.0], [0.0, 1.0]),
            ([4.0, -2.0], [4.0, 1.0], [-1.0, 0.0]),
            ([4.0, 1.0], [0.0, 1.0], [0.0, -1.0]),
            ([0.0, 1.0], [0.0, 3.5], [-1.0, 0.0]),
            ([0.0, 3.5], [-3.0, 3.5], [0.0, -1.0]),
            ([-3.0, 3.5], [-3.0, -2.0], [1.0, 0.0]),
        ];
        walls.into_iter().flat_map(|(from, to, normal)| wall(from, to, normal)).collect()
    }

    fn wall(from: [f32; 2], to: [f32; 2], [nx, ny]: [f32; 2]) -> impl Iterator<Item = Stretch> {
        let length = (to[0] - from[0]).hypot(to[1] - from[1]);
        let count = (length / 0.1) as usize;
        (0..count).map(move |step| {
            let share = (step as f32 + 0.5) / count as f32;
            let x = from[0] + share * (to[0] - from[0]);
            let y = from[1] + share * (to[1] - from[1]);
            Stretch { x, y, nx, ny, weight: 1.0 }
        })
    }

    fn search(from: &Pose2, window: Window) -> Search {
        let mut grid = SearchGrid::new();
        grid.clear();
        grid.insert(&room(), &Pose2::IDENTITY);
        grid.finish();
        let inverse = from.inverse();
        let (sin, cos) = inverse.yaw_rad.sin_cos();
        let [x, y, sin, cos] = [inverse.x_m, inverse.y_m, sin, cos].map(|value| value as f32);
        let seen: Vec<_> = room().iter().map(|stretch| stretch.moved(x, y, sin, cos)).collect();
        grid.set_query(&seen);
        let mut search = Search::new(window);
        while !search.is_done() {
            grid.step(&mut search);
        }
        search
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        /// From anywhere and in any direction, with no idea of the pose.
        #[test]
        fn a_pose_in_a_known_room_is_found_without_a_prior(
            x in -2.5..3.5f64,
            y in -1.5..0.5f64,
            yaw in -3.1..3.1f64,
        ) {
            let truth = Pose2::new(x, y, yaw);
            let window = Window { middle: Pose2::IDENTITY, half_m: [4.0; 2], radians: 3.2 };
            let found = search(&truth, window);
            let best = found.places()[0].pose;
            prop_assert!(best.distance_m(&truth) < 0.25, "{best:?} {truth:?}");
            prop_assert!(hal::wrap_angle(best.yaw_rad - yaw).abs() < 0.05, "{best:?} {truth:?}");
        }

        /// The bound of branch and bound: a coarse cell scores at least as much as any fine one in it.
        #[test]
        fn a_coarser_level_never_scores_less(
            x in -20i32..20,
            y in -20i32..20,
            level in 1..=TOP_LEVEL,
            yaw in -3.1..3.1f64,
        ) {
            let mut grid = SearchGrid::new();
            grid.insert(&room(), &Pose2::IDENTITY);
            grid.finish();
            grid.set_query(&room());
            grid.rotate(yaw);
            let coarse = grid.score(x, y, level);
            for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                let half = 1 << (level - 1);
                prop_assert!(grid.score(x + dx * half, y + dy * half, level - 1) <= coarse);
            }
        }
    }

    #[test]
    fn a_straight_corridor_has_rivals_along_itself() {
        let mut grid = SearchGrid::new();
        let corridor: Vec<_> = long_wall(-1.0, 1.0).chain(long_wall(1.0, -1.0)).collect();
        grid.insert(&corridor, &Pose2::IDENTITY);
        grid.finish();
        grid.set_query(&corridor[50..250]);
        let window = Window { middle: Pose2::IDENTITY, half_m: [3.0; 2], radians: 0.1 };
        let mut search = Search::new(window);
        while !search.is_done() {
            grid.step(&mut search);
        }
        assert!(search.places().len() > 2, "{:?}", search.places());
    }

    fn long_wall(y: f32, ny: f32) -> impl Iterator<Item = Stretch> {
        let along = (0..300).map(|step| 0.1 * step as f32 - 15.0);
        along.map(move |x| Stretch { x, y, nx: 0.0, ny, weight: 1.0 })
    }
}
