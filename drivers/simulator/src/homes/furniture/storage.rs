//! Shelves, wardrobes, chests.

use super::workshop::{Piece, Workshop};
use crate::homes::material_set::Appearance;
use crate::homes::mesh::Mesh;
use crate::homes::texture::Skin;

impl Workshop<'_> {
    /// Boards full of books and a few other things.
    pub fn bookshelf(&mut self) -> Piece {
        let w = self.between(0.75, 1.25);
        let h = self.between(1.5, 2.05);
        let d = 0.3;
        let usual = if self.chance(0.3) { self.white } else { self.any_wood() };
        let appearance = self.body(usual);
        let mut piece = Piece::new("bookshelf", [w, d, h], 0.45);
        let m = &mut piece.mesh;
        m.block([0.0, 0.0, 0.0], [w, 0.02, h], appearance);
        m.block([0.0, 0.021, 0.0], [0.025, d, h], appearance);
        m.block([w - 0.025, 0.021, 0.0], [w, d, h], appearance);
        let count = (h / 0.34) as usize;
        let step = (h - 0.1) / count as f32;
        for i in 0..=count {
            let z = 0.06 + step * i as f32;
            m.block([0.026, 0.021, z], [w - 0.026, d - 0.003, z + 0.022], appearance);
            if i < count {
                self.shelf_of_books(m, [0.03, w - 0.03], [0.05, d - 0.02], z + 0.022, step - 0.03);
            }
        }
        piece
    }

    /// Books of all sizes from the left, then a gap, or a stack, or a pot.
    pub fn shelf_of_books(
        &mut self,
        mesh: &mut Mesh,
        x: [f32; 2],
        y: [f32; 2],
        z: f32,
        height: f32,
    ) {
        let fill = x[0] + (x[1] - x[0]) * self.between(0.45, 1.0);
        let mut at = x[0];
        while at < fill - 0.05 {
            let thick = self.between(0.015, 0.05);
            let tall = height * self.between(0.6, 0.93);
            let depth = (y[1] - y[0]) * self.between(0.6, 0.95);
            let appearance = self.book();
            self.book_box(
                mesh,
                [at, y[1] - depth, z],
                [at + thick, y[1] - 0.005, z + tall],
                appearance,
            );
            at += thick + 0.0015;
        }
        if x[1] - at > 0.28 {
            let low = [at + 0.03, y[0] + 0.02];
            let high = [x[1] - 0.02, y[1]];
            self.scatter(mesh, [low[0], low[1], high[0], high[1]], z, 1);
        }
    }

    /// A book: a box whose texture starts at a place of its own, so that titles differ.
    fn book_box(&mut self, mesh: &mut Mesh, min: [f32; 3], max: [f32; 3], appearance: Appearance) {
        let first = mesh.quads.len();
        mesh.trim(min, max, appearance);
        let start = self.between(0.0, 1.0);
        for quad in &mut mesh.quads[first..] {
            for (uv, corner) in quad.uv.iter_mut().zip(quad.corners) {
                *uv = [
                    start + (corner[0] - min[0] + corner[1] - min[1]) / appearance.tile_m,
                    (max[2] - corner[2]) / 0.3,
                ];
            }
        }
    }

    /// Doors with handles over a carcass.
    pub fn wardrobe(&mut self, width: f32) -> Piece {
        let d = 0.6;
        let h = self.between(1.95, 2.2);
        let usual = if self.chance(0.5) { self.white } else { self.any_wood() };
        let appearance = self.body(usual);
        let mut piece = Piece::new("wardrobe", [width, d, h], 0.65);
        let m = &mut piece.mesh;
        m.block([0.0, 0.0, 0.0], [width, d - 0.02, h], appearance);
        let doors = (width / 0.5).round().max(1.0) as usize;
        let each = width / doors as f32;
        for i in 0..doors {
            let x = each * i as f32;
            m.trim([x + 0.004, d - 0.02, 0.07], [x + each - 0.004, d, h - 0.02], appearance);
            let grip = if i % 2 == 0 { x + each - 0.06 } else { x + 0.045 };
            m.trim([grip, d, 0.95], [grip + 0.015, d + 0.025, 1.15], self.metal);
        }
        piece
    }

    /// Rows of drawers with things on top.
    pub fn chest(&mut self, width: f32, rows: usize) -> Piece {
        let d = 0.42;
        let h = 0.08 + 0.2 * rows as f32;
        let usual = if self.chance(0.3) { self.white } else { self.any_wood() };
        let appearance = self.body(usual);
        let mut piece = Piece::new("chest", [width, d, h], 0.5);
        let m = &mut piece.mesh;
        m.block([0.0, 0.0, 0.0], [width, d - 0.02, h - 0.02], appearance);
        m.trim([-0.005, 0.0, h - 0.02], [width + 0.005, d, h], appearance);
        for i in 0..rows {
            let z = 0.06 + 0.195 * i as f32;
            m.trim([0.01, d - 0.02, z], [width - 0.01, d - 0.005, z + 0.185], appearance);
            for x in [width * 0.25, width * 0.75] {
                m.trim(
                    [x - 0.05, d - 0.005, z + 0.09],
                    [x + 0.05, d + 0.015, z + 0.105],
                    self.metal,
                );
            }
        }
        self.scatter(m, [0.06, 0.06, width - 0.06, d - 0.08], h, 3);
        piece
    }

    /// A low sideboard with a television.
    pub fn television(&mut self) -> Piece {
        let w = self.between(1.4, 1.9);
        let d = 0.42;
        let h = 0.5;
        let usual = if self.chance(0.4) { self.white } else { self.any_wood() };
        let appearance = self.body(usual);
        let mut piece = Piece::new("television", [w, d, 1.25], 0.6);
        let m = &mut piece.mesh;
        m.block([0.0, 0.0, 0.06], [w, d - 0.02, h], appearance);
        for (x, y) in [(0.05, 0.05), (w - 0.1, 0.05), (0.05, d - 0.12), (w - 0.1, d - 0.12)] {
            m.trim([x, y, 0.0], [x + 0.05, y + 0.05, 0.06], self.black);
        }
        for i in 0..3 {
            let x = w / 3.0 * i as f32;
            m.trim(
                [x + 0.005, d - 0.02, 0.07],
                [x + w / 3.0 - 0.005, d - 0.004, h - 0.01],
                appearance,
            );
        }
        let off = self.materials.appearance("dark screen", [40, 42, 48], Skin::Smudge);
        self.monitor(m, [w / 2.0 - 0.58, 0.12, h], [1.16, 0.66], off);
        self.scatter(m, [0.04, 0.08, w / 2.0 - 0.62, d - 0.08], h, 1);
        self.scatter(m, [w / 2.0 + 0.62, 0.08, w - 0.04, d - 0.08], h, 1);
        piece
    }

    /// A steel cabinet with drawers for files, a printer on top perhaps.
    pub fn filing_cabinet(&mut self) -> Piece {
        let w = 0.46;
        let d = 0.6;
        let h = self.between(0.72, 1.3);
        let printer = h < 0.9 && self.chance(0.5);
        let total = if printer { h + 0.3 } else { h };
        let mut piece = Piece::new("filing cabinet", [w, d, total], 0.5);
        let m = &mut piece.mesh;
        m.block([0.0, 0.0, 0.0], [w, d - 0.015, h], self.metal);
        let rows = (h / 0.32) as usize;
        let step = (h - 0.04) / rows as f32;
        for i in 0..rows {
            let z = 0.03 + step * i as f32;
            m.trim([0.01, d - 0.015, z], [w - 0.01, d, z + step - 0.01], self.metal);
            m.trim(
                [w / 2.0 - 0.07, d, z + step - 0.09],
                [w / 2.0 + 0.07, d + 0.015, z + step - 0.07],
                self.black,
            );
        }
        if printer {
            m.block([0.02, 0.08, h + 0.002], [w - 0.02, d - 0.06, h + 0.28], self.white);
            m.trim([0.06, d - 0.06, h + 0.1], [w - 0.06, d + 0.02, h + 0.12], self.black);
        }
        piece
    }
}
