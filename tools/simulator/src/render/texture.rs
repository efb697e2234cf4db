//! Textures as mip chains.

use crate::scene::Texture;

/// One texture with its ever smaller copies.
///
/// Colour bytes hold the square root of linear light: a code with about the resolution of sRGB where the eye needs it, that
/// is decoded by one multiplication. Alpha is linear.
#[derive(Debug)]
pub(super) struct MipChain {
    levels: Vec<Level>,
}

#[derive(Debug)]
struct Level {
    width: i32,
    height: i32,
    texels: Vec<[u8; 4]>,
}

/// Linear RGB and alpha.
pub(super) type Rgba = [f32; 4];

/// Where and how wide a pixel looks at a texture.
#[derive(Debug, Clone, Copy)]
pub(super) struct Footprint {
    /// Texture coordinates of the pixel's centre.
    pub uv: [f32; 2],
    /// Change of the texture coordinates from one pixel to the next, along columns and rows.
    pub per_column: [f32; 2],
    pub per_row: [f32; 2],
}

/// Samples along the longer axis of a footprint, at most. Floors seen from 0.8 m are stretched 6 times at 5 m.
const MAX_TAPS: f32 = 6.0;

impl MipChain {
    /// `None` when the texture's bytes do not fit its size or it has no texels.
    pub fn new(texture: &Texture) -> Option<Self> {
        let (width, height) = (texture.width as usize, texture.height as usize);
        if width == 0 || height == 0 || texture.rgba.len() != width.checked_mul(height)?.checked_mul(4)? {
            return None;
        }
        let code: Vec<u8> = (0..=255_u8).map(|v| quantise(srgb_to_linear(v).sqrt())).collect();
        let texels =
            texture.rgba.chunks_exact(4).map(|p| [code[p[0] as usize], code[p[1] as usize], code[p[2] as usize], p[3]]);
        let mut levels = vec![Level { width: width as i32, height: height as i32, texels: texels.collect() }];
        // Averages are taken of unrounded values, or dark tones would drift from level to level.
        let mut linear: Vec<Rgba> = levels[0].texels.iter().map(|&t| decode(t)).collect();
        let (mut width, mut height) = (width, height);
        while width > 1 || height > 1 {
            let (half_width, half_height) = ((width / 2).max(1), (height / 2).max(1));
            linear = shrink_rows(&shrink_columns(&linear, width, half_width), half_width, height, half_height);
            (width, height) = (half_width, half_height);
            let texels = linear.iter().map(|&t| encode(t)).collect();
            levels.push(Level { width: width as i32, height: height as i32, texels });
        }
        Some(Self { levels })
    }

    /// Alpha at full resolution, 0 to 1, bilinear.
    pub fn alpha(&self, uv: [f32; 2]) -> f32 {
        self.levels[0].bilinear(wrap(uv[0]), wrap(uv[1]))[3]
    }

    /// Filtered colour: trilinear across the footprint, repeated along its longer axis.
    #[inline]
    pub fn sample(&self, footprint: &Footprint) -> Rgba {
        let size = [self.levels[0].width as f32, self.levels[0].height as f32];
        let squared = |d: &[f32; 2]| (d[0] * size[0]).powi(2) + (d[1] * size[1]).powi(2);
        let (column, row) = (squared(&footprint.per_column), squared(&footprint.per_row));
        let (axis, long, short) = if column > row {
            (footprint.per_column, column.sqrt(), row.sqrt())
        } else {
            (footprint.per_row, row.sqrt(), column.sqrt())
        };
        if long <= 1.0 {
            return self.levels[0].bilinear(wrap(footprint.uv[0]), wrap(footprint.uv[1]));
        }
        let taps = (long / short.max(1.0)).clamp(1.0, MAX_TAPS).ceil();
        let texels = (long / taps).max(1.0);
        if taps < 2.0 {
            return self.trilinear(footprint.uv, texels);
        }
        let mut sum = [0.0; 4];
        for tap in 0..taps as usize {
            let along = (tap as f32 + 0.5) / taps - 0.5;
            let uv = [footprint.uv[0] + along * axis[0], footprint.uv[1] + along * axis[1]];
            let colour = self.trilinear(uv, texels);
            for channel in 0..4 {
                sum[channel] += colour[channel];
            }
        }
        sum.map(|s| s / taps)
    }

