//! Flowers on a wallpaper, scattered around a grid that wraps.

use super::noise::{Field, hash};

/// Rows and columns of flowers.
const ROWS: usize = 10;

/// Strength of the motifs at every texel, 0 to 1.5.
pub fn flowers(size: usize, seed: u64) -> Field {
    let cell = size as f32 / ROWS as f32;
    let rows: [Vec<Flower>; ROWS] = std::array::from_fn(|row| {
        (ROWS - 1..=2 * ROWS).map(|column| Flower::new(row, column, size, seed)).collect()
    });
    let mut field = Field::new(size, size);
    for (y, out) in field.values.chunks_exact_mut(size).enumerate() {
        let row = (y as f32 / cell) as usize + ROWS;
        let crossed: Vec<(&Flower, f32)> = (row - 1..=row + 1)
            .flat_map(|row| &rows[row % ROWS])
            .map(|flower| (flower, wrapped_distance(y as f32 - flower.centre[1], size)))
            .filter(|(flower, dy)| dy.abs() < flower.reach)
            .collect();
        for (x, value) in out.iter_mut().enumerate() {
            let column = (x as f32 / cell) as usize + ROWS;
            *value = crossed
                .iter()
                .filter(|(flower, _)| flower.column.abs_diff(column) <= 1)
                .map(|(flower, dy)| {
                    flower.at(wrapped_distance(x as f32 - flower.centre[0], size), *dy)
                })
                .fold(0.0, f32::max);
        }
    }
    field
}

/// A flower of several petals, with random orientation, size and offset from the grid.
struct Flower {
    /// Column of the grid, from [`ROWS`] on.
    column: usize,
    /// Texels.
    centre: [f32; 2],
    petals: f32,
    phase: f32,
    /// Length of the petals, texels.
    length: f32,
    /// No texel is farther away, by a margin for rounding.
    reach: f32,
    strength: f32,
}

impl Flower {
    fn new(row: usize, column: usize, size: usize, seed: u64) -> Self {
        let cell = size as f32 / ROWS as f32;
        let id = seed ^ (row * ROWS + column % ROWS) as u64;
        let [jitter_x, jitter_y] = [1, 2].map(|k| hash(id, k) - 0.5);
        let offset = 0.5 * (row % 2) as f32;
        let length = cell * (0.22 + 0.2 * hash(id, 5));
        Self {
            column,
            centre: [
                (column as f32 + 0.5 + offset + 0.5 * jitter_x) * cell,
                (row as f32 + 0.5 + 0.5 * jitter_y) * cell,
            ],
            petals: 3.0 + (hash(id, 3) * 4.0).floor(),
            phase: 6.3 * hash(id, 4),
            length,
            reach: 1.001 * length,
            strength: 0.5 + hash(id, 6),
        }
    }

    /// Strength at a distance from the centre.
    fn at(&self, dx: f32, dy: f32) -> f32 {
        if dx.abs() > self.reach {
            return 0.0;
        }
        let petals = self.petals * dy.atan2(dx) + self.phase;
        let edge = self.length * (0.7 + 0.3 * petals.cos());
        ((edge - dx.hypot(dy)) / 4.0).clamp(0.0, 1.0) * self.strength
    }
}

fn wrapped_distance(d: f32, size: usize) -> f32 {
    d - (d / size as f32).round() * size as f32
}
