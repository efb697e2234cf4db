//! Images that are stretched over one face: paintings, views through windows, rugs, screens.

use super::noise::{Field, hash};
use super::{lighter, mix, scaled, square};
use crate::scene::Texture;

const SIZE: usize = 256;

/// Versions: a landscape in layers, fields of colour, and a bunch of flowers.
pub fn painting(version: u8, seed: u64) -> Texture {
    let seed = seed ^ u64::from(version) << 24;
    let brush = Field::fractal([SIZE, SIZE], [6, 9], 5, 0.9, seed ^ 50);
    match version % 3 {
        0 => landscape(seed, &brush),
        1 => color_fields(seed, &brush),
        _ => flowers(seed, &brush),
    }
}

/// A muted colour by number.
fn pigment(seed: u64, id: u64) -> [f32; 3] {
    let gray = 70.0 + 130.0 * hash(seed ^ 51, id);
    std::array::from_fn(|i| gray + 56.0 * (hash(seed ^ 52 ^ i as u64, id) - 0.5))
}

fn landscape(seed: u64, brush: &Field) -> Texture {
    let ridges = Field::fractal([SIZE, 8], [3, 8], 5, 0.5, seed ^ 53);
    let top = mix([120.0, 160.0, 205.0], [225.0, 180.0, 150.0], hash(seed, 1));
    let low = [236.0, 222.0, 200.0];
    let far = [150.0, 165.0, 180.0];
    let layers: [[f32; 3]; 5] = std::array::from_fn(|layer| {
        let near = mix([58.0, 84.0, 52.0], [122.0, 92.0, 50.0], hash(seed, 2 + layer as u64));
        mix(far, near, layer as f32 / 4.0)
    });
    square(SIZE, |x, y| {
        let v = y as f32 / SIZE as f32;
        let mut color = mix(top, low, (v * 1.6).min(1.0));
        for (layer, ridge) in layers.iter().enumerate() {
            let crest = 0.34 + 0.13 * layer as f32 + 0.05 * ridges.at(x, layer);
            if v > crest {
                color = *ridge;
            }
        }
        lighter(color, 9.0 * brush.at(x, y))
    })
}

fn color_fields(seed: u64, brush: &Field) -> Texture {
    let wobble = Field::fractal([SIZE, SIZE], [3, 3], 3, 0.6, seed ^ 54);
    let boxes: Vec<[f32; 4]> =
        (0..9).map(|i| std::array::from_fn(|k| hash(seed ^ 55, i * 4 + k as u64))).collect();
    let pigments: Vec<[f32; 3]> = (0..9).map(|i| pigment(seed, i)).collect();
    let ground = pigment(seed, 20);
    square(SIZE, |x, y| {
        let u = x as f32 / SIZE as f32;
        let v = y as f32 / SIZE as f32 + 0.012 * wobble.at(x, y);
        let top = boxes.iter().rposition(|it| is_inside_box(it, u, v));
        lighter(top.map_or(ground, |top| pigments[top]), 10.0 * brush.at(x, y))
    })
}

fn is_inside_box(b: &[f32; 4], u: f32, v: f32) -> bool {
    (u - b[0]).abs() < 0.06 + 0.22 * b[2] && (v - b[1]).abs() < 0.06 + 0.22 * b[3]
}

fn flowers(seed: u64, brush: &Field) -> Texture {
    let ground = pigment(seed, 30);
    let vase = pigment(seed, 31);
    let blossoms: Vec<Blossom> = (0..26).map(|i| Blossom::new(seed, i)).collect();
    square(SIZE, |x, y| {
        let u = x as f32 / SIZE as f32;
        let v = y as f32 / SIZE as f32;
        let mut color = scaled(ground, 1.1 - 0.5 * v);
        if v > 0.72 && (u - 0.5).abs() < 0.16 - 0.2 * (v - 0.86).abs() {
            color = vase;
        }
        let blossom = blossoms.iter().rev().find_map(|blossom| blossom.color(u, v));
        lighter(blossom.unwrap_or(color), 8.0 * brush.at(x, y))
    })
}

/// A round flower of a bunch.
struct Blossom {
    centre: [f32; 2],
    radius: f32,
    pigment: [f32; 3],
}

impl Blossom {
    fn new(seed: u64, i: u64) -> Self {
        Self {
            centre: [
                0.5 + 0.62 * (hash(seed, 60 + i) - 0.5),
                0.4 + 0.56 * (hash(seed, 90 + i) - 0.5),
            ],
            radius: 0.03 + 0.05 * hash(seed, 120 + i),
            pigment: lighter(pigment(seed, 32 + i % 4), 40.0),
        }
    }

