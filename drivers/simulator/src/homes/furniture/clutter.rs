//! Small objects on tables, on shelves and on the floor along walls.

use rand::RngExt;

use super::workshop::{Piece, Workshop};
use crate::homes::mesh::Mesh;
use crate::homes::texture::Skin;

impl Workshop<'_> {
    /// Places up to `count` objects side by side on a surface within `x0, y0, x1, y1`.
    pub fn scatter(&mut self, mesh: &mut Mesh, [x0, y0, x1, y1]: [f32; 4], z: f32, count: usize) {
        // Slots keep objects from overlapping.
        let slot = (x1 - x0) / count as f32;
        for i in 0..count {
            let half_x = slot / 2.0;
            let half_y = (y1 - y0) / 2.0;
            let reach = half_x.min(half_y);
            if reach < 0.05 || self.chance(0.15) {
                continue;
            }
            let x =
                x0 + slot * (i as f32 + 0.5) + self.between(-0.2, 0.2) * (half_x - reach).max(0.0);
            let y = (y0 + y1) / 2.0 + self.between(-0.8, 0.8) * (half_y - reach).max(0.0);
            self.small_thing(mesh, [x, y], z + 0.001, reach.min(0.16));
        }
    }

    fn small_thing(&mut self, mesh: &mut Mesh, [x, y]: [f32; 2], z: f32, reach: f32) {
        let appearance = self.paint();
        match self.rng.random_range(0..7) {
            0 => mesh.post([x, y], [z, z + 0.095], [0.036, 0.04], 8, appearance),
            1 => {
                let r = reach.min(0.12);
                mesh.post([x, y], [z, z + 0.03], [r * 0.4, r * 0.8], 10, appearance);
                mesh.post([x, y], [z + 0.03, z + 0.065], [r * 0.8, r], 10, appearance);
            }
            2 | 3 => {
                let mut top = z;
                for _ in 0..self.rng.random_range(1..5) {
                    let w = reach * self.between(0.75, 0.95);
                    let d = reach * self.between(0.55, 0.7);
                    let t = self.between(0.015, 0.035);
                    let appearance = self.book();
                    let yaw = self.between(-0.25, 0.25);
                    let mut book = Mesh::default();
                    book.trim([-w * 0.8, -d, 0.0], [w * 0.8, d, t], appearance);
                    mesh.append(&book, [x, y, top], yaw);
                    top += t + 0.001;
                }
            }
            4 => {
                mesh.post([x, y], [z, z + 0.15], [0.035, 0.05], 8, appearance);
                self.leaves(mesh, [x, y, z + 0.13], reach.min(0.14), 7);
            }
            5 => {
                mesh.post([x, y], [z, z + 0.17], [0.034, 0.034], 8, appearance);
                mesh.post([x, y], [z + 0.17, z + 0.26], [0.034, 0.012], 8, appearance);
            }
            _ => {
                let w = reach * 0.7;
                let d = reach * 0.5;
                mesh.trim(
                    [x - w, y - d, z],
                    [x + w, y + d, z + self.between(0.05, 0.14)],
                    appearance,
                );
            }
        }
    }

    /// A foot, a stem and a shade that glows.
    pub fn lamp(&mut self, mesh: &mut Mesh, at: [f32; 2], z: f32) {
        let shade = self.materials.glowing("lamp shade", [255, 240, 214], Skin::Cloth(0), 0.35);
        mesh.post(at, [z, z + 0.02], [0.06, 0.06], 8, self.metal);
        mesh.post(at, [z + 0.02, z + 0.24], [0.012, 0.012], 6, self.metal);
        mesh.post(at, [z + 0.22, z + 0.38], [0.12, 0.08], 10, shade);
    }

    pub fn floor_lamp(&mut self) -> Piece {
        let shade = self.materials.glowing("lamp shade", [255, 240, 214], Skin::Cloth(0), 0.35);
        let mut piece = Piece::new("floor lamp", [0.4, 0.4, 1.6], 0.0);
        piece.mesh.post([0.2, 0.2], [0.0, 0.025], [0.15, 0.15], 10, self.black);
        piece.mesh.post([0.2, 0.2], [0.025, 1.35], [0.014, 0.014], 6, self.metal);
        piece.mesh.post([0.2, 0.2], [1.3, 1.6], [0.19, 0.13], 12, shade);
        piece
    }

    /// Bent leaves around a point, each of two faces.
    fn leaves(&mut self, mesh: &mut Mesh, at: [f32; 3], reach: f32, count: usize) {
        for i in 0..count {
            let angle = std::f32::consts::TAU * (i as f32 * 0.382 + self.between(-0.04, 0.04));
            let out = reach * self.between(0.6, 1.0);
            let up = reach * self.between(0.5, 1.6);
            let half = reach * self.between(0.2, 0.34);
            let c = angle.cos();
            let s = angle.sin();
            let root =
                [leaf_point(0.0, -0.004, 0.0, at, [c, s]), leaf_point(0.0, 0.004, 0.0, at, [c, s])];
            let middle = up * 0.8;
            let wide = [
                leaf_point(out * 0.55, -half, middle, at, [c, s]),
                leaf_point(out * 0.55, half, middle, at, [c, s]),
            ];
            let tip = [
                leaf_point(out, 0.004, up * 0.75, at, [c, s]),
                leaf_point(out, -0.004, up * 0.75, at, [c, s]),
            ];
            let start = self.between(0.0, 1.0);
            let strip = [[start, 0.1], [start + 0.4, 0.0], [start + 0.4, 0.3], [start, 0.2]];
            mesh.quad([root[0], wide[0], wide[1], root[1]], strip, self.leaf);
            mesh.quad([wide[0], tip[1], tip[0], wide[1]], strip, self.leaf);
        }
    }

    /// A pot plant that stands on the floor.
    pub fn plant(&mut self) -> Piece {
        let size = self.between(0.4, 0.56);
        let pot = self.paint();
        let c = size / 2.0;
        let stem = self.between(0.3, 0.6);
        let mut piece = Piece::new("plant", [size, size, 1.2], 0.0);
        piece.mesh.post([c, c], [0.0, 0.28], [size * 0.24, size * 0.34], 10, pot);
        piece.mesh.post([c, c], [0.26, 0.283], [size * 0.31, size * 0.31], 10, self.dark_wood);
        piece.mesh.post([c, c], [0.28, 0.3 + stem], [0.014, 0.01], 5, self.dark_wood);
        for level in 0..5 {
            let z = 0.3 + stem * level as f32 / 4.0;
            self.leaves(&mut piece.mesh, [c, c, z], c, 8);
        }
        piece
    }

    /// An object left on the floor.
    pub fn floor_thing(&mut self, for_children: bool) -> Piece {
        match self.rng.random_range(0..if for_children { 6 } else { 4 }) {
            0 => {
                let w = self.between(0.28, 0.5);
                let d = self.between(0.25, 0.4);
                let h = self.between(0.18, 0.4);
                let mut piece = Piece::new("carton", [w, d, h], 0.0);
                piece.mesh.block([0.0, 0.0, 0.0], [w, d, h], self.carton);
                piece.mesh.trim(
                    [w / 2.0 - 0.03, -0.001, h],
                    [w / 2.0 + 0.03, d + 0.001, h + 0.002],
                    self.linen,
                );
                piece
            }
            1 => {
                let cloth = self.cloth();
                let mut piece = Piece::new("basket", [0.38, 0.38, 0.4], 0.0);
                piece.mesh.post([0.19, 0.19], [0.0, 0.36], [0.15, 0.185], 12, self.wood);
                piece.mesh.cushion([0.08, 0.08, 0.33], [0.3, 0.3, 0.42], cloth);
                piece
            }
            2 => {
                let appearance = self.book();
                let mut piece = Piece::new("shoes", [0.5, 0.32, 0.12], 0.0);
                for x in [0.02, 0.14, 0.34] {
                    piece.mesh.trim([x, 0.02, 0.0], [x + 0.09, 0.3, 0.05], appearance);
                    piece.mesh.block([x, 0.02, 0.05], [x + 0.09, 0.16, 0.11], appearance);
                }
                piece
            }
            3 => {
                let cloth = self.cloth();
                let mut piece = Piece::new("bag", [0.42, 0.24, 0.36], 0.0);
                piece.mesh.cushion([0.0, 0.0, 0.0], [0.42, 0.24, 0.32], cloth);
                piece.mesh.trim([0.1, 0.11, 0.32], [0.13, 0.13, 0.38], self.black);
                piece.mesh.trim([0.29, 0.11, 0.32], [0.32, 0.13, 0.38], self.black);
                piece
            }
            4 => {
                let mut piece = Piece::new("toy blocks", [0.5, 0.4, 0.2], 0.0);
                for i in 0..9 {
                    let appearance = self.paint();
                    let mut block = Mesh::default();
                    block.trim([-0.035, -0.035, 0.0], [0.035, 0.035, 0.07], appearance);
                    let x = 0.07 + 0.17 * (i % 3) as f32;
                    let y = 0.07 + 0.12 * (i / 3) as f32;
                    let dx = self.between(-0.02, 0.02);
                    let yaw = self.between(0.0, 1.5);
                    piece.mesh.append(&block, [x + dx, y, 0.0], yaw);
                }
                piece
            }
            _ => {
                let mut piece = Piece::new("book stack", [0.34, 0.26, 0.3], 0.0);
                let mut z = 0.0;
                for _ in 0..self.rng.random_range(4..9) {
                    let t = self.between(0.02, 0.04);
                    let inset = self.between(0.0, 0.05);
                    let appearance = self.book();
                    piece.mesh.block(
                        [inset, inset, z],
                        [0.32 - inset * 0.6, 0.24 - inset * 0.5, z + t],
                        appearance,
                    );
                    z += t + 0.001;
                }
                piece
            }
        }
    }
}

fn leaf_point(r: f32, side: f32, h: f32, at: [f32; 3], [c, s]: [f32; 2]) -> [f32; 3] {
    [at[0] + c * r - s * side, at[1] + s * r + c * side, at[2] + h]
}
