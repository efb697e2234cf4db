//! Quads with texture coordinates at a uniform scale, and the solids that shade them.

use super::material_set::Appearance;
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

/// An axis-aligned box that occludes ambient light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solid {
    pub min: [f32; 3],
    pub max: [f32; 3],
    pub room: u16,
}

/// Faces and solids of a piece of furniture or of a whole home.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Mesh {
    pub quads: Vec<Quad>,
    pub solids: Vec<Solid>,
}

/// Corner indices of a box's faces (bit 0: x, bit 1: y, bit 2: z), with the axes that u and v
/// follow.
const FACES: [([usize; 4], [usize; 2]); 6] = [
    ([0, 2, 3, 1], [0, 1]),
    ([4, 5, 7, 6], [0, 1]),
    ([0, 1, 5, 4], [0, 2]),
    ([3, 2, 6, 7], [0, 2]),
    ([2, 0, 4, 6], [1, 2]),
    ([1, 3, 7, 5], [1, 2]),
];

impl Mesh {
    /// Adds a face with given texture coordinates.
    pub fn quad(&mut self, corners: [[f32; 3]; 4], uv: [[f32; 2]; 4], appearance: Appearance) {
        self.quads.push(Quad {
            corners,
            uv,
            material: appearance.material,
            room: 0,
            surface: Surface::Furniture,
        });
    }

    /// Adds a face with an image stretched over it. The image's top left is at the last corner.
    pub fn stretched_face(&mut self, corners: [[f32; 3]; 4], appearance: Appearance) {
        self.quad(corners, [[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]], appearance);
    }

    /// Adds a solid box that occludes ambient light; see [`Mesh::trim`].
    pub fn block(&mut self, min: [f32; 3], max: [f32; 3], appearance: Appearance) {
        self.trim(min, max, appearance);
        self.solids.push(Solid { min, max, room: 0 });
    }

    /// Adds a box that is too small to occlude ambient light. A bottom face that lies on the floor
    /// is left out.
    ///
    /// Textures run along the longer edge of a face, as wood is sawn. Their origin depends on the
    /// position, so that equal boxes look different.
    pub fn trim(&mut self, min: [f32; 3], max: [f32; 3], appearance: Appearance) {
        let shift = (min[0] * 7.31 + min[1] * 3.77 + min[2] * 5.13 + max[0] * 1.7).fract();
        let first = usize::from(min[2] < 1e-3);
        for (indices, axes) in &FACES[first..] {
            let corners: [[f32; 3]; 4] = indices
                .map(|i| std::array::from_fn(|a| if i >> a & 1 == 0 { min[a] } else { max[a] }));
            let size = axes.map(|a| max[a] - min[a]);
            let axes = if size[1] > size[0] { [axes[1], axes[0]] } else { *axes };
            self.quad(
                corners,
                corners.map(|c| axes.map(|a| c[a] / appearance.tile_m + shift)),
                appearance,
            );
        }
    }

    /// Adds a flat object on a wall with sloped edges: seen from the front, the edges stay wider
    /// than a pixel.
    pub fn plate(&mut self, x: [f32; 2], z: [f32; 2], y: [f32; 2], appearance: Appearance) {
        let bevel = (y[1] - y[0]).min((z[1] - z[0]) / 3.0);
        let back = plate_ring(0.0, y[0], x, z);
        let front = plate_ring(bevel, y[1], x, z);
        self.quad(front, upright(front, appearance), appearance);
        for i in 0..4 {
            let j = (i + 1) % 4;
            let corners = [back[i], back[j], front[j], front[i]];
            self.quad(corners, upright(corners, appearance), appearance);
        }
    }

    /// Adds a box with rounded upper and lower edges, for upholstery.
    pub fn cushion(&mut self, min: [f32; 3], max: [f32; 3], appearance: Appearance) {
        let extent: [f32; 3] = std::array::from_fn(|a| max[a] - min[a]);
        let c = (extent[0].min(extent[1]).min(extent[2]) * 0.3).min(0.04);
        let rings = [
            cushion_ring(c, min[2], min, max),
            cushion_ring(0.0, min[2] + c, min, max),
            cushion_ring(0.0, max[2] - c, min, max),
            cushion_ring(c, max[2], min, max),
        ];
        let mut around = [0.0; 5];
        for i in 0..4 {
            around[i + 1] = around[i] + if i % 2 == 0 { extent[0] } else { extent[1] };
        }
        for pair in rings.windows(2) {
            for i in 0..4 {
                let j = (i + 1) % 4;
                let corners = [pair[0][i], pair[0][j], pair[1][j], pair[1][i]];
                let u = [around[i], around[i + 1], around[i + 1], around[i]];
                let uv = std::array::from_fn(|k| {
                    [u[k] / appearance.tile_m, corners[k][2] / appearance.tile_m]
                });
                self.quad(corners, uv, appearance);
            }
        }
        self.quad(rings[3], flat(rings[3], appearance), appearance);
        let bottom = [rings[0][3], rings[0][2], rings[0][1], rings[0][0]];
        self.quad(bottom, flat(bottom, appearance), appearance);
        self.solids.push(Solid { min, max, room: 0 });
    }

