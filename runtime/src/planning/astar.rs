//! Path search on the costmap: the cheapest path to a goal (A*) and the distance to every cell
//! (Dijkstra).

use super::buckets::{Buckets, Entry};
use super::costmap::{Costmap, LEVEL, WEIGHT};
use super::steps::{
    DIAGONAL, FREE_DIAGONAL, FREE_STEP, NATURAL, NO_STEP, STEPS, STRAIGHT, passable_steps,
    successors,
};
use crate::mapping::Cell;

/// The search data of one cell.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Node {
    cost: u32,
    state: PackedState,
}

/// The search data of a cell apart from its cost, packed into 32 bits.
#[derive(Debug, Clone, Copy, PartialEq)]
struct PackedState(u32);

impl PackedState {
    /// `entered_by` is the step with which the cheapest path enters the cell, `open` is the set of
    /// steps still to take from here, and `expanded` is the set of steps already taken at this
    /// cost.
    #[inline]
    fn new(generation: u8, entered_by: u8, open: u8, expanded: u8) -> Self {
        Self(u32::from_le_bytes([entered_by, open, expanded, generation]))
    }

    #[inline]
    fn entered_by(self) -> u8 {
        self.0.to_le_bytes()[0]
    }

    #[inline]
    fn open(self) -> u8 {
        self.0.to_le_bytes()[1]
    }

    #[inline]
    fn expanded(self) -> u8 {
        self.0.to_le_bytes()[2]
    }

    /// Number of the search that wrote this entry. Entries of earlier searches count as unvisited,
    /// so the memory need not be cleared.
    #[inline]
    fn generation(self) -> u8 {
        self.0.to_le_bytes()[3]
    }
}

const UNVISITED: Node = Node { cost: u32::MAX, state: PackedState(0) };

/// At most this many steps in one direction are taken without using the queue. Longer runs save
/// queue operations, but expand cells that the search does not need. All priorities also have to
/// fit into the queue's ring.
const MAX_RUN: usize = 8;

/// Why there is no path.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, thiserror::Error)]
#[non_exhaustive]
pub enum NoPath {
    /// The start is outside the map, or so deep inside an obstacle that no passable cell is near.
    #[error("the start is blocked")]
    StartBlocked,
    /// The goal is outside the map or too close to an obstacle.
    #[error("the goal is blocked")]
    GoalBlocked,
    /// Start and goal are not connected.
    #[error("the goal cannot be reached from the start")]
    Unreachable,
    /// The search reached the configured maximum number of expanded cells.
    #[error("the search expanded the maximum number of cells without reaching the goal")]
    Budget,
}

/// Searches costmaps and reuses its buffers.
///
/// A step leads to one of the 8 neighbours, but never across the corner of a blocked cell. It costs
/// its length times the weight of the cell that it enters. Costs are integers, so equal maps give
/// equal paths on every machine.
#[derive(Debug, Clone)]
pub struct Planner {
    max_expanded: usize,
    nodes: Vec<Node>,
    /// Number of the current search, from 1; nodes with another number are unvisited.
    generation: u8,
    queue: Buckets,
    /// Cells from a start inside an obstacle's margin to the first passable cell, excluding that
    /// cell.
    exit_path: Vec<Cell>,
    path: Vec<Cell>,
    expanded: usize,
}

impl Planner {
    /// A planner that stops a search after `max_expanded` cells.
    #[must_use]
    pub fn new(max_expanded: usize) -> Self {
        Self {
            max_expanded,
            nodes: Vec::new(),
            generation: 0,
            queue: Buckets::default(),
            exit_path: Vec::new(),
            path: Vec::new(),
            expanded: 0,
        }
    }

    /// The cheapest path from `start` to `goal`, both included (A*). If the start is too close to
    /// an obstacle, the path first leaves the obstacle on the shortest path along which the
    /// distance to obstacles never decreases.
    ///
    /// # Errors
    /// The reason why there is no path.
    pub fn plan(&mut self, costmap: &Costmap, start: Cell, goal: Cell) -> Result<&[Cell], NoPath> {
        let from = self.leave_margin(costmap, start)?;
        if !costmap.is_passable(goal) {
            return Err(NoPath::GoalBlocked);
        }
        if !self.search(costmap, from, Some(goal))? {
            return Err(NoPath::Unreachable);
        }
        self.trace(costmap, goal);
        Ok(&self.path)
    }

