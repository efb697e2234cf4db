//! Triangles on a grid of the floor.

use crate::scene::Triangle;

/// Edges are walked in steps of this share of a cell, so that no cell that they cross by more than that is missed.
const EDGE_STEP: f64 = 0.25;

/// Cells of a rectangle of the world, row 0 at the lowest y.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Frame {
    pub origin_m: [f64; 2],
    pub cell_m: f64,
    pub width: usize,
    pub height: usize,
}

impl Frame {
    /// Cells that cover the rectangle from `low` to `high`, metres.
    pub fn covering(low: [f64; 2], high: [f64; 2], cell_m: f64) -> Self {
        let cells = |axis: usize| (((high[axis] - low[axis]) / cell_m).ceil() as usize).max(1);
        Self { origin_m: low, cell_m, width: cells(0), height: cells(1) }
    }

    pub fn cells(&self) -> usize {
        self.width * self.height
    }

    /// The cell that holds a place, if any.
    pub fn index(&self, x_m: f64, y_m: f64) -> Option<usize> {
        let column = ((x_m - self.origin_m[0]) / self.cell_m).floor();
        let row = ((y_m - self.origin_m[1]) / self.cell_m).floor();
        let inside = column >= 0.0 && row >= 0.0 && column < self.width as f64 && row < self.height as f64;
        inside.then(|| row as usize * self.width + column as usize)
    }

    /// The middle of a cell, metres.
    pub fn center_m(&self, index: usize) -> [f64; 2] {
        let place = [index % self.width, index / self.width];
        [0, 1].map(|axis| self.origin_m[axis] + (place[axis] as f64 + 0.5) * self.cell_m)
    }

    /// The 4-neighbours of a cell.
    pub fn neighbours(&self, index: usize) -> impl Iterator<Item = usize> + use<> {
        let (column, row) = (index % self.width, index / self.width);
        let (width, height) = (self.width, self.height);
        let left = (column > 0).then(|| index - 1);
        let right = (column + 1 < width).then(|| index + 1);
        let below = (row > 0).then(|| index - width);
        let above = (row + 1 < height).then(|| index + width);
        [left, right, below, above].into_iter().flatten()
    }

    /// Marks every cell that the part of the triangle between two heights touches (`whole` = true) or whose middle it
    /// covers (false).
    pub fn mark(&self, triangle: &Triangle, heights_m: [f64; 2], whole: bool, cells: &mut [bool]) {
        let corners = triangle.vertices.map(|vertex| vertex.position_m.map(f64::from));
        let part = between(&corners, heights_m);
        if part.is_empty() {
            return;
        }
        if whole {
            for (at, from) in part.iter().enumerate() {
                self.mark_edge(from, &part[(at + 1) % part.len()], cells);
            }
        }
        self.mark_inside(&part, cells);
    }

    fn mark_edge(&self, from: &[f64; 3], to: &[f64; 3], cells: &mut [bool]) {
        let steps = ((to[0] - from[0]).hypot(to[1] - from[1]) / (EDGE_STEP * self.cell_m)).ceil().max(1.0);
        for step in 0..=steps as usize {
            let share = step as f64 / steps;
            let at = [0, 1].map(|axis| from[axis] + share * (to[axis] - from[axis]));
            if let Some(index) = self.index(at[0], at[1]) {
                cells[index] = true;
            }
        }
    }

    fn mark_inside(&self, part: &[[f64; 3]], cells: &mut [bool]) {
        let span = |axis: usize| {
            let low = part.iter().map(|p| p[axis]).fold(f64::INFINITY, f64::min);
            let high = part.iter().map(|p| p[axis]).fold(f64::NEG_INFINITY, f64::max);
            let cell = |value: f64| ((value - self.origin_m[axis]) / self.cell_m).floor();
            let most = [self.width, self.height][axis] as f64;
            (cell(low).clamp(0.0, most) as usize, (cell(high) + 1.0).clamp(0.0, most) as usize)
        };
        let ((left, right), (bottom, top)) = (span(0), span(1));
        for row in bottom..top {
            for column in left..right {
                let index = row * self.width + column;
                if !cells[index] && covers(part, self.center_m(index)) {
                    cells[index] = true;
                }
            }
        }
    }
}

