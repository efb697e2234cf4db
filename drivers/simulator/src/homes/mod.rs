//! Procedural homes: rooms, doors, furniture and light generated from one seed, without any data
//! files.

mod ambient;
mod cables;
mod fixtures;
mod furniture;
mod geometry;
mod joinery;
mod layout;
mod material_set;
mod mesh;
mod openings;
mod plan;
mod shell;
mod stairs;
mod styles;
mod texture;

#[cfg(test)]
mod tests;

use std::fmt;
use std::str::FromStr;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

pub use furniture::Furniture;
pub use geometry::Rect;
pub use openings::Door;

use crate::scene::Scene;

/// Kind of a built-in home.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HomeKind {
    /// 4 to 6 rooms, 40 to 90 m2.
    Apartment,
    /// 6 to 9 rooms along a corridor, 90 to 180 m2.
    House,
    /// Rooms along a corridor and an open-plan hall, 150 to 300 m2.
    Office,
}

impl HomeKind {
    pub const ALL: [Self; 3] = [Self::Apartment, Self::House, Self::Office];
}

impl fmt::Display for HomeKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Apartment => "apartment",
            Self::House => "house",
            Self::Office => "office",
        })
    }
}

/// The name is not that of a built-in home.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("no built-in home is called {0:?}; the homes are apartment, house and office")]
pub struct UnknownHome(pub String);

impl FromStr for HomeKind {
    type Err = UnknownHome;

    fn from_str(name: &str) -> Result<Self, UnknownHome> {
        Self::ALL
            .into_iter()
            .find(|k| k.to_string() == name)
            .ok_or_else(|| UnknownHome(name.to_owned()))
    }
}

/// Options of a built-in home.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HomeOptions {
    /// The same seed builds the same home, byte for byte.
    pub seed: u64,
    /// Contrast of walls, ceilings and (partly) floors: 0 blank, 1 rich.
    pub texture: f32,
    /// Furniture stands at other positions; walls, doors, fixtures and all textures are unchanged.
    pub moved: bool,
    /// One room has stairs down, without a railing.
    pub stairs: bool,
    /// Cables lie on the floor of most rooms; all else is unchanged.
    pub cables: bool,
}

impl HomeOptions {
    /// Calibrated texture contrast. On blank walls nothing can be matched; on strongly textured
    /// ones plain triangulation needs no learning.
    pub const TEXTURE: f32 = 0.25;

    /// Options with the calibrated texture contrast, unmoved furniture, no stairs and no cables.
    pub fn new(seed: u64) -> Self {
        Self { seed, texture: Self::TEXTURE, moved: false, stairs: false, cables: false }
    }
}

/// Purpose of a room.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RoomKind {
    /// Sofas, television, dining table.
    Living,
    /// A room with counters, cupboards and a fridge.
    Kitchen,
    /// A room with a bed and a wardrobe.
    Bedroom,
    /// Bath tub or shower, toilet, basin.
    Bath,
    /// Desk and shelves; in an office, a room for one or two.
    Study,
    /// A room that connects other rooms.
    Corridor,
    /// An office hall with islands of desks.
    OpenPlan,
    /// A room with one large table.
    Meeting,
}

impl RoomKind {
    /// Whether passages without a door leaf join rooms of this kind.
    fn is_day(self) -> bool {
        matches!(self, Self::Living | Self::Kitchen | Self::OpenPlan)
    }

    /// Whether rooms of this kind have curtains.
    fn is_home(self) -> bool {
        matches!(self, Self::Living | Self::Bedroom | Self::Study | Self::Kitchen)
    }
}

impl fmt::Display for RoomKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Living => "living",
            Self::Kitchen => "kitchen",
            Self::Bedroom => "bedroom",
            Self::Bath => "bath",
            Self::Study => "study",
            Self::Corridor => "corridor",
            Self::OpenPlan => "open-plan",
            Self::Meeting => "meeting",
        })
    }
}

/// A room within its walls.
#[derive(Debug, Clone, PartialEq)]
pub struct Room {
    /// Purpose and number, as in `bedroom-2`.
    pub name: String,
    pub kind: RoomKind,
    pub rect: Rect,
    /// Height of its ceiling, metres.
    pub height_m: f32,
}

/// Kind of surface of a triangle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Surface {
    Floor,
    Ceiling,
    /// A wall's face towards a room.
    Wall,
    /// Door leaves and frames, windows, skirtings and stairs.
    Opening,
    /// Pictures, switches, radiators and lamps, which stay when furniture moves.
    Fixture,
    /// Furniture, which `moved` places elsewhere.
    Furniture,
    /// The outer faces of outer walls.
    Outside,
    /// Cables on the floor.
    Cable,
}

/// A scene with its semantics.
#[derive(Debug, Clone, PartialEq)]
pub struct Home {
    pub scene: Scene,
    /// Kind of surface of each triangle of the scene. Furniture comes last, and then
    /// cables.
    pub surfaces: Vec<Surface>,
    pub rooms: Vec<Room>,
    pub doors: Vec<Door>,
    pub furniture: Vec<Furniture>,
}

/// The random generator of one purpose. Separate generators keep a change of one part from changing
/// the others.
fn stream(seed: u64, purpose: u64) -> Pcg64Mcg {
    Pcg64Mcg::seed_from_u64(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ purpose)
}

/// Builds a home. The result is identical for the same kind and options.
pub fn build(kind: HomeKind, options: &HomeOptions) -> Home {
    let home = construct(kind, options);
    let lit = ambient::bake(&home.mesh, &home.layout.rooms);
    let (triangles, surfaces) = ambient::triangles(&home.mesh, &lit);
    let (materials, textures) = home.materials.finish(options.seed, options.texture);
    let scene = Scene { triangles, materials, textures };
    Home {
        scene,
        surfaces,
        rooms: home.layout.rooms,
        doors: home.layout.doors,
        furniture: home.furniture,
    }
}

/// A home before ambient light is baked and textures are painted.
struct Construction {
    layout: layout::Layout,
    mesh: mesh::Mesh,
    materials: material_set::MaterialSet,
    furniture: Vec<Furniture>,
}

fn construct(kind: HomeKind, options: &HomeOptions) -> Construction {
    let seed = options.seed;
    let height_m = stream(seed, 1).random_range(50..=54) as f32 * 0.05;
    let mut layout = layout::Layout::draw(kind, height_m, &mut stream(seed, 2));
    if options.stairs {
        layout.stairwell = stairs::Stairwell::place(&layout, &mut stream(seed, 10));
    }
    let mut materials = material_set::MaterialSet::default();
    let style = styles::styles(kind, &layout.rooms, &mut materials, &mut stream(seed, 3));
    let mut mesh = mesh::Mesh::default();
    shell::build(&layout, &style, &mut mesh);
    joinery::build(&layout, &style, &mut materials, &mut mesh, &mut stream(seed, 4));
    let mut reserved =
        fixtures::build(kind, &layout, &style, &mut materials, &mut mesh, &mut stream(seed, 5));
    if let Some(stairwell) = layout.stairwell {
        stairwell.build(&layout, &style, &mut mesh);
        reserved.push(stairwell.reserved());
    }
    let furniture = furniture::furnish(
        kind,
        &layout,
        &reserved,
        &mut materials,
        &mut mesh,
        seed,
        options.moved,
    );
    if options.cables {
        cables::build(&layout, &furniture, &mut materials, &mut mesh, &mut stream(seed, 11));
    }
    Construction { layout, mesh, materials, furniture }
}
