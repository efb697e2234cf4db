//! The cheapest way, and the distance to everywhere.

use super::buckets::{Buckets, Entry};
use super::costmap::{BLOCKED, Costmap, FREE, UNIFORM};
use crate::mapping::Cell;

/// Cost of a step along a row or column, for weight 1/[`FREE`]. 17/12 is the square root of 2 within 0.2 %.
const STRAIGHT: u32 = 12;
/// Cost of a diagonal step.
const DIAGONAL: u32 = 17;
/// Cost of a straight step on free floor.
const FREE_STEP: u32 = STRAIGHT * FREE as u32;
const FREE_DIAGONAL: u32 = DIAGONAL * FREE as u32;
/// No step led here: the start.
const NO_STEP: u8 = 8;
/// Steps by column and row: even ones are straight, odd ones lie between their neighbours in this list.
const STEPS: [(i32, i32); 8] = [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)];

/// All 8 steps, as bits.
const ALL: u8 = 0xff;
/// By the step that led into a cell on even ground: the steps worth taking next. Every other neighbour is reached as cheaply
/// from the cell before without this one: directly, or by the same two steps with the diagonal one first. This is the
/// pruning of jump point search (Harabor and Grastien 2011), applied wherever the 3x3 cells around have one weight.
const NATURAL: [u8; 8] =
    [0b0000_0001, 0b0000_0111, 0b0000_0100, 0b0001_1100, 0b0001_0000, 0b0111_0000, 0b0100_0000, 0b1100_0001];

/// What a search knows of a cell.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Node {
    cost: u32,
    /// The step by which the cheapest way enters.
    step: u8,
    /// Steps to take from here.
    open: u8,
    /// Steps taken from here at this cost.
    done: u8,
}

const UNSEEN: Node = Node { cost: u32::MAX, step: NO_STEP, open: 0, done: 0 };

/// Why there is no way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, thiserror::Error)]
#[non_exhaustive]
pub enum NoPath {
    /// The start is outside the map, or so deep inside an obstacle that no way out is near.
    #[error("the start is blocked")]
    StartBlocked,
    /// The goal is outside the map or too near to an obstacle.
    #[error("the goal is blocked")]
    GoalBlocked,
    /// Start and goal are not connected.
    #[error("the goal cannot be reached from the start")]
    Unreachable,
    /// The search was given up after the configured number of cells.
    #[error("the search ran out of its budget of cells")]
    Budget,
}

/// Searches costmaps; owns the memory that this needs.
///
/// Steps go to the 8 neighbours, never across the corner of a blocked cell. A step costs its length times the weight of the
/// cell it enters. Costs are whole numbers, so that equal maps give equal paths on every machine.
#[derive(Debug, Clone)]
pub struct Planner {
    max_expanded: usize,
    nodes: Vec<Node>,
    stride: usize,
    /// Rows of `nodes` that the last search wrote.
    dirty: core::ops::Range<usize>,
    queue: Buckets,
    /// From a start inside an obstacle's margin to the first passable cell, without that one.
    escape: Vec<Cell>,
    path: Vec<Cell>,
    expanded: usize,
}

impl Planner {
    /// A planner that gives up after `max_expanded` cells.
    #[must_use]
    pub fn new(max_expanded: usize) -> Self {
        Self {
            max_expanded,
            nodes: Vec::new(),
            stride: 0,
            dirty: 0..0,
            queue: Buckets::default(),
            escape: Vec::new(),
            path: Vec::new(),
            expanded: 0,
        }
    }

    /// The cheapest way from `start` to `goal`, both included (A*). A start too near to an obstacle first leaves it by the
    /// shortest way on which the distance to obstacles never shrinks.
    ///
    /// # Errors
    /// Why there is none.
    pub fn plan(&mut self, costmap: &Costmap, start: Cell, goal: Cell) -> Result<&[Cell], NoPath> {
        let from = self.leave(costmap, start)?;
        if !costmap.is_passable(goal) {
            return Err(NoPath::GoalBlocked);
        }
        if !self.search(costmap, from, Some(goal))? {
            return Err(NoPath::Unreachable);
        }
        self.trace(costmap, goal);
        Ok(&self.path)
    }

