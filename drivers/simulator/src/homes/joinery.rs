//! Door frames and leaves, windows with their sills and curtains.

use rand::RngExt;
use rand_pcg::Pcg64Mcg;

use super::Surface;
use super::geometry::Side;
use super::layout::Layout;
use super::material_set::{Appearance, MaterialSet};
use super::mesh::{Mesh, flat};
use super::openings::{CASING_M, Door, LINING_M, Leaf, WALL_M, Window};
use super::styles::HomeStyle;
use super::texture::Skin;

/// Distance by which a casing protrudes from its wall, metres.
const CASING_DEPTH_M: f32 = 0.014;
/// Distance of an open leaf from its wall, and thickness of the leaf, metres.
const LEAF_GAP_M: f32 = 0.035;
const LEAF_M: f32 = 0.04;
/// Distance by which an open leaf reaches into the room, handle included, metres.
pub const LEAF_REACH_M: f32 = LEAF_GAP_M + LEAF_M + 0.06;
/// Distance by which a curtain extends beyond its window at each side, metres.
pub const CURTAIN_M: f32 = 0.22;
/// Lower windows are glass doors and have no sill, metres.
const SILL_M: f32 = 0.3;
/// Number of vertical folds of a curtain.
const FOLDS: usize = 8;

pub fn build(
    layout: &Layout,
    style: &HomeStyle,
    materials: &mut MaterialSet,
    mesh: &mut Mesh,
    rng: &mut Pcg64Mcg,
) {
    for door in &layout.doors {
        let mark = mesh.mark();
        frame(door, style, mesh);
        mesh.tag(mark, door.rooms[0], Surface::Opening);
    }
    for leaf in &layout.leaves {
        let mark = mesh.mark();
        open_leaf(leaf, layout, style, mesh);
        mesh.tag(mark, leaf.room, Surface::Opening);
    }
    let views: [Appearance; 3] =
        [0, 1, 2].map(|v| materials.absorbing("window view", [255, 255, 255], Skin::View(v), 0.3));
    let cloths = [[206, 196, 180], [150, 160, 170], [178, 150, 130], [224, 222, 214]];
    let mut curtains: Vec<Option<Appearance>> = Vec::new();
    for room in &layout.rooms {
        let color = cloths[rng.random_range(0..cloths.len())];
        let hung = room.kind.is_home() && rng.random_bool(0.7);
        curtains.push(hung.then(|| materials.appearance("curtain", color, Skin::Cloth(0))));
    }
    for opening in &layout.windows {
        let mark = mesh.mark();
        let view = views[rng.random_range(0..views.len())];
        window(opening, layout, view, curtains[opening.room], style, mesh);
        mesh.tag(mark, opening.room, Surface::Opening);
    }
}

/// Threshold, lining and casings, in a frame with x along the wall and y through it.
fn frame(door: &Door, style: &HomeStyle, mesh: &mut Mesh) {
    let half = door.width_m / 2.0;
    let t = WALL_M / 2.0;
    let top = door.height_m;
    let outer = half + LINING_M;
    let cased = half + LINING_M + CASING_M;
    let mut part = Mesh::default();
    let floor = [[-outer, -t, 0.0], [outer, -t, 0.0], [outer, t, 0.0], [-outer, t, 0.0]];
    part.quad(floor, flat(floor, style.threshold), style.threshold);
    for sign in [-1.0, 1.0_f32] {
        let x = on_side(sign, half, outer);
        part.trim([x[0], -t, 0.0], [x[1], t, top], style.joinery);
        for face in [-1.0, 1.0_f32] {
            let x = on_side(sign, half, cased);
            let y0 = face * t;
            let y1 = face * (t + CASING_DEPTH_M);
            part.trim([x[0], y0.min(y1), 0.0], [x[1], y0.max(y1), top], style.joinery);
        }
    }
    part.trim([-outer, -t, top], [outer, t, top + LINING_M], style.joinery);
    for face in [-1.0, 1.0_f32] {
        let y0 = face * t;
        let y1 = face * (t + CASING_DEPTH_M);
        part.trim(
            [-cased, y0.min(y1), top],
            [cased, y0.max(y1), top + LINING_M + CASING_M],
            style.joinery,
        );
    }
    let [x, y] = door.rect.center();
    mesh.append_at_wall(&part, [x, y, 0.0], if door.along_x { Side::South } else { Side::East });
}

fn on_side(sign: f32, a: f32, b: f32) -> [f32; 2] {
    [(sign * a).min(sign * b), (sign * a).max(sign * b)]
}

