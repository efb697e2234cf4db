//! Floor plan of a home: an outer shape that is split until every room has a purpose.
//!
//! Cells are rectangles between the centre lines of walls. They tile the outer shape, so walls need
//! no separate geometry.

use rand::RngExt;
use rand_pcg::Pcg64Mcg;

use super::geometry::Rect;
use super::{HomeKind, RoomKind};

/// A room up to the centre lines of its walls.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cell {
    pub rect: Rect,
    pub kind: RoomKind,
}

/// Dimension ranges of a day block (living or open plan) with a corridor wing beside it; metres
/// between centre lines.
struct Wing {
    day_width: (f32, f32),
    corridor: (f32, f32),
    south_depth: (f32, f32),
    north_depth: (f32, f32),
    length: (f32, f32),
    /// Distance by which the day block extends beyond the wing, which makes an L shape.
    overhang: (f32, f32),
    min_room: f32,
    kitchen_depth: (f32, f32),
    area_m2: (f32, f32),
    rooms: (usize, usize),
}

const APARTMENT: Wing = Wing {
    day_width: (3.9, 4.9),
    corridor: (1.4, 1.55),
    south_depth: (2.9, 3.5),
    north_depth: (2.2, 3.0),
    length: (3.6, 6.0),
    overhang: (0.9, 1.8),
    min_room: 2.3,
    kitchen_depth: (2.4, 2.9),
    area_m2: (46.0, 88.0),
    rooms: (5, 6),
};

const HOUSE: Wing = Wing {
    day_width: (4.8, 6.4),
    corridor: (1.4, 1.7),
    south_depth: (3.2, 4.2),
    north_depth: (2.7, 3.8),
    length: (6.6, 9.8),
    overhang: (1.2, 3.0),
    min_room: 2.4,
    kitchen_depth: (2.9, 3.8),
    area_m2: (95.0, 178.0),
    rooms: (7, 9),
};

const OFFICE: Wing = Wing {
    day_width: (7.0, 9.5),
    corridor: (1.7, 2.1),
    south_depth: (3.8, 4.8),
    north_depth: (3.6, 4.6),
    length: (8.5, 13.0),
    overhang: (1.5, 3.0),
    min_room: 2.7,
    kitchen_depth: (2.6, 3.4),
    area_m2: (160.0, 295.0),
    rooms: (7, 11),
};

/// Splits an outer shape into rooms. The caller draws again when doors cannot connect them.
pub fn cells(kind: HomeKind, rng: &mut Pcg64Mcg) -> Vec<Cell> {
    let wing = match kind {
        HomeKind::Apartment => &APARTMENT,
        HomeKind::House => &HOUSE,
        HomeKind::Office => &OFFICE,
    };
    let without_corridor = kind == HomeKind::Apartment && rng.random_bool(0.4);
    let mut cells = Vec::new();
    // A draw misses the range of areas or room counts about every third time. The bound only guards
    // against wrong tables.
    for _ in 0..1000 {
        cells = if without_corridor { recursive(rng) } else { with_wing(kind, wing, rng) };
        let area: f32 = cells.iter().map(|c| c.rect.area_m2()).sum();
        if (wing.area_m2.0..=wing.area_m2.1).contains(&area)
            && (wing.rooms.0 - usize::from(without_corridor)..=wing.rooms.1).contains(&cells.len())
        {
            break;
        }
    }
    orient(&mut cells, rng);
    cells
}

/// Rounds to a multiple of 5 cm, so that coordinates that should be equal are.
fn snap(v: f32) -> f32 {
    (v * 20.0).round() / 20.0
}

fn draw(range: (f32, f32), rng: &mut Pcg64Mcg) -> f32 {
    snap(rng.random_range(range.0..=range.1))
}

