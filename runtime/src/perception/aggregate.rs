//! Semi-global aggregation (Hirschmueller 2008) along eight straight paths: a neighbour may differ by one hypothesis for a
//! small penalty and by more for a large one.
//!
//! The camera of a robot is upright, and so are walls: seen from anywhere, a wall keeps its depth down a column and changes it
//! along a row. So a step costs all of the small penalty along columns and little along rows, or else a plain wall takes the
//! depth of what stands beside it instead of that of its own foot.

use multiversion::multiversion;

use super::sweep::PLANES;

/// Path costs of one pixel, with a wall on both sides so that the first and last plane have neighbours.
type PathCosts = [i16; PLANES + 2];

/// Higher than any path cost, low enough to add a penalty.
const WALL: i16 = 20_000;
/// Planes that are computed side by side.
const LANES: usize = 16;
/// A path before its first pixel.
const START: PathCosts = [WALL; PLANES + 2];

/// The cost volume and what smoothness costs where.
#[derive(Debug, Clone, Copy)]
pub struct Volume<'a> {
    /// Rows x columns.
    pub costs: &'a [[u8; PLANES]],
    /// Columns.
    pub width: usize,
    /// Grey values, rows x columns, 256 to a grey level: an edge makes a jump cheap.
    pub grey: &'a [u16],
    /// Penalty of one hypothesis along columns; along diagonals two thirds, along rows a quarter of it.
    pub small: i16,
    /// Penalty of a jump where the picture is flat.
    pub large: i16,
}

/// Two rows of paths in three directions, kept from picture to picture.
#[derive(Debug, Default)]
pub struct PathRows {
    before: Vec<[PathCosts; 3]>,
    now: Vec<[PathCosts; 3]>,
    least_before: Vec<[i16; 3]>,
    least_now: Vec<[i16; 3]>,
}

impl Volume<'_> {
    /// An edge of four grey levels halves the penalty of a jump.
    #[inline(always)]
    fn jump(&self, from: usize, to: usize) -> i16 {
        let edge = i32::from(self.grey[from].abs_diff(self.grey[to]));
        (i32::from(self.large) * 1024 / (1024 + edge)).max(i32::from(self.small)) as i16
    }

    /// Sums the three paths that run down (or up), straight and diagonally, into `sums`.
    pub fn vertical(&self, upwards: bool, rows: &mut PathRows, sums: &mut [[i16; PLANES]]) {
        vertical(self, upwards, rows, sums);
    }

    /// Adds the two paths along `row` to `sums`, which holds that row.
    pub fn horizontal(&self, row: usize, sums: &mut [[i16; PLANES]]) {
        horizontal(self, row, sums);
    }
}

#[multiversion(targets("x86_64+avx2"))]
fn vertical<'a>(
    volume: &Volume<'a>,
    upwards: bool,
    rows: &mut PathRows,
    sums: &mut [[i16; PLANES]],
) {
    let (width, height) = (volume.width, volume.costs.len() / volume.width);
    for paths in [&mut rows.before, &mut rows.now] {
        paths.clear();
        paths.resize(width, [START; 3]);
    }
    rows.least_before.resize(width, [0; 3]);
    rows.least_now.resize(width, [0; 3]);
    for index in 0..height {
        let row = if upwards { height - 1 - index } else { index };
        let above = if upwards { row + 1 } else { row.wrapping_sub(1) };
        for column in 0..width {
            let at = row * width + column;
            for direction in 0..3 {
                let path = &mut rows.now[column][direction];
                let from = (column + direction).wrapping_sub(1);
                rows.least_now[column][direction] = if index == 0 || from >= width {
                    begin(&volume.costs[at], path)
                } else {
                    let jump = volume.jump(above * width + from, at);
                    let (before, least) =
                        (&rows.before[from][direction], rows.least_before[from][direction]);
                    let small = if direction == 1 { volume.small } else { volume.small * 2 / 3 };
                    follow(&volume.costs[at], before, least, small, jump, path)
                };
            }
            let [a, b, c] = &rows.now[column];
            for (plane, sum) in sums[at].iter_mut().enumerate() {
                *sum = a[plane + 1].wrapping_add(b[plane + 1]).wrapping_add(c[plane + 1]);
            }
        }
        std::mem::swap(&mut rows.before, &mut rows.now);
        std::mem::swap(&mut rows.least_before, &mut rows.least_now);
    }
}

