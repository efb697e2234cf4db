//! Connected components of free space, and the choice of the one that is the home.

use super::raster::Raster;

/// Free cells, grouped by connected component.
#[derive(Debug, Clone)]
pub(super) struct Components {
    /// Component of every cell; 0 for cells that are not free.
    pub label: Vec<u32>,
    /// Cells of every component; `cells[0]` is not used.
    pub cells: Vec<Vec<u32>>,
}

/// A ray that crosses this many consecutive cells without floor has left the home.
const OPEN_CELLS: usize = 10;

/// Number of rays that measure how enclosed a place is.
const RAYS: usize = 16;

impl Components {
    /// Labels the free cells; cells that share a side belong to the same component.
    pub fn new(raster: &Raster, is_free: impl Fn(usize) -> bool) -> Self {
        let grid = &raster.grid;
        let mut label = vec![0; grid.cells()];
        let mut cells = vec![Vec::new()];
        for start in 0..grid.cells() {
            if label[start] != 0 || !is_free(start) {
                continue;
            }
            let piece = cells.len() as u32;
            label[start] = piece;
            let mut members = vec![start as u32];
            let mut next = 0;
            while let Some(&cell) = members.get(next) {
                next += 1;
                for side in grid.sides(cell as usize) {
                    if label[side] == 0 && is_free(side) {
                        label[side] = piece;
                        members.push(side as u32);
                    }
                }
            }
            cells.push(members);
        }
        Self { label, cells }
    }

    /// The component that is most likely the interior of a home, and its score: area in square
    /// metres times the square of its enclosure. The ground around a house and its roof are large
    /// but open; rooms are enclosed.
    pub fn best(&self, raster: &Raster, least_m2: f64) -> Option<(u32, f64)> {
        let cell_m2 = raster.grid.resolution_m.powi(2);
        let mut best: Option<(u32, f64)> = None;
        for (piece, cells) in self.cells.iter().enumerate().skip(1) {
            let area_m2 = cells.len() as f64 * cell_m2;
            let bound = area_m2 * score(1.0);
            if area_m2 < least_m2 || best.is_some_and(|(_, score)| bound <= score) {
                continue;
            }
            let value = area_m2 * score(enclosure(raster, cells));
            if best.is_none_or(|(_, score)| value > score) {
                best = Some((piece as u32, value));
            }
        }
        best
    }
}

/// The constant makes area decide where there are no walls at all.
fn score(enclosure: f64) -> f64 {
    1e-3 + enclosure * enclosure
}

/// Fraction of rays, from up to 500 of the cells, that hit a wall before the floor ends.
fn enclosure(raster: &Raster, cells: &[u32]) -> f64 {
    let sampled = cells.iter().step_by(cells.len().div_ceil(500).max(1));
    let mut rays = 0;
    let mut hits = 0;
    for &cell in sampled {
        for ray in 0..RAYS {
            rays += 1;
            hits += usize::from(hits_wall(
                raster,
                cell as usize,
                ray as f64 * std::f64::consts::TAU / RAYS as f64,
            ));
        }
    }
    hits as f64 / f64::from(rays.max(1))
}

fn hits_wall(raster: &Raster, cell: usize, angle_rad: f64) -> bool {
    let mut without_floor = 0;
    for cell in cells_along(raster, cell, angle_rad) {
        if raster.blocked[cell] {
            return true;
        }
        without_floor = if raster.supported[cell] { 0 } else { without_floor + 1 };
        if without_floor > OPEN_CELLS {
            return false;
        }
    }
    false
}

/// Cells along a ray, one per step, until it leaves the raster.
pub(super) fn cells_along(
    raster: &Raster,
    from: usize,
    angle_rad: f64,
) -> impl Iterator<Item = usize> {
    let grid = raster.grid;
    let [x, y] = grid.center(from);
    let (sin, cos) = angle_rad.sin_cos();
    (1..).map_while(move |step| {
        let length = f64::from(step) * grid.resolution_m;
        grid.index(x + length * cos, y + length * sin)
    })
}
