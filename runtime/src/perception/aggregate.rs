//! Semi-global aggregation (Hirschmueller 2008) along eight straight paths. A difference of one hypothesis between neighbours
//! costs P1, a larger one P2.
//!
//! The robot's camera is upright, and so are walls: seen from anywhere, the depth of a wall is constant down a column and
//! changes along a row. So a step costs all of P1 along columns and little along rows. Otherwise a plain wall would take the
//! depth of an object beside it instead of that of its own foot.

use multiversion::multiversion;

use super::sweep::PLANES;

/// Path costs of one cell, with [`WALL`] on both sides so that the first and last plane have neighbours.
type PathCosts = [i16; PLANES + 2];

/// Higher than any path cost, low enough to add a penalty without overflow.
const WALL: i16 = 20_000;
/// Planes that are computed in parallel lanes.
const LANES: usize = 16;
/// Path costs before the first cell of a path.
const START: PathCosts = [WALL; PLANES + 2];

/// The cost volume and the penalties of its aggregation.
#[derive(Debug, Clone, Copy)]
pub struct Volume<'a> {
    /// Matching costs, rows x columns x planes.
    pub costs: &'a [[u8; PLANES]],
    pub width: usize,
    /// Grey values, rows x columns, 256 to a grey level: P2 is lower across edges.
    pub grey: &'a [u16],
    /// Penalty of a difference of one hypothesis along columns; along diagonals two thirds, along rows a quarter of it.
    pub p1: i16,
    /// Penalty of a larger difference where the image is flat.
    pub p2: i16,
}

/// Scratch memory: two rows of paths in three directions.
#[derive(Debug, Default)]
pub struct PathRows {
    before: Vec<[PathCosts; 3]>,
    now: Vec<[PathCosts; 3]>,
    least_before: Vec<[i16; 3]>,
    least_now: Vec<[i16; 3]>,
}

