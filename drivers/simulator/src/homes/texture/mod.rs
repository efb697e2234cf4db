//! Procedural RGBA8 textures for every surface. They wrap.
//!
//! Contrast determines how difficult a home is for depth from motion: strongly textured walls are
//! solved by plain triangulation, blank ones by no method. Contrast values here are standard
//! deviations in sRGB-coded steps of 255 at `texture = 1`.
//!
//! Contrast measured by the example `home` on rendered 640x192 views of 90 degrees, as the
//! deviation of 16x16 pixel blocks from their best plane, at the calibrated strength, medians of
//! eleven homes: walls (including tiles and wallpaper) 2.4 to 4.9 at 1.6 to 2.4 m, mostly about 3,
//! and 2.8 to 3.5 at 4 to 8 m; floors 5 to 9 at 2.4 to 4 m; furniture 3 to 10 at 1.6 to 2.4 m. A
//! camera's own noise is about 1.5.

mod art;
mod floors;
mod flower;
mod goods;
pub mod noise;
mod walls;

use crate::scene::Texture;

/// Texture of a surface. The number in a variant selects its version.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Skin {
    /// Painted plaster; colourless.
    Plaster(u8),
    /// A sprayed or rolled ceiling; colourless.
    Ceiling,
    /// Paper with scattered motifs; colourless.
    Wallpaper(u8),
    /// Brick and mortar.
    Brick,
    /// Boards of wood.
    Planks(u8),
    /// Blocks of short strips in alternating directions.
    Parquet,
    /// Square tiles with grout; `true`: small ones for walls. Colourless.
    Tiles(bool),
    /// The pile of a carpet. Colourless.
    Carpet,
    /// Sawn wood; nearly colourless.
    Grain,
    /// Woven cloth; colourless.
    Cloth(u8),
    /// Lacquer, metal or plastic in use: smudges and fine specks; colourless.
    Smudge,
    /// Polished stone; colourless.
    Stone,
    /// Book backs, with titles and bands; colourless.
    Spines,
    /// Leaves of a plant.
    Leaf,
    /// A painting that hangs on a wall.
    Painting(u8),
    /// The view through a window.
    View(u8),
    /// A rug with a border.
    Rug(u8),
    /// The content of a computer's screen.
    Screen(u8),
}

impl Skin {
    /// Side of the square that the texture covers, metres; `None` where it is stretched over a
    /// whole face.
    pub fn tile_m(self) -> Option<f32> {
        match self {
            Self::Painting(_) | Self::View(_) | Self::Rug(_) | Self::Screen(_) => None,
            Self::Plaster(_) | Self::Ceiling => Some(2.6),
            Self::Wallpaper(_) => Some(2.1),
            Self::Brick | Self::Planks(_) | Self::Parquet | Self::Carpet => Some(2.4),
            Self::Tiles(small) => Some(if small { 1.5 } else { 2.4 }),
            Self::Grain | Self::Stone => Some(1.6),
            Self::Cloth(_) => Some(0.8),
            Self::Smudge => Some(1.2),
            Self::Spines => Some(0.6),
            Self::Leaf => Some(0.4),
        }
    }

    /// Whether the texture only modulates the material's colour, which is then the average colour
    /// of the finished surface.
    pub fn tints(self) -> bool {
        !matches!(
            self,
            Self::Brick
                | Self::Planks(_)
                | Self::Parquet
                | Self::Leaf
                | Self::Painting(_)
                | Self::View(_)
                | Self::Rug(_)
                | Self::Screen(_)
        )
    }

    /// Paints the texture. `texture` scales the contrast of walls and ceilings fully and that of
    /// floors partly.
    pub fn paint(self, seed: u64, texture: f32) -> Texture {
        match self {
            Self::Plaster(version) => walls::plaster(seed ^ u64::from(version), texture),
            Self::Ceiling => walls::ceiling(seed, texture),
            Self::Wallpaper(version) => walls::wallpaper(seed ^ u64::from(version) << 8, texture),
            Self::Brick => walls::brick(seed, texture),
            Self::Planks(version) => floors::planks(version, seed, texture),
            Self::Parquet => floors::parquet(seed, texture),
            Self::Tiles(small) => floors::tiles(small, seed, texture),
            Self::Carpet => floors::carpet(seed, texture),
            Self::Grain => goods::grain(seed),
            Self::Cloth(version) => goods::cloth(version, seed),
            Self::Smudge => goods::smudge(seed),
            Self::Stone => goods::stone(seed),
            Self::Spines => goods::spines(seed),
            Self::Leaf => goods::leaf(seed),
            Self::Painting(version) => art::painting(version, seed),
            Self::View(version) => art::view(version, seed),
            Self::Rug(version) => art::rug(version, seed),
            Self::Screen(version) => art::screen(version, seed),
        }
    }
}

/// A square texture from a colour per texel, in steps of 255.
fn square(size: usize, mut color: impl FnMut(usize, usize) -> [f32; 3]) -> Texture {
    let mut texels = Vec::with_capacity(size * size);
    for y in 0..size {
        for x in 0..size {
            let [r, g, b] = color(x, y);
            texels.push([byte(r), byte(g), byte(b), 255]);
        }
    }
    Texture { width: size as u32, height: size as u32, rgba: texels.into_flattened() }
}

/// A colourless texture from a brightness per texel.
fn gray(size: usize, mut value: impl FnMut(usize, usize) -> f32) -> Texture {
    square(size, |x, y| [value(x, y); 3])
}

#[inline]
fn byte(value: f32) -> u8 {
    (value + 0.5).clamp(0.0, 255.0) as u8
}

// Arrays that are written out, here and for every texel: the compiler does not always inline
// `array::map`.

#[inline]
fn mix(a: [f32; 3], b: [f32; 3], t: f32) -> [f32; 3] {
    [a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t, a[2] + (b[2] - a[2]) * t]
}

#[inline]
fn scaled(color: [f32; 3], factor: f32) -> [f32; 3] {
    [color[0] * factor, color[1] * factor, color[2] * factor]
}

#[inline]
fn lighter(color: [f32; 3], by: f32) -> [f32; 3] {
    [color[0] + by, color[1] + by, color[2] + by]
}