    /// The distance from `start` to everywhere (Dijkstra).
    ///
    /// # Errors
    /// [`NoPath::StartBlocked`] or [`NoPath::Budget`].
    pub fn flood<'a>(&'a mut self, costmap: &'a Costmap, start: Cell) -> Result<Reach<'a>, NoPath> {
        let from = self.leave(costmap, start)?;
        self.search(costmap, from, None)?;
        Ok(Reach { planner: self, costmap })
    }

    /// Cells that the last search looked at.
    #[must_use]
    pub fn expanded(&self) -> usize {
        self.expanded
    }

    fn search(&mut self, costmap: &Costmap, start: Cell, goal: Option<Cell>) -> Result<bool, NoPath> {
        self.prepare(costmap);
        let place = |cell: Cell| {
            let index = costmap.index(cell)?;
            Some((index, (index % costmap.stride) as u16, (index / costmap.stride) as u16))
        };
        let (start_index, x, y) = place(start).ok_or(NoPath::StartBlocked)?;
        let (goal_index, heuristic) = match goal.and_then(place) {
            Some((index, x, y)) => (index, Heuristic { goal: Some((x, y)) }),
            None => (usize::MAX, Heuristic { goal: None }),
        };
        self.nodes[start_index] = Node { cost: 0, step: NO_STEP, open: ALL, done: 0 };
        let first = heuristic.of(x, y);
        self.queue.restart(first);
        self.queue.push(first, Entry { x, y, cost: 0 });
        self.dirty = usize::from(y)..usize::from(y) + 1;
        while let Some(entry) = self.queue.pop() {
            let index = usize::from(entry.y) * costmap.stride + usize::from(entry.x);
            let node = &mut self.nodes[index];
            if node.cost != entry.cost || node.open == 0 {
                continue;
            }
            if index == goal_index {
                return Ok(true);
            }
            let directions = node.open;
            node.open = 0;
            node.done |= directions;
            self.expanded += 1;
            if self.expanded > self.max_expanded {
                return Err(NoPath::Budget);
            }
            self.expand(costmap, entry, index, directions, &heuristic);
        }
        Ok(goal_index == usize::MAX)
    }

    /// Takes every step of the set `directions` from a cell.
    #[inline]
    fn expand(&mut self, costmap: &Costmap, from: Entry, index: usize, directions: u8, heuristic: &Heuristic) {
        let stride = costmap.stride as isize;
        let weight_at = |direction: usize| {
            let (dx, dy) = STEPS[direction];
            costmap.weights[index.wrapping_add_signed(dx as isize + dy as isize * stride)]
        };
        let even = costmap.weights[index] & UNIFORM != 0;
        let row = usize::from(from.y);
        self.dirty = self.dirty.start.min(row.saturating_sub(1))..self.dirty.end.max(row + 2);
        let mut left = directions;
        while left != 0 {
            let direction = left.trailing_zeros() as usize;
            left &= left - 1;
            let next_weight = weight_at(direction);
            let is_diagonal = direction % 2 == 1;
            if !even {
                let cuts_corner = || weight_at(direction - 1) == BLOCKED || weight_at((direction + 1) % 8) == BLOCKED;
                if next_weight == BLOCKED || (is_diagonal && cuts_corner()) {
                    continue;
                }
            }
            let length = if is_diagonal { DIAGONAL } else { STRAIGHT };
            let cost = from.cost + length * u32::from(next_weight & !UNIFORM);
            let (dx, dy) = STEPS[direction];
            let next = index.wrapping_add_signed(dx as isize + dy as isize * stride);
            let node = &mut self.nodes[next];
            if cost > node.cost {
                continue;
            }
            let onward = if next_weight & UNIFORM != 0 { NATURAL[direction] } else { ALL };
            let queued = if cost < node.cost {
                *node = Node { cost, step: direction as u8, open: onward, done: 0 };
                false
            } else {
                // As cheap from here as from elsewhere: the steps that are natural from here have to be taken too.
                let was_open = node.open != 0;
                node.open |= onward & !node.done;
                was_open || node.open == 0
            };
            if !queued {
                let x = from.x.wrapping_add_signed(dx as i16);
                let y = from.y.wrapping_add_signed(dy as i16);
                self.queue.push(cost + heuristic.of(x, y), Entry { x, y, cost });
            }
        }
    }

