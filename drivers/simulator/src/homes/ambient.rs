//! Baked ambient light of built-in homes: the open fraction of the room above a face, from a few
//! fixed rays against the room's solids.

use multiversion::multiversion;
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
/// Solids whose nearest corner is higher than this above a face's plane may occlude it, metres:
/// half of the height at which rays start, so that rounding decides nothing.
const CLEARANCE_M: f32 = LIFT_M / 2.0;
/// Height above a face at which rays start, metres.
const LIFT_M: f32 = 0.004;

/// A number for each ray, side by side for vector registers.
type OfRays = [f32; RAYS];

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

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
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
    let near = occluders(quad, n, solids);
    let inverse: [OfRays; 3] = std::array::from_fn(|i| {
        directions.map(|r| 1.0 / (r[0] * t[i] + r[1] * b[i] + r[2] * n[i]))
    });
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
    std::array::from_fn(|i| p[i] + LIFT_M * normal[i])
}

/// The solids that rays of at most [`REACH_M`] from a face with this normal may hit.
fn occluders(quad: &Quad, normal: [f32; 3], solids: &[Solid]) -> Vec<Solid> {
    let low: [f32; 3] =
        std::array::from_fn(|i| quad.corners.iter().fold(f32::MAX, |low, c| low.min(c[i])));
    let high: [f32; 3] =
        std::array::from_fn(|i| quad.corners.iter().fold(f32::MIN, |high, c| high.max(c[i])));
    let plane = quad.corners.iter().fold(f32::MAX, |low, c| low.min(dot(*c, normal)));
    let is_near = |solid: &Solid| {
        (0..3).all(|i| solid.min[i] < high[i] + REACH_M && solid.max[i] > low[i] - REACH_M)
    };
    let is_above = |solid: &Solid| {
        let highest: [f32; 3] =
            std::array::from_fn(|i| if normal[i] > 0.0 { solid.max[i] } else { solid.min[i] });
        dot(highest, normal) > plane + CLEARANCE_M
    };
    solids.iter().filter(|solid| is_near(solid) && is_above(solid)).copied().collect()
}

/// Light at a point of a face: less where rays hit the room's solids within reach.
#[multiversion(targets("x86_64+avx2"))]
fn open_share(
    origin: [f32; 3],
    inverse: &[OfRays; 3],
    near: &[Solid],
    room: Rect,
    height: f32,
) -> f32 {
    let mut hit = exits(origin, inverse, room, height);
    for solid in near {
        shorten_to_entries(&mut hit, origin, inverse, solid);
    }
    let blocked: f32 = hit.iter().map(|hit| (1.0 - hit / REACH_M).max(0.0)).sum();
    1.0 - (1.0 - FLOOR) * blocked / RAYS as f32
}

/// Distances at which rays leave the room through a wall, the floor or the ceiling.
#[inline(always)]
fn exits(origin: [f32; 3], inverse: &[OfRays; 3], room: Rect, height: f32) -> OfRays {
    let min = [room.min[0], room.min[1], 0.0];
    let max = [room.max[0], room.max[1], height];
    let mut nearest = [REACH_M; RAYS];
    for i in 0..3 {
        for ray in 0..RAYS {
            let side = if inverse[i][ray] > 0.0 { max[i] } else { min[i] };
            let t = (side - origin[i]) * inverse[i][ray];
            // A door lining lies outside of its room, so walls behind it do not limit its rays.
            if t > 0.0 {
                nearest[ray] = nearest[ray].min(t);
            }
        }
    }
    nearest
}

/// Ends rays where they enter a solid; not those that start inside.
#[inline(always)]
fn shorten_to_entries(hit: &mut OfRays, origin: [f32; 3], inverse: &[OfRays; 3], solid: &Solid) {
    let mut enter = [f32::MIN; RAYS];
    let mut leave = [f32::MAX; RAYS];
    for i in 0..3 {
        let min = solid.min[i] - origin[i];
        let max = solid.max[i] - origin[i];
        for ray in 0..RAYS {
            let a = min * inverse[i][ray];
            let b = max * inverse[i][ray];
            enter[ray] = enter[ray].max(a.min(b));
            leave[ray] = leave[ray].min(a.max(b));
        }
    }
    for ray in 0..RAYS {
        let enters = (enter[ray] <= leave[ray]) & (enter[ray] > 0.0);
        hit[ray] = hit[ray].min(if enters { enter[ray] } else { REACH_M });
    }
}
