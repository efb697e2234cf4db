//! Texture filtering with mip chains.

use super::light::srgb_to_linear;
use crate::scene::Texture;

/// One texture with its mip levels.
///
/// Colour bytes hold the square root of linear light. This code has about the resolution of sRGB
/// and is decoded by one multiplication. Alpha is linear.
#[derive(Debug)]
pub(super) struct MipChain {
    levels: Vec<Level>,
}

pub(super) type Rgba = [f32; 4];

/// Area of a texture that a pixel covers.
#[derive(Debug, Clone, Copy)]
pub(super) struct Footprint {
    /// Texture coordinates of the pixel's centre.
    pub uv: [f32; 2],
    /// Change of the texture coordinates from one pixel to the next, along columns and rows.
    pub per_column: [f32; 2],
    pub per_row: [f32; 2],
}

/// Maximum number of samples along the longer axis of a footprint. Floors seen from 0.8 m are
/// stretched 4 times at 3 m.
const MAX_TAPS: f32 = 4.0;

impl MipChain {
    /// `None` when the texture's bytes do not fit its size or it has no texels.
    pub fn new(texture: &Texture) -> Option<Self> {
        let mut width = texture.width as usize;
        let mut height = texture.height as usize;
        if width == 0
            || height == 0
            || texture.rgba.len() != width.checked_mul(height)?.checked_mul(4)?
        {
            return None;
        }
        let (texels, _) = texture.rgba.as_chunks::<4>();
        let light: [f32; 256] = std::array::from_fn(|byte| srgb_to_linear(byte as u8));
        let code = light.map(|light| unit_to_byte(light.sqrt()));
        let coded = texels
            .iter()
            .map(|t| [code[t[0] as usize], code[t[1] as usize], code[t[2] as usize], t[3]]);
        let linear = |i: usize| {
            let [r, g, b, a] = texels[i];
            [light[r as usize], light[g as usize], light[b as usize], f32::from(a) / 255.0]
        };
        let mut levels = vec![Level::new(width, height, coded)];
        // Levels are averaged from unrounded values. Rounded ones would make dark tones drift from
        // level to level.
        let mut finer: Vec<Rgba> = Vec::new();
        while width > 1 || height > 1 {
            let half = ((width / 2).max(1), (height / 2).max(1));
            finer = match levels.len() {
                1 => shrink(linear, (width, height), half),
                _ => shrink(|i| finer[i], (width, height), half),
            };
            (width, height) = half;
            levels.push(Level::new(width, height, finer.iter().map(encode)));
        }
        Some(Self { levels })
    }

    /// Alpha at full resolution, 0 to 1, bilinear.
    pub fn alpha(&self, uv: [f32; 2]) -> f32 {
        self.levels[0].bilinear(wrap(uv[0]), wrap(uv[1])).linear(1)[3]
    }

    /// Filtered colour: trilinear across the footprint, with several samples along its longer axis.
    #[inline(always)]
    pub fn sample(&self, footprint: &Footprint) -> Rgba {
        let size = [self.levels[0].width as i32 as f32, self.levels[0].height as i32 as f32];
        let column = texel_length(&footprint.per_column, size);
        let row = texel_length(&footprint.per_row, size);
        let (axis, long, short) = if column > row {
            (footprint.per_column, column, row)
        } else {
            (footprint.per_row, row, column)
        };
        if long <= 1.0 {
            return Blend::One(&self.levels[0]).sample(footprint.uv);
        }
        let taps = ((long / short.max(1.0)).min(MAX_TAPS) + 0.5) as i32;
        if taps < 2 {
            return self.blend(long).sample(footprint.uv);
        }
        let share = 1.0 / taps as f32;
        let blend = self.blend((long * share).max(1.0));
        let mut sum = [0.0; 4];
        for tap in 0..taps {
            let along = (tap as f32 + 0.5) * share - 0.5;
            let uv = [footprint.uv[0] + along * axis[0], footprint.uv[1] + along * axis[1]];
            let colour = blend.sample(uv);
            for channel in 0..4 {
                sum[channel] += colour[channel] * share;
            }
        }
        sum
    }

