//! Fixtures on walls and ceilings, which stay when furniture moves.

use rand::RngExt;
use rand_pcg::Pcg64Mcg;

use super::furniture::DOORWAY_M;
use super::geometry::{Side, WallFrame};
use super::joinery::CURTAIN_M;
use super::layout::Layout;
use super::material_set::{Appearance, MaterialSet};
use super::mesh::Mesh;
use super::openings::{CASING_M, side_of, span_of};
use super::shell::holes;
use super::styles::HomeStyle;
use super::texture::Skin;
use super::{HomeKind, Room, RoomKind, Surface};

/// A part of a wall that furniture must respect: nothing at all within `depth_m`, or nothing tall
/// where that is 0.
#[derive(Debug, Clone, PartialEq)]
pub struct Reserved {
    pub room: usize,
    pub side: Side,
    pub span: [f32; 2],
    pub depth_m: f32,
}

/// The walls of one room while fixtures are placed on them.
struct Hanging<'a> {
    layout: &'a Layout,
    room: usize,
    reserved: Vec<Reserved>,
}

impl Hanging<'_> {
    fn wall(&self, side: Side) -> WallFrame {
        self.layout.rooms[self.room].rect.wall(side)
    }

    /// Whether a part of a wall has no opening, open leaf, curtain or other fixture.
    fn is_free(&self, side: Side, span: [f32; 2]) -> bool {
        let openings = holes(self.layout, self.room, side);
        let leaves = self.layout.leaves.iter().filter(|l| l.room == self.room && l.side == side);
        let fixtures = self.reserved.iter().filter(|r| r.room == self.room && r.side == side);
        span[0] > 0.1
            && span[1] < self.wall(side).length_m - 0.1
            && !openings.iter().any(|h| {
                spans_meet(h.span, if h.height[0] > 0.0 { CURTAIN_M + 0.1 } else { 0.16 }, span)
            })
            && !leaves.into_iter().any(|l| spans_meet(l.span, 0.05, span))
            && !fixtures.into_iter().any(|r| spans_meet(r.span, 0.15, span))
    }

    /// A free part of a wall of a given width, if a few random draws find one.
    fn find(&self, width: f32, rng: &mut Pcg64Mcg) -> Option<(Side, [f32; 2])> {
        (0..12).find_map(|_| {
            let side = Side::ALL[rng.random_range(0..4)];
            let slack = self.wall(side).length_m - width;
            let s = slack * rng.random_range(0.1..0.9_f32);
            (slack > 0.2 && self.is_free(side, [s, s + width])).then_some((side, [s, s + width]))
        })
    }

    fn reserve(&mut self, side: Side, span: [f32; 2], depth_m: f32) {
        self.reserved.push(Reserved { room: self.room, side, span, depth_m });
    }
}

fn spans_meet(other: [f32; 2], margin: f32, span: [f32; 2]) -> bool {
    span[0] < other[1] + margin && other[0] - margin < span[1]
}

/// Places all fixtures and returns the parts of the walls that they occupy.
pub fn build(
    kind: HomeKind,
    layout: &Layout,
    style: &HomeStyle,
    materials: &mut MaterialSet,
    mesh: &mut Mesh,
    rng: &mut Pcg64Mcg,
) -> Vec<Reserved> {
    let mut reserved = Vec::new();
    let mut entered = false;
    for (index, room) in layout.rooms.iter().enumerate() {
        let mut hanging = Hanging { layout, room: index, reserved: Vec::new() };
        let mark = mesh.mark();
        if !entered
            && matches!(room.kind, RoomKind::Corridor | RoomKind::OpenPlan | RoomKind::Living)
        {
            entered = entrance(&mut hanging, style, mesh);
        }
        radiators(&mut hanging, style, mesh, rng);
        switches(&hanging, style, mesh);
        boards(kind, &mut hanging, style, materials, mesh, rng);
        pictures(&mut hanging, materials, mesh, rng);
        lights(kind, room, style, materials, mesh);
        mesh.tag(mark, index, Surface::Fixture);
        reserved.append(&mut hanging.reserved);
    }
    reserved
}

/// Adds a part that was built along the south wall from x = 0 at a position along another wall.
fn hang(part: &Mesh, wall: &WallFrame, side: Side, station: f32, mesh: &mut Mesh) {
    let [x, y] = wall.at(station, 0.0);
    mesh.append_at_wall(part, [x, y, 0.0], side);
}