    /// The distance from `start` to every reachable cell (Dijkstra).
    ///
    /// # Errors
    /// [`NoPath::StartBlocked`] or [`NoPath::Budget`].
    pub fn flood<'a>(&'a mut self, costmap: &'a Costmap, start: Cell) -> Result<Reach<'a>, NoPath> {
        let from = self.leave_margin(costmap, start)?;
        self.search(costmap, from, None)?;
        Ok(Reach { planner: self, costmap })
    }

    /// Number of steps that the last search tried.
    #[must_use]
    pub fn expanded(&self) -> usize {
        self.expanded
    }

    fn search(
        &mut self,
        costmap: &Costmap,
        start: Cell,
        goal: Option<Cell>,
    ) -> Result<bool, NoPath> {
        self.prepare(costmap);
        let start = GridIndex::of(costmap, start).ok_or(NoPath::StartBlocked)?;
        let goal = goal.and_then(|cell| GridIndex::of(costmap, cell));
        let open = passable_steps(costmap, start.index);
        self.nodes[start.index] =
            Node { cost: 0, state: PackedState::new(self.generation, NO_STEP, open, 0) };
        let first = lower_bound(goal, start.x, start.y);
        self.queue.restart(first);
        self.queue.push(first, Entry { x: start.x, y: start.y, cost: 0 });
        while let Some(entry) = self.queue.pop() {
            if goal.is_some_and(|goal| self.cost(goal.index) <= self.queue.now()) {
                return Ok(true);
            }
            let node =
                &mut self.nodes[usize::from(entry.y) * costmap.stride + usize::from(entry.x)];
            let mut open = node.state.open();
            if node.cost != entry.cost || open == 0 {
                continue;
            }
            node.state = PackedState::new(
                self.generation,
                node.state.entered_by(),
                0,
                node.state.expanded() | open,
            );
            while open != 0 {
                self.expand(costmap, entry, open.trailing_zeros() as usize, goal);
                open &= open - 1;
            }
            if self.expanded > self.max_expanded {
                return Err(NoPath::Budget);
            }
        }
        Ok(goal.is_none_or(|goal| self.cost(goal.index) != u32::MAX))
    }

    /// Takes an allowed step and queues the cell that it leads to if that cell has new steps to
    /// expand. While the only natural successor is the same step again, up to [`MAX_RUN`] steps are
    /// taken without the queue. This is correct because a cell that is reached at a lower cost
    /// later is queued again.
    #[inline]
    fn expand(
        &mut self,
        costmap: &Costmap,
        from: Entry,
        direction: usize,
        goal: Option<GridIndex>,
    ) {
        let weights = costmap.weights.as_slice();
        let nodes = &mut self.nodes[..weights.len()];
        let (dx, dy) = STEPS[direction];
        let offset = dx as isize + dy as isize * costmap.stride as isize;
        let is_straight = direction.is_multiple_of(2);
        let length = if is_straight { STRAIGHT } else { DIAGONAL };
        let level = if is_straight { LEVEL[direction / 2 % 2] } else { LEVEL[0] | LEVEL[1] };
        let same_step = 1 << direction;
        let passed = PackedState::new(self.generation, direction as u8, 0, same_step);
        let queue_from_cost = from.cost + MAX_RUN as u32 * FREE_STEP;
        let mut index = usize::from(from.y) * costmap.stride + usize::from(from.x);
        let mut cost = from.cost;
        let mut steps = 0;
        let has_new_steps = loop {
            index = index.wrapping_add_signed(offset);
            steps += 1;
            let weight = weights[index];
            cost += length * u32::from(weight & WEIGHT);
            let node = &mut nodes[index];
            let known_cost =
                if node.state.generation() == self.generation { node.cost } else { u32::MAX };
            if cost > known_cost {
                break false;
            }
            let successors = if weight & level == level {
                NATURAL[direction]
            } else {
                successors(costmap, index, direction)
            };
            if cost == known_cost {
                // Two paths reach this cell at the same cost: the natural successors of both have
                // to be expanded.
                let open = node.state.open();
                let expanded = node.state.expanded();
                let added = successors & !(open | expanded);
                node.state = PackedState::new(
                    self.generation,
                    node.state.entered_by(),
                    open | added,
                    expanded,
                );
                break added != 0 && open == 0;
            }
            if successors != same_step || cost >= queue_from_cost {
                *node = Node {
                    cost,
                    state: PackedState::new(self.generation, direction as u8, successors, 0),
                };
                break successors != 0;
            }
            *node = Node { cost, state: passed };
        };
        self.expanded += steps;
        if has_new_steps {
            let x = from.x.wrapping_add_signed(dx as i16 * steps as i16);
            let y = from.y.wrapping_add_signed(dy as i16 * steps as i16);
            self.queue.push(cost + lower_bound(goal, x, y), Entry { x, y, cost });
        }
    }

