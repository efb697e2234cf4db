//! Straightening a path.

use super::costmap::Costmap;
use crate::mapping::Cell;

/// Straight pieces longer than this many cells are not tried: nobody sees further.
const LONGEST: usize = 256;
/// A straight piece may cost this much more than the steps it replaces: cells are coarse, and straight is worth something.
const TOLERANCE: f64 = 1.02;

impl Costmap {
    /// Replaces steps by straight pieces where these are free of obstacles and cost no more, so a shorter path does not lead
    /// closer to an obstacle or through the unknown. Returns corner points in `odom`, metres, start and goal included.
    #[must_use]
    pub fn shorten(&self, path: &[Cell]) -> Vec<[f64; 2]> {
        let center = |cell: &Cell| cell.center_m(self.cell_m);
        let mut points: Vec<[f64; 2]> = path.first().map(center).into_iter().collect();
        let mut anchor = 0;
        while anchor + 1 < path.len() {
            let mut reached = anchor + 1;
            let mut steps_cost = self.piece_cost(path[anchor], path[reached]);
            for next in anchor + 2..path.len().min(anchor + LONGEST) {
                steps_cost = add(steps_cost, self.piece_cost(path[next - 1], path[next]));
                let straight = self.piece_cost(path[anchor], path[next]);
                match (straight, steps_cost) {
                    (Some(straight), Some(steps)) if straight <= steps * TOLERANCE => reached = next,
                    // Nothing is gained further on once a piece is blocked.
                    (None, _) => break,
                    _ => {}
                }
            }
            points.push(center(&path[reached]));
            anchor = reached;
        }
        points
    }

    /// Cost of the straight way between two cells' middles, in metres of free floor; `None` if it touches a blocked cell. Any
    /// piece may begin inside an obstacle's margin: that is how a path leaves one.
    fn piece_cost(&self, from: Cell, to: Cell) -> Option<f64> {
        let (start, end) = (from.center_m(self.cell_m), to.center_m(self.cell_m));
        let length_m = (end[0] - start[0]).hypot(end[1] - start[1]);
        // Half a cell apart, no cell that matters is missed: blocked cells lie in discs.
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

fn add(a: Option<f64>, b: Option<f64>) -> Option<f64> {
    Some(a? + b?)
}
