//! Surfaces of several scans, merged and in a grid, so that the surface near a point is found in constant time.

use hal::Pose2;

use super::scan_points::Stretch;

/// Cells along one side of the grid. Points beyond it are left out.
const SIDE: usize = 512;
/// Surfels with normals further apart than 37 degrees are different surfaces: two sides of a wall, two walls of a corner.
const SAME_NORMAL_COSINE: f32 = 0.8;
/// End of a cell's list.
const NONE: u16 = u16::MAX;

/// A piece of surface, the weighted mean of all stretches that fell into its cell.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Surfel {
    /// Middle, metres from the grid's origin.
    pub x: f32,
    pub y: f32,
    /// Unit normal, or zero.
    pub nx: f32,
    pub ny: f32,
    pub weight: f32,
    next: u16,
}

impl Surfel {
    fn has_normal(&self) -> bool {
        self.nx != 0.0 || self.ny != 0.0
    }
}

/// A square of cells around an origin. Lookups depend on the order of insertion only.
pub(crate) struct SurfelGrid {
    cell_m: f32,
    /// Position of the grid's middle in the map's frame. Coordinates inside are relative to it, so that `f32` is exact enough.
    origin: [f64; 2],
    /// First surfel of each cell.
    heads: Vec<u16>,
    surfels: Vec<Surfel>,
    /// Cells with surfels, to clear them.
    used: Vec<u32>,
}

impl SurfelGrid {
    pub(crate) fn new(cell_m: f32) -> Self {
        Self {
            cell_m,
            origin: [0.0; 2],
            heads: vec![NONE; SIDE * SIDE],
            surfels: Vec::with_capacity(usize::from(NONE)),
            used: Vec::with_capacity(usize::from(NONE)),
        }
    }

    /// Empties the grid and puts its middle to `origin`.
    pub(crate) fn clear(&mut self, origin: [f64; 2]) {
        for cell in self.used.drain(..) {
            self.heads[cell as usize] = NONE;
        }
        self.surfels.clear();
        self.origin = origin;
    }

    /// Adds the stretches of a scan whose robot was at `pose`.
    pub(crate) fn insert(&mut self, stretches: &[Stretch], pose: &Pose2) {
        let [x, y, sin, cos] = self.relative(pose);
        for stretch in stretches {
            self.insert_one(&stretch.moved(x, y, sin, cos));
        }
    }

    /// A pose in the grid's frame: x, y, sine and cosine of the yaw.
    pub(crate) fn relative(&self, pose: &Pose2) -> [f32; 4] {
        let (sin, cos) = pose.yaw_rad.sin_cos();
        let x = pose.x_m - self.origin[0];
        let y = pose.y_m - self.origin[1];
        [x as f32, y as f32, sin as f32, cos as f32]
    }

    fn insert_one(&mut self, stretch: &Stretch) {
        let Some(cell) = self.cell(stretch.x, stretch.y) else { return };
        let mut at = self.heads[cell];
        if at == NONE {
            self.used.push(cell as u32);
        }
        while let Some(surfel) = self.surfels.get_mut(usize::from(at)) {
            let cosine = surfel.nx * stretch.nx + surfel.ny * stretch.ny;
            if surfel.has_normal() == stretch.has_normal()
                && (!stretch.has_normal() || cosine > SAME_NORMAL_COSINE)
            {
                surfel.merge(stretch);
                return;
            }
            at = surfel.next;
        }
        // A full grid keeps what it has.
        if let Ok(index) = u16::try_from(self.surfels.len())
            && index != NONE
        {
            let Stretch { x, y, nx, ny, weight } = *stretch;
            self.surfels.push(Surfel { x, y, nx, ny, weight, next: self.heads[cell] });
            self.heads[cell] = index;
        }
    }

    fn cell(&self, x: f32, y: f32) -> Option<usize> {
        let half = (SIDE / 2) as f32;
        let column = x / self.cell_m + half;
        let row = y / self.cell_m + half;
        // Room for the neighbours of every cell.
        let inside = 1.0..(SIDE - 1) as f32;
        (inside.contains(&column) && inside.contains(&row))
            .then(|| row as usize * SIDE + column as usize)
    }