    /// Cost of the cheapest path to a cell that the last search found; `u32::MAX` if it found none.
    #[inline]
    fn cost(&self, index: usize) -> u32 {
        let node = self.nodes[index];
        if node.state.generation() == self.generation { node.cost } else { u32::MAX }
    }

    /// Marks every cell as unvisited.
    fn prepare(&mut self, costmap: &Costmap) {
        let size = costmap.weights.len();
        if self.nodes.len() != size || self.generation == u8::MAX {
            self.nodes.clear();
            self.nodes.resize(size, UNVISITED);
            self.generation = 0;
        }
        self.generation += 1;
        self.expanded = 0;
    }

    /// Fills `exit_path` and returns the cell where the search begins: `start` itself if it is
    /// passable.
    fn leave_margin(&mut self, costmap: &Costmap, start: Cell) -> Result<Cell, NoPath> {
        self.exit_path.clear();
        if costmap.is_passable(start) {
            return Ok(start);
        }
        let start_index = costmap.index(start).ok_or(NoPath::StartBlocked)?;
        // A breadth-first search in which the distance to obstacles never decreases, so it cannot
        // pass through a wall.
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
                    self.trace_exit(costmap, &seen, next);
                    return Ok(cell);
                }
            }
            next += 1;
            if next > MAX_EXIT_CELLS {
                break;
            }
        }
        Err(NoPath::StartBlocked)
    }

    fn trace_exit(&mut self, costmap: &Costmap, seen: &[(usize, usize)], mut at: usize) {
        loop {
            let (index, parent) = seen[at];
            self.exit_path.push(costmap.cell(index));
            if at == 0 {
                break;
            }
            at = parent;
        }
        self.exit_path.reverse();
    }

    /// Writes the path to `goal` into `path`.
    fn trace(&mut self, costmap: &Costmap, goal: Cell) {
        self.path.clear();
        let Some(mut index) = costmap.index(goal) else { return };
        let mut cell = goal;
        self.path.push(cell);
        while let Some(&(dx, dy)) = STEPS.get(usize::from(self.nodes[index].state.entered_by())) {
            cell = cell.offset(-dx, -dy);
            index =
                index.wrapping_add_signed(-(dx as isize + dy as isize * costmap.stride as isize));
            self.path.push(cell);
        }
        self.path.extend(self.exit_path.iter().rev());
        self.path.reverse();
    }
}

/// At most this many cells are visited to leave an obstacle's margin: a disc with a radius of 16
/// cells.
const MAX_EXIT_CELLS: usize = 800;

/// A cell's position in the costmap's memory.
#[derive(Debug, Clone, Copy)]
struct GridIndex {
    index: usize,
    x: u16,
    y: u16,
}

impl GridIndex {
    fn of(costmap: &Costmap, cell: Cell) -> Option<Self> {
        let index = costmap.index(cell)?;
        Some(Self { index, x: (index % costmap.stride) as u16, y: (index / costmap.stride) as u16 })
    }
}

/// Octile distance to the goal on free floor. The heuristic is admissible (never more than the true
/// cost) and consistent (no step lowers it by more than the cost of the step).
#[inline]
fn lower_bound(goal: Option<GridIndex>, x: u16, y: u16) -> u32 {
    let Some(goal) = goal else { return 0 };
    let dx = u32::from(x.abs_diff(goal.x));
    let dy = u32::from(y.abs_diff(goal.y));
    FREE_STEP * dx.max(dy) + (FREE_DIAGONAL - FREE_STEP) * dx.min(dy)
}

/// The distances from one start to every reachable cell.
#[derive(Debug)]
pub struct Reach<'a> {
    planner: &'a mut Planner,
    costmap: &'a Costmap,
}

impl Reach<'_> {
    /// Cost of the path to `cell`, in metres of free floor; `None` if there is no path.
    #[must_use]
    pub fn distance_m(&self, cell: Cell) -> Option<f64> {
        let index = self.costmap.index(cell)?;
        let cost = Some(self.planner.cost(index)).filter(|cost| *cost != u32::MAX)?;
        Some(f64::from(cost) / f64::from(FREE_STEP) * self.costmap.cell_m)
    }

    /// The reachable cell nearest to `cell`, at most `radius_m` away.
    #[must_use]
    pub fn nearest(&self, cell: Cell, radius_m: f64) -> Option<Cell> {
        self.costmap.nearest(cell, radius_m, |near| self.distance_m(near).is_some())
    }

    /// The cheapest path to `cell`.
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
mod tests;
