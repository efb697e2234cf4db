//! Areas that a person has closed for the robot, and areas that it must not leave.

use crate::mapping::CellBox;
use crate::snapshot::remembers;
use crate::task::AreaChange;

/// Polygons in `map`. Every cell that a closed area covers or touches counts as occupied for the planner. Where there are areas to
/// keep in, so does every cell whose middle lies in none of them. The map itself does not change.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct KeepOut {
    /// Those of the configuration, each with its corners in order, metres.
    configured_m: Vec<Vec<[f64; 2]>>,
    /// The areas that the robot must not leave. If there are none, it may drive anywhere.
    keep_in_m: Vec<Vec<[f64; 2]>>,
    /// Those that a person has drawn during the run.
    drawn_m: Vec<[[f64; 2]; 4]>,
}

remembers!(KeepOut: drawn_m);

impl KeepOut {
    /// Closed areas, and areas to keep in, with these corners in metres. A closed area with fewer than three corners is a point or a
    /// line.
    #[must_use]
    pub fn new(closed_m: Vec<Vec<[f64; 2]>>, keep_in_m: Vec<Vec<[f64; 2]>>) -> Self {
        Self { configured_m: closed_m, keep_in_m, drawn_m: Vec::new() }
    }

    /// Closes an area, or opens those that were closed by changes.
    pub fn change(&mut self, change: AreaChange) {
        match change {
            AreaChange::Close { corners_m } => self.drawn_m.push(corners_m),
            AreaChange::OpenAll => self.drawn_m.clear(),
        }
    }

    /// The corners of every area that the robot must not leave, metres in `map`.
    #[must_use]
    pub fn keep_in_m(&self) -> &[Vec<[f64; 2]>] {
        &self.keep_in_m
    }

    /// The corners of every closed area, metres in `map`; first those of the configuration, then those that were drawn.
    pub fn closed_m(&self) -> impl Iterator<Item = &[[f64; 2]]> {
        let drawn_m = self.drawn_m.iter().map(<[[f64; 2]; 4]>::as_slice);
        self.configured_m.iter().map(Vec::as_slice).chain(drawn_m)
    }

    /// Whether there is no area.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.keep_in_m.is_empty() && self.closed_m().next().is_none()
    }

    /// Whether the robot must not be at a point in `map`: it lies in a closed area, or in none of those to keep in.
    #[must_use]
    pub fn forbids(&self, at_m: [f64; 2]) -> bool {
        let is_outside = !self.keep_in_m.is_empty()
            && !self.keep_in_m.iter().any(|polygon| lies_in(polygon, at_m));
        is_outside || self.closed_m().any(|polygon| lies_in(polygon, at_m))
    }

    /// Writes `value` into each cell of a row that is closed. `row` begins at the left of `cells`.
    pub(super) fn write_row(
        &self,
        cells: CellBox,
        y: i32,
        cell_m: f64,
        value: f32,
        row: &mut [f32],
    ) {
        let bottom_m = f64::from(y) * cell_m;
        let middle_m = bottom_m + 0.5 * cell_m;
        if !self.keep_in_m.is_empty() {
            let open: Vec<_> =
                self.keep_in_m.iter().flat_map(|polygon| spans_m(polygon, middle_m)).collect();
            for (column, cell) in row.iter_mut().enumerate() {
                let x_m = (f64::from(cells.min.x) + column as f64 + 0.5) * cell_m;
                if !open.iter().any(|[from_m, to_m]| (*from_m..*to_m).contains(&x_m)) {
                    *cell = value;
                }
            }
        }
        for polygon in self.closed_m() {
            let touched =
                edges(polygon).filter_map(|edge| within(edge, bottom_m, bottom_m + cell_m));
            for [from_m, to_m] in spans_m(polygon, middle_m).into_iter().chain(touched) {
                let [from, to] = [from_m, to_m]
                    .map(|x_m| (x_m / cell_m).floor() as i64 - i64::from(cells.min.x));
                let from = from.clamp(0, row.len() as i64) as usize;
                let to = (to + 1).clamp(from as i64, row.len() as i64) as usize;
                row[from..to].fill(value);
            }
        }
    }
}

