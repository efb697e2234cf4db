//! Fills the cells without depth from the cells around them, guided by the image.
//!
//! From four sides, the nearest known inverse depth is carried into the hole; each step costs more the more the brightness changes,
//! because surfaces end where it does. The four are averaged by their cost. Floors and ceilings have one inverse depth along a row,
//! walls have one along a column. A row that was never seen takes the mean of what the camera saw in that row before.

use hal::{CameraModel, Pose3};
use nalgebra::Vector3;

use super::belief::Belief;
use crate::snapshot::remembers;

/// Cost of one step over an image without edges.
const STEP: f32 = 1.0;
/// Cost of a change of brightness by one grey level, steps.
const PER_GREY: f32 = 0.5;
/// Cost of a value from the mean of the row.
const ROW_COST: f32 = 40.0;
/// The mean of a row follows its newest values with this share.
const ROW_SHARE: f32 = 0.02;

/// Height of a ceiling above the floor, metres, before any was seen: most homes have 2.4 to 2.6 m.
const CEILING_M: f64 = 2.5;
/// Distance of a wall before any was seen, metres.
const WALL_M: f64 = 3.0;

/// A cell that was filled.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Filled {
    /// Inverse depth, 1/m; 0: nothing was known anywhere.
    pub inverse_depth: f32,
    /// Cost of the path from the nearest known cell, steps.
    pub cost: f32,
    /// How much the values from the four sides differ: their mean deviation as a share of their mean.
    pub spread: f32,
}

impl Filled {
    /// Whether this is not a filled cell, but one that was seen.
    #[must_use]
    pub fn is_seen(&self) -> bool {
        self.inverse_depth > 0.0 && self.cost == 0.0
    }

    /// The features of the probability that it is right: a constant, the logarithm of the cost, and the spread.
    #[must_use]
    pub fn features(&self) -> [f32; 3] {
        [1.0, (1.0 + self.cost).ln(), self.spread]
    }
}

/// The value that is carried along a line.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Carried {
    /// 1/m; 0: nothing was known on this side.
    pub inverse_depth: f32,
    /// Cost of the path from the known cell, steps.
    pub cost: f32,
}

/// Fills cells; remembers the mean inverse depth of every row of the image.
#[derive(Debug, Default)]
pub struct Fill {
    rows: Vec<f32>,
    sides: [Vec<Carried>; 4],
    filled: Vec<Filled>,
}

impl Fill {
    /// Begins with a floor, a ceiling and a wall, for a camera mounted at `t_base_camera` on a robot that stands on the floor.
    pub fn on_a_floor(cells: &CameraModel, t_base_camera: &Pose3) -> Self {
        let height_m = t_base_camera.translation.z;
        let rows = (0..cells.height).map(|row| {
            let down = (row as f64 - cells.cy) / cells.fy;
            let up = (t_base_camera.rotation * Vector3::new(0.0, down, 1.0)).z;
            let level =
                if up < 0.0 { -up / height_m } else { up / (CEILING_M - height_m).max(0.5) };
            level.max(1.0 / WALL_M) as f32
        });
        Self { rows: rows.collect(), ..Self::default() }
    }

    /// The result of the last [`fill`](Self::fill).
    pub fn last(&self) -> &[Filled] {
        &self.filled
    }

    /// What the last [`fill`](Self::fill) carried into this cell from the four sides.
    pub(super) fn sides(&self, cell: usize) -> [Carried; 4] {
        self.sides.each_ref().map(|side| side[cell])
    }

    /// Fills all cells of `known` (rows of `width` cells) without inverse depth. `grey` is the brightness of the cells, 256 to a
    /// grey level.
    pub fn fill(&mut self, known: &[Belief], grey: &[u16], width: usize) -> &[Filled] {
        let height = known.len() / width;
        self.learn_rows(known, width);
        for side in &mut self.sides {
            side.clear();
            side.resize(known.len(), Carried::default());
        }
        let [right, left, down, up] = &mut self.sides;
        for row in 0..height {
            let line = row * width..(row + 1) * width;
            carry(right, known, grey, line.clone());
            carry(left, known, grey, line.rev());
        }
        for column in 0..width {
            let line = (column..known.len()).step_by(width);
            carry(down, known, grey, line.clone());
            carry(up, known, grey, line.rev());
        }
        self.filled.clear();
        for cell in 0..known.len() {
            let sides = [right[cell], left[cell], down[cell], up[cell]];
            self.filled.push(blend(sides, self.rows.get(cell / width).copied().unwrap_or(0.0)));
        }
        &self.filled
    }

    fn learn_rows(&mut self, known: &[Belief], width: usize) {
        self.rows.resize(known.len() / width, 0.0);
        for (mean, line) in self.rows.iter_mut().zip(known.chunks_exact(width)) {
            let cells = line.iter().filter(|belief| belief.inverse_depth > 0.0);
            let (sum, count) = cells
                .fold((0.0, 0), |(sum, count), belief| (sum + belief.inverse_depth, count + 1));
            if count * 4 > width {
                let value = sum / count as f32;
                *mean = if *mean > 0.0 { *mean + (value - *mean) * ROW_SHARE } else { value };
            }
        }
    }
}

fn carry(side: &mut [Carried], known: &[Belief], grey: &[u16], line: impl Iterator<Item = usize>) {
    let mut carried = Carried::default();
    let mut before: Option<usize> = None;
    for cell in line {
        if known[cell].inverse_depth > 0.0 {
            carried = Carried { inverse_depth: known[cell].inverse_depth, cost: 0.0 };
        } else if let Some(before) = before {
            let change = (f32::from(grey[cell]) - f32::from(grey[before])).abs() / 256.0;
            carried.cost += STEP + PER_GREY * change;
        }
        side[cell] = carried;
        before = Some(cell);
    }
}

