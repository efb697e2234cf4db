//! Placement of doors and windows. A spanning tree over neighbouring rooms makes every room
//! reachable; a few more doors make loops.

use rand::RngExt;
use rand_pcg::Pcg64Mcg;

use super::geometry::{Rect, Side, WallFrame};
use super::plan::Cell;
use super::{Room, RoomKind};

/// Thickness of every wall, metres. Light inner walls are 0.1, masonry ones 0.115 to 0.15.
pub const WALL_M: f32 = 0.12;
/// Clear height of a door, metres.
pub const DOOR_HEIGHT_M: f32 = 2.05;
/// Thickness of a door's lining at each side of the clear opening, metres.
pub const LINING_M: f32 = 0.02;
/// Width of the casing on the wall around a door, metres.
pub const CASING_M: f32 = 0.06;

/// An opening between two rooms.
#[derive(Debug, Clone, PartialEq)]
pub struct Door {
    /// Indices of the rooms it joins.
    pub rooms: [usize; 2],
    /// The clear opening on the floor, through the thickness of the wall, metres.
    pub rect: Rect,
    /// Whether the wall around it runs along x; along y otherwise.
    pub along_x: bool,
    pub width_m: f32,
    pub height_m: f32,
}

/// A window in an outer wall, in the frame of its room's wall.
#[derive(Debug, Clone, PartialEq)]
pub struct Window {
    pub room: usize,
    pub side: Side,
    pub span: [f32; 2],
    pub height: [f32; 2],
}

/// A door leaf that stands open flat against a wall.
#[derive(Debug, Clone, PartialEq)]
pub struct Leaf {
    pub room: usize,
    pub side: Side,
    pub span: [f32; 2],
}

/// A rectangular hole in one room's wall: along it and in height.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hole {
    pub span: [f32; 2],
    pub height: [f32; 2],
}

/// A stretch of wall between two rooms.
struct Shared {
    rooms: [usize; 2],
    along_x: bool,
    at: f32,
    span: [f32; 2],
}

fn shared_walls(cells: &[Cell]) -> Vec<Shared> {
    let mut walls = Vec::new();
    for i in 0..cells.len() {
        for j in 0..cells.len() {
            for axis in 0..2 {
                let a = cells[i].rect;
                let b = cells[j].rect;
                let along = 1 - axis;
                let span = [
                    a.min[along].max(b.min[along]) + WALL_M / 2.0,
                    a.max[along].min(b.max[along]) - WALL_M / 2.0,
                ];
                if (a.max[axis] - b.min[axis]).abs() < 1e-3 && span[1] > span[0] {
                    walls.push(Shared {
                        rooms: [i, j],
                        along_x: along == 0,
                        at: a.max[axis],
                        span,
                    });
                }
            }
        }
    }
    walls
}

/// Cost of a door between two kinds of room. Baths and bedrooms are poor passages.
fn cost(a: RoomKind, b: RoomKind) -> f32 {
    use RoomKind::{Bath, Bedroom, Corridor, Kitchen, Living, Meeting, OpenPlan, Study};
    match (a, b) {
        (Corridor, Living | OpenPlan) | (Living | OpenPlan, Corridor) => 0.5,
        (Corridor, _) | (_, Corridor) | (Living, Kitchen) | (Kitchen, Living) => 1.0,
        (OpenPlan, Meeting | Study) | (Meeting | Study, OpenPlan) => 1.5,
        (Living, _) | (_, Living) | (OpenPlan, _) | (_, OpenPlan) => 2.0,
        (Bath, Bedroom | Study) | (Bedroom | Study, Bath) => 5.0,
        (Bath, _) | (_, Bath) => 9.0,
        _ => 4.0,
    }
}

