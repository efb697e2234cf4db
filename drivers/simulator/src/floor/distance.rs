//! Exact Euclidean distance transform (Felzenszwalb and Huttenlocher, "Distance transforms of
//! sampled functions", 2012).

use super::grid::Grid;

/// Distance from every cell's centre to the centre of the nearest cell for which `is_source` holds,
/// metres; infinite when there is none.
pub(super) fn distance_to(grid: &Grid, is_source: impl Fn(usize) -> bool) -> Vec<f32> {
    let width = grid.width;
    let height = grid.height;
    let mut squared: Vec<f64> =
        (0..grid.cells()).map(|i| if is_source(i) { 0.0 } else { f64::INFINITY }).collect();
    let mut envelope = Envelope::default();
    let mut line = vec![0.0; width.max(height)];
    for column in 0..width {
        for row in 0..height {
            line[row] = squared[row * width + column];
        }
        envelope.transform(&mut line[..height]);
        for row in 0..height {
            squared[row * width + column] = line[row];
        }
    }
    for row in squared.chunks_exact_mut(width) {
        envelope.transform(row);
    }
    squared.into_iter().map(|d| (d.sqrt() * grid.resolution_m) as f32).collect()
}

#[derive(Default)]
struct Envelope {
    /// Vertex of each parabola of the envelope, and the position from which it is the lowest.
    parts: Vec<(usize, f64)>,
    values: Vec<f64>,
}

impl Envelope {
    fn transform(&mut self, line: &mut [f64]) {
        self.values.clear();
        self.values.extend_from_slice(line);
        self.parts.clear();
        for (vertex, &value) in
            self.values.iter().enumerate().filter(|(_, value)| value.is_finite())
        {
            let mut from = f64::NEG_INFINITY;
            while let Some(&(other, other_from)) = self.parts.last() {
                let p = vertex as f64;
                let q = other as f64;
                from = ((value + p * p) - (self.values[other] + q * q)) / (2.0 * (p - q));
                if from > other_from {
                    break;
                }
                self.parts.pop();
                from = f64::NEG_INFINITY;
            }
            self.parts.push((vertex, from));
        }
        let mut part = 0;
        for (at, value) in line.iter_mut().enumerate() {
            while self.parts.get(part + 1).is_some_and(|&(_, from)| from < at as f64) {
                part += 1;
            }
            if let Some(&(vertex, _)) = self.parts.get(part) {
                *value = (at as f64 - vertex as f64).powi(2) + self.values[vertex];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn equals_the_search_over_all_cells(sources in prop::collection::vec(any::<bool>(), 63), sparse in any::<bool>()) {
            let grid = Grid::covering([0.0; 2], [0.9, 0.7], 0.1);
            let is_source: Vec<bool> = sources.iter().enumerate().map(|(i, source)| *source && (!sparse || i % 9 == 4)).collect();
            let distances = distance_to(&grid, |i| is_source[i]);
            for (cell, distance) in distances.into_iter().enumerate() {
                let [x, y] = grid.center(cell);
                let expected = (0..63)
                    .filter(|&i| is_source[i])
                    .map(|other| (grid.center(other)[0] - x).hypot(grid.center(other)[1] - y))
                    .fold(f64::INFINITY, f64::min);
                prop_assert!(f64::from(distance) == expected || (f64::from(distance) - expected).abs() < 1e-6);
            }
        }
    }
}
