//! Triangles clipped to a height band and projected onto the floor.

use super::grid::Grid;

/// A convex polygon in the plane with at most five corners. A wall is a polygon without area.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Polygon {
    corners: [[f64; 2]; 5],
    len: usize,
}

impl Polygon {
    /// The part of a triangle between two heights, seen from above; `None` when that part is empty.
    pub fn from_band(triangle: &[[f64; 3]; 3], low_m: f64, high_m: f64) -> Option<Self> {
        let heights = triangle.map(|corner| corner[2]);
        let least = heights[0].min(heights[1]).min(heights[2]);
        let most = heights[0].max(heights[1]).max(heights[2]);
        if least > high_m || most < low_m {
            return None;
        }
        let mut cut = [[0.0; 3]; 5];
        cut[..3].copy_from_slice(triangle);
        let mut len = 3;
        if least < low_m {
            (cut, len) = clip(&cut[..len], |corner| corner[2] - low_m);
        }
        if most > high_m {
            (cut, len) = clip(&cut[..len], |corner| high_m - corner[2]);
        }
        (len > 0).then(|| Self { corners: cut.map(|[x, y, _]| [x, y]), len })
    }

    /// A rectangle along the axes.
    pub fn rectangle([x0, y0]: [f64; 2], [x1, y1]: [f64; 2]) -> Self {
        Self { corners: [[x0, y0], [x1, y0], [x1, y1], [x0, y1], [0.0; 2]], len: 4 }
    }

    pub fn corners(&self) -> &[[f64; 2]] {
        &self.corners[..self.len]
    }

    /// Calls `visit` with every cell that the polygon touches.
    pub fn for_each_cell(&self, grid: &Grid, mut visit: impl FnMut(usize)) {
        let (min, max) = self.bounds();
        let [_, rows] = grid.range(min, max);
        for row in rows {
            let [low, high] = grid.row_band(row);
            let Some((left, right)) = self.span_in_band(low, high) else { continue };
            // The part of a convex polygon in a band is convex, so it touches every cell between
            // its ends.
            let [columns, _] = grid.range([left, low], [right, low]);
            for column in columns {
                visit(row * grid.width + column);
            }
        }
    }

    fn bounds(&self) -> ([f64; 2], [f64; 2]) {
        (
            fold_corners(f64::INFINITY, f64::min, self.corners()),
            fold_corners(f64::NEG_INFINITY, f64::max, self.corners()),
        )
    }

    /// Least and greatest x of the part with `low <= y <= high`.
    fn span_in_band(&self, low: f64, high: f64) -> Option<(f64, f64)> {
        let mut span = (f64::INFINITY, f64::NEG_INFINITY);
        for (a, b) in edges(self.corners()) {
            if (low..=high).contains(&a[1]) {
                span = widened(span, a[0]);
            }
            for y in [low, high] {
                if (a[1] - y) * (b[1] - y) < 0.0 {
                    let x = a[0] + (b[0] - a[0]) * (y - a[1]) / (b[1] - a[1]);
                    span = widened(span, x);
                }
            }
        }
        (span.0 <= span.1).then_some(span)
    }
}

fn widened((left, right): (f64, f64), x: f64) -> (f64, f64) {
    (left.min(x), right.max(x))
}

fn fold_corners(start: f64, pick: fn(f64, f64) -> f64, corners: &[[f64; 2]]) -> [f64; 2] {
    [0, 1].map(|axis| corners.iter().map(|c| c[axis]).fold(start, pick))
}

/// Sides of a closed polygon.
fn edges<const N: usize>(corners: &[[f64; N]]) -> impl Iterator<Item = (&[f64; N], &[f64; N])> {
    corners.iter().zip(corners.iter().cycle().skip(1))
}

/// Sutherland-Hodgman: the part of a convex polygon where `inside` is not negative.
fn clip(corners: &[[f64; 3]], inside: impl Fn(&[f64; 3]) -> f64) -> ([[f64; 3]; 5], usize) {
    let mut kept = [[0.0; 3]; 5];
    let mut len = 0;
    let mut keep = |corner: [f64; 3]| {
        if let Some(slot) = kept.get_mut(len) {
            *slot = corner;
            len += 1;
        }
    };
    for (a, b) in edges(corners) {
        let at_a = inside(a);
        let at_b = inside(b);
        if at_a >= 0.0 {
            keep(*a);
        }
        if (at_a < 0.0) != (at_b < 0.0) && at_a != 0.0 && at_b != 0.0 {
            let part = at_a / (at_a - at_b);
            keep(std::array::from_fn(|i| a[i] + part * (b[i] - a[i])));
        }
    }
    (kept, len)
}