    /// Makes every cell unseen, at the price of the rows that the last search saw.
    fn prepare(&mut self, costmap: &Costmap) {
        let size = costmap.weights.len();
        if self.nodes.len() == size && self.stride == costmap.stride {
            let dirty = self.dirty.start * self.stride..(self.dirty.end * self.stride).min(size);
            self.nodes[dirty].fill(UNSEEN);
        } else {
            self.nodes.clear();
            self.nodes.resize(size, UNSEEN);
            self.stride = costmap.stride;
        }
        self.dirty = 0..0;
        self.expanded = 0;
    }

    /// Fills `escape` and returns where the search begins: `start`, if it is passable.
    fn leave(&mut self, costmap: &Costmap, start: Cell) -> Result<Cell, NoPath> {
        self.escape.clear();
        if costmap.is_passable(start) {
            return Ok(start);
        }
        let start_index = costmap.index(start).ok_or(NoPath::StartBlocked)?;
        // A breadth-first search that only climbs away from obstacles: it cannot pass through a wall.
        let mut seen: Vec<(usize, usize)> = vec![(start_index, 0)];
        let mut next = 0;
        while let Some(&(index, _)) = seen.get(next) {
            for (dx, dy) in STEPS {
                let cell = costmap.cell(index).offset(dx, dy);
                let Some(neighbour) = costmap.index(cell) else { continue };
                let climbs = costmap.clearance2(neighbour) >= costmap.clearance2(index);
                if !climbs || seen.iter().any(|(known, _)| *known == neighbour) {
                    continue;
                }
                seen.push((neighbour, next));
                if costmap.is_passable(cell) {
                    self.retrace(costmap, &seen, next);
                    return Ok(cell);
                }
            }
            next += 1;
            if next > LONGEST_ESCAPE {
                break;
            }
        }
        Err(NoPath::StartBlocked)
    }

    fn retrace(&mut self, costmap: &Costmap, seen: &[(usize, usize)], mut at: usize) {
        loop {
            let (index, parent) = seen[at];
            self.escape.push(costmap.cell(index));
            if at == 0 {
                break;
            }
            at = parent;
        }
        self.escape.reverse();
    }

    /// Writes the way to `goal` into `path`.
    fn trace(&mut self, costmap: &Costmap, goal: Cell) {
        self.path.clear();
        let mut cell = goal;
        while let Some(index) = costmap.index(cell) {
            self.path.push(cell);
            let Some((dx, dy)) = STEPS.get(usize::from(self.nodes[index].step)) else { break };
            cell = cell.offset(-dx, -dy);
        }
        self.path.extend(self.escape.iter().rev());
        self.path.reverse();
    }
}

/// Cells that are looked at to leave an obstacle's margin: a disc of 16 cells radius.
const LONGEST_ESCAPE: usize = 800;

/// Octile distance to the goal on free floor: never more than the true cost, and no step lowers it by more than the step costs.
struct Heuristic {
    goal: Option<(u16, u16)>,
}

impl Heuristic {
    #[inline]
    fn of(&self, x: u16, y: u16) -> u32 {
        let Some((goal_x, goal_y)) = self.goal else { return 0 };
        let dx = u32::from(x.abs_diff(goal_x));
        let dy = u32::from(y.abs_diff(goal_y));
        FREE_STEP * dx.max(dy) + (FREE_DIAGONAL - FREE_STEP) * dx.min(dy)
    }
}

/// Distances from one start to everywhere.
#[derive(Debug)]
pub struct Reach<'a> {
    planner: &'a mut Planner,
    costmap: &'a Costmap,
}