type Edge = [[f64; 2]; 2];

/// The sides of a polygon, the last one back to its first corner.
fn edges(polygon: &[[f64; 2]]) -> impl Iterator<Item = Edge> + '_ {
    polygon.iter().zip(polygon.iter().cycle().skip(1)).map(|(from, to)| [*from, *to])
}

fn lies_in(polygon: &[[f64; 2]], [x_m, y_m]: [f64; 2]) -> bool {
    let crossings = edges(polygon).filter_map(|edge| crossing_m(edge, y_m));
    crossings.filter(|crossing_m| *crossing_m <= x_m).count() % 2 == 1
}

/// The parts of the line of this y that lie in a polygon.
fn spans_m(polygon: &[[f64; 2]], y_m: f64) -> Vec<[f64; 2]> {
    let mut crossings: Vec<f64> = edges(polygon).filter_map(|edge| crossing_m(edge, y_m)).collect();
    crossings.sort_by(f64::total_cmp);
    crossings.as_chunks::<2>().0.to_vec()
}

/// Where an edge crosses the line of this y. The lower end of an edge belongs to it and the upper one does not, so that a corner
/// counts once.
fn crossing_m([a, b]: Edge, y_m: f64) -> Option<f64> {
    ((a[1] <= y_m) != (b[1] <= y_m)).then(|| a[0] + (y_m - a[1]) / (b[1] - a[1]) * (b[0] - a[0]))
}

