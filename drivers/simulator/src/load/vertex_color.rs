//! Vertex colours of meshes without textures, as in scans (Replica, small exports of Gibson).

use crate::scene::Texture;

/// Packs the corner colours of triangles into one texture, two by two texels per triangle.
///
/// With texels c0 c1 / c2 (c1 + c2 - c0), bilinear filtering inside the block equals the linear
/// blend of the three corners.
#[derive(Debug, Default)]
pub struct ColorAtlas {
    blocks: Vec<[[u8; 3]; 4]>,
}

/// Blocks in one row of the texture.
const BLOCKS_PER_ROW: usize = 2048;

impl ColorAtlas {
    /// Adds one triangle's corner colours (sRGB) and returns the index of its block.
    pub fn push(&mut self, [c0, c1, c2]: [[u8; 3]; 3]) -> usize {
        let opposite = std::array::from_fn(|i| {
            (i16::from(c1[i]) + i16::from(c2[i]) - i16::from(c0[i])).clamp(0, 255) as u8
        });
        self.blocks.push([c0, c1, c2, opposite]);
        self.blocks.len() - 1
    }

    /// Texture coordinates of a block's three corners. Valid only after all blocks were added.
    pub fn uv(&self, block: usize) -> [[f32; 2]; 3] {
        let (columns, rows) = self.shape();
        let left = block % columns;
        let top = block / columns;
        [(0, 0), (1, 0), (0, 1)]
            .map(|(u, v)| [texel_center(left, u, columns), texel_center(top, v, rows)])
    }

    pub fn into_texture(self) -> Texture {
        let (columns, rows) = self.shape();
        let width = 2 * columns;
        let height = 2 * rows;
        let mut rgba = vec![255; width * height * 4];
        for (index, block) in self.blocks.iter().enumerate() {
            let left = 2 * (index % columns);
            let top = 2 * (index / columns);
            for (part, color) in block.iter().enumerate() {
                let texel = (top + part / 2) * width + left + part % 2;
                rgba[4 * texel..4 * texel + 3].copy_from_slice(color);
            }
        }
        Texture { width: width as u32, height: height as u32, rgba }
    }

    fn shape(&self) -> (usize, usize) {
        let columns = self.blocks.len().clamp(1, BLOCKS_PER_ROW);
        (columns, self.blocks.len().div_ceil(columns).max(1))
    }
}

fn texel_center(block: usize, part: usize, blocks: usize) -> f32 {
    (((2 * block + part) as f64 + 0.5) / (2 * blocks) as f64) as f32
}

/// sRGB code of a linear-light value.
pub fn srgb_from_linear(linear: f32) -> u8 {
    let linear = linear.clamp(0.0, 1.0);
    let code =
        if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 };
    (code * 255.0).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bilinear_filtering_inside_a_block_blends_the_corners() {
        let mut atlas = ColorAtlas::default();
        for _ in 0..5 {
            atlas.push([[9; 3]; 3]);
        }
        let corners = [[40, 0, 0], [0, 80, 10], [100, 60, 30]];
        let block = atlas.push(corners);
        let uv = atlas.uv(block);
        let texture = atlas.into_texture();
        // A point inside the triangle, by its weights.
        let weights = [0.2_f32, 0.5, 0.3];
        let x = weighted_position(0, texture.width, weights, uv);
        let y = weighted_position(1, texture.height, weights, uv);
        let fx = x.fract();
        let fy = y.fract();
        for channel in 0..3 {
            let upper = texel_value(0, 0, x, y, &texture, channel) * (1.0 - fx)
                + texel_value(1, 0, x, y, &texture, channel) * fx;
            let lower = texel_value(0, 1, x, y, &texture, channel) * (1.0 - fx)
                + texel_value(1, 1, x, y, &texture, channel) * fx;
            let blend: f32 = (0..3).map(|i| weights[i] * f32::from(corners[i][channel])).sum();
            assert!((upper * (1.0 - fy) + lower * fy - blend).abs() < 0.01);
        }
    }

    fn texel_value(dx: u32, dy: u32, x: f32, y: f32, texture: &Texture, channel: usize) -> f32 {
        let index = (y as u32 + dy) * texture.width + x as u32 + dx;
        f32::from(texture.rgba[4 * index as usize + channel])
    }

    fn weighted_position(axis: usize, side: u32, weights: [f32; 3], uv: [[f32; 2]; 3]) -> f32 {
        (0..3).map(|i| weights[i] * uv[i][axis]).sum::<f32>() * side as f32 - 0.5
    }

    #[test]
    fn the_srgb_curve_meets_its_published_points() {
        assert_eq!([0.0, 0.215_861, 1.0, 7.0].map(srgb_from_linear), [0, 128, 255, 255]);
    }
}
