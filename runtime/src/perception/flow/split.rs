//! An image whose rows keep their even columns first and their odd columns after them. Red-black relaxation updates every
//! other pixel; in this layout these are contiguous, as vector registers need them.
//!
//! A row is `0 e e e e 0 | 0 o o o o 0`: each part lies between two padding values for the columns outside the image. One row
//! above and one below the image are padding as well. With an odd width, the last odd column is padding, too.

/// A part of a row: the even or the odd columns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    Even,
    Odd,
}

/// An image in split rows.
#[derive(Debug, Clone)]
pub struct Split {
    width: usize,
    data: Vec<f32>,
}

impl Split {
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, data: vec![0.0; stride(width) * (height + 2)] }
    }

    /// The whole split row `y`, with its padding.
    pub fn row(&self, y: usize) -> &[f32] {
        let stride = stride(self.width);
        &self.data[(y + 1) * stride..][..stride]
    }

    /// The whole split row `y`, with its padding, for writing.
    pub fn row_mut(&mut self, y: usize) -> &mut [f32] {
        let stride = stride(self.width);
        &mut self.data[(y + 1) * stride..][..stride]
    }

    /// Several whole rows from row `y` on, writable.
    pub fn rows_mut(&mut self, y: usize, rows: usize) -> &mut [f32] {
        let stride = stride(self.width);
        &mut self.data[(y + 1) * stride..][..rows * stride]
    }

    /// Several whole rows from row `y` on.
    pub fn rows(&self, y: usize, rows: usize) -> &[f32] {
        let stride = stride(self.width);
        &self.data[(y + 1) * stride..][..rows * stride]
    }

    /// Sets row `y` from a row in ordinary column order.
    pub fn split_row(&mut self, y: usize, row: &[f32]) {
        let half = half(self.width);
        let (even, odd) = self.row_mut(y).split_at_mut(half + 2);
        let even = &mut even[1..=half];
        let odd = &mut odd[1..=half];
        for ((pair, even), odd) in row.chunks_exact(2).zip(even.iter_mut()).zip(odd) {
            *even = pair[0];
            *odd = pair[1];
        }
        if let [last] = row.chunks_exact(2).remainder() {
            even[half - 1] = *last;
        }
    }

    /// Writes row `y` in ordinary column order.
    pub fn join_row(&self, y: usize, row: &mut [f32]) {
        let half = half(self.width);
        let (even, odd) = self.row(y).split_at(half + 2);
        let even = &even[1..=half];
        let odd = &odd[1..=half];
        let mut pairs = row.chunks_exact_mut(2);
        for ((pair, even), odd) in pairs.by_ref().zip(even).zip(odd) {
            pair[0] = *even;
            pair[1] = *odd;
        }
        if let [last] = pairs.into_remainder() {
            *last = even[half - 1];
        }
    }

    /// One part of row `y`.
    pub fn part(&self, y: usize, part: Part) -> &[f32] {
        &self.row(y)[first(self.width, part)..][..half(self.width)]
    }

    /// The left neighbours of one part of row `y`.
    pub fn left_of(&self, y: usize, part: Part) -> &[f32] {
        &self.row(y)[left(self.width, part)..][..half(self.width)]
    }

    /// The right neighbours of one part of row `y`.
    pub fn right_of(&self, y: usize, part: Part) -> &[f32] {
        &self.row(y)[left(self.width, part) + 1..][..half(self.width)]
    }

    /// One part of the row above row `y`.
    pub fn part_above(&self, y: usize, part: Part) -> &[f32] {
        &self.data[y * stride(self.width) + first(self.width, part)..][..half(self.width)]
    }

    /// One part of row `y`, writable.
    pub fn part_mut(&mut self, y: usize, part: Part) -> &mut [f32] {
        let first = first(self.width, part);
        let half = half(self.width);
        &mut self.row_mut(y)[first..][..half]
    }

    /// One part of row `y`, writable, and its neighbours to the left, to the right, above and below.
    pub fn cross(&mut self, y: usize, part: Part) -> (&mut [f32], [&[f32]; 4]) {
        let stride = stride(self.width);
        let half = half(self.width);
        let first = first(self.width, part);
        let (above, rest) = self.data[y * stride..].split_at_mut(stride);
        let (row, below) = rest.split_at_mut(stride);
        let (even, odd) = row.split_at_mut(half + 2);
        let (own, left, right) = match part {
            Part::Even => (&mut even[1..][..half], &odd[..half], &odd[1..][..half]),
            Part::Odd => (&mut odd[1..][..half], &even[1..][..half], &even[2..][..half]),
        };
        (own, [left, right, &above[first..][..half], &below[first..][..half]])
    }

    /// Copies the last column of row `y` into the padding to its right.
    pub fn repeat_last_column(&mut self, y: usize) {
        let half = half(self.width);
        let even_width = self.width.is_multiple_of(2);
        let row = self.row_mut(y);
        if even_width {
            row[half + 1] = row[2 * half + 2];
        } else {
            row[2 * half + 2] = row[half];
        }
    }

    /// Sets the last column of row `y`, and with an odd width the padding to its right.
    pub fn set_last_column(&mut self, y: usize, value: f32) {
        let half = half(self.width);
        let even_width = self.width.is_multiple_of(2);
        let row = self.row_mut(y);
        row[2 * half + 2] = value;
        if !even_width {
            row[half] = value;
        }
    }
}

fn half(width: usize) -> usize {
    width.div_ceil(2)
}

fn stride(width: usize) -> usize {
    2 * (half(width) + 2)
}

/// Index at which a part begins in its row.
fn first(width: usize, part: Part) -> usize {
    match part {
        Part::Even => 1,
        Part::Odd => half(width) + 3,
    }
}

/// Index at which the left neighbours of a part begin in their row; the right neighbours begin one later.
fn left(width: usize, part: Part) -> usize {
    match part {
        Part::Even => half(width) + 2,
        Part::Odd => 1,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The value at column `x`, 0 outside.
    fn value(row: &[f32], x: Option<usize>) -> f32 {
        x.and_then(|x| row.get(x)).copied().unwrap_or(0.0)
    }

    #[test]
    fn a_split_row_joins_to_the_same_row_and_has_its_neighbours_for_even_and_odd_widths() {
        for width in [6, 7] {
            let row: Vec<f32> = (1..=width as u8).map(f32::from).collect();
            let mut split = Split::new(width, 1);
            split.split_row(0, &row);
            let mut back = vec![0.0; width];
            split.join_row(0, &mut back);
            assert_eq!(row, back);
            for (part, offset) in [(Part::Even, 0), (Part::Odd, 1)] {
                let left = split.left_of(0, part).to_vec();
                let right = split.right_of(0, part).to_vec();
                let (own, around) = split.cross(0, part);
                assert_eq!((around[0], around[1]), (left.as_slice(), right.as_slice()));
                for x in (offset..width).step_by(2) {
                    assert_eq!(own[x / 2], value(&row, Some(x)));
                    assert_eq!(
                        (left[x / 2], right[x / 2]),
                        (value(&row, x.checked_sub(1)), value(&row, Some(x + 1)))
                    );
                }
            }
        }
    }
}