/// Places doors along a spanning tree and a few loops; `None` where the walls between rooms are too
/// short to connect them all.
pub fn doors(cells: &[Cell], rng: &mut Pcg64Mcg) -> Option<Vec<Door>> {
    let hole = 2.0 * (LINING_M + CASING_M);
    let mut walls: Vec<(f32, Shared)> = shared_walls(cells)
        .into_iter()
        .filter(|w| w.span[1] - w.span[0] > 0.9 + hole + 0.02)
        .map(|w| {
            (cost(cells[w.rooms[0]].kind, cells[w.rooms[1]].kind) + rng.random_range(0.0..0.4), w)
        })
        .collect();
    walls.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut group: Vec<usize> = (0..cells.len()).collect();
    let mut doors = Vec::new();
    let mut loops = 0;
    for (cost, wall) in walls {
        let [a, b] = wall.rooms.map(|r| group[r]);
        let joins = a != b;
        if joins {
            group.iter_mut().filter(|g| **g == b).for_each(|g| *g = a);
        }
        let extra = loops < 2 && cost < 3.0 && rng.random_bool(0.3);
        loops += usize::from(!joins && extra);
        if joins || extra {
            let open = cells
                .iter()
                .zip(0..)
                .filter(|(_, i)| wall.rooms.contains(i))
                .all(|(c, _)| c.kind.is_day());
            doors.push(place_door(&wall, open, rng));
        }
    }
    group.iter().all(|g| *g == group[0]).then_some(doors)
}

/// Places a door near an end of its wall, which leaves the rest for furniture. Passages between day
/// rooms are wide.
fn place_door(wall: &Shared, open: bool, rng: &mut Pcg64Mcg) -> Door {
    let margin = LINING_M + CASING_M + 0.01;
    let free_m = wall.span[1] - wall.span[0] - 2.0 * margin;
    let preferred_width =
        if open { 1.1 } else { [0.9, 0.9, 0.95, 1.0_f32][rng.random_range(0..4)] };
    let width = free_m.min(preferred_width);
    let slack = free_m - width;
    let near = (slack * rng.random_range(0.0..1.0_f32)).min(rng.random_range(0.08..0.45));
    let offset = match rng.random_range(0..5) {
        0 => slack * rng.random_range(0.3..0.7),
        1 | 2 => near,
        _ => slack - near,
    };
    let start = wall.span[0] + margin + offset;
    let s = [start, start + width];
    let t = [wall.at - WALL_M / 2.0, wall.at + WALL_M / 2.0];
    let rect = if wall.along_x {
        Rect::new(s[0], t[0], s[1], t[1])
    } else {
        Rect::new(t[0], s[0], t[1], s[1])
    };
    Door { rooms: wall.rooms, rect, along_x: wall.along_x, width_m: width, height_m: DOOR_HEIGHT_M }
}

/// The side of `room` in which `door` is.
pub fn side_of(door: &Door, room: &Rect) -> Side {
    let c = door.rect.center();
    let r = room.center();
    match (door.along_x, c[0] < r[0], c[1] < r[1]) {
        (true, _, true) => Side::South,
        (true, _, false) => Side::North,
        (false, true, _) => Side::West,
        (false, false, _) => Side::East,
    }
}

/// A door's clear span along a wall of one of its rooms.
pub fn span_of(door: &Door, wall: &WallFrame) -> [f32; 2] {
    let s = wall.project(door.rect.center());
    [s - door.width_m / 2.0, s + door.width_m / 2.0]
}

/// Parts of a cell's side that no other room touches, in the frame of the room's wall.
pub fn outer_spans(cells: &[Cell], index: usize, side: Side, wall: &WallFrame) -> Vec<[f32; 2]> {
    let cell = cells[index].rect;
    let mut spans = vec![[0.0, wall.length_m]];
    for (_, other) in cells.iter().enumerate().filter(|(i, _)| *i != index) {
        let (axis, here, there) = match side {
            Side::South => (1, cell.min[1], other.rect.max[1]),
            Side::North => (1, cell.max[1], other.rect.min[1]),
            Side::East => (0, cell.max[0], other.rect.min[0]),
            Side::West => (0, cell.min[0], other.rect.max[0]),
        };
        let along = 1 - axis;
        let meets =
            other.rect.min[along] < cell.max[along] && cell.min[along] < other.rect.max[along];
        if (here - there).abs() > 1e-3 || !meets {
            continue;
        }
        let a = wall.project(other.rect.min);
        let b = wall.project(other.rect.max);
        let lo = a.min(b) - WALL_M / 2.0;
        let hi = a.max(b) + WALL_M / 2.0;
        spans = spans.iter().flat_map(|s| [[s[0], s[1].min(lo)], [s[0].max(hi), s[1]]]).collect();
    }
    spans.retain(|s| s[1] - s[0] > 0.05);
    spans
}