#[multiversion(targets("x86_64+avx2"))]
fn horizontal<'a>(volume: &Volume<'a>, row: usize, sums: &mut [[i16; PLANES]]) {
    for backwards in [false, true] {
        let (mut before, mut now, mut least) = (START, START, 0);
        for index in 0..volume.width {
            let column = if backwards { volume.width - 1 - index } else { index };
            let at = row * volume.width + column;
            least = if index == 0 {
                begin(&volume.costs[at], &mut now)
            } else {
                let jump = volume.jump(if backwards { at + 1 } else { at - 1 }, at);
                follow(&volume.costs[at], &before, least, volume.small / 4, jump, &mut now)
            };
            for (sum, path) in sums[column].iter_mut().zip(&now[1..]) {
                *sum = sum.wrapping_add(*path);
            }
            std::mem::swap(&mut before, &mut now);
        }
    }
}

/// Continues a path from `before`, whose smallest cost is `least`; returns the smallest cost now.
#[inline(always)]
fn follow(
    costs: &[u8; PLANES],
    before: &PathCosts,
    least: i16,
    small: i16,
    large: i16,
    now: &mut PathCosts,
) -> i16 {
    let jump = least + large;
    let mut smallest = [WALL; LANES];
    for block in (0..PLANES).step_by(LANES) {
        for lane in 0..LANES {
            let plane = block + lane;
            // No sum can overflow (WALL + small, 96 + large); saying so keeps checked builds in the vector unit.
            let beside = before[plane].min(before[plane + 2]).wrapping_add(small);
            let best = beside.min(before[plane + 1]).min(jump).wrapping_sub(least);
            let cost = i16::from(costs[plane]).wrapping_add(best);
            now[plane + 1] = cost;
            smallest[lane] = smallest[lane].min(cost);
        }
    }
    smallest.into_iter().fold(WALL, i16::min)
}

