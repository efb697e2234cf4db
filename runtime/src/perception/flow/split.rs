//! A picture whose rows keep their even columns first and their odd columns after them. Red-black relaxation updates every
//! other pixel; here they lie side by side, as vector registers like them.
//!
//! A row is `0 e e e e 0 | 0 o o o o 0`: each part between two places that stand for what is outside, as is a row above and a
//! row below the picture. With an odd width, the last odd column is outside, too.

/// A part of a row: the even or the odd columns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    Even,
    Odd,
}

/// A picture in split rows.
#[derive(Debug, Clone)]
pub struct Split {
    width: usize,
    data: Vec<f32>,
}

impl Split {
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, data: vec![0.0; stride(width) * (height + 2)] }
    }

    /// The whole split row `y`, with what is outside.
    pub fn row(&self, y: usize) -> &[f32] {
        let stride = stride(self.width);
        &self.data[(y + 1) * stride..][..stride]
    }

    /// The same, to be written.
    pub fn row_mut(&mut self, y: usize) -> &mut [f32] {
        let stride = stride(self.width);
        &mut self.data[(y + 1) * stride..][..stride]
    }

    /// Several whole rows from row `y` on, to be written.
    pub fn rows_mut(&mut self, y: usize, rows: usize) -> &mut [f32] {
        let stride = stride(self.width);
        &mut self.data[(y + 1) * stride..][..rows * stride]
    }

    /// Several whole rows from row `y` on.
    pub fn rows(&self, y: usize, rows: usize) -> &[f32] {
        let stride = stride(self.width);
        &self.data[(y + 1) * stride..][..rows * stride]
    }

    /// Row `y` from an ordinary row.
    pub fn split_row(&mut self, y: usize, row: &[f32]) {
        let half = half(self.width);
        let (even, odd) = self.row_mut(y).split_at_mut(half + 2);
        let (even, odd) = (&mut even[1..=half], &mut odd[1..=half]);
        for ((pair, even), odd) in row.chunks_exact(2).zip(even.iter_mut()).zip(odd) {
            (*even, *odd) = (pair[0], pair[1]);
        }
        if let [last] = row.chunks_exact(2).remainder() {
            even[half - 1] = *last;
        }
    }

    /// Row `y` as an ordinary row.
    pub fn join_row(&self, y: usize, row: &mut [f32]) {
        let half = half(self.width);
        let (even, odd) = self.row(y).split_at(half + 2);
        let (even, odd) = (&even[1..=half], &odd[1..=half]);
        let mut pairs = row.chunks_exact_mut(2);
        for ((pair, even), odd) in pairs.by_ref().zip(even).zip(odd) {
            (pair[0], pair[1]) = (*even, *odd);
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

    /// One part of row `y` (of the row above the picture for `None`).
    pub fn part_above(&self, y: usize, part: Part) -> &[f32] {
        &self.data[y * stride(self.width) + first(self.width, part)..][..half(self.width)]
    }

    /// One part of row `y`, to be written.
    pub fn part_mut(&mut self, y: usize, part: Part) -> &mut [f32] {
        let (first, half) = (first(self.width, part), half(self.width));
        &mut self.row_mut(y)[first..][..half]
    }

    /// One part of row `y`, to be written, and its neighbours to the left, to the right, above and below.
    pub fn cross(&mut self, y: usize, part: Part) -> (&mut [f32], [&[f32]; 4]) {
        let (stride, half, first) = (stride(self.width), half(self.width), first(self.width, part));
        let (above, rest) = self.data[y * stride..].split_at_mut(stride);
        let (row, below) = rest.split_at_mut(stride);
        let (even, odd) = row.split_at_mut(half + 2);
        let (own, left, right) = match part {
            Part::Even => (&mut even[1..][..half], &odd[..half], &odd[1..][..half]),
            Part::Odd => (&mut odd[1..][..half], &even[1..][..half], &even[2..][..half]),
        };
        (own, [left, right, &above[first..][..half], &below[first..][..half]])
    }

    /// Sets what is right of the last column of row `y` to the last column.
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

    /// Sets the last column of row `y`, and with an odd width what is right of it.
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

/// Where a part begins in its row.
fn first(width: usize, part: Part) -> usize {
    match part {
        Part::Even => 1,
        Part::Odd => half(width) + 3,
    }
}

/// Where the left neighbours of a part begin in their row; the right neighbours follow one place later.
fn left(width: usize, part: Part) -> usize {
    match part {
        Part::Even => half(width) + 2,
        Part::Odd => 1,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_comes_back_and_knows_its_neighbours_for_even_and_odd_widths() {
        for width in [6, 7] {
            let row: Vec<f32> = (1..=width as u8).map(f32::from).collect();
            let mut split = Split::new(width, 1);
            split.split_row(0, &row);
            let mut back = vec![0.0; width];
            split.join_row(0, &mut back);
            assert_eq!(row, back);
            for (part, offset) in [(Part::Even, 0), (Part::Odd, 1)] {
                let (left, right) =
                    (split.left_of(0, part).to_vec(), split.right_of(0, part).to_vec());
                let (own, around) = split.cross(0, part);
                assert_eq!((around[0], around[1]), (left.as_slice(), right.as_slice()));
                for x in (offset..width).step_by(2) {
                    let value =
                        |x: Option<usize>| x.and_then(|x| row.get(x)).copied().unwrap_or(0.0);
                    assert_eq!(own[x / 2], value(Some(x)));
                    assert_eq!(
                        (left[x / 2], right[x / 2]),
                        (value(x.checked_sub(1)), value(Some(x + 1)))
                    );
                }
            }
        }
    }
}