fn with_wing(kind: HomeKind, wing: &Wing, rng: &mut Pcg64Mcg) -> Vec<Cell> {
    let a = draw(wing.day_width, rng);
    let b = draw(wing.length, rng);
    let south = draw(wing.south_depth, rng);
    let corridor = draw(wing.corridor, rng);
    let north = draw(wing.north_depth, rng);
    let depth = snap(south + corridor + north);
    let overhang = if rng.random_bool(0.55) { draw(wing.overhang, rng) } else { 0.0 };
    let height = snap(depth + overhang);
    let door0 = south;
    let door1 = snap(south + corridor);
    let mut cells = day_block(kind, wing, Rect::new(0.0, 0.0, a, height), (door0, door1), rng);
    let end = snap(a + b);
    cells.push(Cell { rect: Rect::new(a, door0, end, door1), kind: RoomKind::Corridor });
    let rows = [Rect::new(a, 0.0, end, door0), Rect::new(a, door1, end, depth)];
    let south_rooms = split_row(rows[0], wing.min_room, rng);
    let north_rooms = split_row(rows[1], wing.min_room, rng);
    let kinds = wing_kinds(kind, &south_rooms, &north_rooms, rng);
    let rects = south_rooms.into_iter().chain(north_rooms);
    cells.extend(rects.zip(kinds).map(|(rect, kind)| Cell { rect, kind }));
    cells
}

/// Living room (which borders the corridor between `meets`) and kitchen. In an office the open plan
/// takes the whole block.
fn day_block(
    kind: HomeKind,
    wing: &Wing,
    block: Rect,
    meets: (f32, f32),
    rng: &mut Pcg64Mcg,
) -> Vec<Cell> {
    if kind == HomeKind::Office {
        return vec![Cell { rect: block, kind: RoomKind::OpenPlan }];
    }
    let x1 = block.max[0];
    let y1 = block.max[1];
    let kitchen = draw(wing.kitchen_depth, rng);
    let above = y1 - meets.1 >= kitchen + 0.3 && rng.random_bool(0.6);
    let (living, strip) = if above {
        let y = snap(y1 - kitchen);
        (Rect::new(0.0, 0.0, x1, y), Rect::new(0.0, y, x1, y1))
    } else {
        let y = kitchen.min(meets.0);
        (Rect::new(0.0, y, x1, y1), Rect::new(0.0, 0.0, x1, y))
    };
    let mut cells = vec![Cell { rect: living, kind: RoomKind::Living }];
    let third = kind == HomeKind::House && x1 >= 5.4 && rng.random_bool(0.6);
    if third {
        let x = snap(x1 * rng.random_range(0.45..0.58));
        cells.push(Cell {
            rect: Rect::new(x, strip.min[1], x1, strip.max[1]),
            kind: RoomKind::Kitchen,
        });
        cells.push(Cell {
            rect: Rect::new(0.0, strip.min[1], x, strip.max[1]),
            kind: RoomKind::Study,
        });
    } else {
        cells.push(Cell { rect: strip, kind: RoomKind::Kitchen });
    }
    cells
}

/// Splits a row along x into as many rooms as fit comfortably, of uneven widths.
fn split_row(row: Rect, min_width: f32, rng: &mut Pcg64Mcg) -> Vec<Rect> {
    let length = row.size()[0];
    let most = ((length / min_width).floor() as usize).max(1);
    let count =
        ((length / (min_width * rng.random_range(1.15..1.6))).round() as usize).clamp(1, most);
    let weights: Vec<f32> = (0..count).map(|_| rng.random_range(0.3..1.0)).collect();
    let spare = length - min_width * count as f32;
    let total: f32 = weights.iter().sum();
    let mut x = row.min[0];
    let mut rects = Vec::with_capacity(count);
    for (i, weight) in weights.iter().enumerate() {
        let next =
            if i + 1 == count { row.max[0] } else { snap(x + min_width + spare * weight / total) };
        rects.push(Rect::new(x, row.min[1], next, row.max[1]));
        x = next;
    }
    rects
}