    /// The levels for a pixel whose size is `texels`, at least 1.
    #[inline(always)]
    fn blend(&self, texels: f32) -> Blend<'_> {
        // The exponent is the level and the mantissa the position between levels: a piecewise
        // linear log2, which is smooth enough.
        let bits = texels.to_bits();
        let level = (bits >> 23) as usize - 127;
        // The blend goes from 0 at a quarter of the interval to 1 at three quarters, so that half
        // of all samples need only one level.
        let fraction = ((bits & 0x007f_ffff) >> (22 - Mix::LEVEL_BITS))
            .saturating_sub(Blend::WHOLE / 2)
            .min(Blend::WHOLE);
        let Some([fine, coarse]) = self.levels.get(level..level + 2) else {
            return Blend::One(&self.levels[self.levels.len() - 1]);
        };
        match fraction {
            0 => Blend::One(fine),
            Blend::WHOLE => Blend::One(coarse),
            _ => Blend::Two { fine, coarse, fraction },
        }
    }
}

/// The mip levels that a pixel is sampled from: one, or two neighbours.
enum Blend<'a> {
    One(&'a Level),
    /// `fraction` is the weight of the coarse one, in units of 1 / [`Blend::WHOLE`].
    Two {
        fine: &'a Level,
        coarse: &'a Level,
        fraction: u32,
    },
}

impl Blend<'_> {
    const WHOLE: u32 = 1 << Mix::LEVEL_BITS;

    #[inline(always)]
    fn sample(&self, uv: [f32; 2]) -> Rgba {
        let u = wrap(uv[0]);
        let v = wrap(uv[1]);
        match self {
            Self::One(level) => level.bilinear(u, v).linear(1),
            Self::Two { fine, coarse, fraction } => {
                let mut mix = Mix::default();
                mix.add(&fine.bilinear(u, v), Self::WHOLE - fraction);
                mix.add(&coarse.bilinear(u, v), *fraction);
                mix.linear(Self::WHOLE)
            }
        }
    }
}

fn texel_length(d: &[f32; 2], size: [f32; 2]) -> f32 {
    ((d[0] * size[0]) * (d[0] * size[0]) + (d[1] * size[1]) * (d[1] * size[1])).sqrt()
}

/// A weighted sum of texels, four channels in one vector register. It never overflows; arithmetic
/// that wraps keeps the checks of unoptimised builds out of these loops.
#[derive(Debug, Default, Clone, Copy)]
struct Mix([u32; 4]);

impl Mix {
    /// Resolution of the position between two texels, bits. Eight bits of colour, twice eight of
    /// position and seven of level make 31.
    const PLACE_BITS: u32 = 8;
    /// Resolution of the position between two levels, bits.
    const LEVEL_BITS: u32 = 7;

    #[inline(always)]
    fn add_texel(&mut self, texel: [u8; 4], weight: u32) {
        for (sum, value) in self.0.iter_mut().zip(texel) {
            *sum = sum.wrapping_add(u32::from(value).wrapping_mul(weight));
        }
    }

    #[inline(always)]
    fn add(&mut self, other: &Self, weight: u32) {
        for (sum, value) in self.0.iter_mut().zip(other.0) {
            *sum = sum.wrapping_add(value.wrapping_mul(weight));
        }
    }

    /// Linear light of a sum of bilinear mixes whose total weight is `weight`.
    #[inline(always)]
    fn linear(&self, weight: u32) -> Rgba {
        let scale = 1.0 / (255 * (weight << (2 * Self::PLACE_BITS))) as f32;
        let mut color = [0.0; 4];
        for (value, sum) in color.iter_mut().zip(self.0) {
            *value = sum as i32 as f32 * scale;
        }
        let [r, g, b, a] = color;
        [r * r, g * g, b * b, a]
    }
}

/// One mip level, stored in tiles of 4 x 4 texels. A tile is one cache line, so neighbours in any
/// direction share lines and pages.
#[derive(Debug)]
struct Level {
    width: u32,
    height: u32,
    /// Number of texels from one row of tiles to the next.
    tile_row: u32,
    /// R, G, B, A.
    texels: Vec<[u8; 4]>,
}