    /// The surfel with a normal like `stretch`'s (any surfel if it has none) whose middle is nearest, among those in
    /// the cell of `stretch` and its eight neighbours.
    #[inline]
    pub(crate) fn nearest(&self, stretch: &Stretch) -> Option<&Surfel> {
        let middle = self.cell(stretch.x, stretch.y)?;
        let mut best = None;
        let mut best_distance = f32::INFINITY;
        for row in [middle - SIDE, middle, middle + SIDE] {
            for head in &self.heads[row - 1..row + 2] {
                let mut at = *head;
                while let Some(surfel) = self.surfels.get(usize::from(at)) {
                    at = surfel.next;
                    let (dx, dy) = (surfel.x - stretch.x, surfel.y - stretch.y);
                    let distance = dx * dx + dy * dy;
                    let cosine = surfel.nx * stretch.nx + surfel.ny * stretch.ny;
                    if distance < best_distance && cosine > SAME_NORMAL_COSINE {
                        best_distance = distance;
                        best = Some(surfel);
                    }
                }
            }
        }
        best
    }

    /// All surfels as stretches around the grid's origin, in the order of insertion.
    pub(crate) fn stretches(&self) -> impl Iterator<Item = Stretch> {
        self.surfels.iter().map(|surfel| {
            let Surfel { x, y, nx, ny, weight, .. } = *surfel;
            Stretch { x, y, nx, ny, weight }
        })
    }
}

impl Surfel {
    /// The weighted mean. Normals stay of unit length.
    fn merge(&mut self, stretch: &Stretch) {
        let weight = self.weight + stretch.weight;
        let share = stretch.weight / weight;
        self.x += share * (stretch.x - self.x);
        self.y += share * (stretch.y - self.y);
        self.weight = weight;
        if self.has_normal() {
            let nx = self.nx + share * (stretch.nx - self.nx);
            let ny = self.ny + share * (stretch.ny - self.ny);
            let length = (nx * nx + ny * ny).sqrt().max(1e-6);
            self.nx = nx / length;
            self.ny = ny / length;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wall(y: f32) -> Vec<Stretch> {
        (0..20)
            .map(|index| Stretch { x: 0.1 * index as f32, y, nx: 0.0, ny: -1.0, weight: 1.0 })
            .collect()
    }

    #[test]
    fn stretches_of_one_surface_become_their_mean() {
        let mut grid = SurfelGrid::new(0.1);
        grid.clear([100.0, -50.0]);
        let pose = Pose2::new(100.05, -50.0, 0.0);
        grid.insert(&wall(1.04), &pose);
        grid.insert(&wall(1.06), &pose);
        assert_eq!(grid.stretches().count(), 20);
        let probe = Stretch { x: 0.55, y: 1.1, nx: 0.0, ny: -1.0, weight: 1.0 };
        let near = grid.nearest(&probe).unwrap();
        assert!((near.y - 1.05).abs() < 1e-5, "{near:?}");
    }

    #[test]
    fn the_other_side_of_a_thin_wall_is_another_surface() {
        let mut grid = SurfelGrid::new(0.1);
        grid.clear([0.0; 2]);
        grid.insert(&wall(1.05), &Pose2::IDENTITY);
        let behind = Stretch { x: 0.5, y: 1.06, nx: 0.0, ny: 1.0, weight: 1.0 };
        assert!(grid.nearest(&behind).is_none());
    }

    #[test]
    fn a_cleared_grid_is_empty_and_points_outside_are_left_out() {
        let mut grid = SurfelGrid::new(0.1);
        grid.insert(&wall(1.05), &Pose2::IDENTITY);
        grid.clear([0.0; 2]);
        grid.insert(&wall(1.05), &Pose2::new(30.0, 0.0, 0.0));
        assert_eq!(grid.stretches().count(), 0);
        let probe = Stretch { x: 0.5, y: 1.05, nx: 0.0, ny: -1.0, weight: 1.0 };
        assert!(grid.nearest(&probe).is_none());
    }
}
