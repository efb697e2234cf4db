//! The cheapest way, and the distance to everywhere.

use super::buckets::{Buckets, Entry};
use super::costmap::{Costmap, LEVEL, WEIGHT};
use super::steps::{
    DIAGONAL, FREE_DIAGONAL, FREE_STEP, NATURAL, NO_STEP, STEPS, STRAIGHT, all_allowed, onward,
};
use crate::mapping::Cell;

/// What a search knows of a cell.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Node {
    cost: u32,
    mark: Mark,
}

/// The rest of what a search knows of a cell, in one word.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Mark(u32);

impl Mark {
    /// `step` is how the cheapest way enters, `open` are the steps to take from here, `done` those taken at this cost.
    #[inline]
    fn new(search: u8, step: u8, open: u8, done: u8) -> Self {
        Self(u32::from_le_bytes([step, open, done, search]))
    }

    #[inline]
    fn step(self) -> u8 {
        self.0.to_le_bytes()[0]
    }

    #[inline]
    fn open(self) -> u8 {
        self.0.to_le_bytes()[1]
    }

    #[inline]
    fn done(self) -> u8 {
        self.0.to_le_bytes()[2]
    }

    /// The search that wrote this. What earlier ones knew is forgotten without being touched.
    #[inline]
    fn search(self) -> u8 {
        self.0.to_le_bytes()[3]
    }
}

const UNSEEN: Node = Node { cost: u32::MAX, mark: Mark(0) };

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
    /// Number of the last search, from 1; what bears another number is forgotten.
    search: u8,
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
            search: 0,
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

    /// Steps that the last search tried.
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
        let start = Place::of(costmap, start).ok_or(NoPath::StartBlocked)?;
        let goal = goal.and_then(|cell| Place::of(costmap, cell));
        let open = all_allowed(costmap, start.index);
        self.nodes[start.index] = Node { cost: 0, mark: Mark::new(self.search, NO_STEP, open, 0) };
        let first = lower_bound(goal, start.x, start.y);
        self.queue.restart(first);
        self.queue.push(first, Entry { x: start.x, y: start.y, cost: 0 });
        while let Some(entry) = self.queue.pop() {
            if goal.is_some_and(|goal| self.cost(goal.index) <= self.queue.now()) {
                return Ok(true);
            }
            let node =
                &mut self.nodes[usize::from(entry.y) * costmap.stride + usize::from(entry.x)];
            let mut open = node.mark.open();
            if node.cost != entry.cost || open == 0 {
                continue;
            }
            node.mark = Mark::new(self.search, node.mark.step(), 0, node.mark.done() | open);
            while open != 0 {
                self.run(costmap, entry, open.trailing_zeros() as usize, goal);
                open &= open - 1;
            }
            if self.expanded > self.max_expanded {
                return Err(NoPath::Budget);
            }
        }
        Ok(goal.is_none_or(|goal| self.cost(goal.index) != u32::MAX))
    }

    /// Takes a step that is allowed, and queues where it leads if that is news. Where no other step than the same again is worth
    /// taking, up to [`RUN`] are taken without asking the queue: a cell that later turns out cheaper is queued again.
    #[inline]
    fn run(&mut self, costmap: &Costmap, from: Entry, direction: usize, goal: Option<Place>) {
        let weights = costmap.weights.as_slice();
        let nodes = &mut self.nodes[..weights.len()];
        let (dx, dy) = STEPS[direction];
        let offset = dx as isize + dy as isize * costmap.stride as isize;
        let is_straight = direction.is_multiple_of(2);
        let length = if is_straight { STRAIGHT } else { DIAGONAL };
        let level = if is_straight { LEVEL[direction / 2 % 2] } else { LEVEL[0] | LEVEL[1] };
        let again = 1 << direction;
        let passed = Mark::new(self.search, direction as u8, 0, again);
        let enough = from.cost + RUN as u32 * FREE_STEP;
        let mut index = usize::from(from.y) * costmap.stride + usize::from(from.x);
        let mut cost = from.cost;
        let mut steps = 0;
        let is_news = loop {
            index = index.wrapping_add_signed(offset);
            steps += 1;
            let weight = weights[index];
            cost += length * u32::from(weight & WEIGHT);
            let node = &mut nodes[index];
            let known = if node.mark.search() == self.search { node.cost } else { u32::MAX };
            if cost > known {
                break false;
            }
            let onward = if weight & level == level {
                NATURAL[direction]
            } else {
                onward(costmap, index, direction)
            };
            if cost == known {
                // As cheap from here as from elsewhere: the steps that are natural from here have to be taken too.
                let (open, done) = (node.mark.open(), node.mark.done());
                let news = onward & !(open | done);
                node.mark = Mark::new(self.search, node.mark.step(), open | news, done);
                break news != 0 && open == 0;
            }
            if onward != again || cost >= enough {
                *node = Node { cost, mark: Mark::new(self.search, direction as u8, onward, 0) };
                break onward != 0;
            }
            *node = Node { cost, mark: passed };
        };
        self.expanded += steps;
        if is_news {
            let x = from.x.wrapping_add_signed(dx as i16 * steps as i16);
            let y = from.y.wrapping_add_signed(dy as i16 * steps as i16);
            self.queue.push(cost + lower_bound(goal, x, y), Entry { x, y, cost });
        }
    }

    /// Cost of the cheapest way that the last search knows.
    #[inline]
    fn cost(&self, index: usize) -> u32 {
        let node = self.nodes[index];
        if node.mark.search() == self.search { node.cost } else { u32::MAX }
    }

    /// Makes every cell unseen.
    fn prepare(&mut self, costmap: &Costmap) {
        let size = costmap.weights.len();
        if self.nodes.len() != size || self.search == u8::MAX {
            self.nodes.clear();
            self.nodes.resize(size, UNSEEN);
            self.search = 0;
        }
        self.search += 1;
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
        let Some(mut index) = costmap.index(goal) else { return };
        let mut cell = goal;
        self.path.push(cell);
        while let Some(&(dx, dy)) = STEPS.get(usize::from(self.nodes[index].mark.step())) {
            cell = cell.offset(-dx, -dy);
            index =
                index.wrapping_add_signed(-(dx as isize + dy as isize * costmap.stride as isize));
            self.path.push(cell);
        }
        self.path.extend(self.escape.iter().rev());
        self.path.reverse();
    }
}

/// Cells that are looked at to leave an obstacle's margin: a disc of 16 cells radius.
const LONGEST_ESCAPE: usize = 800;

/// A cell in memory.
#[derive(Debug, Clone, Copy)]
struct Place {
    index: usize,
    x: u16,
    y: u16,
}

impl Place {
    fn of(costmap: &Costmap, cell: Cell) -> Option<Self> {
        let index = costmap.index(cell)?;
        Some(Self { index, x: (index % costmap.stride) as u16, y: (index / costmap.stride) as u16 })
    }
}

/// Octile distance to the goal on free floor: never more than the true cost, and no step lowers it by more than the step costs.
#[inline]
fn lower_bound(goal: Option<Place>, x: u16, y: u16) -> u32 {
    let Some(goal) = goal else { return 0 };
    let dx = u32::from(x.abs_diff(goal.x));
    let dy = u32::from(y.abs_diff(goal.y));
    FREE_STEP * dx.max(dy) + (FREE_DIAGONAL - FREE_STEP) * dx.min(dy)
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
        let cost = Some(self.planner.cost(index)).filter(|cost| *cost != u32::MAX)?;
        Some(f64::from(cost) / f64::from(FREE_STEP) * self.costmap.cell_m)
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
