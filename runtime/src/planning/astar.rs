//! The cheapest way, and the distance to everywhere.

use super::buckets::{Buckets, Entry};
use super::costmap::{Costmap, UNIFORM};
use super::steps::{ALL, DIAGONAL, FREE_DIAGONAL, FREE_STEP, NATURAL, NO_STEP, STEPS, STRAIGHT, is_allowed, onward};
use crate::mapping::Cell;

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

/// Straight steps on free floor that are taken at once. Long runs save queueing, but run past what the search needs; and all
/// priorities have to fit into the queue's ring.
const RUN: usize = 8;

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
            self.expand(costmap, entry, goal_index, directions, &heuristic);
        }
        Ok(goal_index == usize::MAX)
    }

    /// Takes every step of the set `directions` from a cell.
    #[inline]
    fn expand(&mut self, costmap: &Costmap, from: Entry, goal_index: usize, directions: u8, heuristic: &Heuristic) {
        let row = usize::from(from.y);
        self.dirty = self.dirty.start.min(row.saturating_sub(RUN + 1))..self.dirty.end.max(row + RUN + 2);
        let index = row * costmap.stride + usize::from(from.x);
        let even = costmap.weights[index] & UNIFORM != 0;
        let mut left = directions;
        while left != 0 {
            let direction = left.trailing_zeros() as usize;
            left &= left - 1;
            if even || is_allowed(costmap, index, direction) {
                self.step(costmap, from, direction, goal_index, heuristic);
            }
        }
    }

    /// Takes a step that is allowed, and queues where it leads if that is news. On even ground and along walls a straight
    /// step is followed by up to [`RUN`] more like it without asking the queue: a cell that later turns out cheaper is queued again.
    #[inline]
    fn step(&mut self, costmap: &Costmap, mut from: Entry, direction: usize, goal_index: usize, heuristic: &Heuristic) {
        let (dx, dy) = STEPS[direction];
        let offset = dx as isize + dy as isize * costmap.stride as isize;
        let is_diagonal = direction % 2 == 1;
        let length = if is_diagonal { DIAGONAL } else { STRAIGHT };
        let mut index = usize::from(from.y) * costmap.stride + usize::from(from.x);
        let enough = from.cost + RUN as u32 * FREE_STEP;
        loop {
            index = index.wrapping_add_signed(offset);
            let weight = costmap.weights[index];
            let cost = from.cost + length * u32::from(weight & !UNIFORM);
            let even = weight & UNIFORM != 0;
            let onward = if even { NATURAL[direction] } else { onward(costmap, index, direction) };
            from = Entry { x: from.x.wrapping_add_signed(dx as i16), y: from.y.wrapping_add_signed(dy as i16), cost };
            let node = &mut self.nodes[index];
            if cost < node.cost {
                *node = Node { cost, step: direction as u8, open: onward, done: 0 };
            } else {
                // As cheap from here as from elsewhere: the steps that are natural from here have to be taken too.
                let news = onward & !(node.done | node.open);
                if cost > node.cost || news == 0 {
                    return;
                }
                node.open |= news;
                if node.open != news {
                    return;
                }
            }
            if is_diagonal || cost >= enough || index == goal_index {
                break;
            }
            // Along a wall without openings nothing else is natural either.
            if !even && (onward != NATURAL[direction] || !is_allowed(costmap, index, direction)) {
                break;
            }
            node.done |= node.open;
            node.open = 0;
            self.expanded += 1;
        }
        self.queue.push(from.cost + heuristic.of(from.x, from.y), from);
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
mod tests;
