//! Distance transform: the distance of every cell to the nearest obstacle, up to a limited reach.

/// There is no obstacle within the reach.
pub(super) const FAR: u16 = u16::MAX;

/// Exact squared Euclidean distances in cells, up to a reach; reuses its buffers.
///
/// The transform is separable: first the squared distance along the row, then the minimum over
/// nearby rows (Felzenszwalb and Huttenlocher 2012). With a reach of a few cells, the second step
/// is a short loop over whole rows.
#[derive(Debug, Clone, Default)]
pub(super) struct Distances {
    along_row: Vec<u16>,
    /// Whether the row contains an obstacle.
    has_obstacle: Vec<bool>,
}

impl Distances {
    /// Prepares the transform for a map without obstacles.
    pub fn reset(&mut self, width: usize, height: usize) {
        self.along_row.clear();
        self.along_row.resize(width * height, FAR);
        self.has_obstacle.clear();
        self.has_obstacle.resize(height, false);
    }

    /// Sets the obstacles of one row, one item for each column.
    pub fn set_row(&mut self, row: usize, obstacles: impl Iterator<Item = bool>, reach: u16) {
        let width = self.along_row.len() / self.has_obstacle.len().max(1);
        let line = &mut self.along_row[row * width..(row + 1) * width];
        let mut since = FAR;
        for (out, obstacle) in line.iter_mut().zip(obstacles) {
            since = if obstacle { 0 } else { since.saturating_add(1) };
            *out = since;
            self.has_obstacle[row] |= obstacle;
        }
        if !self.has_obstacle[row] {
            line.fill(FAR);
            return;
        }
        let mut until = FAR;
        for out in line.iter_mut().rev() {
            until = if *out == 0 { 0 } else { until.saturating_add(1) };
            let nearest = until.min(*out);
            *out = if nearest <= reach { nearest * nearest } else { FAR };
        }
    }

    /// Writes the squared distances of one row to `out`, with [`FAR`] beyond `reach`.
    pub fn row(&self, row: usize, reach: u16, out: &mut [u16]) {
        let width = out.len();
        out.fill(FAR);
        let reach = usize::from(reach);
        for near in row.saturating_sub(reach)..(row + reach + 1).min(self.has_obstacle.len()) {
            if self.has_obstacle[near] {
                let apart = near.abs_diff(row);
                let apart2 = (apart * apart) as u16;
                let line = &self.along_row[near * width..(near + 1) * width];
                for (out, along) in out.iter_mut().zip(line) {
                    *out = (*out).min(along.saturating_add(apart2));
                }
            }
        }
        let reach2 = (reach * reach) as u16;
        for out in out {
            *out = if *out <= reach2 { *out } else { FAR };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn distances_equal_those_of_a_search_over_all_obstacles(
            width in 1..40usize, height in 1..25usize, reach in 0..12u16, obstacles in proptest::collection::vec((0..40usize, 0..25usize), 0..8),
        ) {
            let mut distances = Distances::default();
            distances.reset(width, height);
            for row in 0..height {
                distances.set_row(row, (0..width).map(|x| obstacles.contains(&(x, row))), reach);
            }
            let mut out = vec![0; width];
            for row in 0..height {
                distances.row(row, reach, &mut out);
                for (x, got) in out.iter().enumerate() {
                    let inside = obstacles.iter().filter(|(ox, oy)| *ox < width && *oy < height);
                    let nearest = inside.map(|(ox, oy)| (ox.abs_diff(x).pow(2) + oy.abs_diff(row).pow(2)) as u16).min();
                    let expected = nearest.filter(|d2| *d2 <= reach * reach).unwrap_or(FAR);
                    prop_assert_eq!(*got, expected);
                }
            }
        }
    }
}