impl Level {
    /// From texels row by row.
    fn new(width: usize, height: usize, mut colours: impl Iterator<Item = [u8; 4]>) -> Self {
        let tile_row = width.div_ceil(4) * 16;
        let texels = vec![[0; 4]; tile_row * height.div_ceil(4)];
        let mut level =
            Self { width: width as u32, height: height as u32, tile_row: tile_row as u32, texels };
        for y in 0..height {
            let start = level.row_start(y as u32);
            for (x, colour) in colours.by_ref().take(width).enumerate() {
                level.texels[(start + column_start(x as u32)) as usize] = colour;
            }
        }
        level
    }

    #[inline(always)]
    fn row_start(&self, y: u32) -> u32 {
        (y >> 2) * self.tile_row + ((y & 3) << 2)
    }

    /// Bilinear sample for `u`, `v` in [0, 1]. Texel centres lie at half-integers and the texture
    /// repeats.
    #[inline(always)]
    fn bilinear(&self, u: f32, v: f32) -> Mix {
        let (x0, x1, fx) = neighbours(u, self.width);
        let (y0, y1, fy) = neighbours(v, self.height);
        let upper = self.row_start(y0);
        let lower = self.row_start(y1);
        let left = column_start(x0);
        let right = column_start(x1);
        const WHOLE: u32 = 1 << Mix::PLACE_BITS;
        let mut mix = Mix::default();
        mix.add_texel(self.texels[(upper + left) as usize], (WHOLE - fx) * (WHOLE - fy));
        mix.add_texel(self.texels[(upper + right) as usize], fx * (WHOLE - fy));
        mix.add_texel(self.texels[(lower + left) as usize], (WHOLE - fx) * fy);
        mix.add_texel(self.texels[(lower + right) as usize], fx * fy);
        mix
    }
}

#[inline(always)]
fn column_start(x: u32) -> u32 {
    ((x >> 2) << 4) | (x & 3)
}

/// The two texels beside coordinate `s` in [0, 1] and the weight of the second, in units of
/// 2^-[`Mix::PLACE_BITS`].
#[inline(always)]
fn neighbours(s: f32, size: u32) -> (u32, u32, u32) {
    // The offset of half a texel makes truncation equal to floor. Signed integers, because their
    // conversions are single instructions.
    let place = ((s * size as i32 as f32 + 0.5) * (1 << Mix::PLACE_BITS) as f32) as i32 as u32;
    let whole = (place >> Mix::PLACE_BITS).min(size);
    let left = if whole == 0 { size - 1 } else { whole - 1 };
    let right = if whole == size { 0 } else { whole };
    (left, right, place & ((1 << Mix::PLACE_BITS) - 1))
}

/// The fractional part, in [0, 1], without a call to `floor`, for which plain x86-64 has no
/// instruction.
#[inline(always)]
fn wrap(s: f32) -> f32 {
    let fraction = s - (s as i32) as f32;
    let fraction = if fraction < 0.0 { fraction + 1.0 } else { fraction };
    fraction.clamp(0.0, 1.0) // beyond the range of i32 it is not a fraction
}

fn encode(colour: &Rgba) -> [u8; 4] {
    [
        unit_to_byte(colour[0].sqrt()),
        unit_to_byte(colour[1].sqrt()),
        unit_to_byte(colour[2].sqrt()),
        unit_to_byte(colour[3]),
    ]
}

fn unit_to_byte(value: f32) -> u8 {
    (value * 255.0 + 0.5) as u8
}

/// Reduces an image by area averaging. `texel` takes the index of a texel, row by row.
fn shrink(
    texel: impl Fn(usize) -> Rgba,
    (width, height): (usize, usize),
    (to_width, to_height): (usize, usize),
) -> Vec<Rgba> {
    let columns = shares(width, to_width);
    let rows = shares(height, to_height);
    let mut out = Vec::with_capacity(to_width * to_height);
    let mut line: Vec<Rgba> = vec![[0.0; 4]; width];
    for sources in &rows {
        line.fill([0.0; 4]);
        for (y, share) in sources {
            for (sum, index) in line.iter_mut().zip(y * width..) {
                let texel = texel(index);
                for channel in 0..4 {
                    sum[channel] += share * texel[channel];
                }
            }
        }
        for sources in &columns {
            let mut sum = [0.0; 4];
            for (x, share) in sources {
                for channel in 0..4 {
                    sum[channel] += share * line[*x][channel];
                }
            }
            out.push(sum);
        }
    }
    out
}

