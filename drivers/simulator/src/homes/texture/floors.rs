//! Floor textures. Boards and tiles repeat, but each has its own shade and grain.

use super::noise::{Field, hash};
use super::{gray, mix, scaled, square};
use crate::scene::Texture;

/// Boards in a row.
const BOARDS: usize = 3;

/// Boards, tiles and blocks differ from each other in any home; only their detail scales with
/// `texture`.
fn partly(texture: f32) -> f32 {
    0.55 + 0.9 * texture
}

/// Boards of 15 cm and uneven lengths; versions are oak, walnut and grey laminate.
pub fn planks(version: u8, seed: u64, texture: f32) -> Texture {
    const SIZE: usize = 1024;
    const ROWS: usize = 16;
    let grain = Field::fractal([SIZE, SIZE], [3, 48], 5, 0.85, seed ^ 10);
    let cloud = Field::fractal([SIZE, SIZE], [4, 4], 6, 1.0, seed ^ 11);
    let (light, dark) = match version % 3 {
        0 => ([196.0, 158.0, 112.0], [160.0, 120.0, 80.0]),
        1 => ([138.0, 98.0, 70.0], [102.0, 70.0, 50.0]),
        _ => ([176.0, 168.0, 158.0], [140.0, 132.0, 122.0]),
    };
    let contrast = partly(texture);
    let joints: [[usize; BOARDS]; ROWS] =
        std::array::from_fn(|row| std::array::from_fn(|k| joint_column(row, k, seed, SIZE)));
    let boards: Vec<Piece> =
        (0..ROWS * BOARDS).map(|id| Piece::new([seed ^ 12, seed ^ 13], id, SIZE)).collect();
    square(SIZE, |x, y| {
        let row = y * ROWS / SIZE;
        let within = y * ROWS % SIZE / ROWS;
        let board = joints[row].iter().rposition(|joint| x >= *joint).unwrap_or(BOARDS - 1);
        let Piece { offset, tone } = boards[row * BOARDS + board];
        let tone =
            tone + contrast * (0.17 * grain.at(x + offset, y + offset * 7) + 0.07 * cloud.at(x, y));
        let gap = within < 1 || joints[row].contains(&x);
        scaled(mix(dark, light, tone), if gap { 0.62 } else { 1.0 })
    })
}

/// A board, strip or tile.
#[derive(Clone, Copy)]
struct Piece {
    /// Where in the grain's field its own begins, texels.
    offset: usize,
    /// Shade, 0 to 1.
    tone: f32,
}

impl Piece {
    /// `seeds` are those of the offset and of the tone.
    fn new(seeds: [u64; 2], id: usize, size: usize) -> Self {
        let [offset, tone] = seeds.map(|seed| hash(seed, id as u64));
        Self { offset: (offset * size as f32) as usize, tone }
    }
}

/// Three boards per row, with joints at random positions.
fn joint_column(row: usize, k: usize, seed: u64, size: usize) -> usize {
    ((k as f32 + 0.7 * hash(seed ^ row as u64, k as u64)) / BOARDS as f32 * size as f32) as usize
}

/// Blocks of 24 cm with five strips each, in alternating directions.
pub fn parquet(seed: u64, texture: f32) -> Texture {
    const SIZE: usize = 1024;
    const BLOCKS: usize = 10;
    const STRIPS: usize = 5;
    let along = Field::fractal([SIZE, SIZE], [6, 96], 4, 0.85, seed ^ 14);
    let cloud = Field::fractal([SIZE, SIZE], [4, 4], 6, 1.0, seed ^ 15);
    let contrast = partly(texture);
    let strips: Vec<Piece> = (0..BLOCKS * BLOCKS * STRIPS)
        .map(|id| Piece::new([seed ^ 16, seed ^ 17], id, SIZE))
        .collect();
    square(SIZE, |x, y| {
        let column = x * BLOCKS / SIZE;
        let row = y * BLOCKS / SIZE;
        let u = x * BLOCKS % SIZE;
        let v = y * BLOCKS % SIZE;
        let (across, length) = if (row + column).is_multiple_of(2) { (v, u) } else { (u, v) };
        let strip = across * STRIPS / SIZE;
        let Piece { offset, tone } = strips[(row * BLOCKS + column) * STRIPS + strip];
        let grain = if (row + column).is_multiple_of(2) {
            along.at(x + offset, y)
        } else {
            along.at(y + offset, x)
        };
        let tone = tone + contrast * (0.12 * grain + 0.06 * cloud.at(x, y));
        let gap = across * STRIPS % SIZE < SIZE / 9 || length < BLOCKS * 2;
        scaled(mix([150.0, 106.0, 68.0], [190.0, 148.0, 102.0], tone), if gap { 0.74 } else { 1.0 })
    })
}

/// Square tiles, large for floors (40 cm) and small for walls (15 cm), with veins and grey grout.
pub fn tiles(small: bool, seed: u64, texture: f32) -> Texture {
    const SIZE: usize = 512;
    let (count, grout, rms) = if small { (10, 0.03, 3.0) } else { (6, 0.018, 8.0) };
    let stone = Field::fractal([SIZE, SIZE], [5, 5], 6, 0.95, seed ^ 18);
    let fleck = Field::fractal([SIZE, SIZE], [90, 90], 2, 0.9, seed ^ 19);
    let contrast = partly(texture);
    let pieces: Vec<Piece> =
        (0..count * count).map(|id| Piece::new([seed ^ 20, seed ^ 21], id, SIZE)).collect();
    gray(SIZE, |x, y| {
        let u = x as f32 * count as f32 / SIZE as f32;
        let v = y as f32 * count as f32 / SIZE as f32;
        if u.fract() < grout || v.fract() < grout {
            return 160.0 + 6.0 * fleck.at(x, y);
        }
        let Piece { offset, tone } = pieces[v as usize * count + u as usize];
        let detail = 0.8 * stone.at(x + offset, y + 2 * offset) + 0.4 * fleck.at(x, y);
        214.0 + 12.0 * (tone - 0.5) + contrast * rms * detail
    })
}

/// Tufts, and the traces of feet and of the vacuum cleaner.
pub fn carpet(seed: u64, texture: f32) -> Texture {
    const SIZE: usize = 512;
    let tufts = Field::fractal([SIZE, SIZE], [128, 128], 3, 1.0, seed ^ 22);
    let traces = Field::fractal([SIZE, SIZE], [3, 4], 6, 0.95, seed ^ 23);
    let contrast = partly(texture);
    gray(SIZE, |x, y| 205.0 + contrast * (21.0 * tufts.at(x, y) + 15.0 * traces.at(x, y)))
}