/// Places windows in outer walls: one every 2 to 3 m, smaller and higher in baths.
pub fn windows(cells: &[Cell], rooms: &[Room], rng: &mut Pcg64Mcg) -> Vec<Window> {
    let mut windows = Vec::new();
    for (index, room) in rooms.iter().enumerate() {
        for side in Side::ALL {
            let wall = room.rect.wall(side);
            for span in outer_spans(cells, index, side, &wall) {
                let length = span[1] - span[0];
                let (preferred_width, height): (f32, _) = match room.kind {
                    RoomKind::Bath => (0.6, [1.4, 2.05]),
                    RoomKind::OpenPlan | RoomKind::Meeting => {
                        (rng.random_range(1.4..1.8), [0.9, 2.2])
                    }
                    _ => (rng.random_range(0.9..1.5), [0.9, 2.1]),
                };
                let width = preferred_width.min(length - 0.7);
                let count = ((length / rng.random_range(2.2..3.2)) as usize).max(1);
                if width < 0.5 || !rng.random_bool(0.8) {
                    continue;
                }
                for i in 0..count {
                    let middle = span[0] + length * (i as f32 + 0.5) / count as f32;
                    let span = [middle - width / 2.0, middle + width / 2.0];
                    windows.push(Window { room: index, side, span, height });
                }
            }
        }
    }
    open_to_balcony(&mut windows, rooms);
    windows
}

/// Makes the first window of every living room and open-plan hall a glass door that reaches down to
/// the floor.
fn open_to_balcony(windows: &mut [Window], rooms: &[Room]) {
    for (index, room) in rooms.iter().enumerate() {
        let has_balcony = matches!(room.kind, RoomKind::Living | RoomKind::OpenPlan);
        let first = windows.iter_mut().find(|window| window.room == index && has_balcony);
        if let Some(window) = first {
            window.height[0] = 0.02;
        }
    }
}

/// Places open door leaves for about two of three doors, where the wall beside the opening is free
/// for them.
pub fn leaves(doors: &[Door], rooms: &[Room], rng: &mut Pcg64Mcg) -> Vec<Leaf> {
    let mut leaves = Vec::new();
    for door in doors {
        let wide = door.width_m > 1.05;
        let which = door.rooms[rng.random_range(0..2)];
        let low_end = rng.random_bool(0.5);
        let room = &rooms[which];
        let side = side_of(door, &room.rect);
        let wall = room.rect.wall(side);
        let clear = span_of(door, &wall);
        let gap = LINING_M + CASING_M + 0.01;
        let span = if low_end {
            [clear[0] - gap - door.width_m, clear[0] - gap]
        } else {
            [clear[1] + gap, clear[1] + gap + door.width_m]
        };
        let others = doors.iter().filter(|d| *d != door);
        let narrow = room.kind == RoomKind::Corridor;
        if wide
            || narrow
            || span[0] < 0.02
            || span[1] > wall.length_m - 0.02
            || others.into_iter().any(|it| meets_door(it, which, room, side, &wall, span))
        {
            continue;
        }
        leaves.push(Leaf { room: which, side, span });
    }
    leaves
}

fn meets_door(
    d: &Door,
    which: usize,
    room: &Room,
    side: Side,
    wall: &WallFrame,
    span: [f32; 2],
) -> bool {
    let other = span_of(d, wall);
    d.rooms.contains(&which)
        && side_of(d, &room.rect) == side
        && other[0] - 0.15 < span[1]
        && span[0] < other[1] + 0.15
}