fn open_leaf(leaf: &Leaf, layout: &Layout, style: &HomeStyle, mesh: &mut Mesh) {
    let wall = layout.rooms[leaf.room].rect.wall(leaf.side);
    let mut part = Mesh::default();
    let width = leaf.span[1] - leaf.span[0];
    let y0 = LEAF_GAP_M;
    let y1 = LEAF_GAP_M + LEAF_M;
    part.block([0.0, y0, 0.01], [width, y1, 2.03], style.leaf);
    for (low, high) in [(0.25, 0.95), (1.15, 1.85)] {
        part.trim([0.16, y1, low], [width - 0.16, y1 + 0.006, high], style.leaf);
    }
    part.trim([0.05, y1, 0.98], [0.08, y1 + 0.02, 1.1], style.metal);
    part.trim([0.055, y1 + 0.02, 1.03], [0.17, y1 + 0.045, 1.05], style.metal);
    let [x, y] = wall.at(leaf.span[0], 0.0);
    mesh.append_at_wall(&part, [x, y, 0.0], leaf.side);
}

/// A pane with the view outside, its reveal, bars, sill, and curtains at its sides.
fn window(
    opening: &Window,
    layout: &Layout,
    view: Appearance,
    curtain: Option<Appearance>,
    style: &HomeStyle,
    mesh: &mut Mesh,
) {
    let wall = layout.rooms[opening.room].rect.wall(opening.side);
    let w = opening.span[1] - opening.span[0];
    let [z0, z1] = opening.height;
    let depth = WALL_M - 0.02;
    let mut part = Mesh::default();
    part.stretched_face(
        [[w, -depth, z0], [0.0, -depth, z0], [0.0, -depth, z1], [w, -depth, z1]],
        view,
    );
    // The reveal is a box seen from inside.
    let appearance = style.joinery;
    for corners in [
        [[0.0, -depth, z0], [w, -depth, z0], [w, 0.0, z0], [0.0, 0.0, z0]],
        [[0.0, 0.0, z1], [w, 0.0, z1], [w, -depth, z1], [0.0, -depth, z1]],
        [[0.0, 0.0, z0], [0.0, 0.0, z1], [0.0, -depth, z1], [0.0, -depth, z0]],
        [[w, -depth, z0], [w, -depth, z1], [w, 0.0, z1], [w, 0.0, z0]],
    ] {
        let tile = appearance.tile_m;
        part.quad(
            corners,
            corners.map(|c| [(c[0] + c[1]) / tile, (c[2] + c[1]) / tile]),
            appearance,
        );
    }
    let back = -depth + 0.005;
    let front = -depth + 0.045;
    for x in [0.002, w - 0.052] {
        part.trim([x, back, z0 + 0.002], [x + 0.05, front, z1 - 0.002], appearance);
    }
    for z in [z0 + 0.003, z1 - 0.053] {
        part.trim([0.052, back, z], [w - 0.052, front, z + 0.05], appearance);
    }
    if w > 0.8 {
        part.trim(
            [w / 2.0 - 0.03, back, z0 + 0.053],
            [w / 2.0 + 0.03, front, z1 - 0.053],
            appearance,
        );
    }
    if z0 > SILL_M {
        part.plate([-0.05, w + 0.05], [z0 - 0.06, z0 - 0.004], [0.0, 0.03], appearance);
    }
    if let Some(cloth) = curtain {
        part.trim(
            [-CURTAIN_M - 0.05, 0.06, z1 + 0.11],
            [w + CURTAIN_M + 0.05, 0.08, z1 + 0.13],
            style.metal,
        );
        for start in [-CURTAIN_M, w - 0.03] {
            let hem = (z0 - 0.06).max(0.02);
            folds(start, CURTAIN_M + 0.03, [hem, z1 + 0.12], cloth, &mut part);
        }
    }
    let [x, y] = wall.at(opening.span[0], 0.0);
    mesh.append_at_wall(&part, [x, y, 0.0], opening.side);
}

fn folds(start: f32, width: f32, z: [f32; 2], appearance: Appearance, part: &mut Mesh) {
    for i in 0..FOLDS {
        let (x0, y0) = fold_edge(i, start, width);
        let (x1, y1) = fold_edge(i + 1, start, width);
        let corners = [[x1, y1, z[0]], [x0, y0, z[0]], [x0, y0, z[1]], [x1, y1, z[1]]];
        let u = [i, i + 1].map(|i| 0.045 * i as f32 / appearance.tile_m);
        let v = z.map(|z| -z / appearance.tile_m);
        part.quad(corners, [[u[1], v[0]], [u[0], v[0]], [u[0], v[1]], [u[1], v[1]]], appearance);
    }
}

fn fold_edge(i: usize, start: f32, width: f32) -> (f32, f32) {
    (start + width * i as f32 / FOLDS as f32, if i.is_multiple_of(2) { 0.055 } else { 0.085 })
}
