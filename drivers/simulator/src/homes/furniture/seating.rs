//! Seats and beds.

use super::workshop::{Piece, Workshop};
use crate::homes::material_set::Appearance;
use crate::homes::mesh::Mesh;
use crate::homes::texture::Skin;

impl Workshop<'_> {
    /// Two or three seats between arms, on short feet.
    pub fn sofa(&mut self, seats: usize) -> Piece {
        let width = 0.36 + 0.66 * seats as f32;
        let depth = self.between(0.86, 0.95);
        let cloth = self.cloth();
        let pillow = self.cloth();
        let mut piece =
            Piece::new(if seats == 1 { "armchair" } else { "sofa" }, [width, depth, 0.82], 0.5);
        let m = &mut piece.mesh;
        for (x, y) in
            [(0.06, 0.06), (width - 0.12, 0.06), (0.06, depth - 0.12), (width - 0.12, depth - 0.12)]
        {
            m.trim([x, y, 0.0], [x + 0.06, y + 0.06, 0.1], self.dark_wood);
        }
        m.block([0.02, 0.02, 0.1], [width - 0.02, depth - 0.03, 0.28], cloth);
        m.cushion([0.0, 0.0, 0.1], [0.18, depth, 0.6], cloth);
        m.cushion([width - 0.18, 0.0, 0.1], [width, depth, 0.6], cloth);
        m.cushion([0.16, 0.0, 0.26], [width - 0.16, 0.2, 0.8], cloth);
        let seat = (width - 0.36) / seats as f32;
        for i in 0..seats {
            let x = 0.18 + seat * i as f32;
            m.cushion([x + 0.006, 0.16, 0.28], [x + seat - 0.006, depth - 0.005, 0.45], cloth);
            m.cushion([x + 0.012, 0.18, 0.44], [x + seat - 0.012, 0.33, 0.82], cloth);
        }
        if seats > 1 {
            let x = if self.chance(0.5) { 0.2 } else { width - 0.62 };
            piece.mesh.cushion([x, 0.32, 0.455], [x + 0.42, 0.46, 0.83], pillow);
        }
        piece
    }

    pub fn chair(&mut self, appearance: Appearance) -> Piece {
        let mut piece = Piece::new("chair", [0.44, 0.48, 0.88], 0.0);
        let m = &mut piece.mesh;
        for (x, y, top) in
            [(0.01, 0.01, 0.88), (0.39, 0.01, 0.88), (0.01, 0.42, 0.43), (0.39, 0.42, 0.43)]
        {
            m.block([x, y, 0.0], [x + 0.04, y + 0.04, top], appearance);
        }
        m.block([0.0, 0.0 + 0.052, 0.43], [0.44, 0.48, 0.46], appearance);
        for z in [0.58, 0.7, 0.82] {
            m.trim([0.052, 0.02, z], [0.388, 0.04, z + 0.055], appearance);
        }
        piece
    }

    /// A swivel chair on five castors.
    pub fn office_chair(&mut self) -> Piece {
        let cloth = self.cloth();
        let mut piece = Piece::new("office chair", [0.58, 0.58, 1.0], 0.0);
        let m = &mut piece.mesh;
        let mut arm = Mesh::default();
        arm.trim([0.03, -0.02, 0.05], [0.27, 0.02, 0.09], self.black);
        arm.trim([0.23, -0.025, 0.0], [0.28, 0.025, 0.05], self.black);
        for i in 0..5 {
            m.append(&arm, [0.29, 0.29, 0.0], std::f32::consts::TAU * i as f32 / 5.0 + 0.3);
        }
        m.post([0.29, 0.29], [0.05, 0.42], [0.03, 0.03], 6, self.metal);
        m.cushion([0.05, 0.07, 0.42], [0.53, 0.55, 0.5], cloth);
        m.trim([0.26, 0.03, 0.4], [0.32, 0.06, 0.65], self.black);
        m.cushion([0.07, 0.05, 0.56], [0.51, 0.12, 1.0], cloth);
        piece
    }

    /// A bed with its head at the wall.
    pub fn bed(&mut self, width: f32) -> Piece {
        let length = 2.08;
        let wood = self.any_wood();
        let cover = self.cloth();
        let blanket = self.cloth();
        let mut piece = Piece::new("bed", [width, length, 0.84], 0.55);
        let m = &mut piece.mesh;
        m.block([0.0, 0.0, 0.0], [width, 0.05, 0.84], wood);
        m.block([0.0, 0.055, 0.12], [width, length, 0.3], wood);
        for (x, y) in
            [(0.03, 0.1), (width - 0.1, 0.1), (0.03, length - 0.1), (width - 0.1, length - 0.1)]
        {
            m.trim([x, y, 0.0], [x + 0.07, y + 0.07, 0.12], wood);
        }
        m.cushion([0.03, 0.07, 0.3], [width - 0.03, length - 0.04, 0.5], self.linen);
        m.cushion([0.0, 0.62, 0.33], [width, length - 0.01, 0.55], cover);
        let pillows = if width > 1.2 { 2 } else { 1 };
        let each = (width - 0.1) / pillows as f32;
        for i in 0..pillows {
            let x = 0.05 + each * i as f32;
            m.cushion([x + 0.04, 0.1, 0.49], [x + each - 0.04, 0.5, 0.62], self.linen);
        }
        if self.chance(0.5) {
            piece.mesh.cushion(
                [-0.006, length - 0.6, 0.34],
                [width + 0.006, length - 0.15, 0.566],
                blanket,
            );
        }
        piece
    }

    /// Sofa, coffee table in reach, and a rug.
    pub fn lounge(&mut self, seats: usize) -> Piece {
        let sofa = self.sofa(seats);
        let table = self.coffee_table();
        let [width, depth, height] = sofa.size;
        let total = depth + 0.38 + table.size[1];
        let mut piece = Piece::new("lounge", [width, total, height], 0.55);
        let version = u8::from(self.chance(0.5));
        let rug = self.materials.appearance("rug", [255, 255, 255], Skin::Rug(version));
        self.rug(&mut piece.mesh, [0.1, depth - 0.25, width - 0.1, total + 0.35], rug);
        piece.with(&sofa, [0.0, 0.0], false);
        piece.with(&table, [(width - table.size[0]) / 2.0, depth + 0.38], false);
        piece
    }

    /// A thin carpet that does not block the robot.
    pub fn rug(&mut self, mesh: &mut Mesh, [x0, y0, x1, y1]: [f32; 4], appearance: Appearance) {
        let top = 0.008;
        mesh.stretched_face(
            [[x0, y0, top], [x1, y0, top], [x1, y1, top], [x0, y1, top]],
            appearance,
        );
        let plain = self.cloths[0];
        mesh.trim([x0, y0, 0.0], [x1, y1, top - 0.003], plain);
    }
}
