//! Baked ambient light of built-in homes: the open fraction of the room above a face, from a few
//! fixed rays against the room's solids.

use rayon::prelude::*;

use super::geometry::Rect;
use super::mesh::{Mesh, Quad, Solid};
use super::{Room, Surface};
use crate::scene::{Triangle, Vertex};

/// Objects farther away than this do not occlude, metres.
const REACH_M: f32 = 1.4;
/// Ambient light of a fully occluded point, because interiors reflect light.
const FLOOR: f32 = 0.3;
/// Faces whose corners are within this distance of their centre get one light value, metres.
const SMALL_M: f32 = 0.1;
/// Rays over the hemisphere; enough for steps below 2/255 after weighting.
const RAYS: usize = 24;

/// Computes the light on the four corners of every quad, 0 to 1.
pub fn bake(mesh: &Mesh, rooms: &[Room]) -> Vec<[f32; 4]> {
    let mut solids: Vec<Vec<Solid>> = vec![Vec::new(); rooms.len()];
    for solid in &mesh.solids {
        solids[usize::from(solid.room)].push(*solid);
    }
    let directions = hemisphere();
    mesh.quads
        .par_iter()
        .map(|quad| {
            let room = usize::from(quad.room);
            light(quad, rooms[room].rect, rooms[room].height_m, &solids[room], &directions)
        })
        .collect()
}

/// Converts lit quads to triangles, with the surface kind of each.
pub fn triangles(mesh: &Mesh, lit: &[[f32; 4]]) -> (Vec<Triangle>, Vec<Surface>) {
    let mut triangles = Vec::with_capacity(mesh.quads.len() * 2);
    let mut surfaces = Vec::with_capacity(mesh.quads.len() * 2);
    for (quad, ambient) in mesh.quads.iter().zip(lit) {
        for corners in [[0, 1, 2], [0, 2, 3]] {
            let vertices = corners.map(|i| Vertex {
                position_m: quad.corners[i],
                uv: quad.uv[i],
                ambient: ambient[i],
            });
            if area2(vertices.map(|v| v.position_m)) > 1e-9 {
                triangles.push(Triangle { vertices, material: quad.material });
                surfaces.push(quad.surface);
            }
        }
    }
    (triangles, surfaces)
}

fn sub(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    std::array::from_fn(|i| a[i] - b[i])
}

fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn norm(a: [f32; 3]) -> f32 {
    a.iter().map(|v| v * v).sum::<f32>().sqrt()
}

/// Twice a triangle's area.
fn area2(p: [[f32; 3]; 3]) -> f32 {
    norm(cross(sub(p[1], p[0]), sub(p[2], p[0])))
}

/// Cosine-weighted directions about +z on a spiral (Fibonacci lattice).
fn hemisphere() -> [[f32; 3]; RAYS] {
    std::array::from_fn(|i| {
        let r2 = (i as f32 + 0.5) / RAYS as f32;
        let angle = 2.399_963_2 * i as f32;
        [r2.sqrt() * angle.cos(), r2.sqrt() * angle.sin(), (1.0 - r2).sqrt()]
    })
}

fn light(
    quad: &Quad,
    room: Rect,
    height: f32,
    solids: &[Solid],
    directions: &[[f32; 3]; RAYS],
) -> [f32; 4] {
    if quad.surface == Surface::Outside {
        return [1.0; 4];
    }
    let n = cross(sub(quad.corners[2], quad.corners[0]), sub(quad.corners[3], quad.corners[1]));
    let length = norm(n).max(1e-12);
    let n = n.map(|v| v / length);
    let helper = if n[2].abs() < 0.9 { [0.0, 0.0, 1.0] } else { [1.0, 0.0, 0.0] };
    let t = cross(helper, n);
    let t = t.map(|v| v / norm(t).max(1e-12));
    let b = cross(n, t);
    let center: [f32; 3] =
        std::array::from_fn(|i| quad.corners.iter().map(|c| c[i]).sum::<f32>() / 4.0);
    let near: Vec<&Solid> = solids.iter().filter(|s| reachable(s, quad)).collect();
    let inverse = directions
        .map(|r| std::array::from_fn(|i| 1.0 / (r[0] * t[i] + r[1] * b[i] + r[2] * n[i])));
    if quad.corners.iter().all(|c| norm(sub(*c, center)) < SMALL_M) {
        return [open_share(lifted(center, n), &inverse, &near, room, height); 4];
    }
    // Slightly towards the centre and off the surface, so that a ray from a corner does not start
    // inside a neighbouring solid.
    quad.corners.map(|c| {
        open_share(
            lifted(std::array::from_fn(|i| c[i] + 0.04 * (center[i] - c[i])), n),
            &inverse,
            &near,
            room,
            height,
        )
    })
}

fn lifted(p: [f32; 3], normal: [f32; 3]) -> [f32; 3] {
    std::array::from_fn(|i| p[i] + 0.004 * normal[i])
}

/// Light at a point of a face: less where rays hit the room's solids within reach.
fn open_share(
    origin: [f32; 3],
    inverse: &[[f32; 3]; RAYS],
    near: &[&Solid],
    room: Rect,
    height: f32,
) -> f32 {
    let blocked: f32 = inverse
        .iter()
        .map(|inverse| {
            let out = exit(origin, inverse, room, height);
            let hit = near.iter().fold(out, |hit, solid| hit.min(entry(origin, inverse, solid)));
            (1.0 - hit / REACH_M).max(0.0)
        })
        .sum();
    1.0 - (1.0 - FLOOR) * blocked / RAYS as f32
}

/// Whether a solid may occlude rays of at most [`REACH_M`] from a face.
fn reachable(solid: &Solid, quad: &Quad) -> bool {
    (0..3).all(|i| {
        let (low, high) =
            quad.corners.iter().fold((f32::MAX, f32::MIN), |(l, h), c| (l.min(c[i]), h.max(c[i])));
        solid.min[i] < high + REACH_M && solid.max[i] > low - REACH_M
    })
}

/// Distance at which a ray leaves the room through a wall, the floor or the ceiling.
fn exit(origin: [f32; 3], inverse: &[f32; 3], room: Rect, height: f32) -> f32 {
    let min = [room.min[0], room.min[1], 0.0];
    let max = [room.max[0], room.max[1], height];
    (0..3).fold(REACH_M, |best, i| {
        let side = if inverse[i] > 0.0 { max[i] } else { min[i] };
        let t = (side - origin[i]) * inverse[i];
        // A door lining lies outside of its room, so walls behind it do not limit its rays.
        if t > 0.0 { best.min(t) } else { best }
    })
}

/// Distance at which a ray enters a solid; [`REACH_M`] where it does not or starts inside.
fn entry(origin: [f32; 3], inverse: &[f32; 3], solid: &Solid) -> f32 {
    let mut enter = f32::MIN;
    let mut leave = f32::MAX;
    for i in 0..3 {
        let a = (solid.min[i] - origin[i]) * inverse[i];
        let b = (solid.max[i] - origin[i]) * inverse[i];
        enter = enter.max(a.min(b));
        leave = leave.min(a.max(b));
    }
    if enter <= leave && enter > 0.0 { enter } else { REACH_M }
}
