//! Walls, floors and ceilings as grids of quads that are fine enough for baked light to vary over
//! them.

use super::Surface;
use super::geometry::{Rect, Side, WallFrame};
use super::layout::Layout;
use super::material_set::Appearance;
use super::mesh::{Mesh, flat};
use super::openings::{
    CASING_M, DOOR_HEIGHT_M, Hole, LINING_M, WALL_M, outer_spans, side_of, span_of,
};
use super::styles::HomeStyle;

/// Longest edge of a wall's, floor's or ceiling's quads, metres.
const GRID_M: f32 = 0.2;
const SKIRTING_HEIGHT_M: f32 = 0.07;
const SKIRTING_DEPTH_M: f32 = 0.012;

/// Holes that doors and windows make in one wall of a room.
pub fn holes(layout: &Layout, room: usize, side: Side) -> Vec<Hole> {
    let rect = layout.rooms[room].rect;
    let wall = rect.wall(side);
    let doors =
        layout.doors.iter().filter(|d| d.rooms.contains(&room) && side_of(d, &rect) == side).map(
            |d| {
                let [a, b] = span_of(d, &wall);
                Hole { span: [a - LINING_M, b + LINING_M], height: [0.0, DOOR_HEIGHT_M + LINING_M] }
            },
        );
    let windows = layout.windows.iter().filter(|w| w.room == room && w.side == side);
    doors.chain(windows.map(|w| Hole { span: w.span, height: w.height })).collect()
}

/// Builds floors, ceilings, walls and facades, without openings and wall fixtures.
pub fn build(layout: &Layout, style: &HomeStyle, mesh: &mut Mesh) {
    for (index, room) in layout.rooms.iter().enumerate() {
        let appearance = &style.rooms[index];
        let mark = mesh.mark();
        let opening = layout
            .stairwell
            .filter(|stairwell| stairwell.room == index)
            .map(|stairwell| stairwell.opening(layout));
        floor(room.rect, opening, appearance.floor, mesh);
        mesh.tag(mark, index, Surface::Floor);
        let mark = mesh.mark();
        ceiling(room.rect, room.height_m, style.ceiling, mesh);
        mesh.tag(mark, index, Surface::Ceiling);
        for side in Side::ALL {
            let wall = room.rect.wall(side);
            let holes = holes(layout, index, side);
            let mark = mesh.mark();
            // Each wall has its own offset in the texture.
            let shift = index as f32 * 0.37 + side.quarter_rotations() as f32 * 0.61;
            panel(
                &wall,
                [0.0, wall.length_m],
                room.height_m,
                &holes,
                appearance.wall_at(side),
                shift,
                mesh,
            );
            mesh.tag(mark, index, Surface::Wall);
            let mark = mesh.mark();
            skirting(&wall, &holes, style.skirting, mesh);
            mesh.tag(mark, index, Surface::Opening);
            let mark = mesh.mark();
            facade(layout, index, side, style.outside, mesh);
            mesh.tag(mark, index, Surface::Outside);
        }
    }
}

/// Positions that divide `low` to `high` into parts no longer than the grid, including every value
/// of `through`.
fn cuts(low: f32, high: f32, through: impl Iterator<Item = f32>) -> Vec<f32> {
    let mut marks: Vec<f32> = through.filter(|m| *m > low + 1e-3 && *m < high - 1e-3).collect();
    marks.extend([low, high]);
    marks.sort_by(f32::total_cmp);
    marks.dedup_by(|a, b| *a - *b < 1e-3);
    let mut all = vec![low];
    for pair in marks.windows(2) {
        let steps = ((pair[1] - pair[0]) / GRID_M).ceil().max(1.0) as usize;
        all.extend((1..=steps).map(|i| pair[0] + (pair[1] - pair[0]) * i as f32 / steps as f32));
    }
    all
}

/// A floor, with an opening where stairs lead down.
fn floor(rect: Rect, opening: Option<Rect>, appearance: Appearance, mesh: &mut Mesh) {
    for corners in horizontal(rect, 0.0, opening) {
        mesh.quad(corners, flat(corners, appearance), appearance);
    }
}

fn ceiling(rect: Rect, z: f32, appearance: Appearance, mesh: &mut Mesh) {
    for mut corners in horizontal(rect, z, None) {
        corners.reverse();
        mesh.quad(corners, flat(corners, appearance), appearance);
    }
}

