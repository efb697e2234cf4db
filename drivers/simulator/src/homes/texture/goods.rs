//! Textures of furniture and small objects. Base colours tint them.

use super::noise::{Field, hash};
use super::{gray, square};
use crate::scene::Texture;

/// Sawn wood: wavy lines along u.
pub fn grain(seed: u64) -> Texture {
    const SIZE: usize = 512;
    let lines = Field::fractal([SIZE, SIZE], [3, 40], 4, 0.85, seed ^ 30);
    let waves = Field::fractal([SIZE, SIZE], [2, 5], 4, 0.8, seed ^ 31);
    let cloud = Field::fractal([SIZE, SIZE], [6, 6], 5, 0.9, seed ^ 32);
    square(SIZE, |x, y| {
        let rings =
            (waves.at(x, y) * 3.0 + y as f32 * std::f32::consts::TAU * 6.0 / SIZE as f32).sin();
        let shade = 11.0 * lines.at(x, y) + 6.0 * rings + 5.0 * cloud.at(x, y);
        [212.0 + shade, 210.0 + 1.1 * shade, 207.0 + 1.2 * shade]
    })
}

/// Versions: plain weave, a check of several thread colours, and a mottled knit.
pub fn cloth(version: u8, seed: u64) -> Texture {
    const SIZE: usize = 256;
    let seed = seed ^ u64::from(version) << 16;
    let weave = Field::fractal([SIZE, SIZE], [64, 64], 2, 1.0, seed ^ 33);
    let folds = Field::fractal([SIZE, SIZE], [3, 3], 5, 0.95, seed ^ 34);
    gray(SIZE, |x, y| {
        let base = 205.0 + 9.0 * folds.at(x, y) + 6.0 * weave.at(x, y);
        match version % 3 {
            0 => base,
            1 => base + band(x * 10 / SIZE, seed) + band((y + SIZE * 2) * 10 / SIZE, seed),
            _ => base + 8.0 * folds.at(x * 3, y * 3 + 40),
        }
    })
}

fn band(index: usize, seed: u64) -> f32 {
    26.0 * (hash(seed, index as u64) - 0.5)
}

/// Finger marks, dust and fine specks.
pub fn smudge(seed: u64) -> Texture {
    const SIZE: usize = 256;
    let cloud = Field::fractal([SIZE, SIZE], [3, 4], 6, 0.95, seed ^ 35);
    gray(SIZE, |x, y| 220.0 + 5.0 * cloud.at(x, y))
}

/// Veins on a mottled ground.
pub fn stone(seed: u64) -> Texture {
    const SIZE: usize = 256;
    let cloud = Field::fractal([SIZE, SIZE], [6, 6], 5, 0.95, seed ^ 36);
    let veins = Field::fractal([SIZE, SIZE], [3, 3], 5, 0.6, seed ^ 37);
    gray(SIZE, |x, y| {
        200.0 + 10.0 * cloud.at(x, y) - 45.0 * (1.0 - veins.at(x, y).abs() * 9.0).max(0.0)
    })
}

/// Bands and lettering at random heights. A book's position on the texture decides which it gets.
pub fn spines(seed: u64) -> Texture {
    const SIZE: usize = 256;
    // 24 strips of 2.5 cm: about one book's width.
    const STRIPS: usize = 24;
    let wear = Field::fractal([SIZE, SIZE], [8, 8], 5, 0.9, seed ^ 38);
    gray(SIZE, |x, y| {
        let strip = (x * STRIPS / SIZE) as u64;
        let v = y as f32 / SIZE as f32;
        let start = 0.2 + 0.4 * hash(seed, strip);
        let within = (x * STRIPS % SIZE) as f32 / SIZE as f32;
        let letters = (start..start + 0.3).contains(&v)
            && (0.3..0.7).contains(&within)
            && hash(seed ^ 39, (y as u64 / 3) * 64 + strip) > 0.4;
        let band = (hash(seed ^ 40, strip) - v).abs() < 0.025
            || (hash(seed ^ 41, strip) - v).abs() < 0.012;
        let base = 190.0 + 10.0 * wear.at(x, y);
        if letters {
            base + 60.0
        } else if band {
            base - 90.0
        } else {
            base
        }
    })
}

/// Greens that differ from leaf to leaf.
pub fn leaf(seed: u64) -> Texture {
    const SIZE: usize = 256;
    let tone = Field::fractal([SIZE, SIZE], [6, 6], 6, 0.95, seed ^ 42);
    square(SIZE, |x, y| {
        let t = tone.at(x, y);
        [74.0 + 16.0 * t, 112.0 + 20.0 * t, 58.0 + 12.0 * t]
    })
}
