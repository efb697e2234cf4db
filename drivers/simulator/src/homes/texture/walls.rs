//! Textures of walls and ceilings. Their contrast scales with `HomeOptions::texture`.

use super::flower::flowers;
use super::noise::{Field, hash};
use super::{gray, lighter, mix, square};
use crate::scene::Texture;

const SIZE: usize = 512;
/// Mean brightness of colourless wall textures. It is below white so that contrast is not clipped.
const MEAN: f32 = 222.0;
/// Painted plaster: standard deviation over a whole tile at full texture, of 255.
const PLASTER_RMS: f32 = 24.0;
/// Ceilings are painted more evenly than walls.
const CEILING_RMS: f32 = 18.0;
/// Contrast of wallpaper motifs against their background.
const MOTIF: f32 = 60.0;
/// Scale of the brightness variations within and between bricks, of 255.
const BRICK_RMS: f32 = 26.0;

/// Variations at every scale, the marks of a roller, and a few stains and scuffs.
pub fn plaster(seed: u64, texture: f32) -> Texture {
    let mut field = cloud([SIZE, SIZE], seed);
    let roller = Field::fractal([SIZE, SIZE], [24, 3], 3, 0.8, seed ^ 1);
    let stains = Field::fractal([SIZE, SIZE], [4, 5], 5, 0.8, seed ^ 2);
    let scuffs = Field::fractal([SIZE, SIZE], [10, 60], 2, 0.8, seed ^ 3);
    for (i, value) in field.values.iter_mut().enumerate() {
        *value += 0.45 * roller.values[i];
        *value -= 0.9 * (stains.values[i] - 1.8).max(0.0) + 1.5 * (scuffs.values[i] - 2.3).max(0.0);
    }
    field.standardise();
    gray(SIZE, |x, y| MEAN + texture * PLASTER_RMS * field.at(x, y).clamp(-4.0, 3.0))
}

/// Contrast at every scale, with less above 30 cm: paint hides large unevenness better than small.
fn cloud(size: [usize; 2], seed: u64) -> Field {
    let mut field = Field::fractal(size, [9, 9], 6, 1.0, seed);
    let coarse = Field::fractal(size, [3, 3], 2, 1.0, seed ^ 8);
    field.values.iter_mut().zip(&coarse.values).for_each(|(v, c)| *v += 0.3 * c);
    field.standardise();
    field
}

/// Fine and even, with a little cloud.
pub fn ceiling(seed: u64, texture: f32) -> Texture {
    let field = cloud([SIZE, SIZE], seed ^ 4);
    gray(SIZE, |x, y| MEAN + texture * CEILING_RMS * field.at(x, y))
}

/// Flowers of several petals with random orientation, size and offset from a grid.
pub fn wallpaper(seed: u64, texture: f32) -> Texture {
    let ground = cloud([SIZE, SIZE], seed ^ 5);
    let motifs = flowers(SIZE, seed);
    gray(SIZE, |x, y| {
        MEAN + texture * (0.6 * PLASTER_RMS * ground.at(x, y) - MOTIF * motifs.at(x, y))
    })
}

/// Running bond; every brick has its own colour.
pub fn brick(seed: u64, texture: f32) -> Texture {
    const COURSES: usize = 30;
    const COLUMNS: usize = 10;
    let field = Field::fractal([SIZE, SIZE], [8, 8], 6, 0.9, seed ^ 6);
    let contrast = 0.5 + 0.5 * texture;
    square(SIZE, |x, y| {
        let v = y as f32 * COURSES as f32 / SIZE as f32;
        let course = v as usize;
        let u = x as f32 * COLUMNS as f32 / SIZE as f32 + 0.5 * (course % 2) as f32;
        let id = (course * COLUMNS + u as usize % COLUMNS) as u64;
        let brick = mix([168.0, 98.0, 76.0], [128.0, 72.0, 60.0], hash(seed, id));
        let mortar = u.fract() < 0.05 || v.fract() < 0.14;
        let color = if mortar { [172.0, 164.0, 152.0] } else { brick };
        let shade =
            contrast * BRICK_RMS * (0.5 * field.at(x, y) + 0.7 * (hash(seed ^ 7, id) - 0.5));
        lighter(color, shade)
    })
}
