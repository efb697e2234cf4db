//! Quads with texture coordinates at one scale, and the solids that shade them.

use super::looks::Look;
use super::{Surface, geometry::Side};

/// A flat four-cornered face, counter-clockwise seen from outside.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quad {
    pub corners: [[f32; 3]; 4],
    pub uv: [[f32; 2]; 4],
    pub material: u32,
    pub room: u16,
    pub surface: Surface,
}

/// An axis-aligned box that takes light from its surroundings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solid {
    pub min: [f32; 3],
    pub max: [f32; 3],
    pub room: u16,
}

/// Faces and solids, of one piece of furniture or of a whole home.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Mesh {
    pub quads: Vec<Quad>,
    pub solids: Vec<Solid>,
}

/// Corner indices of a box's faces (bit 0: x, bit 1: y, bit 2: z), with the axes that u and v follow.
const FACES: [([usize; 4], [usize; 2]); 6] = [
    ([0, 2, 3, 1], [0, 1]),
    ([4, 5, 7, 6], [0, 1]),
    ([0, 1, 5, 4], [0, 2]),
    ([3, 2, 6, 7], [0, 2]),
    ([2, 0, 4, 6], [1, 2]),
    ([1, 3, 7, 5], [1, 2]),
];

impl Mesh {
    /// A face with given texture coordinates.
    pub fn quad(&mut self, corners: [[f32; 3]; 4], uv: [[f32; 2]; 4], look: Look) {
        self.quads.push(Quad {
            corners,
            uv,
            material: look.material,
            room: 0,
            surface: Surface::Furniture,
        });
    }

    /// A face with its picture stretched over it: the picture's top left is at the last corner.
    pub fn picture(&mut self, corners: [[f32; 3]; 4], look: Look) {
        self.quad(corners, [[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]], look);
    }

    /// A solid box that also shades what is near; see [`Mesh::trim`].
    pub fn block(&mut self, min: [f32; 3], max: [f32; 3], look: Look) {
        self.trim(min, max, look);
        self.solids.push(Solid { min, max, room: 0 });
    }

    /// A box too small to shade its surroundings. A bottom that lies on the floor is left out.
    ///
    /// Textures run along the longer of a face's edges, as wood is sawn; their origin depends on the place, so that
    /// equal boxes look different.
    pub fn trim(&mut self, min: [f32; 3], max: [f32; 3], look: Look) {
        let corner =
            |i: usize| std::array::from_fn(|a| if i >> a & 1 == 0 { min[a] } else { max[a] });
        let shift = (min[0] * 7.31 + min[1] * 3.77 + min[2] * 5.13 + max[0] * 1.7).fract();
        let first = usize::from(min[2] < 1e-3);
        for (indices, axes) in &FACES[first..] {
            let corners: [[f32; 3]; 4] = indices.map(corner);
            let size = axes.map(|a| max[a] - min[a]);
            let axes = if size[1] > size[0] { [axes[1], axes[0]] } else { *axes };
            self.quad(corners, corners.map(|c| axes.map(|a| c[a] / look.tile_m + shift)), look);
        }
    }

    /// Something flat on a wall, its edges sloped back: seen from the front they stay wider than a pixel.
    pub fn plate(&mut self, x: [f32; 2], z: [f32; 2], y: [f32; 2], look: Look) {
        let bevel = (y[1] - y[0]).min((z[1] - z[0]) / 3.0);
        let ring = |inset: f32, y: f32| {
            let (x, z) = ([x[0] + inset, x[1] - inset], [z[0] + inset, z[1] - inset]);
            [[x[1], y, z[0]], [x[0], y, z[0]], [x[0], y, z[1]], [x[1], y, z[1]]]
        };
        let (back, front) = (ring(0.0, y[0]), ring(bevel, y[1]));
        let flat = |c: [f32; 3]| [c[0] / look.tile_m, -c[2] / look.tile_m];
        self.quad(front, front.map(flat), look);
        for i in 0..4 {
            let j = (i + 1) % 4;
            let corners = [back[i], back[j], front[j], front[i]];
            self.quad(corners, corners.map(flat), look);
        }
    }

    /// A box with rounded upper and lower edges: upholstery.
    pub fn cushion(&mut self, min: [f32; 3], max: [f32; 3], look: Look) {
        let extent: [f32; 3] = std::array::from_fn(|a| max[a] - min[a]);
        let c = (extent[0].min(extent[1]).min(extent[2]) * 0.3).min(0.04);
        let ring = |inset: f32, z: f32| {
            let (x0, x1, y0, y1) = (min[0] + inset, max[0] - inset, min[1] + inset, max[1] - inset);
            [[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]]
        };
        let rings =
            [ring(c, min[2]), ring(0.0, min[2] + c), ring(0.0, max[2] - c), ring(c, max[2])];
        let flat = |p: [f32; 3]| [p[0] / look.tile_m, p[1] / look.tile_m];
        let mut around = [0.0; 5];
        for i in 0..4 {
            around[i + 1] = around[i] + if i % 2 == 0 { extent[0] } else { extent[1] };
        }
        for pair in rings.windows(2) {
            for i in 0..4 {
                let j = (i + 1) % 4;
                let corners = [pair[0][i], pair[0][j], pair[1][j], pair[1][i]];
                let u = [around[i], around[i + 1], around[i + 1], around[i]];
                let uv = std::array::from_fn(|k| [u[k] / look.tile_m, corners[k][2] / look.tile_m]);
                self.quad(corners, uv, look);
            }
        }
        self.quad(rings[3], rings[3].map(flat), look);
        let bottom = [rings[0][3], rings[0][2], rings[0][1], rings[0][0]];
        self.quad(bottom, bottom.map(flat), look);
        self.solids.push(Solid { min, max, room: 0 });
    }