    /// `texels`: size of the pixel, at least 1.
    #[inline]
    fn trilinear(&self, uv: [f32; 2], texels: f32) -> Rgba {
        // The exponent is the level and the mantissa the way to the next: log2 with straight pieces, which is smooth enough.
        let bits = texels.to_bits();
        let level = (bits >> 23) as usize - 127;
        let fraction = (bits & 0x007f_ffff) as f32 / 8_388_608.0;
        let (u, v) = (wrap(uv[0]), wrap(uv[1]));
        let Some([fine, coarse]) = self.levels.get(level..level + 2) else {
            return self.levels[self.levels.len() - 1].bilinear(u, v);
        };
        let (a, b) = (fine.bilinear(u, v), coarse.bilinear(u, v));
        std::array::from_fn(|c| a[c] + fraction * (b[c] - a[c]))
    }
}

impl Level {
    /// `u`, `v` in [0, 1]; texel centres lie at half-integers; the picture repeats.
    #[inline]
    fn bilinear(&self, u: f32, v: f32) -> Rgba {
        let (x0, x1, fx) = neighbours(u, self.width);
        let (y0, y1, fy) = neighbours(v, self.height);
        let (upper, lower) = (y0 * self.width, y1 * self.width);
        let texel = |index: i32| decode(self.texels[index as usize]);
        let (a, b, c, d) = (texel(upper + x0), texel(upper + x1), texel(lower + x0), texel(lower + x1));
        let weights = [(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy];
        std::array::from_fn(|i| weights[0] * a[i] + weights[1] * b[i] + weights[2] * c[i] + weights[3] * d[i])
    }
}

/// The two texels beside coordinate `s` in [0, 1] and the share of the second.
#[inline(always)]
fn neighbours(s: f32, size: i32) -> (i32, i32, f32) {
    let x = s * size as f32 + 0.5; // one texel to the right, so that truncation is floor
    let whole = x as i32;
    let fraction = x - whole as f32;
    let left = if whole <= 0 { size - 1 } else { whole - 1 };
    let right = if whole >= size { 0 } else { whole };
    (left, right, fraction)
}

/// The fractional part, in [0, 1]; without a call to `floor`, which plain x86-64 has no instruction for.
#[inline(always)]
fn wrap(s: f32) -> f32 {
    let fraction = s - (s as i32) as f32;
    let fraction = if fraction < 0.0 { fraction + 1.0 } else { fraction };
    fraction.clamp(0.0, 1.0) // beyond the range of i32 it is not a fraction
}

#[inline(always)]
fn decode(texel: [u8; 4]) -> Rgba {
    let [r, g, b, a] = texel.map(|byte| f32::from(byte) * (1.0 / 255.0));
    [r * r, g * g, b * b, a]
}

fn encode(colour: Rgba) -> [u8; 4] {
    [quantise(colour[0].sqrt()), quantise(colour[1].sqrt()), quantise(colour[2].sqrt()), quantise(colour[3])]
}

fn quantise(value: f32) -> u8 {
    (value * 255.0).round() as u8
}

/// IEC 61966-2-1.
pub(super) fn srgb_to_linear(byte: u8) -> f32 {
    let s = f32::from(byte) / 255.0;
    if s <= 0.04045 { s / 12.92 } else { ((s + 0.055) / 1.055).powf(2.4) }
}

/// Area average of every row from `width` to `target` texels.
fn shrink_columns(texels: &[Rgba], width: usize, target: usize) -> Vec<Rgba> {
    let mut out = Vec::with_capacity(texels.len() / width * target);
    for row in texels.chunks_exact(width) {
        out.extend((0..target).map(|x| average(x, width, target, |i| row[i])));
    }
    out
}

/// Area average of every column from `height` to `target` texels.
fn shrink_rows(texels: &[Rgba], width: usize, height: usize, target: usize) -> Vec<Rgba> {
    let mut out = Vec::with_capacity(width * target);
    for y in 0..target {
        out.extend((0..width).map(|x| average(y, height, target, |i| texels[i * width + x])));
    }
    out
}

/// Average of texels `index * size / target .. (index + 1) * size / target`, the first and last counted by their share.
fn average(index: usize, size: usize, target: usize, texel: impl Fn(usize) -> Rgba) -> Rgba {
    let span = size as f32 / target as f32;
    let (from, to) = (index as f32 * span, (index + 1) as f32 * span);
    let mut sum = [0.0; 4];
    for i in from as usize..(to.ceil() as usize).min(size) {
        let share = (to.min(i as f32 + 1.0) - from.max(i as f32)) / span;
        let colour = texel(i);
        for channel in 0..4 {
            sum[channel] += share * colour[channel];
        }
    }
    sum
}