    /// Adds an upright cylinder or cone with `sides` faces and closed ends.
    pub fn post(
        &mut self,
        at: [f32; 2],
        z: [f32; 2],
        radius: [f32; 2],
        sides: usize,
        appearance: Appearance,
    ) {
        let girth = std::f32::consts::TAU * radius[0].max(radius[1]);
        for k in 0..sides {
            let corners = [
                rim_point(k, 0, at, z, radius, sides),
                rim_point(k + 1, 0, at, z, radius, sides),
                rim_point(k + 1, 1, at, z, radius, sides),
                rim_point(k, 1, at, z, radius, sides),
            ];
            let u = [k, k + 1].map(|k| girth * k as f32 / sides as f32 / appearance.tile_m);
            let v = z.map(|z| z / appearance.tile_m);
            self.quad(
                corners,
                [[u[0], v[0]], [u[1], v[0]], [u[1], v[1]], [u[0], v[1]]],
                appearance,
            );
        }
        for end in 0..2 {
            if radius[end] > 1e-3 && (end == 1 || z[0] > 1e-3) {
                let around: Vec<_> = (0..sides)
                    .map(|k| {
                        rim_point(
                            if end == 1 { k } else { sides - 1 - k },
                            end,
                            at,
                            z,
                            radius,
                            sides,
                        )
                    })
                    .collect();
                self.disc(&around, appearance);
            }
        }
        let r = radius[0].max(radius[1]) * 0.85;
        if r > 0.04 {
            let min = [at[0] - r, at[1] - r, z[0]];
            let max = [at[0] + r, at[1] + r, z[1]];
            self.solids.push(Solid { min, max, room: 0 });
        }
    }

    /// Adds a convex polygon with an even number of corners, as quads that share its first corner.
    fn disc(&mut self, rim: &[[f32; 3]], appearance: Appearance) {
        for i in (1..rim.len() - 2).step_by(2) {
            let corners = [rim[0], rim[i], rim[i + 1], rim[i + 2]];
            self.quad(corners, flat(corners, appearance), appearance);
        }
    }

    /// Adds another mesh, rotated by `yaw_rad` about the vertical and then translated.
    pub fn append(&mut self, other: &Self, at: [f32; 3], yaw_rad: f32) {
        self.append_rotated(other, at, [yaw_rad.cos(), yaw_rad.sin()]);
    }

    /// Adds a piece that was built along the south wall to another wall. The quarter rotation is
    /// exact, without rounded sines.
    pub fn append_at_wall(&mut self, other: &Self, at: [f32; 3], side: Side) {
        let rotate = [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]][side.quarter_rotations()];
        self.append_rotated(other, at, rotate);
    }

    fn append_rotated(&mut self, other: &Self, at: [f32; 3], rotation: [f32; 2]) {
        self.quads.extend(other.quads.iter().map(|q| {
            let corners = q.corners.map(|p| rotated(p, at, rotation));
            Quad { corners, ..*q }
        }));
        self.solids.extend(other.solids.iter().map(|solid| {
            let a = solid.min;
            let b = solid.max;
            let base = [[a[0], a[1]], [b[0], a[1]], [b[0], b[1]], [a[0], b[1]]]
                .map(|p| rotated([p[0], p[1], a[2]], at, rotation));
            Solid {
                min: [fold_axis(f32::min, 0, &base), fold_axis(f32::min, 1, &base), at[2] + a[2]],
                max: [fold_axis(f32::max, 0, &base), fold_axis(f32::max, 1, &base), at[2] + b[2]],
                room: solid.room,
            }
        }));
    }

    /// Assigns all quads and solids from the given counts on to a room and a kind of surface.
    pub fn tag(&mut self, from: (usize, usize), room: usize, surface: Surface) {
        for quad in &mut self.quads[from.0..] {
            (quad.room, quad.surface) = (room as u16, surface);
        }
        for solid in &mut self.solids[from.1..] {
            solid.room = room as u16;
        }
    }

    /// Counts of quads and solids, for [`Mesh::tag`].
    pub fn mark(&self) -> (usize, usize) {
        (self.quads.len(), self.solids.len())
    }
}

fn rotated(p: [f32; 3], at: [f32; 3], [c, s]: [f32; 2]) -> [f32; 3] {
    [at[0] + c * p[0] - s * p[1], at[1] + s * p[0] + c * p[1], at[2] + p[2]]
}

/// Texture coordinates of a face that lies flat.
pub fn flat(corners: [[f32; 3]; 4], appearance: Appearance) -> [[f32; 2]; 4] {
    corners.map(|c| [c[0] / appearance.tile_m, c[1] / appearance.tile_m])
}

/// Texture coordinates of a face that stands upright along x.
fn upright(corners: [[f32; 3]; 4], appearance: Appearance) -> [[f32; 2]; 4] {
    corners.map(|c| [c[0] / appearance.tile_m, -c[2] / appearance.tile_m])
}

fn rim_point(
    k: usize,
    end: usize,
    at: [f32; 2],
    z: [f32; 2],
    radius: [f32; 2],
    sides: usize,
) -> [f32; 3] {
    let angle = std::f32::consts::TAU * k as f32 / sides as f32;
    [at[0] + radius[end] * angle.cos(), at[1] + radius[end] * angle.sin(), z[end]]
}

fn cushion_ring(inset: f32, z: f32, min: [f32; 3], max: [f32; 3]) -> [[f32; 3]; 4] {
    let x0 = min[0] + inset;
    let x1 = max[0] - inset;
    let y0 = min[1] + inset;
    let y1 = max[1] - inset;
    [[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]]
}

fn plate_ring(inset: f32, y: f32, x: [f32; 2], z: [f32; 2]) -> [[f32; 3]; 4] {
    let x = [x[0] + inset, x[1] - inset];
    let z = [z[0] + inset, z[1] - inset];
    [[x[1], y, z[0]], [x[0], y, z[0]], [x[0], y, z[1]], [x[1], y, z[1]]]
}

fn fold_axis(f: fn(f32, f32) -> f32, axis: usize, base: &[[f32; 3]; 4]) -> f32 {
    base.iter().map(|p| p[axis]).fold(base[0][axis], f)
}
