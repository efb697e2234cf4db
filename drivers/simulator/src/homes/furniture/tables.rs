//! Tables, with chairs and the objects on them.

use super::workshop::{Piece, Workshop};
use crate::homes::material_set::Appearance;
use crate::homes::texture::Skin;

impl Workshop<'_> {
    /// Four legs, an apron and a top. A scan near the floor sees only the legs.
    pub fn table(&mut self, size: [f32; 3], appearance: Appearance) -> Piece {
        let [w, d, h] = size;
        let mut piece = Piece::new("table", size, 0.0);
        let m = &mut piece.mesh;
        let leg = 0.05;
        for (x, y) in [
            (0.04, 0.04),
            (w - 0.04 - leg, 0.04),
            (0.04, d - 0.04 - leg),
            (w - 0.04 - leg, d - 0.04 - leg),
        ] {
            m.block([x, y, 0.0], [x + leg, y + leg, h - 0.03], appearance);
        }
        m.block([0.0, 0.0, h - 0.03], [w, d, h], appearance);
        for y in [0.055, d - 0.085] {
            m.trim([0.09, y, h - 0.1], [w - 0.09, y + 0.02, h - 0.03], appearance);
        }
        piece
    }

    pub fn coffee_table(&mut self) -> Piece {
        let w = self.between(0.8, 1.1);
        let d = self.between(0.48, 0.58);
        let wood = self.any_wood();
        let mut piece = self.table([w, d, 0.42], wood);
        piece.name = "coffee table";
        self.scatter(&mut piece.mesh, [0.1, 0.08, w - 0.1, d - 0.08], 0.42, 3);
        piece
    }

    /// A table with chairs along both long sides and perhaps at its ends.
    pub fn dining_set(&mut self, pairs: usize, ends: bool) -> Piece {
        let wood = self.any_wood();
        let chair_wood = if self.chance(0.7) { wood } else { self.white };
        let w = 0.2 + 0.62 * pairs as f32;
        let d = self.between(0.78, 0.9);
        let margin = if ends { 0.3 } else { 0.0 };
        let out = 0.34;
        let mut piece = Piece::new("dining table", [w + 2.0 * margin, d + 2.0 * out, 0.88], 0.0);
        let mut table = self.table([w, d, 0.75], wood);
        self.scatter(&mut table.mesh, [0.2, 0.15, w - 0.2, d - 0.15], 0.75, 1 + pairs);
        piece.with(&table, [margin, out], false);
        let chair = self.chair(chair_wood);
        for i in 0..pairs {
            let x = margin + (w - 0.62 * pairs as f32) / 2.0 + 0.62 * i as f32 + 0.09;
            piece.with(&chair, [x, self.between(0.0, 0.06)], false);
            piece.with(&chair, [x, d + 2.0 * out - 0.48 - self.between(0.0, 0.06)], true);
        }
        if ends {
            let y = out + d / 2.0;
            for (x, side) in [(0.0, -1.0_f32), (w + 2.0 * margin, 1.0)] {
                let at = [x, y + 0.22 * side, 0.0];
                piece.mesh.append(&chair.mesh, at, side * std::f32::consts::FRAC_PI_2);
            }
        }
        piece
    }

    /// A desk at a wall with a screen and a chair before it.
    pub fn desk(&mut self) -> Piece {
        let w = self.between(1.2, 1.6);
        let d = self.between(0.65, 0.75);
        let mut piece = Piece::new("desk", [w, d + 0.5, 0.8], 0.2);
        self.workplace(&mut piece, w, d);
        let chair = self.office_chair();
        let x = self.between(0.35 * w, 0.6 * w) - 0.29;
        piece.with(&chair, [x, d - 0.08], true);
        piece
    }

    /// The table of a desk with what is on it; back at y = 0.
    fn workplace(&mut self, piece: &mut Piece, w: f32, d: f32) {
        let appearance = if self.chance(0.6) { self.any_wood() } else { self.white };
        let mut table = self.table([w, d, 0.74], appearance);
        let m = &mut table.mesh;
        m.block([w - 0.48, 0.08, 0.06], [w - 0.1, d - 0.06, 0.6], self.white);
        for i in 0..3 {
            let z = 0.08 + 0.17 * i as f32;
            m.trim([w - 0.475, d - 0.06, z], [w - 0.105, d - 0.045, z + 0.155], self.white);
            m.trim([w - 0.34, d - 0.045, z + 0.11], [w - 0.24, d - 0.03, z + 0.12], self.metal);
        }
        let version = u8::from(self.chance(0.4));
        let screen = self.materials.glowing("screen", [215, 215, 220], Skin::Screen(version), 0.25);
        let x = w * 0.42;
        self.monitor(m, [x - 0.3, 0.16, 0.74], [0.6, 0.36], screen);
        m.trim([x - 0.22, 0.36, 0.742], [x + 0.22, 0.5, 0.76], self.black);
        m.trim([x + 0.27, 0.4, 0.742], [x + 0.33, 0.5, 0.77], self.black);
        self.scatter(m, [w * 0.68, 0.1, w - 0.08, d - 0.1], 0.74, 2);
        piece.with(&table, [0.0, 0.0], false);
    }

    /// A flat screen on a foot; `at` is its back left lower corner.
    pub fn monitor(
        &mut self,
        mesh: &mut crate::homes::mesh::Mesh,
        at: [f32; 3],
        size: [f32; 2],
        screen: Appearance,
    ) {
        let [x, y, z] = at;
        let [w, h] = size;
        mesh.trim(
            [x + w / 2.0 - 0.12, y - 0.04, z + 0.002],
            [x + w / 2.0 + 0.12, y + 0.12, z + 0.015],
            self.black,
        );
        mesh.trim(
            [x + w / 2.0 - 0.03, y, z + 0.015],
            [x + w / 2.0 + 0.03, y + 0.02, z + 0.12],
            self.black,
        );
        mesh.trim([x, y + 0.02, z + 0.1], [x + w, y + 0.05, z + 0.1 + h], self.black);
        let x0 = x + 0.012;
        let x1 = x + w - 0.012;
        let y = y + 0.053;
        let z0 = z + 0.112;
        let z1 = z + 0.088 + h;
        mesh.stretched_face([[x1, y, z0], [x0, y, z0], [x0, y, z1], [x1, y, z1]], screen);
    }

    /// Four desks back to back with a low screen between them.
    pub fn desk_island(&mut self, columns: usize) -> Piece {
        let w = 1.4;
        let d = 0.7;
        let total = w * columns as f32;
        let mut piece = Piece::new("desk island", [total, 2.0 * d + 1.1, 1.1], 0.0);
        let middle = 0.55 + d;
        for i in 0..columns {
            let x = w * i as f32;
            for reversed in [false, true] {
                let mut place = Piece::new("desk", [w - 0.01, d, 0.8], 0.0);
                self.workplace(&mut place, w - 0.01, d);
                let y = if reversed { middle - 0.02 - d } else { middle + 0.02 };
                piece.with(&place, [x, y], reversed);
                let chair = self.office_chair();
                let cx = x + 0.4 + self.between(-0.1, 0.2);
                let cy = if reversed {
                    self.between(0.0, 0.1)
                } else {
                    2.0 * d + 1.1 - 0.58 - self.between(0.0, 0.1)
                };
                piece.with(&chair, [cx, cy], !reversed);
            }
        }
        let felt = self.cloths[2];
        piece.mesh.block([0.0, middle - 0.015, 0.3], [total, middle + 0.015, 1.1], felt);
        piece
    }

    /// A long table with a row of chairs at each side.
    pub fn meeting_set(&mut self, pairs: usize) -> Piece {
        let w = 0.3 + 0.75 * pairs as f32;
        let d = 1.1;
        let out = 0.42;
        let appearance = if self.chance(0.5) { self.white } else { self.wood };
        let mut piece = Piece::new("meeting table", [w, d + 2.0 * out, 1.0], 0.0);
        let mut table = self.table([w, d, 0.74], appearance);
        self.scatter(&mut table.mesh, [0.3, 0.2, w - 0.3, d - 0.2], 0.74, pairs);
        piece.with(&table, [0.0, out], false);
        for i in 0..pairs {
            let x = 0.15 + 0.75 * i as f32 + 0.08;
            let near = self.office_chair();
            let far = self.office_chair();
            piece.with(&near, [x, self.between(0.0, 0.08)], false);
            piece.with(&far, [x, d + 2.0 * out - 0.58 - self.between(0.0, 0.08)], true);
        }
        piece
    }

    pub fn nightstand(&mut self) -> Piece {
        let wood = self.any_wood();
        let mut piece = Piece::new("nightstand", [0.45, 0.4, 0.5], 0.0);
        let m = &mut piece.mesh;
        m.block([0.0, 0.0, 0.04], [0.45, 0.38, 0.5], wood);
        for z in [0.07, 0.28] {
            m.trim([0.012, 0.38, z], [0.438, 0.395, z + 0.19], wood);
            m.trim([0.19, 0.395, z + 0.1], [0.26, 0.41, z + 0.115], self.metal);
        }
        self.lamp(&mut piece.mesh, [0.15, 0.18], 0.5);
        self.scatter(&mut piece.mesh, [0.24, 0.1, 0.42, 0.34], 0.5, 1);
        piece
    }
}