impl Volume<'_> {
    /// P2 between two cells: an edge of four grey levels halves it, and P1 is its minimum.
    #[inline(always)]
    fn p2_between(&self, from: usize, to: usize) -> i16 {
        let edge = i32::from(self.grey[from].abs_diff(self.grey[to]));
        (i32::from(self.p2) * 1024 / (1024 + edge)).max(i32::from(self.p1)) as i16
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
    let width = volume.width;
    let height = volume.costs.len() / volume.width;
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
                    let p2 = volume.p2_between(above * width + from, at);
                    let before = &rows.before[from][direction];
                    let least = rows.least_before[from][direction];
                    let p1 = if direction == 1 { volume.p1 } else { volume.p1 * 2 / 3 };
                    follow(&volume.costs[at], before, least, p1, p2, path)
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
        let mut before = START;
        let mut now = START;
        let mut least = 0;
        for index in 0..volume.width {
            let column = if backwards { volume.width - 1 - index } else { index };
            let at = row * volume.width + column;
            least = if index == 0 {
                begin(&volume.costs[at], &mut now)
            } else {
                let p2 = volume.p2_between(if backwards { at + 1 } else { at - 1 }, at);
                follow(&volume.costs[at], &before, least, volume.p1 / 4, p2, &mut now)
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
    p1: i16,
    p2: i16,
    now: &mut PathCosts,
) -> i16 {
    let jump = least + p2;
    let mut smallest = [WALL; LANES];
    for block in (0..PLANES).step_by(LANES) {
        for lane in 0..LANES {
            let plane = block + lane;
            // No sum can overflow (WALL + P1, 96 + P2): wrapping operations keep builds with overflow checks vectorised.
            let beside = before[plane].min(before[plane + 2]).wrapping_add(p1);
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
    fn follow_slowly(costs: &[u8; PLANES], before: &[i16], p1: i16, p2: i16) -> Vec<i16> {
        let least = *before.iter().min().unwrap();
        (0..PLANES)
            .map(|d| {
                let mut best = before[d].min(least + p2);
                if d > 0 {
                    best = best.min(before[d - 1] + p1);
                }
                if d + 1 < PLANES {
                    best = best.min(before[d + 1] + p1);
                }
                i16::from(costs[d]) + best - least
            })
            .collect()
    }

    proptest! {
        #[test]
        fn a_step_equals_the_definition(
            costs in prop::array::uniform32(0_u8..96), before in prop::array::uniform32(0_i16..900),
            p1 in 0_i16..100, extra in 0_i16..600,
        ) {
            let costs: [u8; PLANES] = std::array::from_fn(|i| costs[i % 32].wrapping_add(i as u8) % 96);
            let before: Vec<i16> = (0..PLANES).map(|i| before[(i * 7) % 32]).collect();
            let mut path = START;
            path[1..=PLANES].copy_from_slice(&before);
            let mut now = START;
            let least = follow(&costs, &path, *before.iter().min().unwrap(), p1, p1 + extra, &mut now);
            let want = follow_slowly(&costs, &before, p1, p1 + extra);
            prop_assert_eq!(&now[1..=PLANES], &want[..]);
            prop_assert_eq!(least, *want.iter().min().unwrap());
        }
    }

    #[test]
    fn a_cell_without_texture_takes_the_depth_of_its_neighbours() {
        let mut costs = vec![[50_u8; PLANES]; 9 * 5];
        for (index, costs) in costs.iter_mut().enumerate() {
            if index != 2 * 9 + 4 {
                costs[20] = 5;
            }
        }
        let grey = vec![0; 45];
        let volume = Volume { costs: &costs, width: 9, grey: &grey, p1: 10, p2: 100 };
        let mut down = vec![[0; PLANES]; 45];
        let mut up = vec![[0; PLANES]; 45];
        volume.vertical(false, &mut PathRows::default(), &mut down);
        volume.vertical(true, &mut PathRows::default(), &mut up);
        let mut row: Vec<[i16; PLANES]> =
            (18..27).map(|i| std::array::from_fn(|d| down[i][d] + up[i][d])).collect();
        volume.horizontal(2, &mut row);
        let best = (0..PLANES).min_by_key(|d| row[4][*d]).unwrap();
        assert_eq!(best, 20);
    }

    #[test]
    fn a_plain_wall_takes_the_depth_of_its_foot_rather_than_that_of_the_object_beside_it() {
        // A shelf in the first column and the foot of the wall in the last row have texture; the wall between has none.
        let columns = 24;
        let rows = 8;
        let foot: Vec<usize> = (0..columns).map(|column| 16 + column / 3).collect();
        let mut costs = vec![[0_u8; PLANES]; columns * rows];
        for (at, costs) in costs.iter_mut().enumerate() {
            let row = at / columns;
            let column = at % columns;
            if column == 0 || row == rows - 1 {
                *costs = std::array::from_fn(|plane| if plane == foot[column] { 0 } else { 40 });
            }
        }
        let grey = vec![0; columns * rows];
        let volume = Volume { costs: &costs, width: columns, grey: &grey, p1: 24, p2: 160 };
        let mut down = vec![[0; PLANES]; columns * rows];
        let mut up = vec![[0; PLANES]; columns * rows];
        volume.vertical(false, &mut PathRows::default(), &mut down);
        volume.vertical(true, &mut PathRows::default(), &mut up);
        let mut sums: Vec<[i16; PLANES]> =
            (0..columns).map(|i| std::array::from_fn(|d| down[i][d] + up[i][d])).collect();
        volume.horizontal(0, &mut sums);
        for column in 2..columns {
            let best = (0..PLANES).min_by_key(|plane| sums[column][*plane]).unwrap();
            // With the same P1 along rows, most columns would take the shelf's plane, up to 7 away.
            assert!(
                best.abs_diff(foot[column]) <= 3,
                "column {column}: plane {best}, not {}",
                foot[column]
            );
        }
    }

    #[test]
    fn aggregation_upwards_mirrors_aggregation_downwards() {
        let costs: Vec<[u8; PLANES]> =
            (0..6 * 4).map(|i| std::array::from_fn(|d| ((i * 31 + d * 17) % 90) as u8)).collect();
        let flipped: Vec<[u8; PLANES]> = costs.chunks(6).rev().flatten().copied().collect();
        let grey: Vec<u16> = vec![7; 24];
        let volume = Volume { costs: &costs, width: 6, grey: &grey, p1: 10, p2: 60 };
        let mirrored = Volume { costs: &flipped, ..volume };
        let mut down = vec![[0; PLANES]; 24];
        let mut up = vec![[0; PLANES]; 24];
        volume.vertical(false, &mut PathRows::default(), &mut down);
        mirrored.vertical(true, &mut PathRows::default(), &mut up);
        let up_flipped: Vec<[i16; PLANES]> = up.chunks(6).rev().flatten().copied().collect();
        assert_eq!(down, up_flipped);
    }
}