impl Reach<'_> {
    /// Cost of the way to `cell`, in metres of free floor; `None` when there is no way.
    #[must_use]
    pub fn distance_m(&self, cell: Cell) -> Option<f64> {
        let index = self.costmap.index(cell)?;
        let node = self.planner.nodes.get(index).filter(|node| **node != UNSEEN)?;
        Some(f64::from(node.cost) / f64::from(FREE_STEP) * self.costmap.cell_m)
    }

    /// The cell nearest to `cell` that can be reached, at most `radius_m` away.
    #[must_use]
    pub fn nearest(&self, cell: Cell, radius_m: f64) -> Option<Cell> {
        self.costmap.nearest(cell, radius_m, |near| self.distance_m(near).is_some())
    }

    /// The cheapest way to `cell`.
    ///
    /// # Errors
    /// [`NoPath::GoalBlocked`] or [`NoPath::Unreachable`].
    pub fn path_to(&mut self, cell: Cell) -> Result<&[Cell], NoPath> {
        if !self.costmap.is_passable(cell) {
            return Err(NoPath::GoalBlocked);
        }
        if self.distance_m(cell).is_none() {
            return Err(NoPath::Unreachable);
        }
        self.planner.trace(self.costmap, cell);
        Ok(&self.planner.path)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mapping::CellBox;
    use proptest::prelude::*;
    use rand::{RngExt, SeedableRng};

    /// A random costmap: `None` with probability `blocked`, otherwise a weight of 1 to 15 in patches.
    fn random_map(width: i32, height: i32, blocked: f64, rough: f64, seed: u64) -> Costmap {
        let mut random = rand_pcg::Pcg64::seed_from_u64(seed);
        let cells = CellBox { min: Cell::new(-3, 5), max: Cell::new(width - 4, height + 4) };
        Costmap::from_weights(cells, 0.03, |_| {
            if random.random_bool(blocked) {
                return None;
            }
            Some(if random.random_bool(rough) { f64::from(random.random_range(4..60)) / 4.0 } else { 1.0 })
        })
    }

    /// Neighbours and whole-number costs, by the rules as documented.
    fn successors(costmap: &Costmap, cell: Cell) -> Vec<(Cell, u32)> {
        let mut found = Vec::new();
        for (dx, dy) in STEPS {
            let next = cell.offset(dx, dy);
            let open = |dx, dy| costmap.is_passable(cell.offset(dx, dy));
            if let Some(weight) = costmap.weight(next)
                && open(dx, 0)
                && open(0, dy)
            {
                let length = if dx != 0 && dy != 0 { DIAGONAL } else { STRAIGHT };
                found.push((next, length * (weight * 4.0) as u32));
            }
        }
        found
    }

    fn cost_of(costmap: &Costmap, path: &[Cell]) -> u32 {
        path.windows(2)
            .map(|pair| {
                let step = successors(costmap, pair[0]).into_iter().find(|(cell, _)| *cell == pair[1]);
                step.expect("the path takes a step that is not allowed").1
            })
            .sum()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(200))]
        #[test]
        fn paths_cost_what_those_of_the_pathfinding_crate_cost(
            width in 2..40i32, height in 2..40i32, blocked in 0.0..0.5f64, rough in prop_oneof![Just(0.0), Just(0.02), 0.0..1.0f64], seed: u64,
            ends in (0.0..1.0f64, 0.0..1.0f64, 0.0..1.0f64, 0.0..1.0f64),
        ) {
            let costmap = random_map(width, height, blocked, rough, seed);
            let at = |x: f64, y: f64| {
                Cell::new(-3 + (x * f64::from(width)) as i32, 5 + (y * f64::from(height)) as i32)
            };
            let (start, goal) = (at(ends.0, ends.1), at(ends.2, ends.3));
            let mut planner = Planner::new(usize::MAX);
            prop_assume!(costmap.is_passable(start));
            let expected = pathfinding::prelude::astar(&start, |cell| successors(&costmap, *cell), |_| 0, |cell| *cell == goal);
            // Twice: the second search must not be disturbed by what the first left behind.
            let _ = planner.plan(&costmap, goal, start);
            match (planner.plan(&costmap, start, goal), expected) {
                (Ok(path), Some((_, cost))) => {
                    prop_assert_eq!((path[0], path[path.len() - 1]), (start, goal));
                    prop_assert_eq!(cost_of(&costmap, path), cost);
                    let reach_m = planner.flood(&costmap, start).unwrap().distance_m(goal).unwrap();
                    prop_assert!((reach_m - f64::from(cost) / 48.0 * 0.03).abs() < 1e-9);
                }
                (Err(NoPath::GoalBlocked), None) => prop_assert!(!costmap.is_passable(goal)),
                (Err(NoPath::Unreachable), None) => {
                    prop_assert!(costmap.is_passable(goal));
                    let mut reach = planner.flood(&costmap, start).unwrap();
                    prop_assert_eq!(reach.distance_m(goal), None);
                    prop_assert_eq!(reach.path_to(goal), Err(NoPath::Unreachable));
                }
                (got, expected) => prop_assert!(false, "{:?} instead of {:?}", got, expected.map(|(_, cost)| cost)),
            }
        }

        #[test]
        fn a_flood_knows_the_distance_to_every_cell(
            width in 2..25i32, height in 2..25i32, blocked in 0.0..0.4f64, rough in prop_oneof![Just(0.0), Just(0.03), 0.0..1.0f64], seed: u64,
        ) {
            let costmap = random_map(width, height, blocked, rough, seed);
            let start = Cell::new(-3, 5);
            prop_assume!(costmap.is_passable(start));
            let expected = pathfinding::prelude::dijkstra_all(&start, |cell| successors(&costmap, *cell));
            let mut planner = Planner::new(usize::MAX);
            let mut reach = planner.flood(&costmap, start).unwrap();
            let cells = costmap.cells();
            for cell in (cells.min.y..=cells.max.y).flat_map(|y| (cells.min.x..=cells.max.x).map(move |x| Cell::new(x, y))) {
                let cost = if cell == start { Some(0) } else { expected.get(&cell).map(|(_, cost)| *cost) };
                let got = reach.distance_m(cell).map(|distance_m| (distance_m / 0.03 * 48.0).round() as u32);
                prop_assert_eq!(got, cost);
                if let Some(cost) = cost {
                    let path = reach.path_to(cell).unwrap().to_vec();
                    prop_assert_eq!((path[0], cost_of(&costmap, &path)), (start, cost));
                }
            }
        }
    }

    #[test]
    fn a_corner_is_not_cut() {
        let cells = CellBox { min: Cell::new(0, 0), max: Cell::new(1, 1) };
        let costmap = Costmap::from_weights(cells, 0.03, |cell| (cell != Cell::new(1, 0)).then_some(1.0));
        let mut planner = Planner::new(100);
        let path = planner.plan(&costmap, Cell::new(0, 0), Cell::new(1, 1)).unwrap();
        assert_eq!(path, [Cell::new(0, 0), Cell::new(0, 1), Cell::new(1, 1)]);
    }

    #[test]
    fn every_reason_is_told_apart() {
        let cells = CellBox { min: Cell::new(0, 0), max: Cell::new(20, 20) };
        // A wall in column 10.
        let costmap = Costmap::from_weights(cells, 0.03, |cell| (cell.x != 10).then_some(1.0));
        let (here, there) = (Cell::new(2, 2), Cell::new(18, 2));
        let mut planner = Planner::new(1000);
        assert_eq!(planner.plan(&costmap, here, there), Err(NoPath::Unreachable));
        assert_eq!(planner.plan(&costmap, here, Cell::new(10, 2)), Err(NoPath::GoalBlocked));
        assert_eq!(planner.plan(&costmap, here, Cell::new(99, 2)), Err(NoPath::GoalBlocked));
        assert_eq!(planner.plan(&costmap, Cell::new(-1, 2), here), Err(NoPath::StartBlocked));
        assert_eq!(Planner::new(5).plan(&costmap, here, Cell::new(9, 20)), Err(NoPath::Budget));
        assert_eq!(planner.plan(&costmap, here, here), Ok(&[here][..]));
    }
}
