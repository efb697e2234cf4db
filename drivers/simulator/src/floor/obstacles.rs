//! All obstacles as convex polygons in the plane, with exact distance queries.

use super::grid::Grid;
use super::polygon::{Polygon, nearest_point};

/// Convex polygons, indexed by the grid cells that they touch.
#[derive(Debug)]
pub(super) struct Obstacles {
    grid: Grid,
    corners: Vec<[f32; 2]>,
    /// Corners of polygon i: `corners[first_corner[i]..first_corner[i + 1]]`.
    first_corner: Vec<u32>,
    /// Polygons in cell i: `by_cell[first_in_cell[i]..first_in_cell[i + 1]]`.
    first_in_cell: Vec<u32>,
    by_cell: Vec<u32>,
}

impl Obstacles {
    pub fn new(grid: Grid, polygons: &[Polygon]) -> Self {
        let mut corners = Vec::new();
        let mut first_corner = vec![0];
        let mut first_in_cell = vec![0_u32; grid.cells() + 1];
        for polygon in polygons {
            corners.extend(polygon.corners().iter().map(|c| c.map(|v| v as f32)));
            first_corner.push(corners.len() as u32);
            polygon.for_each_cell(&grid, |cell| first_in_cell[cell + 1] += 1);
        }
        for cell in 0..grid.cells() {
            first_in_cell[cell + 1] += first_in_cell[cell];
        }
        let mut next = first_in_cell.clone();
        let mut by_cell = vec![0; *first_in_cell.last().unwrap_or(&0) as usize];
        for (index, polygon) in polygons.iter().enumerate() {
            polygon.for_each_cell(&grid, |cell| {
                by_cell[next[cell] as usize] = index as u32;
                next[cell] += 1;
            });
        }
        Self { grid, corners, first_corner, first_in_cell, by_cell }
    }

    /// The obstacle point nearest to `point` and its distance, when that is less than `limit_m`.
    /// Accurate to the single precision of the corners: a micrometre.
    pub fn nearest(&self, point: [f64; 2], limit_m: f64) -> Option<([f64; 2], f64)> {
        let mut best = None;
        let mut limit = limit_m;
        let [columns, rows] =
            self.grid.range(point.map(|c| c - limit_m), point.map(|c| c + limit_m));
        for row in rows {
            for column in columns.clone() {
                let cell = row * self.grid.width + column;
                let shapes =
                    self.first_in_cell[cell] as usize..self.first_in_cell[cell + 1] as usize;
                if shapes.is_empty() || self.distance_to_cell(point, cell) >= limit {
                    continue;
                }
                for &shape in &self.by_cell[shapes] {
                    let range = self.first_corner[shape as usize] as usize
                        ..self.first_corner[shape as usize + 1] as usize;
                    let mut corners = [[0.0; 2]; 5];
                    for (corner, stored) in corners.iter_mut().zip(&self.corners[range.clone()]) {
                        *corner = stored.map(f64::from);
                    }
                    let near = nearest_point(&corners[..range.len()], point);
                    let distance = (near[0] - point[0]).hypot(near[1] - point[1]);
                    if distance < limit {
                        limit = distance;
                        best = Some((near, distance));
                    }
                }
            }
        }
        best
    }

    fn distance_to_cell(&self, point: [f64; 2], cell: usize) -> f64 {
        let center = self.grid.center(cell);
        outside_cell(point[0] - center[0], self.grid.resolution_m)
            .hypot(outside_cell(point[1] - center[1], self.grid.resolution_m))
    }
}

fn outside_cell(offset_m: f64, resolution_m: f64) -> f64 {
    (offset_m.abs() - resolution_m / 2.0).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_nearest_obstacle_is_the_one_that_a_search_over_all_finds(
            boxes in prop::collection::vec((0.0..4.0, 0.0..4.0, 0.0..1.0, 0.0..1.0), 1..12),
            point in [0.0..4.0, 0.0..4.0],
            limit in 0.05..2.0,
        ) {
            let boxes: Vec<Polygon> =
                boxes.into_iter().map(|(x, y, w, h)| Polygon::rectangle([x, y], [x + w, y + h])).collect();
            let obstacles = Obstacles::new(Grid::covering([0.0; 2], [5.0; 2], 0.1), &boxes);
            let expected = boxes
                .iter()
                .map(|b| nearest_point(b.corners(), point))
                .map(|near| (near[0] - point[0]).hypot(near[1] - point[1]))
                .fold(f64::INFINITY, f64::min);
            match obstacles.nearest(point, limit) {
                Some((near, distance)) => {
                    prop_assert!((distance - expected).abs() < 1e-6);
                    prop_assert!(((near[0] - point[0]).hypot(near[1] - point[1]) - distance).abs() < 1e-12);
                }
                None => prop_assert!(expected > limit - 1e-6),
            }
        }
    }
}
