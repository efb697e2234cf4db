//! How the rooms of one home are painted and floored.

use rand::RngExt;
use rand_pcg::Pcg64Mcg;

use super::geometry::Side;
use super::looks::{Look, Looks};
use super::texture::Skin;
use super::{HomeKind, Room, RoomKind};

/// What all rooms of a home share.
#[derive(Debug, Clone)]
pub struct HomeStyle {
    pub rooms: Vec<RoomStyle>,
    pub ceiling: Look,
    pub skirting: Look,
    pub joinery: Look,
    pub leaf: Look,
    pub threshold: Look,
    pub outside: Look,
    pub metal: Look,
    pub plastic: Look,
}

/// One room's surfaces.
#[derive(Debug, Clone)]
pub struct RoomStyle {
    pub wall: Look,
    /// A wall unlike the others.
    pub accent: Option<(Side, Look)>,
    pub floor: Look,
}

impl RoomStyle {
    pub fn wall_at(&self, side: Side) -> Look {
        self.accent.filter(|(s, _)| *s == side).map_or(self.wall, |(_, look)| look)
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
pub fn styles(kind: HomeKind, rooms: &[Room], looks: &mut Looks, rng: &mut Pcg64Mcg) -> HomeStyle {
    let white = pick(&[[250, 250, 248], [242, 238, 228]], rng);
    let wooden = pick(&[[196, 150, 104], [150, 104, 70], [250, 250, 248]], rng);
    let boards = Skin::Planks(rng.random_range(0..3));
    let main_floor = match kind {
        HomeKind::Office => looks.look(
            "office carpet",
            pick(&[[132, 138, 146], [120, 124, 120]], rng),
            Skin::Carpet,
        ),
        _ if rng.random_bool(0.25) => looks.look("parquet", [255, 255, 255], Skin::Parquet),
        _ => looks.look("floor boards", [255, 255, 255], boards),
    };
    let main_paint = pick(&PAINTS, rng);
    let rooms =
        rooms.iter().map(|r| room_style(kind, r, main_floor, main_paint, looks, rng)).collect();
    HomeStyle {
        rooms,
        ceiling: looks.look("ceiling", [252, 252, 250], Skin::Ceiling),
        skirting: looks.look("skirting", white, Skin::Smudge),
        joinery: looks.look("door frame", white, Skin::Smudge),
        leaf: looks.look("door leaf", wooden, Skin::Grain),
        threshold: looks.look("threshold", [150, 116, 84], Skin::Grain),
        outside: looks.look("facade", [214, 206, 192], Skin::Plaster(0)),
        metal: looks.look("brushed metal", [176, 178, 182], Skin::Smudge),
        plastic: looks.look("white plastic", [244, 244, 240], Skin::Smudge),
    }
}

fn room_style(
    home: HomeKind,
    room: &Room,
    main_floor: Look,
    main_paint: [u8; 3],
    looks: &mut Looks,
    rng: &mut Pcg64Mcg,
) -> RoomStyle {
    let paint = if rng.random_bool(0.5) { main_paint } else { pick(&PAINTS, rng) };
    let plaster = Skin::Plaster(rng.random_range(0..3));
    let mut wall = looks.look("painted wall", paint, plaster);
    let mut floor = main_floor;
    let mut accent = None;
    match room.kind {
        RoomKind::Bath => {
            wall = looks.look(
                "wall tiles",
                pick(&[[250, 250, 250], [222, 234, 236], [238, 232, 220]], rng),
                Skin::Tiles(true),
            );
            floor = looks.look(
                "bath tiles",
                pick(&[[186, 190, 194], [206, 198, 186], [150, 160, 168]], rng),
                Skin::Tiles(false),
            );
        }
        RoomKind::Kitchen => {
            floor = looks.look(
                "kitchen tiles",
                pick(&[[214, 204, 190], [190, 188, 184], [226, 220, 210]], rng),
                Skin::Tiles(false),
            );
        }
        RoomKind::Bedroom if home != HomeKind::Office && rng.random_bool(0.35) => {
            floor = looks.look(
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
        let look = match rng.random_range(0..5) {
            0 if room.kind == RoomKind::Living => {
                looks.look("brick wall", [255, 255, 255], Skin::Brick)
            }
            1 | 2 => looks.look("wallpaper", paint, Skin::Wallpaper(version)),
            _ => looks.look("accent wall", pick(&ACCENTS, rng), plaster),
        };
        accent = Some((side, look));
    }
    RoomStyle { wall, accent, floor }
}