    /// `None` beside the flower.
    fn color(&self, u: f32, v: f32) -> Option<[f32; 3]> {
        let dx = u - self.centre[0];
        let dy = v - self.centre[1];
        // Before the root, which takes longer than all the rest of the image.
        if dx.abs() > self.radius || dy.abs() > self.radius {
            return None;
        }
        let r = dx.hypot(dy);
        let middle = [60.0, 70.0, 40.0];
        (r < self.radius).then(|| mix(self.pigment, middle, r / self.radius * 0.6))
    }
}

/// Sky, a far line of trees or roofs, and a hedge.
pub fn view(version: u8, seed: u64) -> Texture {
    let seed = seed ^ u64::from(version) << 32;
    let clouds = Field::fractal([SIZE, SIZE], [2, 4], 5, 0.6, seed ^ 56);
    let leaves = Field::fractal([SIZE, SIZE], [10, 10], 5, 0.9, seed ^ 57);
    let crowns = Field::fractal([SIZE, 4], [5, 4], 4, 0.6, seed ^ 58);
    square(SIZE, |x, y| {
        let v = y as f32 / SIZE as f32;
        let sky = mix(
            [176.0, 205.0, 238.0],
            [240.0, 244.0, 248.0],
            (0.3 + v + 0.18 * clouds.at(x, y)).clamp(0.0, 1.0),
        );
        let trees = 0.55 + 0.07 * crowns.at(x, 0);
        let house = hash(seed, (x / 32) as u64);
        let roofs = 0.52 - 0.12 * house;
        if v > 0.8 + 0.03 * crowns.at(x, 2) {
            lighter([104.0, 128.0, 84.0], 14.0 * leaves.at(x, y))
        } else if v > trees {
            lighter([128.0, 150.0, 118.0], 12.0 * leaves.at(x, y))
        } else if version % 2 == 1 && v > roofs {
            let pane = x % 11 > 6 && y % 16 > 9;
            scaled(
                mix([205.0, 190.0, 178.0], [176.0, 168.0, 170.0], house),
                if pane { 0.72 } else { 1.0 },
            )
        } else {
            sky
        }
    })
}

/// A border, a field of jittered diamonds, and wear.
pub fn rug(version: u8, seed: u64) -> Texture {
    let seed = seed ^ u64::from(version) << 40;
    let pile = Field::fractal([SIZE, SIZE], [64, 64], 2, 1.0, seed ^ 59);
    let wear = Field::fractal([SIZE, SIZE], [3, 3], 5, 0.9, seed ^ 60);
    let field = pigment(seed, 1);
    let border = pigment(seed, 2);
    let motif = pigment(seed, 3);
    square(SIZE, |x, y| {
        let edge = x.min(y).min(SIZE - 1 - x).min(SIZE - 1 - y);
        let column = x / 20;
        let row = y / 20;
        let id = (row * 16 + column) as u64;
        let diamond = (x % 20).abs_diff(10) + (y % 20).abs_diff(10);
        let color = match edge {
            0..4 => scaled(border, 0.7),
            4..24 => {
                if (x + y) % 14 < 7 && hash(seed, id) > 0.3 {
                    border
                } else {
                    scaled(border, 1.15)
                }
            }
            24..28 => motif,
            _ if diamond < 3 + (7.0 * hash(seed ^ 61, id)) as usize => {
                mix(motif, border, hash(seed ^ 62, id))
            }
            _ => field,
        };
        lighter(lighter(color, 7.0 * pile.at(x, y)), 7.0 * wear.at(x, y))
    })
}

/// Windows with lines of text.
pub fn screen(version: u8, seed: u64) -> Texture {
    let seed = seed ^ u64::from(version) << 48;
    let dark = version % 2 == 1;
    square(SIZE, |x, y| {
        let (ink, paper) = if dark {
            ([190.0, 205.0, 190.0], [30.0, 34.0, 42.0])
        } else {
            ([70.0, 74.0, 84.0], [214.0, 220.0, 226.0])
        };
        let line = (y / 8) as u64;
        let column = x as f32 / SIZE as f32;
        let reach = 0.1 + 0.55 * hash(seed, line);
        if y < 12 || x < 40 {
            mix(paper, [90.0, 130.0, 170.0], 0.5)
        } else if y % 8 < 3
            && column > 0.2
            && column < 0.2 + reach
            && hash(seed ^ 63, line * 128 + (x / 3) as u64) > 0.25
        {
            ink
        } else {
            paper
        }
    })
}
