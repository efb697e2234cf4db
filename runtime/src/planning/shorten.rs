//! Straight segments: what they cost, and paths whose steps between cells are replaced by them.

use super::costmap::Costmap;
use crate::mapping::Cell;

/// Straight segments across more than this many steps are not tried, which bounds the work.
const LONGEST: usize = 256;
/// A straight segment may cost this factor of the steps that it replaces: the cost of steps is only
/// accurate to a cell.
const TOLERANCE: f64 = 1.02;

impl Costmap {
    /// Replaces steps by straight segments that are passable and cost no more than the steps
    /// (within 2 %), so a shorter path does not lead closer to obstacles or through unknown floor.
    /// Returns corner points in `odom`, metres, including start and goal.
    #[must_use]
    pub fn shorten(&self, path: &[Cell]) -> Vec<[f64; 2]> {
        let mut points: Vec<[f64; 2]> = Vec::new();
        points.extend(path.first().map(|start| start.center_m(self.cell_m)));
        let mut anchor = 0;
        while anchor + 1 < path.len() {
            let mut reached = anchor + 1;
            let mut steps_cost = self.segment_cost(path[anchor], path[reached]);
            for next in anchor + 2..path.len().min(anchor + LONGEST) {
                steps_cost = sum(steps_cost, self.segment_cost(path[next - 1], path[next]));
                let straight = self.segment_cost(path[anchor], path[next]);
                match (straight, steps_cost) {
                    (Some(straight), Some(steps)) if straight <= steps * TOLERANCE => {
                        reached = next;
                    }
                    // Once a segment is blocked, a longer one would only pass the same obstacle at
                    // another angle.
                    (None, _) => break,
                    _ => {}
                }
            }
            points.push(path[reached].center_m(self.cell_m));
            anchor = reached;
        }
        points
    }

    /// Cost of a path given by its corner points, in metres of free floor; `None` if it touches a
    /// blocked cell.
    #[must_use]
    pub fn path_cost_m(&self, points_m: &[[f64; 2]]) -> Option<f64> {
        points_m
            .iter()
            .zip(points_m.iter().skip(1))
            .try_fold(0.0, |total, (from, to)| Some(total + self.line_cost(*from, *to)?))
    }

    /// Cost of the straight segment between the centres of two cells; as [`path_cost_m`](Self::path_cost_m).
    fn segment_cost(&self, from: Cell, to: Cell) -> Option<f64> {
        self.line_cost(from.center_m(self.cell_m), to.center_m(self.cell_m))
    }

    fn line_cost(&self, start: [f64; 2], end: [f64; 2]) -> Option<f64> {
        let length_m = (end[0] - start[0]).hypot(end[1] - start[1]);
        // Samples half a cell apart miss no cell that matters, because blocked cells form discs.
        let samples = (2.0 * length_m / self.cell_m).ceil().max(1.0) as i32;
        let mut total = 0.0;
        for sample in 0..samples {
            let share = (f64::from(sample) + 0.5) / f64::from(samples);
            let x_m = start[0] + share * (end[0] - start[0]);
            let y_m = start[1] + share * (end[1] - start[1]);
            total += self.weight(Cell::containing(x_m, y_m, self.cell_m))?;
        }
        Some(total / f64::from(samples) * length_m)
    }
}