/// The extent in x of the part of an edge between two values of y.
fn within([a, b]: Edge, from_m: f64, to_m: f64) -> Option<[f64; 2]> {
    let low_m = a[1].min(b[1]).max(from_m);
    let high_m = a[1].max(b[1]).min(to_m);
    if low_m > high_m {
        return None;
    }
    let rise_m = b[1] - a[1];
    let [one, other] = if rise_m == 0.0 {
        [a[0], b[0]]
    } else {
        [low_m, high_m].map(|y_m| a[0] + (y_m - a[1]) / rise_m * (b[0] - a[0]))
    };
    Some([one.min(other), one.max(other)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mapping::Cell;
    use proptest::prelude::*;

    const CELL_M: f64 = 0.1;

    /// The closed cells around the origin, row by row from the lowest.
    fn closed(keep_out: &KeepOut) -> Vec<Vec<bool>> {
        let cells = CellBox { min: Cell::new(-20, -20), max: Cell::new(19, 19) };
        let rows = (-20..20).map(|y| {
            let mut row = vec![0.0; 40];
            keep_out.write_row(cells, y, CELL_M, 1.0, &mut row);
            row.iter().map(|value| *value > 0.0).collect()
        });
        rows.collect()
    }

    fn polygon() -> impl Strategy<Value = Vec<[f64; 2]>> {
        prop::collection::vec([-1.9..1.9_f64, -1.9..1.9_f64], 3..8)
    }

    #[test]
    fn a_square_closes_its_cells_and_no_other() {
        let square = vec![[0.01, 0.01], [0.49, 0.01], [0.49, 0.29], [0.01, 0.29]];
        let closed = closed(&KeepOut::new(vec![square], Vec::new()));
        for (row, cells) in closed.iter().enumerate() {
            for (column, is_closed) in cells.iter().enumerate() {
                let inside = (20..25).contains(&column) && (20..23).contains(&row);
                assert_eq!(*is_closed, inside, "{column} {row}");
            }
        }
    }

    #[test]
    fn drawn_areas_are_closed_until_they_are_opened_and_configured_ones_for_ever() {
        let triangle = vec![[-1.0, -1.0], [-0.5, -1.0], [-0.5, -0.5]];
        let mut keep_out = KeepOut::new(vec![triangle], Vec::new());
        let configured = closed(&keep_out);
        let corners_m = [[0.01, 0.01], [0.49, 0.01], [0.49, 0.29], [0.01, 0.29]];
        keep_out.change(AreaChange::Close { corners_m });
        assert!(keep_out.forbids([0.2, 0.1]) && closed(&keep_out)[21][22]);
        assert_eq!(keep_out.closed_m().count(), 2);
        keep_out.change(AreaChange::OpenAll);
        assert!(!keep_out.forbids([0.2, 0.1]));
        assert_eq!(closed(&keep_out), configured);
    }

    #[test]
    fn outside_of_the_areas_to_keep_in_every_cell_is_closed_and_areas_that_meet_have_no_wall_between()
     {
        let left = vec![[-1.0, 0.0], [0.01, 0.0], [0.01, 1.0], [-1.0, 1.0]];
        let right = vec![[0.01, 0.0], [1.0, 0.0], [1.0, 1.0], [0.01, 1.0]];
        let mut keep_out = KeepOut::new(Vec::new(), vec![left, right]);
        for (row, cells) in closed(&keep_out).iter().enumerate() {
            for (column, is_closed) in cells.iter().enumerate() {
                let inside = (10..30).contains(&column) && (20..30).contains(&row);
                assert_eq!(*is_closed, !inside, "{column} {row}");
            }
        }
        assert!(
            !keep_out.is_empty() && keep_out.forbids([0.5, -0.1]) && !keep_out.forbids([0.5, 0.5])
        );
        // A closed area inside of them is closed.
        let corners_m = [[0.41, 0.41], [0.59, 0.41], [0.59, 0.59], [0.41, 0.59]];
        keep_out.change(AreaChange::Close { corners_m });
        assert!(keep_out.forbids([0.5, 0.5]) && closed(&keep_out)[25][25]);
    }

    #[test]
    fn a_line_closes_a_path_of_cells_without_gaps() {
        let closed = closed(&KeepOut::new(vec![vec![[-1.5, -1.2], [1.4, 1.3]]], Vec::new()));
        let first = 8;
        let last = 33;
        for row in first..last {
            let shared = closed[row].iter().zip(&closed[row + 1]).any(|(a, b)| *a && *b);
            assert!(row + 1 == last || shared, "a robot could pass at row {row}");
        }
    }

    proptest! {
        #[test]
        fn a_cell_is_open_where_its_middle_lies_in_an_area_to_keep_in_and_nowhere_else(
            areas in prop::collection::vec(polygon(), 1..4),
        ) {
            let keep_out = KeepOut::new(Vec::new(), areas);
            for (row, cells) in closed(&keep_out).iter().enumerate() {
                for (column, is_closed) in cells.iter().enumerate() {
                    let middle = [column, row].map(|at| (at as f64 - 20.0 + 0.5) * CELL_M);
                    prop_assert_eq!(*is_closed, keep_out.forbids(middle));
                }
            }
        }

        #[test]
        fn every_cell_whose_middle_lies_in_an_area_is_closed(polygon in polygon()) {
            let keep_out = KeepOut::new(vec![polygon], Vec::new());
            for (row, cells) in closed(&keep_out).iter().enumerate() {
                for (column, is_closed) in cells.iter().enumerate() {
                    let middle = [column, row].map(|at| (at as f64 - 20.0 + 0.5) * CELL_M);
                    prop_assert!(*is_closed || !keep_out.forbids(middle));
                }
            }
        }

        #[test]
        fn cells_far_from_an_area_stay_open(polygon in polygon()) {
            let keep_out = KeepOut::new(vec![polygon.clone()], Vec::new());
            let low = [0, 1].map(|axis| polygon.iter().map(|at| at[axis]).fold(9.0, f64::min));
            let high = [0, 1].map(|axis| polygon.iter().map(|at| at[axis]).fold(-9.0, f64::max));
            for (row, cells) in closed(&keep_out).iter().enumerate() {
                for (column, is_closed) in cells.iter().enumerate() {
                    let middle = [column, row].map(|at| (at as f64 - 20.0 + 0.5) * CELL_M);
                    let is_far = (0..2).any(|axis| {
                        middle[axis] < low[axis] - CELL_M || middle[axis] > high[axis] + CELL_M
                    });
                    prop_assert!(!(is_far && *is_closed));
                }
            }
        }
    }
}
