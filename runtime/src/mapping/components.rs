//! Connected components: 8-connected groups of cells. The algorithm first collects runs of
//! neighbouring cells in each row and then unites touching runs of neighbouring rows.

use super::Cell;
use super::bits::BitPlane;

/// A run of cells in one row, both ends included.
#[derive(Debug, Clone, Copy)]
pub(super) struct Run {
    pub y: i32,
    pub first_x: i32,
    pub last_x: i32,
    /// Index of the parent in the union-find forest. A root is its own parent and the first run of
    /// its group.
    parent: u32,
}

/// An 8-connected group of cells.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Component {
    pub cells: usize,
    sum_x: i64,
    sum_y: i64,
}

impl Component {
    /// Mean of the cells' centres, metres.
    pub fn centroid_m(&self, cell_m: f64) -> [f64; 2] {
        [self.sum_x, self.sum_y].map(|sum| (sum as f64 / self.cells as f64 + 0.5) * cell_m)
    }

    /// The cell nearest to the centroid.
    pub fn centroid(&self) -> Cell {
        let [x, y] =
            [self.sum_x, self.sum_y].map(|sum| (sum as f64 / self.cells as f64).round() as i32);
        Cell::new(x, y)
    }
}

/// Finds the connected components of a set of cells and reuses its buffers.
#[derive(Debug, Clone, Default)]
pub(super) struct Components {
    runs: Vec<Run>,
    groups: Vec<Component>,
    /// For each run that is a root, the index of its group in `groups`.
    group_index: Vec<u32>,
}

impl Components {
    /// Finds all groups of a set; [`groups`](Self::groups) and [`runs`](Self::runs) return the
    /// result.
    pub fn find(&mut self, plane: &BitPlane) {
        self.runs.clear();
        let mut above = 0..0;
        for row in 0..plane.rows() {
            let start = self.runs.len();
            let y = plane.cells.min.y + row as i32;
            for_each_run(plane.row(row), |first, last| {
                self.runs.push(Run {
                    y,
                    first_x: plane.cells.min.x + first as i32,
                    last_x: plane.cells.min.x + last as i32,
                    parent: self.runs.len() as u32,
                });
            });
            let here = start..self.runs.len();
            self.join(above, here.clone());
            above = here;
        }
        self.collect_groups();
    }

    /// The groups in the order of their first cells, row by row.
    pub fn groups(&self) -> &[Component] {
        &self.groups
    }

    /// Every run with the index of its group in [`groups`](Self::groups).
    pub fn runs(&self) -> impl Iterator<Item = (&Run, usize)> {
        self.runs.iter().map(|run| (run, self.group_index[run.parent as usize] as usize))
    }

    /// Unites the runs of one row with the runs of the next row that touch them, including
    /// diagonally.
    fn join(&mut self, above: core::ops::Range<usize>, here: core::ops::Range<usize>) {
        let mut a = above.start;
        let mut b = here.start;
        while a < above.end && b < here.end {
            let upper = self.runs[a];
            let lower = self.runs[b];
            if upper.first_x <= lower.last_x + 1 && lower.first_x <= upper.last_x + 1 {
                self.unite(a as u32, b as u32);
            }
            if upper.last_x < lower.last_x {
                a += 1;
            } else {
                b += 1;
            }
        }
    }

    fn root(&mut self, mut run: u32) -> u32 {
        loop {
            let parent = self.runs[run as usize].parent;
            if parent == run {
                return run;
            }
            let grandparent = self.runs[parent as usize].parent;
            self.runs[run as usize].parent = grandparent;
            run = grandparent;
        }
    }

    fn unite(&mut self, a: u32, b: u32) {
        let root_a = self.root(a);
        let root_b = self.root(b);
        // The earlier run becomes the root, so the order of groups does not depend on the order of
        // unions.
        self.runs[root_a.max(root_b) as usize].parent = root_a.min(root_b);
    }