fn sum(a: Option<f64>, b: Option<f64>) -> Option<f64> {
    Some(a? + b?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mapping::CellBox;
    use crate::planning::Planner;
    use proptest::prelude::*;

    fn open(weight: impl FnMut(Cell) -> Option<f64>) -> Costmap {
        let cells = CellBox { min: Cell::new(0, 0), max: Cell::new(99, 79) };
        Costmap::from_weights(cells, 0.03, weight)
    }

    fn shortened(costmap: &Costmap, start: Cell, goal: Cell) -> Vec<[f64; 2]> {
        let mut planner = Planner::new(usize::MAX);
        let path = planner.plan(costmap, start, goal).unwrap().to_vec();
        costmap.shorten(&path)
    }

    fn length_m(points: &[[f64; 2]]) -> f64 {
        points.windows(2).map(|ends| (ends[1][0] - ends[0][0]).hypot(ends[1][1] - ends[0][1])).sum()
    }

    #[test]
    fn on_open_floor_a_path_is_one_straight_line() {
        let costmap = open(|_| Some(1.0));
        for goal in [Cell::new(97, 31), Cell::new(5, 70), Cell::new(90, 3)] {
            let points = shortened(&costmap, Cell::new(2, 3), goal);
            assert_eq!(points, [Cell::new(2, 3).center_m(0.03), goal.center_m(0.03)]);
        }
    }

    #[test]
    fn a_detour_around_expensive_cells_is_not_straightened_through_them() {
        // A square of expensive cells in the middle.
        let costmap = open(|cell| {
            let is_expensive = (40..60).contains(&cell.x) && (20..60).contains(&cell.y);
            Some(if is_expensive { 6.0 } else { 1.0 })
        });
        let points = shortened(&costmap, Cell::new(20, 35), Cell::new(80, 35));
        assert!(points.len() > 2);
        for ends in points.windows(2) {
            for sample in 0..=200 {
                let share = f64::from(sample) / 200.0;
                let at = [0, 1].map(|axis| ends[0][axis] + share * (ends[1][axis] - ends[0][axis]));
                let cell = Cell::containing(at[0], at[1], 0.03);
                let inside = (41..59).contains(&cell.x) && (21..59).contains(&cell.y);
                assert!(!inside, "{at:?} is in the expensive square");
            }
        }
    }

    #[test]
    fn a_path_costs_its_length_times_the_weights_and_has_no_cost_through_an_obstacle() {
        let costmap = open(|cell| match cell.x {
            0..50 => Some(1.0),
            50..60 => Some(2.0),
            _ => None,
        });
        let free = costmap.path_cost_m(&[corner(5, 5), corner(45, 5), corner(45, 35)]).unwrap();
        assert!((free - 70.0 * 0.03).abs() < 1e-9, "{free}");
        let dear = costmap.path_cost_m(&[corner(52, 5), corner(52, 35)]).unwrap();
        assert!((dear - 2.0 * 30.0 * 0.03).abs() < 1e-9, "{dear}");
        assert_eq!(costmap.path_cost_m(&[corner(5, 5), corner(70, 5)]), None);
        assert_eq!(costmap.path_cost_m(&[]), Some(0.0));
    }

    fn corner(x: i32, y: i32) -> [f64; 2] {
        Cell::new(x, y).center_m(0.03)
    }

    /// Whether a cell is in one of the boxes: x and y of their lowest cell, width and height.
    fn is_inside(boxes: &[(i32, i32, i32, i32)], cell: Cell) -> bool {
        boxes
            .iter()
            .any(|(x, y, w, h)| (*x..x + w).contains(&cell.x) && (*y..y + h).contains(&cell.y))
    }

    #[test]
    fn no_points_and_one_point_stay_what_they_are() {
        let costmap = open(|_| Some(1.0));
        assert!(costmap.shorten(&[]).is_empty());
        assert_eq!(costmap.shorten(&[Cell::new(1, 1)]), [Cell::new(1, 1).center_m(0.03)]);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]
        #[test]
        fn around_boxes_the_line_stays_clear_and_is_never_longer(
            boxes in proptest::collection::vec((5..90i32, 5..70i32, 3..25i32, 3..25i32), 0..10),
        ) {
            let costmap = open(|cell| (!is_inside(&boxes, cell)).then_some(1.0));
            let mut planner = Planner::new(usize::MAX);
            let planned = planner.plan(&costmap, Cell::new(1, 1), Cell::new(98, 78));
            let Ok(path) = planned else { return Ok(()) };
            let centers: Vec<[f64; 2]> = path.iter().map(|cell| cell.center_m(0.03)).collect();
            let points = costmap.shorten(path);
            prop_assert_eq!((points[0], points[points.len() - 1]), (centers[0], centers[centers.len() - 1]));
            prop_assert!(length_m(&points) <= length_m(&centers) + 1e-9);
            for ends in points.windows(2) {
                for cell in crate::mapping::cells_on_line(ends[0], ends[1], 0.03) {
                    // A line through a corner touches cells on both sides of it.
                    let [cx, cy] = cell.center_m(0.03);
                    let length = (ends[1][0] - ends[0][0]).hypot(ends[1][1] - ends[0][1]);
                    let off = ((ends[1][0] - ends[0][0]) * (cy - ends[0][1]) - (ends[1][1] - ends[0][1]) * (cx - ends[0][0])).abs() / length;
                    prop_assert!(!is_inside(&boxes, cell) || off > 0.008, "{:?} is blocked", cell);
                }
            }
        }
    }
}
