//! Homes that never existed: rooms, doors, furniture and light from one seed, with nothing to download.

mod ambient;
mod fixtures;
mod furniture;
mod geometry;
mod joinery;
mod layout;
mod looks;
mod mesh;
mod openings;
mod plan;
mod shell;
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

/// What kind of place to build.
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
    /// All kinds.
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

/// A name that is no kind of home.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("no built-in home is called {0:?}; there are apartment, house and office")]
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

/// What a home is drawn from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HomeOptions {
    /// The same seed builds the same home, byte for byte.
    pub seed: u64,
    /// Contrast of walls, ceilings and (partly) floors: 0 blank, 1 rich.
    pub texture: f32,
    /// Furniture stands elsewhere; walls, doors, pictures and all textures stay.
    pub moved: bool,
}

impl HomeOptions {
    /// Between blank walls, on which nothing can be matched, and rich ones, on which plain triangulation needs no learning.
    pub const TEXTURE: f32 = 0.25;

    /// Calibrated texture, furniture in its first place.
    pub fn new(seed: u64) -> Self {
        Self { seed, texture: Self::TEXTURE, moved: false }
    }
}

/// What a room is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RoomKind {
    /// Sofas, television, dining table.
    Living,
    /// Counters, cupboards, fridge.
    Kitchen,
    /// Bed and wardrobe.
    Bedroom,
    /// Bath tub or shower, toilet, basin.
    Bath,
    /// Desk and shelves; in an office, a room for one or two.
    Study,
    /// Joins other rooms.
    Corridor,
    /// Islands of desks.
    OpenPlan,
    /// One large table.
    Meeting,
}

impl RoomKind {
    /// Rooms that passages without a door leaf join.
    fn is_day(self) -> bool {
        matches!(self, Self::Living | Self::Kitchen | Self::OpenPlan)
    }

    /// Rooms with curtains and pictures.
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
    /// What it is for.
    pub kind: RoomKind,
    /// Its floor, metres.
    pub rect: Rect,
    /// Height of its ceiling, metres.
    pub height_m: f32,
}

/// What a triangle belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Surface {
    /// A room's floor.
    Floor,
    /// A room's ceiling.
    Ceiling,
    /// A wall's face towards a room.
    Wall,
    /// Doors, windows, skirting.
    Opening,
    /// Pictures, switches, radiators, lamps: what stays when furniture moves.
    Fixture,
    /// What moves.
    Furniture,
    /// The outer faces of outer walls.
    Outside,
}

/// A scene and what it means.
#[derive(Debug, Clone, PartialEq)]
pub struct Home {
    /// What the camera sees.
    pub scene: Scene,
    /// What each of the scene's triangles belongs to; furniture comes last.
    pub surfaces: Vec<Surface>,
    /// All rooms.
    pub rooms: Vec<Room>,
    /// All openings between rooms.
    pub doors: Vec<Door>,
    /// What stands where.
    pub furniture: Vec<Furniture>,
}

/// A generator for one purpose, so that drawing more for one thing changes no other.
fn stream(seed: u64, purpose: u64) -> Pcg64Mcg {
    Pcg64Mcg::seed_from_u64(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ purpose)
}

/// Builds a home: the same bytes for the same kind and options.
pub fn build(kind: HomeKind, options: &HomeOptions) -> Home {
    let home = construct(kind, options);
    let lit = ambient::bake(&home.mesh, &home.layout.rooms);
    let (triangles, surfaces) = ambient::triangles(&home.mesh, &lit);
    let (materials, textures) = home.looks.finish(options.seed, options.texture);
    let scene = Scene { triangles, materials, textures };
    Home {
        scene,
        surfaces,
        rooms: home.layout.rooms,
        doors: home.layout.doors,
        furniture: home.furniture,
    }
}

/// A home before it is lit and painted.
struct Construction {
    layout: layout::Layout,
    mesh: mesh::Mesh,
    looks: looks::Looks,
    furniture: Vec<Furniture>,
}

fn construct(kind: HomeKind, options: &HomeOptions) -> Construction {
    let seed = options.seed;
    let height_m = stream(seed, 1).random_range(50..=54) as f32 * 0.05;
    let layout = layout::Layout::draw(kind, height_m, &mut stream(seed, 2));
    let mut looks = looks::Looks::default();
    let style = styles::styles(kind, &layout.rooms, &mut looks, &mut stream(seed, 3));
    let mut mesh = mesh::Mesh::default();
    shell::build(&layout, &style, &mut mesh);
    joinery::build(&layout, &style, &mut looks, &mut mesh, &mut stream(seed, 4));
    let reserved =
        fixtures::build(kind, &layout, &style, &mut looks, &mut mesh, &mut stream(seed, 5));
    let furniture =
        furniture::furnish(kind, &layout, &reserved, &mut looks, &mut mesh, seed, options.moved);
    Construction { layout, mesh, looks, furniture }
}