fn blend(sides: [Carried; 4], row: f32) -> Filled {
    let mut weights = 0.0;
    let mut mean = 0.0;
    let mut least = f32::INFINITY;
    let from_row = Carried { inverse_depth: row, cost: ROW_COST };
    let all = sides.into_iter().chain([from_row]).filter(|side| side.inverse_depth > 0.0);
    for side in all.clone() {
        let weight = weight_of(side.cost);
        weights += weight;
        mean += weight * side.inverse_depth;
        least = least.min(side.cost);
    }
    if weights == 0.0 {
        return Filled::default();
    }
    let inverse_depth = mean / weights;
    let deviation: f32 =
        all.map(|side| weight_of(side.cost) * (side.inverse_depth - inverse_depth).abs()).sum();
    Filled { inverse_depth, cost: least, spread: deviation / weights / inverse_depth }
}

fn weight_of(cost: f32) -> f32 {
    1.0 / ((cost + STEP) * (cost + STEP))
}

remembers!(Fill: rows);

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 20;
    const HEIGHT: usize = 12;

    fn at(row: usize, column: usize) -> usize {
        row * WIDTH + column
    }

    fn known(inverse_depth: impl Fn(usize, usize) -> f32) -> Vec<Belief> {
        let cells = (0..WIDTH * HEIGHT).map(|cell| Belief {
            inverse_depth: inverse_depth(cell / WIDTH, cell % WIDTH),
            ..Belief::default()
        });
        cells.collect()
    }

    #[test]
    fn a_hole_in_a_wall_has_the_depth_of_the_wall() {
        let is_hole =
            |row: usize, column: usize| (3..8).contains(&row) && (5..15).contains(&column);
        let cells = known(|row, column| if is_hole(row, column) { 0.0 } else { 0.4 });
        let mut fill = Fill::default();
        let filled = fill.fill(&cells, &[0; WIDTH * HEIGHT], WIDTH);
        assert!(filled.iter().all(|cell| (cell.inverse_depth - 0.4).abs() < 1e-6));
        assert!(filled.iter().all(|cell| cell.spread < 1e-6));
        assert!(filled[at(5, 9)].cost > filled[at(5, 5)].cost);
        assert_eq!(filled[at(0, 0)].cost, 0.0);
    }

    #[test]
    fn a_hole_belongs_to_the_side_from_which_no_edge_of_the_image_separates_it() {
        // Near on the left, far on the right; the image's edge is right of the hole.
        let cells = known(|_, column| match column {
            0..6 => 1.0,
            6..14 => 0.0,
            _ => 0.25,
        });
        let grey: Vec<u16> =
            (0..WIDTH * HEIGHT).map(|cell| if cell % WIDTH < 14 { 0 } else { 100 * 256 }).collect();
        let mut fill = Fill::default();
        let filled = fill.fill(&cells, &grey, WIDTH);
        assert!((filled[at(6, 13)].inverse_depth - 1.0).abs() < 0.1, "{:?}", filled[at(6, 13)]);
        let mut fill = Fill::default();
        let without_edge = fill.fill(&cells, &[0; WIDTH * HEIGHT], WIDTH);
        assert!((without_edge[at(6, 13)].inverse_depth - 0.25).abs() < 0.1);
        assert!(without_edge[at(6, 9)].spread > 0.2);
    }

    #[test]
    fn before_anything_was_seen_a_robot_expects_a_floor_and_a_wall_and_another_camera_expects_nothing()
     {
        let cells = CameraModel::pinhole(WIDTH, HEIGHT, std::f64::consts::FRAC_PI_2);
        let axes = nalgebra::Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
        let mount = Pose3::from_parts(
            nalgebra::Translation3::new(0.0, 0.0, 0.5),
            nalgebra::UnitQuaternion::from_matrix(&axes),
        );
        let nothing = known(|_, _| 0.0);
        let mut fill = Fill::on_a_floor(&cells, &mount);
        let filled = fill.fill(&nothing, &[0; WIDTH * HEIGHT], WIDTH);
        // The ray of the lowest row falls by `slope` per metre and meets the floor at depth 0.5 / slope.
        let slope = (HEIGHT as f64 - 1.0 - cells.cy) / cells.fy;
        let floor = filled[at(HEIGHT - 1, 3)].inverse_depth;
        assert!((f64::from(floor) - slope / 0.5).abs() < 1e-6);
        let wall = filled[at(HEIGHT / 2, 3)].inverse_depth;
        assert!((f64::from(wall) - 1.0 / WALL_M).abs() < 1e-6);
        let mut handheld = Fill::default();
        let none = handheld.fill(&nothing, &[0; WIDTH * HEIGHT], WIDTH);
        assert!(none.iter().all(|cell| cell.inverse_depth == 0.0));
    }

    #[test]
    fn a_row_that_was_seen_often_is_expected_where_nothing_is_known() {
        let mut fill = Fill::default();
        let grey = [0; WIDTH * HEIGHT];
        fill.fill(&known(|row, _| 0.1 + 0.05 * row as f32), &grey, WIDTH);
        let filled = fill.fill(&known(|_, _| 0.0), &grey, WIDTH);
        assert!((filled[at(7, 2)].inverse_depth - 0.45).abs() < 1e-6);
    }
}