/// The closed front door, in an outer wall.
fn entrance(hanging: &mut Hanging<'_>, style: &HomeStyle, mesh: &mut Mesh) -> bool {
    for side in Side::ALL {
        let wall = hanging.wall(side);
        let spans = super::openings::outer_spans(&hanging.layout.cells, hanging.room, side, &wall);
        for span in spans {
            let mut s = span[0] + 0.12;
            while s + 1.14 < span[1] {
                if hanging.is_free(side, [s, s + 1.12]) {
                    let mut part = Mesh::default();
                    part.trim([0.0, 0.0, 0.0], [0.06, 0.02, 2.13], style.joinery);
                    part.trim([1.06, 0.0, 0.0], [1.12, 0.02, 2.13], style.joinery);
                    part.trim([0.06, 0.0, 2.07], [1.06, 0.02, 2.13], style.joinery);
                    part.trim([0.06, 0.0, 0.0], [1.06, 0.03, 2.07], style.leaf);
                    for (low, high) in [(0.2, 0.9), (1.15, 1.9)] {
                        part.trim([0.2, 0.03, low], [0.92, 0.036, high], style.leaf);
                    }
                    part.trim([0.97, 0.03, 1.0], [1.0, 0.07, 1.06], style.metal);
                    part.trim([0.85, 0.055, 1.02], [1.0, 0.07, 1.04], style.metal);
                    hang(&part, &wall, side, s, mesh);
                    hanging.reserve(side, [s, s + 1.12], DOORWAY_M);
                    return true;
                }
                s += 0.1;
            }
        }
    }
    false
}

/// A ribbed radiator under about every second window.
fn radiators(hanging: &mut Hanging<'_>, style: &HomeStyle, mesh: &mut Mesh, rng: &mut Pcg64Mcg) {
    let layout = hanging.layout;
    let room = hanging.room;
    for window in
        layout.windows.iter().filter(|w| w.room == room && (0.3..1.0).contains(&w.height[0]))
    {
        let width = (window.span[1] - window.span[0] - 0.1).min(1.2);
        if !rng.random_bool(0.45) {
            continue;
        }
        let mut part = Mesh::default();
        part.block([0.0, 0.035, 0.15], [width, 0.085, 0.72], style.plastic);
        let ribs = (width / 0.07) as usize;
        for i in 0..ribs {
            let x = width * (i as f32 + 0.25) / ribs as f32;
            part.trim([x, 0.085, 0.17], [x + 0.035, 0.1, 0.7], style.plastic);
        }
        for x in [0.05, width - 0.07] {
            part.trim([x, 0.05, 0.0], [x + 0.02, 0.07, 0.15], style.plastic);
        }
        let s = (window.span[0] + window.span[1] - width) / 2.0;
        hang(&part, &hanging.wall(window.side), window.side, s, mesh);
        hanging.reserve(window.side, [s, s + width], 0.11);
    }
}

/// A switch beside each door and a socket below it.
fn switches(hanging: &Hanging<'_>, style: &HomeStyle, mesh: &mut Mesh) {
    let rect = hanging.layout.rooms[hanging.room].rect;
    for door in hanging.layout.doors.iter().filter(|d| d.rooms.contains(&hanging.room)) {
        let side = side_of(door, &rect);
        let wall = rect.wall(side);
        let span = span_of(door, &wall);
        for s in [span[1] + CASING_M + 0.08, span[0] - CASING_M - 0.16] {
            let leaves =
                hanging.layout.leaves.iter().filter(|l| l.room == hanging.room && l.side == side);
            let hidden = leaves.into_iter().any(|l| l.span[0] < s + 0.1 && s - 0.1 < l.span[1]);
            if s > 0.02 && s + 0.1 < wall.length_m && !hidden {
                let mut part = Mesh::default();
                part.plate([0.0, 0.08], [1.04, 1.12], [0.0, 0.01], style.plastic);
                part.plate([0.02, 0.06], [1.055, 1.105], [0.01, 0.016], style.plastic);
                part.plate([0.0, 0.08], [0.26, 0.34], [0.0, 0.01], style.plastic);
                hang(&part, &wall, side, s, mesh);
                break;
            }
        }
    }
}

/// Whiteboards and notice boards of offices.
fn boards(
    kind: HomeKind,
    hanging: &mut Hanging<'_>,
    style: &HomeStyle,
    materials: &mut MaterialSet,
    mesh: &mut Mesh,
    rng: &mut Pcg64Mcg,
) {
    let room = &hanging.layout.rooms[hanging.room];
    let count = match (kind, room.kind) {
        (HomeKind::Office, RoomKind::Meeting | RoomKind::OpenPlan) => 2,
        (HomeKind::Office, RoomKind::Study) => 1,
        _ => 0,
    };
    for i in 0..count {
        let width = rng.random_range(1.2..1.9);
        let Some((side, span)) = hanging.find(width, rng) else { continue };
        let face = if i == 0 {
            materials.appearance("whiteboard", [250, 250, 252], Skin::Plaster(2))
        } else {
            materials.appearance("pin board", [186, 150, 110], Skin::Carpet)
        };
        let mut part = Mesh::default();
        part.plate([0.0, width], [0.95, 2.0], [0.0, 0.02], style.metal);
        part.plate([0.025, width - 0.025], [0.975, 1.975], [0.021, 0.023], face);
        for note in 0..rng.random_range(4..9) {
            let x = rng.random_range(0.06..width - 0.28);
            let z = rng.random_range(1.05..1.7);
            let appearance = materials.appearance(
                "note",
                [[244, 232, 150], [240, 240, 236], [190, 214, 226]][note % 3],
                Skin::Spines,
            );
            let w = rng.random_range(0.08..0.21);
            let h = rng.random_range(0.08..0.2);
            let y = 0.025 + 0.002 * note as f32;
            part.plate([x, x + w], [z, z + h], [y, y + 0.001], appearance);
        }
        hang(&part, &hanging.wall(side), side, span[0], mesh);
        hanging.reserve(side, span, 0.0);
    }
}