    /// An upright round post or cone with `sides` faces and closed ends.
    pub fn post(&mut self, at: [f32; 2], z: [f32; 2], radius: [f32; 2], sides: usize, look: Look) {
        let rim = |k: usize, end: usize| {
            let angle = std::f32::consts::TAU * k as f32 / sides as f32;
            [at[0] + radius[end] * angle.cos(), at[1] + radius[end] * angle.sin(), z[end]]
        };
        let girth = std::f32::consts::TAU * radius[0].max(radius[1]);
        for k in 0..sides {
            let corners = [rim(k, 0), rim(k + 1, 0), rim(k + 1, 1), rim(k, 1)];
            let u = |k: usize| girth * k as f32 / sides as f32 / look.tile_m;
            let v = z.map(|z| z / look.tile_m);
            self.quad(
                corners,
                [[u(k), v[0]], [u(k + 1), v[0]], [u(k + 1), v[1]], [u(k), v[1]]],
                look,
            );
        }
        for end in 0..2 {
            if radius[end] > 1e-3 && (end == 1 || z[0] > 1e-3) {
                let around: Vec<_> = (0..sides)
                    .map(|k| rim(if end == 1 { k } else { sides - 1 - k }, end))
                    .collect();
                self.disc(&around, look);
            }
        }
        let r = radius[0].max(radius[1]) * 0.85;
        if r > 0.04 {
            let (min, max) = ([at[0] - r, at[1] - r, z[0]], [at[0] + r, at[1] + r, z[1]]);
            self.solids.push(Solid { min, max, room: 0 });
        }
    }

    /// A convex polygon with an even number of corners, as quads that share its first corner.
    fn disc(&mut self, rim: &[[f32; 3]], look: Look) {
        for i in (1..rim.len() - 2).step_by(2) {
            let corners = [rim[0], rim[i], rim[i + 1], rim[i + 2]];
            self.quad(corners, corners.map(|c| [c[0] / look.tile_m, c[1] / look.tile_m]), look);
        }
    }

    /// Adds another mesh, turned by `yaw_rad` about the vertical and then moved.
    pub fn append(&mut self, other: &Self, at: [f32; 3], yaw_rad: f32) {
        self.append_turned(other, at, [yaw_rad.cos(), yaw_rad.sin()]);
    }

    /// Adds a piece built along the south wall to another wall, without the rounding of sines.
    pub fn append_at_wall(&mut self, other: &Self, at: [f32; 3], side: Side) {
        let turn = [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]][side.quarter_turns()];
        self.append_turned(other, at, turn);
    }

    fn append_turned(&mut self, other: &Self, at: [f32; 3], [c, s]: [f32; 2]) {
        let turn =
            |p: [f32; 3]| [at[0] + c * p[0] - s * p[1], at[1] + s * p[0] + c * p[1], at[2] + p[2]];
        self.quads.extend(other.quads.iter().map(|q| Quad { corners: q.corners.map(turn), ..*q }));
        self.solids.extend(other.solids.iter().map(|solid| {
            let (a, b) = (solid.min, solid.max);
            let base = [[a[0], a[1]], [b[0], a[1]], [b[0], b[1]], [a[0], b[1]]]
                .map(|p| turn([p[0], p[1], a[2]]));
            let fold = |f: fn(f32, f32) -> f32, axis: usize| {
                base.iter().map(|p| p[axis]).fold(base[0][axis], f)
            };
            Solid {
                min: [fold(f32::min, 0), fold(f32::min, 1), at[2] + a[2]],
                max: [fold(f32::max, 0), fold(f32::max, 1), at[2] + b[2]],
                room: solid.room,
            }
        }));
    }

    /// Marks everything from the given counts on as part of a room.
    pub fn tag(&mut self, from: (usize, usize), room: usize, surface: Surface) {
        for quad in &mut self.quads[from.0..] {
            (quad.room, quad.surface) = (room as u16, surface);
        }
        for solid in &mut self.solids[from.1..] {
            solid.room = room as u16;
        }
    }

    /// Where the next quad and solid will be, for [`Mesh::tag`].
    pub fn mark(&self) -> (usize, usize) {
        (self.quads.len(), self.solids.len())
    }
}