/// The quads of a horizontal face whose normal points up.
fn horizontal(rect: Rect, z: f32, opening: Option<Rect>) -> Vec<[[f32; 3]; 4]> {
    let [xs, ys] = [0, 1].map(|axis| {
        let edges = opening.into_iter().flat_map(|o| [o.min[axis], o.max[axis]]);
        cuts(rect.min[axis], rect.max[axis], edges)
    });
    let mut quads = Vec::new();
    for x in xs.windows(2) {
        for y in ys.windows(2) {
            let middle = [f32::midpoint(x[0], x[1]), f32::midpoint(y[0], y[1])];
            if !opening.is_some_and(|opening| opening.contains(middle)) {
                quads.push([[x[0], y[0], z], [x[1], y[0], z], [x[1], y[1], z], [x[0], y[1], z]]);
            }
        }
    }
    quads
}

/// A wall's face with its holes; u runs to the right as seen from the room, v downwards.
fn panel(
    wall: &WallFrame,
    span: [f32; 2],
    height: f32,
    holes: &[Hole],
    appearance: Appearance,
    shift: f32,
    mesh: &mut Mesh,
) {
    let ss = cuts(span[0], span[1], holes.iter().flat_map(|h| h.span));
    let zs = cuts(0.0, height, holes.iter().flat_map(|h| h.height));
    for s in ss.windows(2) {
        for z in zs.windows(2) {
            let middle = [(s[0] + s[1]) / 2.0, (z[0] + z[1]) / 2.0];
            if holes.iter().any(|h| is_inside(h.span, middle[0]) && is_inside(h.height, middle[1]))
            {
                continue;
            }
            let stations = [(s[1], z[0]), (s[0], z[0]), (s[0], z[1]), (s[1], z[1])];
            let corners = stations.map(|(s, z)| wall.at3(s, 0.0, z));
            mesh.quad(
                corners,
                stations.map(|(s, z)| [shift - s / appearance.tile_m, -z / appearance.tile_m]),
                appearance,
            );
        }
    }
}

fn is_inside(r: [f32; 2], m: f32) -> bool {
    m > r[0] && m < r[1]
}

fn skirting(wall: &WallFrame, holes: &[Hole], appearance: Appearance, mesh: &mut Mesh) {
    let mut doors: Vec<[f32; 2]> = holes
        .iter()
        .filter(|h| h.height[0] <= 0.0)
        .map(|h| [h.span[0] - CASING_M, h.span[1] + CASING_M])
        .collect();
    doors.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let mut from = 0.0;
    for door in doors.iter().copied().chain([[wall.length_m, 0.0]]) {
        if door[0] - from > 0.01 {
            // The skirting leans against the wall: an upper edge of 1 cm would be thinner than a
            // pixel and flicker.
            let stations = [
                (door[0], SKIRTING_DEPTH_M),
                (from, SKIRTING_DEPTH_M),
                (from, 0.0),
                (door[0], 0.0),
            ];
            let corners = stations
                .map(|(s, d)| wall.at3(s, d, if d > 0.0 { 0.0 } else { SKIRTING_HEIGHT_M }));
            mesh.quad(corners, stations.map(|(s, d)| [s / appearance.tile_m, d]), appearance);
        }
        from = door[1];
    }
}

/// The outer face of an outer wall, longer by the wall's thickness at the building's convex
/// corners.
fn facade(layout: &Layout, index: usize, side: Side, appearance: Appearance, mesh: &mut Mesh) {
    let wall = layout.rooms[index].rect.wall(side);
    for [mut from, mut to] in outer_spans(&layout.cells, index, side, &wall) {
        from -= overhang(from < 0.01, wall.at(-0.5, 0.3), layout);
        let beyond = wall.at(wall.length_m + 0.5, 0.3);
        to += overhang(to > wall.length_m - 0.01, beyond, layout);
        let stations = [
            (from, 0.0),
            (to, 0.0),
            (to, layout.rooms[index].height_m),
            (from, layout.rooms[index].height_m),
        ];
        let corners = stations.map(|(s, z)| wall.at3(s, -WALL_M, z));
        mesh.quad(
            corners,
            stations.map(|(s, z)| [s / appearance.tile_m, -z / appearance.tile_m]),
            appearance,
        );
    }
}

/// How far a facade goes on behind the end of its wall: the wall's thickness at a convex corner of the home, half of it at a
/// concave one, else 0. The corner is concave if `beyond`, a point behind the end, lies in a room.
fn overhang(is_corner: bool, beyond: [f32; 2], layout: &Layout) -> f32 {
    match (is_corner, layout.cells.iter().any(|c| c.rect.contains(beyond))) {
        (true, false) => WALL_M,
        (true, true) => WALL_M / 2.0,
        _ => 0.0,
    }
}