    /// Fills `groups` from the runs.
    fn collect_groups(&mut self) {
        self.groups.clear();
        self.group_index.clear();
        self.group_index.resize(self.runs.len(), 0);
        for at in 0..self.runs.len() as u32 {
            let root = self.root(at);
            self.runs[at as usize].parent = root;
            if root == at {
                self.group_index[at as usize] = self.groups.len() as u32;
                self.groups.push(Component { cells: 0, sum_x: 0, sum_y: 0 });
            }
            let run = self.runs[at as usize];
            let length = i64::from(run.last_x - run.first_x + 1);
            let group = &mut self.groups[self.group_index[root as usize] as usize];
            group.cells += length as usize;
            group.sum_x += length * (i64::from(run.first_x) + i64::from(run.last_x)) / 2;
            group.sum_y += length * i64::from(run.y);
        }
    }
}

/// Calls `found` with the first and last position of every run of set bits.
fn for_each_run(row: &[u64], mut found: impl FnMut(usize, usize)) {
    let mut open = None;
    for (at, &word) in row.iter().enumerate() {
        // Bits that differ from their left neighbour mark where runs begin and end.
        let carry = u64::from(open.is_some());
        let mut edges = word ^ (word << 1 | carry);
        while edges != 0 {
            let position = at * 64 + edges.trailing_zeros() as usize;
            edges &= edges - 1;
            match open.take() {
                None => open = Some(position),
                Some(first) => found(first, position - 1),
            }
        }
    }
    if let Some(first) = open {
        found(first, row.len() * 64 - 1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mapping::CellBox;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    fn naive(cells: &BTreeSet<(i32, i32)>) -> Vec<BTreeSet<(i32, i32)>> {
        let mut left = cells.clone();
        let mut groups = Vec::new();
        while let Some(first) = left.pop_first() {
            let mut group = BTreeSet::from([first]);
            let mut stack = vec![first];
            while let Some((y, x)) = stack.pop() {
                for (dy, dx) in (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dy, dx))) {
                    if left.remove(&(y + dy, x + dx)) {
                        group.insert((y + dy, x + dx));
                        stack.push((y + dy, x + dx));
                    }
                }
            }
            groups.push(group);
        }
        groups
    }

    proptest! {
        #[test]
        fn groups_are_those_of_a_flood_fill(
            width in 1..150i32, height in 1..20i32, density in 0.05..0.7f64, seed in 0..u64::MAX, x0 in -200..200i32,
        ) {
            let cells = CellBox { min: Cell::new(x0, -7), max: Cell::new(x0 + width - 1, height - 8) };
            let mut plane = BitPlane::default();
            plane.reset(cells);
            let mut set = BTreeSet::new();
            let mut state = seed | 1;
            for y in cells.min.y..=cells.max.y {
                for x in cells.min.x..=cells.max.x {
                    state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                    if (state >> 40) as f64 / (1u64 << 24) as f64 <= density {
                        plane.insert(Cell::new(x, y));
                        set.insert((y, x));
                    }
                }
            }
            let expected = naive(&set);
            let mut components = Components::default();
            components.find(&plane);
            let found = components.groups();
            prop_assert_eq!(found.len(), expected.len());
            for (group, cells) in found.iter().zip(&expected) {
                prop_assert_eq!(group.cells, cells.len());
                let mean_x = cells.iter().map(|(_, x)| f64::from(*x) + 0.5).sum::<f64>() / cells.len() as f64;
                let mean_y = cells.iter().map(|(y, _)| f64::from(*y) + 0.5).sum::<f64>() / cells.len() as f64;
                let [x, y] = group.centroid_m(1.0);
                prop_assert!((x - mean_x).abs() < 1e-9 && (y - mean_y).abs() < 1e-9);
            }
            for (run, place) in components.runs() {
                prop_assert!((run.first_x..=run.last_x).all(|x| expected[place].contains(&(run.y, x))));
            }
        }
    }
}