/// The point of a convex polygon, of any winding, that is nearest to `point`.
pub(super) fn nearest_point(corners: &[[f64; 2]], point: [f64; 2]) -> [f64; 2] {
    let mut nearest = point;
    let mut nearest_2 = f64::INFINITY;
    let mut on_left = false;
    let mut on_right = false;
    for (a, b) in edges(corners) {
        let along = [b[0] - a[0], b[1] - a[1]];
        let to_point = [point[0] - a[0], point[1] - a[1]];
        let length_2 = along[0] * along[0] + along[1] * along[1];
        let cross = along[0] * to_point[1] - along[1] * to_point[0];
        on_left |= cross > 0.0;
        on_right |= cross < 0.0;
        let t = if length_2 > 0.0 {
            ((along[0] * to_point[0] + along[1] * to_point[1]) / length_2).clamp(0.0, 1.0)
        } else {
            0.0
        };
        let foot = [a[0] + t * along[0], a[1] + t * along[1]];
        let distance_2 = (point[0] - foot[0]).powi(2) + (point[1] - foot[1]).powi(2);
        if distance_2 < nearest_2 {
            (nearest, nearest_2) = (foot, distance_2);
        }
    }
    // A point on the same side of every edge of a polygon with area is inside.
    if on_left != on_right { point } else { nearest }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn coordinate() -> impl Strategy<Value = f64> {
        -1.0..1.0
    }

    proptest! {
        #[test]
        fn a_clipped_triangle_holds_exactly_its_points_between_the_heights(
            t in prop::array::uniform3([coordinate(), coordinate(), coordinate()]),
            (a, b) in (0.0..1.0, 0.0..1.0),
        ) {
            let (a, b): (f64, f64) = if a + b > 1.0 { (1.0 - a, 1.0 - b) } else { (a, b) };
            let point: [f64; 3] = std::array::from_fn(|i| t[0][i] + a * (t[1][i] - t[0][i]) + b * (t[2][i] - t[0][i]));
            let low = -0.4;
            let high = 0.3;
            if let Some(polygon) = Polygon::from_band(&t, low, high) {
                let near = nearest_point(polygon.corners(), [point[0], point[1]]);
                let distance = (near[0] - point[0]).hypot(near[1] - point[1]);
                if (low..=high).contains(&point[2]) {
                    prop_assert!(distance < 1e-9, "{distance}");
                }
            } else {
                prop_assert!(!(low..=high).contains(&point[2]));
            }
        }

        #[test]
        fn every_touched_cell_is_visited_once(t in prop::array::uniform3([coordinate(), coordinate(), coordinate()])) {
            let grid = Grid::covering([-1.0; 2], [1.0; 2], 0.13);
            let Some(polygon) = Polygon::from_band(&t, -2.0, 2.0) else { panic!("the band holds all") };
            let mut visits = vec![0; grid.cells()];
            polygon.for_each_cell(&grid, |cell| visits[cell] += 1);
            for (cell, count) in visits.into_iter().enumerate() {
                let center = grid.center(cell);
                let near = nearest_point(polygon.corners(), center);
                let half = grid.resolution_m / 2.0;
                let apart = (near[0] - center[0]).abs().max((near[1] - center[1]).abs());
                if apart < half - 1e-9 {
                    prop_assert_eq!(count, 1);
                }
                // The nearest point in the round may lie outside of the square where another one
                // lies inside, by at most this.
                if apart > 2.0 * half {
                    prop_assert_eq!(count, 0);
                }
            }
        }
    }

    #[test]
    fn a_wall_is_a_line_from_above() {
        let wall = [[0.0, 0.0, -1.0], [0.0, 2.0, -1.0], [0.0, 2.0, 3.0]];
        let polygon = Polygon::from_band(&wall, 0.06, 0.9).unwrap();
        let near = nearest_point(polygon.corners(), [0.5, 1.9]);
        assert!((near[0]).abs() < 1e-12 && (near[1] - 1.9).abs() < 1e-12);
    }

    #[test]
    fn the_inside_of_a_polygon_is_nearest_to_itself() {
        let square = Polygon::rectangle([0.0; 2], [1.0; 2]);
        assert_eq!(nearest_point(square.corners(), [0.3, 0.4]), [0.3, 0.4]);
        assert_eq!(nearest_point(square.corners(), [2.0, 0.5]), [1.0, 0.5]);
    }
}