#[inline(always)]
fn begin(costs: &[u8; PLANES], now: &mut PathCosts) -> i16 {
    for (now, cost) in now[1..].iter_mut().zip(costs) {
        *now = i16::from(*cost);
    }
    now[1..=PLANES].iter().copied().fold(WALL, i16::min)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The recursion of the paper, plane by plane.
    fn follow_slowly(costs: &[u8; PLANES], before: &[i16], small: i16, large: i16) -> Vec<i16> {
        let least = *before.iter().min().unwrap();
        (0..PLANES)
            .map(|d| {
                let mut best = before[d].min(least + large);
                if d > 0 {
                    best = best.min(before[d - 1] + small);
                }
                if d + 1 < PLANES {
                    best = best.min(before[d + 1] + small);
                }
                i16::from(costs[d]) + best - least
            })
            .collect()
    }

    proptest! {
        #[test]
        fn a_step_equals_the_definition(
            costs in prop::array::uniform32(0_u8..96), before in prop::array::uniform32(0_i16..900),
            small in 0_i16..100, extra in 0_i16..600,
        ) {
            let costs: [u8; PLANES] = std::array::from_fn(|i| costs[i % 32].wrapping_add(i as u8) % 96);
            let before: Vec<i16> = (0..PLANES).map(|i| before[(i * 7) % 32]).collect();
            let mut path = START;
            path[1..=PLANES].copy_from_slice(&before);
            let mut now = START;
            let least = follow(&costs, &path, *before.iter().min().unwrap(), small, small + extra, &mut now);
            let want = follow_slowly(&costs, &before, small, small + extra);
            prop_assert_eq!(&now[1..=PLANES], &want[..]);
            prop_assert_eq!(least, *want.iter().min().unwrap());
        }
    }

    #[test]
    fn a_pixel_without_an_opinion_takes_that_of_its_neighbours() {
        let mut costs = vec![[50_u8; PLANES]; 9 * 5];
        for (index, costs) in costs.iter_mut().enumerate() {
            if index != 2 * 9 + 4 {
                costs[20] = 5;
            }
        }
        let grey = vec![0; 45];
        let volume = Volume { costs: &costs, width: 9, grey: &grey, small: 10, large: 100 };
        let (mut down, mut up) = (vec![[0; PLANES]; 45], vec![[0; PLANES]; 45]);
        volume.vertical(false, &mut PathRows::default(), &mut down);
        volume.vertical(true, &mut PathRows::default(), &mut up);
        let mut row: Vec<[i16; PLANES]> =
            (18..27).map(|i| std::array::from_fn(|d| down[i][d] + up[i][d])).collect();
        volume.horizontal(2, &mut row);
        let best = (0..PLANES).min_by_key(|d| row[4][*d]).unwrap();
        assert_eq!(best, 20);
    }

    #[test]
    fn a_plain_wall_takes_the_depth_of_its_foot_rather_than_of_what_stands_beside_it() {
        // A shelf in the first column and the foot of the wall in the last row know their planes; the wall has no opinion.
        let (columns, rows) = (24, 8);
        let foot = |column: usize| 16 + column / 3;
        let mut costs = vec![[0_u8; PLANES]; columns * rows];
        for (at, costs) in costs.iter_mut().enumerate() {
            let (row, column) = (at / columns, at % columns);
            if column == 0 || row == rows - 1 {
                *costs = std::array::from_fn(|plane| if plane == foot(column) { 0 } else { 40 });
            }
        }
        let grey = vec![0; columns * rows];
        let volume = Volume { costs: &costs, width: columns, grey: &grey, small: 24, large: 160 };
        let (mut down, mut up) =
            (vec![[0; PLANES]; columns * rows], vec![[0; PLANES]; columns * rows]);
        volume.vertical(false, &mut PathRows::default(), &mut down);
        volume.vertical(true, &mut PathRows::default(), &mut up);
        let mut sums: Vec<[i16; PLANES]> =
            (0..columns).map(|i| std::array::from_fn(|d| down[i][d] + up[i][d])).collect();
        volume.horizontal(0, &mut sums);
        for column in 2..columns {
            let best = (0..PLANES).min_by_key(|plane| sums[column][*plane]).unwrap();
            // Were all steps as dear, it would be the shelf's plane for most of them, up to 7 away.
            assert!(
                best.abs_diff(foot(column)) <= 3,
                "column {column}: plane {best}, not {}",
                foot(column)
            );
        }
    }

    #[test]
    fn up_is_down_in_a_mirror() {
        let costs: Vec<[u8; PLANES]> =
            (0..6 * 4).map(|i| std::array::from_fn(|d| ((i * 31 + d * 17) % 90) as u8)).collect();
        let flipped: Vec<[u8; PLANES]> = costs.chunks(6).rev().flatten().copied().collect();
        let grey: Vec<u16> = vec![7; 24];
        let volume = |costs| Volume { costs, width: 6, grey: &grey, small: 10, large: 60 };
        let (mut down, mut up) = (vec![[0; PLANES]; 24], vec![[0; PLANES]; 24]);
        volume(&costs[..]).vertical(false, &mut PathRows::default(), &mut down);
        volume(&flipped[..]).vertical(true, &mut PathRows::default(), &mut up);
        let up_flipped: Vec<[i16; PLANES]> = up.chunks(6).rev().flatten().copied().collect();
        assert_eq!(down, up_flipped);
    }
}
