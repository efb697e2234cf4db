//! Materials of the walls, floors and joinery of one home.

use rand::RngExt;
use rand_pcg::Pcg64Mcg;

use super::geometry::Side;
use super::material_set::{Appearance, MaterialSet};
use super::texture::Skin;
use super::{HomeKind, Room, RoomKind};

/// Materials that all rooms of a home share, and those of each room.
#[derive(Debug, Clone)]
pub struct HomeStyle {
    pub rooms: Vec<RoomStyle>,
    pub ceiling: Appearance,
    pub skirting: Appearance,
    pub joinery: Appearance,
    pub leaf: Appearance,
    pub threshold: Appearance,
    pub outside: Appearance,
    pub metal: Appearance,
    pub plastic: Appearance,
}

#[derive(Debug, Clone)]
pub struct RoomStyle {
    pub wall: Appearance,
    /// A wall with a material of its own.
    pub accent: Option<(Side, Appearance)>,
    pub floor: Appearance,
}

impl RoomStyle {
    pub fn wall_at(&self, side: Side) -> Appearance {
        self.accent.filter(|(s, _)| *s == side).map_or(self.wall, |(_, appearance)| appearance)
    }
}

/// Off-whites and pale colours that paint shops sell most.
const PAINTS: [[u8; 3]; 9] = [
    [250, 247, 240],
    [244, 240, 230],
    [240, 242, 244],
    [236, 230, 218],
    [228, 232, 226],
    [222, 230, 236],
    [246, 238, 218],
    [232, 222, 212],
    [218, 216, 212],
];
/// Stronger colours for one wall.
const ACCENTS: [[u8; 3]; 6] = [
    [150, 168, 160],
    [168, 150, 140],
    [138, 156, 176],
    [190, 160, 128],
    [170, 170, 150],
    [176, 140, 132],
];

fn pick<T: Copy>(from: &[T], rng: &mut Pcg64Mcg) -> T {
    from[rng.random_range(0..from.len())]
}

/// Draws paints, floors and joinery.
pub fn styles(
    kind: HomeKind,
    rooms: &[Room],
    materials: &mut MaterialSet,
    rng: &mut Pcg64Mcg,
) -> HomeStyle {
    let white = pick(&[[250, 250, 248], [242, 238, 228]], rng);
    let wooden = pick(&[[196, 150, 104], [150, 104, 70], [250, 250, 248]], rng);
    let boards = Skin::Planks(rng.random_range(0..3));
    let main_floor = match kind {
        HomeKind::Office => materials.appearance(
            "office carpet",
            pick(&[[132, 138, 146], [120, 124, 120]], rng),
            Skin::Carpet,
        ),
        _ if rng.random_bool(0.25) => {
            materials.appearance("parquet", [255, 255, 255], Skin::Parquet)
        }
        _ => materials.appearance("floor boards", [255, 255, 255], boards),
    };
    let main_paint = pick(&PAINTS, rng);
    let rooms =
        rooms.iter().map(|r| room_style(kind, r, main_floor, main_paint, materials, rng)).collect();
    HomeStyle {
        rooms,
        ceiling: materials.appearance("ceiling", [252, 252, 250], Skin::Ceiling),
        skirting: materials.appearance("skirting", white, Skin::Smudge),
        joinery: materials.appearance("door frame", white, Skin::Smudge),
        leaf: materials.appearance("door leaf", wooden, Skin::Grain),
        threshold: materials.appearance("threshold", [150, 116, 84], Skin::Grain),
        outside: materials.appearance("facade", [214, 206, 192], Skin::Plaster(0)),
        metal: materials.appearance("brushed metal", [176, 178, 182], Skin::Smudge),
        plastic: materials.appearance("white plastic", [244, 244, 240], Skin::Smudge),
    }
}

fn room_style(
    home: HomeKind,
    room: &Room,
    main_floor: Appearance,
    main_paint: [u8; 3],
    materials: &mut MaterialSet,
    rng: &mut Pcg64Mcg,
) -> RoomStyle {
    let paint = if rng.random_bool(0.5) { main_paint } else { pick(&PAINTS, rng) };
    let plaster = Skin::Plaster(rng.random_range(0..3));
    let mut wall = materials.appearance("painted wall", paint, plaster);
    let mut floor = main_floor;
    let mut accent = None;
    match room.kind {
        RoomKind::Bath => {
            wall = materials.appearance(
                "wall tiles",
                pick(&[[250, 250, 250], [222, 234, 236], [238, 232, 220]], rng),
                Skin::Tiles(true),
            );
            floor = materials.appearance(
                "bath tiles",
                pick(&[[186, 190, 194], [206, 198, 186], [150, 160, 168]], rng),
                Skin::Tiles(false),
            );
        }
        RoomKind::Kitchen => {
            floor = materials.appearance(
                "kitchen tiles",
                pick(&[[214, 204, 190], [190, 188, 184], [226, 220, 210]], rng),
                Skin::Tiles(false),
            );
        }
        RoomKind::Bedroom if home != HomeKind::Office && rng.random_bool(0.35) => {
            floor = materials.appearance(
                "bedroom carpet",
                pick(&[[196, 184, 168], [170, 172, 178], [188, 176, 160]], rng),
                Skin::Carpet,
            );
        }
        _ => {}
    }
    let side = Side::ALL[rng.random_range(0..4)];
    if matches!(
        room.kind,
        RoomKind::Living | RoomKind::Bedroom | RoomKind::Study | RoomKind::Meeting
    ) && rng.random_bool(0.45)
    {
        let version = rng.random_range(0..2);
        let appearance = match rng.random_range(0..5) {
            0 if room.kind == RoomKind::Living => {
                materials.appearance("brick wall", [255, 255, 255], Skin::Brick)
            }
            1 | 2 => materials.appearance("wallpaper", paint, Skin::Wallpaper(version)),
            _ => materials.appearance("accent wall", pick(&ACCENTS, rng), plaster),
        };
        accent = Some((side, appearance));
    }
    RoomStyle { wall, accent, floor }
}