/// Computes for each of `target` equal parts of a line of `size` texels the texels that it covers
/// and their fractions of it.
fn shares(size: usize, target: usize) -> Vec<Vec<(usize, f32)>> {
    let span = size as f32 / target as f32;
    (0..target).map(|it| covered_texels(it, span, size)).collect()
}

fn covered_texels(index: usize, span: f32, size: usize) -> Vec<(usize, f32)> {
    let from = index as f32 * span;
    let to = (index + 1) as f32 * span;
    let texels = from as usize..(to.ceil() as usize).min(size);
    texels.map(|i| (i, (to.min(i as f32 + 1.0) - from.max(i as f32)) / span)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn every_level_keeps_the_average_of_a_texture_of_any_size() {
        for (width, height) in [(8, 8), (7, 5), (1, 9), (12, 1), (33, 17)] {
            let rgba: Vec<u8> = (0..width * height * 4).map(|i| (i * 37 % 251) as u8).collect();
            let chain = MipChain::new(&Texture { width, height, rgba: rgba.clone() }).unwrap();
            let light = rgba.chunks_exact(4).map(|p| srgb_to_linear(p[1])).sum::<f32>()
                / (width * height) as f32;
            let smallest = &chain.levels[chain.levels.len() - 1];
            assert_eq!((smallest.width, smallest.height), (1, 1));
            assert!((smallest.bilinear(0.5, 0.5).linear(1)[1] - light).abs() < 0.004);
        }
    }

    #[test]
    fn textures_whose_bytes_do_not_match_their_size_are_refused() {
        assert!(MipChain::new(&Texture { width: 2, height: 2, rgba: vec![0; 15] }).is_none());
        assert!(MipChain::new(&Texture { width: 0, height: 2, rgba: vec![] }).is_none());
    }

    fn byte(code: u32) -> u8 {
        super::super::light::linear_to_srgb((code as f32 / 255.0).powi(2))
    }

    proptest! {
        #[test]
        fn any_coordinate_is_between_the_texels_beside_it(u in -3.0..3.0_f32, v in -3.0..3.0_f32) {
            // Red rises by 20 per column and green by 30 per row, in the square root of light.
            let rgba = (0..48).flat_map(|i| [byte(20 + i % 8 * 20), byte(30 + i / 8 * 30), 0, 255]).collect();
            let chain = MipChain::new(&Texture { width: 8, height: 6, rgba }).unwrap();
            let x = u.rem_euclid(1.0) * 8.0 - 0.5;
            let y = v.rem_euclid(1.0) * 6.0 - 0.5;
            prop_assume!((0.0..7.0).contains(&x) && (0.0..5.0).contains(&y));
            let narrow = Footprint { uv: [u, v], per_column: [0.001, 0.0], per_row: [0.0, 0.001] };
            let [red, green, _, alpha] = chain.sample(&narrow);
            prop_assert!((red.sqrt() * 255.0 - (20.0 + 20.0 * x)).abs() < 1.5, "{} at {x}", red.sqrt() * 255.0);
            prop_assert!((green.sqrt() * 255.0 - (30.0 + 30.0 * y)).abs() < 1.5, "{} at {y}", green.sqrt() * 255.0);
            prop_assert!((alpha - 1.0).abs() < 1e-6);
        }

        #[test]
        fn no_coordinate_and_no_footprint_leaves_the_texture(
            uv in prop::array::uniform2(prop::num::f32::ANY),
            per_column in prop::array::uniform2(prop::num::f32::ANY),
            per_row in prop::array::uniform2(prop::num::f32::ANY),
        ) {
            let chain = MipChain::new(&Texture { width: 5, height: 3, rgba: vec![90; 60] }).unwrap();
            chain.sample(&Footprint { uv, per_column, per_row });
            chain.alpha(uv);
        }
    }
}
