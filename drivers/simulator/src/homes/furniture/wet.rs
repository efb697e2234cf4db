//! Kitchen units and bathroom fixtures.

use super::workshop::{Piece, Workshop};
use crate::homes::material_set::Appearance;
use crate::homes::texture::Skin;

impl Workshop<'_> {
    /// A row of base units with sink and hob; `tall`: with cupboards above.
    pub fn counter(&mut self, units: usize, tall: bool, front: Appearance) -> Piece {
        let w = 0.6 * units as f32;
        let d = 0.6;
        let h = 0.9;
        let mut piece = Piece::new("counter", [w, d, if tall { 2.15 } else { h }], 0.75);
        let m = &mut piece.mesh;
        m.block([0.0, 0.0, 0.0], [w, d - 0.07, 0.1], self.black);
        m.block([0.0, 0.0, 0.1], [w, d - 0.03, h - 0.04], self.white);
        m.block([0.0, 0.0, h - 0.04], [w, d, h], self.stone);
        for i in 0..units {
            let x = 0.6 * i as f32;
            if i == 1 {
                // The oven, under the hob.
                m.trim([x + 0.005, d - 0.03, 0.12], [x + 0.595, d - 0.01, 0.7], self.black);
                m.trim([x + 0.06, d - 0.01, 0.64], [x + 0.54, d + 0.02, 0.66], self.metal);
                m.trim([x + 0.005, d - 0.03, 0.71], [x + 0.595, d - 0.012, 0.85], self.metal);
                m.trim([x + 0.03, 0.06, h], [x + 0.57, d - 0.07, h + 0.006], self.black);
                continue;
            }
            m.trim([x + 0.004, d - 0.03, 0.12], [x + 0.596, d - 0.01, 0.68], front);
            m.trim([x + 0.004, d - 0.03, 0.69], [x + 0.596, d - 0.01, 0.85], front);
            for z in [0.63, 0.77] {
                m.trim([x + 0.22, d - 0.01, z], [x + 0.38, d + 0.012, z + 0.015], self.metal);
            }
        }
        let sink = w - 0.58;
        m.trim([sink, 0.08, h], [sink + 0.5, d - 0.08, h + 0.005], self.metal);
        m.trim([sink + 0.04, 0.14, h + 0.005], [sink + 0.46, d - 0.12, h + 0.008], self.black);
        m.post([sink + 0.25, 0.1], [h, h + 0.28], [0.015, 0.012], 6, self.metal);
        m.trim([sink + 0.24, 0.1, h + 0.27], [sink + 0.26, 0.26, h + 0.29], self.metal);
        if units > 3 {
            self.scatter(m, [1.25, 0.1, w - 0.65, 0.4], h, 3);
        }
        self.scatter(m, [0.05, 0.1, 0.55, 0.4], h, 2);
        if tall {
            let splash =
                self.materials.appearance("splashback", [232, 228, 220], Skin::Tiles(true));
            m.trim([0.0, 0.0, h], [w, 0.012, 1.45], splash);
            m.block([0.0, 0.0, 1.45], [w, 0.33, 2.15], self.white);
            for i in 0..units {
                let x = 0.6 * i as f32;
                m.trim([x + 0.004, 0.33, 1.46], [x + 0.596, 0.348, 2.14], front);
                m.trim([x + 0.05, 0.348, 1.5], [x + 0.065, 0.37, 1.62], self.metal);
            }
        }
        piece
    }

    pub fn fridge(&mut self) -> Piece {
        let usual = if self.chance(0.5) { self.white } else { self.metal };
        let appearance = self.body(usual);
        let mut piece = Piece::new("fridge", [0.6, 0.65, 1.8], 0.65);
        let m = &mut piece.mesh;
        m.block([0.0, 0.0, 0.0], [0.6, 0.6, 1.8], appearance);
        for (z0, z1) in [(0.06, 0.66), (0.67, 1.79)] {
            m.trim([0.004, 0.6, z0], [0.596, 0.645, z1], appearance);
            m.trim([0.05, 0.645, z1 - 0.42], [0.07, 0.67, z1 - 0.05], self.metal);
        }
        for i in 0..3 {
            let x = 0.12 + 0.13 * i as f32;
            let z = self.between(1.1, 1.5);
            let note = self.paint();
            piece.mesh.trim([x, 0.645, z], [x + 0.09, 0.648, z + 0.12], note);
        }
        piece
    }

    /// A tub with a hollow inside.
    pub fn tub(&mut self) -> Piece {
        let w = 1.65;
        let d = 0.74;
        let h = 0.56;
        let rim = 0.07;
        let mut piece = Piece::new("tub", [w, d, h], 0.5);
        let m = &mut piece.mesh;
        let appearance = self.ceramic;
        m.block([0.0, 0.0, 0.0], [rim, d, h], appearance);
        m.block([w - rim, 0.0, 0.0], [w, d, h], appearance);
        m.block([rim, 0.0, 0.0], [w - rim, rim, h], appearance);
        m.block([rim, d - rim, 0.0], [w - rim, d, h], appearance);
        m.block([rim, rim, 0.0], [w - rim, d - rim, 0.12], appearance);
        m.trim([0.02, d / 2.0 - 0.02, h], [0.05, d / 2.0 + 0.02, h + 0.14], self.metal);
        m.trim([0.02, d / 2.0 - 0.015, h + 0.12], [0.2, d / 2.0 + 0.015, h + 0.14], self.metal);
        let towel = self.cloth();
        m.trim([w * 0.6, d - rim - 0.005, h - 0.3], [w * 0.6 + 0.3, d + 0.008, h + 0.008], towel);
        piece
    }

    /// A tray with a rail and a drawn curtain.
    pub fn shower(&mut self) -> Piece {
        let w = 0.9;
        let h = 2.0;
        let mut piece = Piece::new("shower", [w, w, h], 0.45);
        let cloth = self.cloth();
        let m = &mut piece.mesh;
        m.block([0.0, 0.0, 0.0], [w, w, 0.06], self.ceramic);
        m.trim([0.0, w - 0.03, h - 0.02], [w, w - 0.01, h], self.metal);
        for i in 0..10 {
            let (x0, y0) = curtain_fold(i, w);
            let (x1, y1) = curtain_fold(i + 1, w);
            let corners = [[x1, y1, 0.12], [x0, y0, 0.12], [x0, y0, h], [x1, y1, h]];
            let uv = corners.map(|[x, _, z]| [x * 1.4 / cloth.tile_m, -z / cloth.tile_m]);
            m.quad(corners, uv, cloth);
        }
        m.trim([w / 2.0 - 0.012, 0.005, 0.9], [w / 2.0 + 0.012, 0.03, 1.95], self.metal);
        m.post([w / 2.0, 0.16], [1.93, 1.96], [0.09, 0.09], 8, self.metal);
        m.trim([w / 2.0 - 0.01, 0.03, 1.94], [w / 2.0 + 0.01, 0.1, 1.955], self.metal);
        piece
    }

    pub fn toilet(&mut self) -> Piece {
        let mut piece = Piece::new("toilet", [0.4, 0.66, 0.8], 0.45);
        let m = &mut piece.mesh;
        let appearance = self.ceramic;
        m.block([0.02, 0.0, 0.36], [0.38, 0.17, 0.78], appearance);
        m.trim([0.01, 0.0, 0.78], [0.39, 0.18, 0.8], appearance);
        m.block([0.11, 0.05, 0.0], [0.29, 0.4, 0.3], appearance);
        m.post([0.2, 0.42], [0.0, 0.28], [0.12, 0.17], 10, appearance);
        m.post([0.2, 0.42], [0.28, 0.4], [0.17, 0.2], 10, appearance);
        m.block([0.03, 0.16, 0.28], [0.37, 0.4, 0.4], appearance);
        m.post([0.2, 0.43], [0.396, 0.43], [0.206, 0.206], 10, self.white);
        m.trim([0.025, 0.176, 0.396], [0.375, 0.42, 0.426], self.white);
        piece
    }

    /// A basin on a cabinet, a mirror above.
    pub fn washstand(&mut self) -> Piece {
        let w = self.between(0.6, 0.85);
        let appearance = if self.chance(0.5) { self.white } else { self.any_wood() };
        let mut piece = Piece::new("washstand", [w, 0.48, 1.75], 0.55);
        let m = &mut piece.mesh;
        m.block([0.02, 0.0, 0.12], [w - 0.02, 0.42, 0.78], appearance);
        for x in [0.025, w / 2.0 + 0.003] {
            m.trim([x, 0.42, 0.14], [x + w / 2.0 - 0.028, 0.435, 0.77], appearance);
            m.trim([x + 0.1, 0.435, 0.68], [x + 0.18, 0.455, 0.695], self.metal);
        }
        m.block([0.0, 0.0, 0.78], [w, 0.48, 0.88], self.ceramic);
        let bowl = self.materials.appearance("bowl", [214, 216, 218], Skin::Smudge);
        m.trim([0.1, 0.14, 0.88], [w - 0.1, 0.43, 0.884], bowl);
        m.post([w / 2.0, 0.08], [0.88, 1.02], [0.015, 0.015], 6, self.metal);
        m.trim([w / 2.0 - 0.012, 0.08, 1.01], [w / 2.0 + 0.012, 0.2, 1.03], self.metal);
        let mirror = self.materials.appearance("mirror", [186, 198, 204], Skin::Plaster(1));
        m.trim([0.03, 0.0, 1.1], [w - 0.03, 0.02, 1.75], self.metal);
        m.trim([0.05, 0.02, 1.12], [w - 0.05, 0.024, 1.73], mirror);
        self.scatter(m, [0.02, 0.02, 0.2, 0.12], 0.88, 1);
        piece
    }

    /// A washing machine with its round window.
    pub fn washer(&mut self) -> Piece {
        let mut piece = Piece::new("washing machine", [0.6, 0.6, 0.85], 0.6);
        let m = &mut piece.mesh;
        m.block([0.0, 0.0, 0.0], [0.6, 0.57, 0.85], self.white);
        m.trim([0.005, 0.57, 0.72], [0.595, 0.58, 0.84], self.metal);
        for (radius, y, appearance) in [(0.2, 0.575, self.metal), (0.155, 0.58, self.black)] {
            for k in (1..11).step_by(2) {
                let corners = [
                    ring_corner(radius, y, 0),
                    ring_corner(radius, y, k),
                    ring_corner(radius, y, k + 1),
                    ring_corner(radius, y, k + 2),
                ];
                m.quad(corners, corners.map(|c| [c[0], c[2]]), appearance);
            }
        }
        self.scatter(m, [0.05, 0.05, 0.5, 0.4], 0.85, 2);
        piece
    }
}

fn ring_corner(r: f32, y: f32, k: usize) -> [f32; 3] {
    let a = std::f32::consts::TAU * k as f32 / 12.0;
    [0.3 - r * a.cos(), y, 0.4 + r * a.sin()]
}

fn curtain_fold(i: usize, w: f32) -> (f32, f32) {
    (0.04 + 0.5 * i as f32 / 10.0, w - if i.is_multiple_of(2) { 0.005 } else { 0.045 })
}