/// Purposes of the rooms along a corridor: the smallest is a bath, an office's largest is for
/// meetings.
fn wing_kinds(kind: HomeKind, south: &[Rect], north: &[Rect], rng: &mut Pcg64Mcg) -> Vec<RoomKind> {
    let rects: Vec<Rect> = south.iter().chain(north).copied().collect();
    let mut order: Vec<usize> = (0..rects.len()).collect();
    order.sort_by(|&i, &j| rects[i].area_m2().total_cmp(&rects[j].area_m2()));
    let mut kinds = vec![RoomKind::Bedroom; rects.len()];
    if kind == HomeKind::Office {
        kinds.fill(RoomKind::Study);
        kinds[order[0]] = RoomKind::Bath;
        kinds[order[order.len() - 1]] = RoomKind::Meeting;
        if order.len() > 4 {
            kinds[order[1]] = RoomKind::Kitchen;
        }
        return kinds;
    }
    kinds[order[0]] = RoomKind::Bath;
    if order.len() > 3
        && kind == HomeKind::House
        && rects[order[1]].area_m2() < 9.0
        && rng.random_bool(0.5)
    {
        kinds[order[1]] = RoomKind::Bath;
    } else if order.len() > 2 && rng.random_bool(0.6) {
        kinds[order[1]] = RoomKind::Study;
    }
    kinds
}

/// A flat without a corridor: the largest rectangle is split repeatedly.
fn recursive(rng: &mut Pcg64Mcg) -> Vec<Cell> {
    let area = rng.random_range(44.0..80.0_f32);
    let aspect = rng.random_range(1.05..1.5_f32);
    let mut rects =
        vec![Rect::new(0.0, 0.0, snap((area * aspect).sqrt()), snap((area / aspect).sqrt()))];
    let count = if area < 56.0 { 4 } else { 5 };
    while rects.len() < count {
        let Some(rect) = rects.iter().max_by(by_area).copied() else { break };
        rects.retain(|r| *r != rect);
        let axis = usize::from(rect.size()[1] > rect.size()[0]);
        // Uneven shares make a large living room and a small bath.
        let share = if rects.is_empty() {
            rng.random_range(0.5..0.6)
        } else {
            rng.random_range(0.34..0.44)
        };
        let share = if rng.random_bool(0.5) { share } else { 1.0 - share };
        let cut = snap(rect.min[axis] + rect.size()[axis] * share);
        let mut low = rect;
        let mut high = rect;
        low.max[axis] = cut;
        high.min[axis] = cut;
        rects.extend([low, high]);
    }
    rects.sort_by(|a, b| b.area_m2().total_cmp(&a.area_m2()));
    let kinds = [RoomKind::Living, RoomKind::Bedroom, RoomKind::Kitchen, RoomKind::Study];
    let last = rects.len() - 1;
    rects
        .iter()
        .enumerate()
        .map(|(i, rect)| {
            let kind = if i == last { RoomKind::Bath } else { kinds[i] };
            Cell { rect: *rect, kind }
        })
        .collect()
}

fn by_area(a: &&Rect, b: &&Rect) -> std::cmp::Ordering {
    a.area_m2().total_cmp(&b.area_m2())
}

/// Mirrors and transposes at random, so that homes differ in orientation.
fn orient(cells: &mut [Cell], rng: &mut Pcg64Mcg) {
    let extent =
        cells.iter().fold([0.0_f32; 2], |m, c| [m[0].max(c.rect.max[0]), m[1].max(c.rect.max[1])]);
    let flip_x = rng.random_bool(0.5);
    let flip_y = rng.random_bool(0.5);
    let swap = rng.random_bool(0.5);
    for cell in cells {
        let r = &mut cell.rect;
        for (axis, flip) in [(0, flip_x), (1, flip_y)] {
            if flip {
                (r.min[axis], r.max[axis]) =
                    (snap(extent[axis] - r.max[axis]), snap(extent[axis] - r.min[axis]));
            }
        }
        if swap {
            r.min.swap(0, 1);
            r.max.swap(0, 1);
        }
    }
}