/// The part of a polygon between two heights (Sutherland and Hodgman, 1974).
fn between(corners: &[[f64; 3]], [low, high]: [f64; 2]) -> Vec<[f64; 3]> {
    let above = cut(corners, |p| p[2] - low);
    cut(&above, |p| high - p[2])
}

fn cut(polygon: &[[f64; 3]], inside: impl Fn(&[f64; 3]) -> f64) -> Vec<[f64; 3]> {
    let mut kept = Vec::with_capacity(polygon.len() + 1);
    for (at, from) in polygon.iter().enumerate() {
        let to = &polygon[(at + 1) % polygon.len()];
        let (d_from, d_to) = (inside(from), inside(to));
        if d_from >= 0.0 {
            kept.push(*from);
        }
        if (d_from >= 0.0) != (d_to >= 0.0) {
            let share = d_from / (d_from - d_to);
            kept.push([0, 1, 2].map(|axis| from[axis] + share * (to[axis] - from[axis])));
        }
    }
    kept
}

/// Whether a convex polygon, seen from above and wound either way, covers a point.
fn covers(polygon: &[[f64; 3]], [x, y]: [f64; 2]) -> bool {
    let mut left = false;
    let mut right = false;
    for (at, from) in polygon.iter().enumerate() {
        let to = &polygon[(at + 1) % polygon.len()];
        let side = (to[0] - from[0]) * (y - from[1]) - (to[1] - from[1]) * (x - from[0]);
        left |= side > 0.0;
        right |= side < 0.0;
    }
    left != right
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Vertex;

    fn triangle(corners: [[f32; 3]; 3]) -> Triangle {
        let vertices = corners.map(|position_m| Vertex { position_m, uv: [0.0; 2], ..Vertex::default() });
        Triangle { vertices, material: 0 }
    }

    const FRAME: Frame = Frame { origin_m: [0.0, 0.0], cell_m: 0.1, width: 20, height: 20 };

    #[test]
    fn a_thin_upright_wall_marks_every_cell_along_it_and_no_other() {
        let mut cells = vec![false; FRAME.cells()];
        FRAME.mark(&triangle([[0.25, 0.05, -1.0], [0.25, 1.95, -1.0], [0.25, 1.0, 3.0]]), [0.1, 0.2], true, &mut cells);
        let marked: Vec<_> = (0..FRAME.cells()).filter(|i| cells[*i]).collect();
        assert!(marked.iter().all(|i| i % 20 == 2));
        assert!(marked.len() >= 12, "{}", marked.len());
    }

    #[test]
    fn only_the_part_between_the_heights_counts() {
        let mut cells = vec![false; FRAME.cells()];
        FRAME.mark(&triangle([[0.0, 0.0, 1.0], [2.0, 0.0, 1.0], [0.0, 2.0, 1.0]]), [0.1, 0.9], true, &mut cells);
        assert!(cells.iter().all(|cell| !cell));
        // A ramp from 0 to 2 m high over 2 m is within 0.5 to 1.0 m for a quarter of its length.
        FRAME.mark(&triangle([[0.0, 0.0, 0.0], [2.0, 0.0, 2.0], [2.0, 1.0, 2.0]]), [0.5, 1.0], true, &mut cells);
        assert!((0..FRAME.cells()).filter(|i| cells[*i]).all(|i| (5..=10).contains(&(i % 20))));
    }

    #[test]
    fn a_floor_covers_half_of_its_rectangle_whichever_way_it_is_wound() {
        for corners in [[0, 1, 2], [0, 2, 1]] {
            let points = [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0]];
            let mut cells = vec![false; FRAME.cells()];
            FRAME.mark(&triangle(corners.map(|c| points[c])), [-0.1, 0.1], false, &mut cells);
            let share = cells.iter().filter(|cell| **cell).count() as f64 / 400.0;
            assert!((share - 0.5).abs() < 0.05, "{share}");
        }
    }
}
