//! Semi-global aggregation (Hirschmueller 2008): along straight paths, a neighbour may differ by one hypothesis for a
//! small penalty and by more for a large one.

use super::sweep::MAX_PLANES;

/// Path costs of one pixel with a border on both sides, so that the neighbours of the first and last plane exist.
pub type PathCosts = [i16; MAX_PLANES + 2];

/// Higher than any path cost, low enough to add a penalty.
pub const WALL: i16 = 20_000;

/// Fresh path costs: the path begins here.
pub const START: PathCosts = [WALL; MAX_PLANES + 2];

/// Continues a path from `before` (whose smallest cost is `least`) to the pixel with `costs`; adds the path's costs to
/// `sum` and returns their minimum.
#[inline]
pub fn step(
    costs: &[u8],
    before: &PathCosts,
    least: i16,
    small: i16,
    large: i16,
    path: &mut PathCosts,
    sum: &mut [i16],
) -> i16 {
    let planes = costs.len();
    let jump = least + large;
    let (lower, same, upper) = (&before[..planes], &before[1..=planes], &before[2..planes + 2]);
    let path = &mut path[1..=planes];
    let sum = &mut sum[..planes];
    let mut minimum = WALL;
    for i in 0..planes {
        let near = (lower[i].min(upper[i]) + small).min(same[i]).min(jump) - least;
        let cost = i16::from(costs[i]) + near;
        path[i] = cost;
        sum[i] += cost;
        minimum = minimum.min(cost);
    }
    minimum
}

/// Begins a path at the pixel with `costs`.
#[inline]
pub fn begin(costs: &[u8], path: &mut PathCosts, sum: &mut [i16]) -> i16 {
    let mut minimum = WALL;
    for ((path, sum), cost) in path[1..].iter_mut().zip(sum.iter_mut()).zip(costs) {
        *path = i16::from(*cost);
        *sum += *path;
        minimum = minimum.min(*path);
    }
    minimum
}

/// The cost volume's shape and what smoothness costs where.
#[derive(Debug, Clone, Copy)]
pub struct Volume<'a> {
    /// Rows x columns x planes.
    pub costs: &'a [u8],
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Hypotheses.
    pub planes: usize,
    /// Grey values, rows x columns: an edge makes a jump cheap.
    pub grey: &'a [u16],
    /// Penalty of one hypothesis.
    pub small: i16,
    /// Penalty of a jump where the picture is flat.
    pub large: i16,
}

impl Volume<'_> {
    fn pixel(&self, index: usize) -> &[u8] {
        &self.costs[index * self.planes..][..self.planes]
    }

    fn jump(&self, from: usize, to: usize) -> i16 {
        let edge = i32::from(self.grey[from].abs_diff(self.grey[to]));
        (i32::from(self.large) * 1024 / (1024 + edge)).max(i32::from(self.small)) as i16
    }

    /// Three paths that run down (or up): straight and both diagonals. Fills `sum`.
    pub fn sweep_vertical(&self, upwards: bool, sum: &mut [i16]) {
        let width = self.width;
        sum.fill(0);
        let mut before = vec![START; 3 * width];
        let mut path = vec![START; 3 * width];
        let mut least = vec![0_i16; 3 * width];
        let mut least_before = vec![0_i16; 3 * width];
        for step_index in 0..self.height {
            let row = if upwards { self.height - 1 - step_index } else { step_index };
            let previous_row = if upwards { row + 1 } else { row.wrapping_sub(1) };
            for column in 0..width {
                let at = row * width + column;
                let costs = self.pixel(at);
                let sum = &mut sum[at * self.planes..][..self.planes];
                for direction in 0..3 {
                    let slot = direction * width + column;
                    let from = (column + direction).wrapping_sub(1);
                    least[slot] = if step_index == 0 || from >= width {
                        begin(costs, &mut path[slot], sum)
                    } else {
                        let jump = self.jump(previous_row * width + from, at);
                        let from = direction * width + from;
                        step(costs, &before[from], least_before[from], self.small, jump, &mut path[slot], sum)
                    };
                }
            }
            std::mem::swap(&mut before, &mut path);
            std::mem::swap(&mut least, &mut least_before);
        }
    }

    /// The two paths along `row`. Adds to `sum`, which holds that row.
    pub fn sweep_row(&self, row: usize, sum: &mut [i16]) {
        for backwards in [false, true] {
            let (mut before, mut path, mut least) = (START, START, 0);
            for index in 0..self.width {
                let column = if backwards { self.width - 1 - index } else { index };
                let at = row * self.width + column;
                let sum = &mut sum[column * self.planes..][..self.planes];
                least = if index == 0 {
                    begin(self.pixel(at), &mut path, sum)
                } else {
                    let jump = self.jump(if backwards { at + 1 } else { at - 1 }, at);
                    step(self.pixel(at), &before, least, self.small, jump, &mut path, sum)
                };
                std::mem::swap(&mut before, &mut path);
            }
        }
    }
}
