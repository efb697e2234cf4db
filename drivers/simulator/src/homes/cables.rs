//! Cables on the floor: thin tubes from a wall towards furniture or across the free floor.

use rand::RngExt;
use rand_pcg::Pcg64Mcg;

use super::furniture::Furniture;
use super::geometry::{Rect, Side};
use super::layout::Layout;
use super::material_set::{Appearance, MaterialSet};
use super::mesh::{Mesh, flat};
use super::openings::{side_of, span_of};
use super::texture::Skin;
use super::{RoomKind, Surface};

/// Cross-section of a cable that lies on the floor: metres to its right, and height. Mains cables
/// (H05VV-F, three cores of 1 to 1.5 mm2) are 7 to 9 mm thick.
const PROFILE_M: [[f32; 2]; 4] = [[-0.004, 0.0], [-0.002, 0.008], [0.002, 0.008], [0.004, 0.0]];
/// Length of the straight pieces of a curve, metres.
const PIECE_M: f32 = 0.05;
/// Cables stay as far from walls, metres: a skirting is 12 mm deep.
const WALL_GAP_M: f32 = 0.02;
/// Distance by which a curve bends aside at most, as a share of its length.
const BEND: f32 = 0.25;
/// Random courses that are tried for a cable.
const TRIES: usize = 12;
/// Colours of cables, sRGB: dark and white.
const COLORS: [[u8; 3]; 2] = [[28, 28, 30], [232, 232, 228]];

/// Lays none to two cables in every room except baths.
pub fn build(
    layout: &Layout,
    furniture: &[Furniture],
    materials: &mut MaterialSet,
    mesh: &mut Mesh,
    rng: &mut Pcg64Mcg,
) {
    for (room, kind) in layout.rooms.iter().map(|room| room.kind).enumerate() {
        // Five of six rooms have one or two.
        let count = rng.random_range(0..6_usize).div_ceil(3);
        if kind == RoomKind::Bath {
            continue;
        }
        for _ in 0..count {
            let color = COLORS[rng.random_range(0..COLORS.len())];
            let course = (0..TRIES).find_map(|_| course(room, layout, furniture, rng));
            let Some(course) = course else { continue };
            let mark = mesh.mark();
            tube(&course, materials.appearance("cable", color, Skin::Smudge), mesh);
            mesh.tag(mark, room, Surface::Cable);
        }
    }
}

/// Points of a curve on the floor, from a wall of a room to a piece of furniture, or to the free
/// floor where there is none and for one cable of three. `None` where it would start in a doorway or
/// cross stairs.
fn course(
    room: usize,
    layout: &Layout,
    furniture: &[Furniture],
    rng: &mut Pcg64Mcg,
) -> Option<Vec<[f32; 2]>> {
    let rect = layout.rooms[room].rect;
    let floor = rect.grown(-WALL_GAP_M);
    let side = Side::ALL[rng.random_range(0..4)];
    let wall = rect.wall(side);
    let station = wall.length_m * rng.random_range(0.05..0.95_f32);
    if is_doorway(room, side, station, layout) {
        return None;
    }
    let start = wall.at(station, WALL_GAP_M);
    let pieces: Vec<&Furniture> = furniture.iter().filter(|piece| piece.room == room).collect();
    let end = if pieces.is_empty() || rng.random_range(0..3) == 0 {
        [0, 1].map(|axis| rng.random_range(floor.min[axis]..floor.max[axis]))
    } else {
        pieces[rng.random_range(0..pieces.len())].rect.center()
    };
    let bends = [(); 2].map(|()| rng.random_range(-BEND..BEND));
    let course = curve([start, end], bends, &floor);
    let opening = layout.stairwell.filter(|stairs| stairs.room == room);
    let opening = opening.map(|stairs| stairs.opening(layout).grown(WALL_GAP_M));
    let is_whole = course.iter().all(|p| opening.is_none_or(|opening| !opening.contains(*p)));
    is_whole.then_some(course)
}

fn is_doorway(room: usize, side: Side, station: f32, layout: &Layout) -> bool {
    let rect = layout.rooms[room].rect;
    let wall = rect.wall(side);
    let doors = layout.doors.iter().filter(|door| door.rooms.contains(&room));
    doors.filter(|door| side_of(door, &rect) == side).any(|door| {
        let [from, to] = span_of(door, &wall);
        (from - 0.1..to + 0.1).contains(&station)
    })
}

/// A cubic Bezier curve in pieces of about [`PIECE_M`]. Its inner control points are a third and two
/// thirds of the distance, shifted aside by `bends` of its length, and stay on the floor; so does the
/// curve, because it lies within the hull of its control points.
fn curve([start, end]: [[f32; 2]; 2], bends: [f32; 2], floor: &Rect) -> Vec<[f32; 2]> {
    let way = [end[0] - start[0], end[1] - start[1]];
    let control = |share: f32, bend: f32| {
        let x = start[0] + share * way[0] - bend * way[1];
        let y = start[1] + share * way[1] + bend * way[0];
        [x.clamp(floor.min[0], floor.max[0]), y.clamp(floor.min[1], floor.max[1])]
    };
    let points = [start, control(1.0 / 3.0, bends[0]), control(2.0 / 3.0, bends[1]), end];
    let count = (way[0].hypot(way[1]) / PIECE_M).ceil().max(1.0) as usize;
    (0..=count)
        .map(|index| {
            let t = index as f32 / count as f32;
            let rest = 1.0 - t;
            let weights = [rest.powi(3), 3.0 * rest.powi(2) * t, 3.0 * rest * t.powi(2), t.powi(3)];
            [0, 1].map(|axis| weights.iter().zip(points).map(|(w, p)| w * p[axis]).sum())
        })
        .collect()
}

/// Adds the faces of a cable along its course. Its ends are open: they are at a wall or hidden by
/// furniture, or too small to see.
fn tube(course: &[[f32; 2]], appearance: Appearance, mesh: &mut Mesh) {
    let rings: Vec<[[f32; 3]; 4]> = (0..course.len()).map(|at| ring(course, at)).collect();
    for pair in rings.windows(2) {
        let [near, far] = [pair[0], pair[1]];
        for edge in 0..3 {
            let corners = [near[edge], near[edge + 1], far[edge + 1], far[edge]];
            mesh.quad(corners, flat(corners, appearance), appearance);
        }
    }
}

/// The cross-section at a point of a course, perpendicular to the line between its neighbours.
fn ring(course: &[[f32; 2]], at: usize) -> [[f32; 3]; 4] {
    let before = course[at.saturating_sub(1)];
    let after = course[(at + 1).min(course.len() - 1)];
    let way = [after[0] - before[0], after[1] - before[1]];
    let length = way[0].hypot(way[1]).max(f32::MIN_POSITIVE);
    let right = [way[1] / length, -way[0] / length];
    let [x, y] = course[at];
    PROFILE_M.map(|[aside, up]| [x + aside * right[0], y + aside * right[1], up])
}
