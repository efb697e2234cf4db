//! Sets of cells as bit planes with 64 cells per word.

use super::{Cell, CellBox, OccupancyGrid};

/// A set of cells within a box. The bits that pad each row to whole words are 0.
#[derive(Debug, Clone)]
pub(super) struct BitPlane {
    pub cells: CellBox,
    pub words_per_row: usize,
    words: Vec<u64>,
}

impl Default for BitPlane {
    fn default() -> Self {
        Self { cells: CellBox::of(Cell::default()), words_per_row: 1, words: vec![0] }
    }
}

impl BitPlane {
    /// Empties the set and changes its box.
    pub fn reset(&mut self, cells: CellBox) {
        self.cells = cells;
        self.words_per_row = cells.width().div_ceil(64);
        self.words.clear();
        self.words.resize(self.words_per_row * cells.height(), 0);
    }

    pub fn rows(&self) -> usize {
        self.cells.height()
    }

    /// Row `row` of the box, counted from 0.
    pub fn row(&self, row: usize) -> &[u64] {
        &self.words[row * self.words_per_row..(row + 1) * self.words_per_row]
    }

    pub fn row_mut(&mut self, row: usize) -> &mut [u64] {
        &mut self.words[row * self.words_per_row..(row + 1) * self.words_per_row]
    }

    fn place(&self, cell: Cell) -> Option<(usize, u32)> {
        if !self.cells.contains(cell) {
            return None;
        }
        let x = (cell.x - self.cells.min.x) as usize;
        let y = (cell.y - self.cells.min.y) as usize;
        Some((y * self.words_per_row + x / 64, (x % 64) as u32))
    }

    /// Adds a cell; cells outside the box are ignored.
    pub fn insert(&mut self, cell: Cell) {
        if let Some((word, bit)) = self.place(cell) {
            self.words[word] |= 1 << bit;
        }
    }

    pub fn contains(&self, cell: Cell) -> bool {
        self.place(cell).is_some_and(|(word, bit)| self.words[word] >> bit & 1 == 1)
    }
}

/// Fills `free` and `known` with the free and the known cells of the map within `cells`.
pub(super) fn free_and_known(
    grid: &OccupancyGrid,
    cells: CellBox,
    free: &mut BitPlane,
    known: &mut BitPlane,
) {
    free.reset(cells);
    known.reset(cells);
    for row in 0..cells.height() {
        let (left, right) = grid.row(cells.min.y + row as i32, cells.min.x, cells.width());
        pack(left, 0, free.row_mut(row), known.row_mut(row));
        pack(right, left.len(), free.row_mut(row), known.row_mut(row));
    }
}

/// Writes the states of `values` to the bits from position `first` on.
fn pack(values: &[f32], first: usize, free: &mut [u64], known: &mut [u64]) {
    let head = values.len().min((64 - first % 64) % 64);
    let (head, body) = values.split_at(head);
    let mut at = first;
    for chunk in core::iter::once(head).chain(body.chunks(64)).filter(|chunk| !chunk.is_empty()) {
        let negative = bits_of(chunk, |value| value < 0.0);
        let nonzero = bits_of(chunk, |value| value != 0.0);
        free[at / 64] |= negative << (at % 64);
        known[at / 64] |= nonzero << (at % 64);
        at += chunk.len();
    }
}

/// One bit for each of at most 64 values.
fn bits_of(values: &[f32], test: impl Fn(f32) -> bool) -> u64 {
    let mut flags = [0u8; 64];
    for (flag, value) in flags.iter_mut().zip(values) {
        *flag = u8::from(test(*value));
    }
    let mut bits = 0;
    for (at, eight) in flags.as_chunks::<8>().0.iter().enumerate() {
        // The multiplication collects the lowest bits of 8 bytes: byte k becomes bit k of the top
        // byte, and no sum carries.
        bits |= (u64::from_le_bytes(*eight).wrapping_mul(0x0102_0408_1020_4080) >> 56) << (8 * at);
    }
    bits
}

/// Writes the row dilated by one cell: a bit is set if it or its left or right neighbour is set in
/// `row`.
pub(super) fn widen(row: &[u64], out: &mut [u64]) {
    for (at, wide) in out.iter_mut().enumerate() {
        let word = row[at];
        let left = if at > 0 { row[at - 1] >> 63 } else { 0 };
        let right = row.get(at + 1).map_or(0, |next| next << 63);
        *wide = word | word << 1 | left | word >> 1 | right;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn packing_in_two_parts_equals_packing_each_value(values in proptest::collection::vec(-1..2i32, 1..300), cut in 0..300usize) {
            let values: Vec<f32> = values.iter().map(|value| *value as f32).collect();
            let cut = cut.min(values.len());
            let words = values.len().div_ceil(64);
            let mut free = vec![0; words];
            let mut known = vec![0; words];
            pack(&values[..cut], 0, &mut free, &mut known);
            pack(&values[cut..], cut, &mut free, &mut known);
            for (at, value) in values.iter().enumerate() {
                prop_assert_eq!(free[at / 64] >> (at % 64) & 1 == 1, *value < 0.0);
                prop_assert_eq!(known[at / 64] >> (at % 64) & 1 == 1, *value != 0.0);
            }
        }

        #[test]
        fn widening_sets_the_neighbours(cells in proptest::collection::vec(0..190usize, 0..20)) {
            let mut row = vec![0u64; 3];
            for cell in &cells {
                row[cell / 64] |= 1 << (cell % 64);
            }
            let mut wide = vec![0; 3];
            widen(&row, &mut wide);
            for at in 0..192usize {
                let expected = cells.iter().any(|cell| cell.abs_diff(at) <= 1);
                prop_assert_eq!(wide[at / 64] >> (at % 64) & 1 == 1, expected);
            }
        }
    }
}