/// Framed paintings at eye height.
fn pictures(
    hanging: &mut Hanging<'_>,
    materials: &mut MaterialSet,
    mesh: &mut Mesh,
    rng: &mut Pcg64Mcg,
) {
    let room = &hanging.layout.rooms[hanging.room];
    let longest = room.rect.size()[0].max(room.rect.size()[1]);
    let count = match room.kind {
        RoomKind::Bath => 0,
        RoomKind::Kitchen => 1,
        RoomKind::Corridor => (longest / 2.0) as usize,
        _ => 1 + (longest / 2.2) as usize,
    };
    for _ in 0..count {
        let width = rng.random_range(0.35..1.0_f32);
        let Some((side, span)) = hanging.find(width, rng) else { continue };
        let height = (width * rng.random_range(0.65..1.3)).min(0.9);
        let middle = rng.random_range(1.45..1.6);
        let painting = materials.appearance(
            "painting",
            [255, 255, 255],
            Skin::Painting(rng.random_range(0..12)),
        );
        let frames = [[60, 50, 44], [196, 160, 110], [238, 236, 230], [140, 100, 66]];
        let frame = materials.appearance(
            "picture frame",
            frames[rng.random_range(0..frames.len())],
            Skin::Grain,
        );
        hang(
            &framed(width, [middle - height / 2.0, middle + height / 2.0], painting, frame),
            &hanging.wall(side),
            side,
            span[0],
            mesh,
        );
        hanging.reserve(side, span, 0.0);
    }
}

fn framed(width: f32, [z0, z1]: [f32; 2], painting: Appearance, frame: Appearance) -> Mesh {
    const BORDER: f32 = 0.04;
    let mut part = Mesh::default();
    part.plate([0.0, width], [z0, z1], [0.003, 0.02], frame);
    let x0 = BORDER;
    let x1 = width - BORDER;
    let y = 0.023;
    let z0 = z0 + BORDER;
    let z1 = z1 - BORDER;
    part.stretched_face([[x1, y, z0], [x0, y, z0], [x0, y, z1], [x1, y, z1]], painting);
    part
}

/// A pendant lamp in homes, panels in offices.
fn lights(
    kind: HomeKind,
    room: &Room,
    style: &HomeStyle,
    materials: &mut MaterialSet,
    mesh: &mut Mesh,
) {
    let [x, y] = room.rect.center();
    let h = room.height_m;
    if kind == HomeKind::Office {
        let panel = materials.glowing("light panel", [250, 250, 248], Skin::Smudge, 0.5);
        let [w, d] = room.rect.size();
        let nx = (w / 2.6).round().max(1.0) as usize;
        let ny = (d / 2.6).round().max(1.0) as usize;
        for i in 0..nx * ny {
            let px = room.rect.min[0] + w * ((i % nx) as f32 + 0.5) / nx as f32;
            let py = room.rect.min[1] + d * ((i / nx) as f32 + 0.5) / ny as f32;
            mesh.trim(
                [px - 0.3, py - 0.3, h - 0.04],
                [px + 0.3, py + 0.3, h - 0.002],
                style.plastic,
            );
            mesh.trim([px - 0.27, py - 0.27, h - 0.044], [px + 0.27, py + 0.27, h - 0.04], panel);
        }
        return;
    }
    let shade = materials.glowing("lamp shade", [255, 240, 214], Skin::Cloth(0), 0.35);
    if matches!(room.kind, RoomKind::Bath | RoomKind::Corridor) {
        mesh.post([x, y], [h - 0.09, h - 0.002], [0.15, 0.17], 14, shade);
    } else {
        mesh.post([x, y], [h - 0.03, h - 0.002], [0.05, 0.05], 8, style.plastic);
        mesh.post([x, y], [h - 0.45, h - 0.03], [0.006, 0.006], 4, style.plastic);
        mesh.post([x, y], [h - 0.66, h - 0.42], [0.22, 0.1], 14, shade);
    }
}
