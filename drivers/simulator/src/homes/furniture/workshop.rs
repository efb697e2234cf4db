//! Builds pieces of furniture from the woods, cloths and colours of one home.

use rand::RngExt;
use rand_pcg::Pcg64Mcg;

use crate::homes::material_set::{Appearance, MaterialSet};
use crate::homes::mesh::Mesh;
use crate::homes::texture::Skin;

/// A piece that stands on the floor, built along the south wall: x from 0 to its width, y from 0
/// (back) to its depth.
#[derive(Debug, Clone)]
pub struct Piece {
    pub name: &'static str,
    pub mesh: Mesh,
    /// Width, depth and height, metres.
    pub size: [f32; 3],
    /// Free floor that the piece needs in front, metres.
    pub front_m: f32,
}

impl Piece {
    pub fn new(name: &'static str, size: [f32; 3], front_m: f32) -> Self {
        Self { name, mesh: Mesh::default(), size, front_m }
    }

    /// Adds another piece with its back left corner at `at`, facing the same direction or, if
    /// `reversed`, the opposite one.
    pub fn with(&mut self, other: &Self, at: [f32; 2], reversed: bool) {
        let (x, y) =
            if reversed { (at[0] + other.size[0], at[1] + other.size[1]) } else { (at[0], at[1]) };
        let side = if reversed {
            crate::homes::geometry::Side::North
        } else {
            crate::homes::geometry::Side::South
        };
        self.mesh.append_at_wall(&other.mesh, [x, y, 0.0], side);
    }
}

/// Materials of one home and the random generator of its pieces.
pub struct Workshop<'a> {
    pub materials: &'a mut MaterialSet,
    pub rng: Pcg64Mcg,
    pub wood: Appearance,
    pub dark_wood: Appearance,
    pub white: Appearance,
    pub metal: Appearance,
    pub black: Appearance,
    pub lacquer: Appearance,
    /// Decides which pieces are lacquered, apart from what decides their shape.
    lacquer_rng: Pcg64Mcg,
    pub ceramic: Appearance,
    pub stone: Appearance,
    pub linen: Appearance,
    pub leaf: Appearance,
    pub carton: Appearance,
    pub cloths: Vec<Appearance>,
    pub books: Vec<Appearance>,
    pub paints: Vec<Appearance>,
}

impl<'a> Workshop<'a> {
    pub fn new(materials: &'a mut MaterialSet, mut rng: Pcg64Mcg, lacquer_rng: Pcg64Mcg) -> Self {
        let woods = [[226, 190, 146], [196, 152, 108], [176, 128, 88], [232, 214, 188]];
        let darks = [[120, 82, 56], [92, 66, 50], [146, 104, 70]];
        let wood =
            materials.appearance("wood", woods[rng.random_range(0..woods.len())], Skin::Grain);
        let dark_wood =
            materials.appearance("dark wood", darks[rng.random_range(0..darks.len())], Skin::Grain);
        let cloths = [
            [132, 138, 148],
            [168, 152, 132],
            [98, 112, 128],
            [150, 120, 104],
            [116, 130, 112],
            [188, 178, 164],
        ];
        let cloths = cloths
            .iter()
            .zip(0u8..)
            .map(|(c, i)| materials.appearance("cloth", *c, Skin::Cloth(i % 3)))
            .collect();
        let books = [
            [150, 60, 52],
            [58, 84, 120],
            [70, 104, 76],
            [196, 170, 110],
            [220, 214, 200],
            [60, 58, 64],
            [120, 80, 110],
            [176, 116, 70],
            [104, 138, 150],
            [150, 142, 128],
        ];
        let books = books.iter().map(|c| materials.appearance("book", *c, Skin::Spines)).collect();
        let paints = [
            [196, 96, 78],
            [88, 132, 164],
            [222, 190, 104],
            [120, 156, 118],
            [226, 222, 214],
            [82, 88, 98],
        ];
        let paints =
            paints.iter().map(|c| materials.appearance("glaze", *c, Skin::Smudge)).collect();
        Self {
            wood,
            dark_wood,
            white: materials.appearance("white lacquer", [228, 226, 220], Skin::Smudge),
            metal: materials.appearance("steel", [168, 170, 174], Skin::Smudge),
            black: materials.appearance("black", [52, 52, 56], Skin::Smudge),
            lacquer: materials.absorbing("black lacquer", [40, 40, 44], Skin::Smudge, 0.0),
            lacquer_rng,
            ceramic: materials.appearance("ceramic", [236, 236, 232], Skin::Smudge),
            stone: materials.appearance("worktop", [150, 146, 142], Skin::Stone),
            linen: materials.appearance("linen", [222, 218, 208], Skin::Cloth(0)),
            leaf: materials.appearance("leaf", [255, 255, 255], Skin::Leaf),
            carton: materials.appearance("carton", [190, 156, 116], Skin::Smudge),
            cloths,
            books,
            paints,
            materials,
            rng,
        }
    }

    pub fn between(&mut self, low: f32, high: f32) -> f32 {
        self.rng.random_range(low..=high)
    }

    pub fn chance(&mut self, p: f64) -> bool {
        self.rng.random_bool(p)
    }

    pub fn cloth(&mut self) -> Appearance {
        self.cloths[self.rng.random_range(0..self.cloths.len())]
    }

    pub fn book(&mut self) -> Appearance {
        self.books[self.rng.random_range(0..self.books.len())]
    }

    pub fn paint(&mut self) -> Appearance {
        self.paints[self.rng.random_range(0..self.paints.len())]
    }

    /// The surface of a large piece: one of five is of black lacquer, which a laser scanner hardly
    /// sees.
    pub fn body(&mut self, usual: Appearance) -> Appearance {
        if self.lacquer_rng.random_bool(0.2) { self.lacquer } else { usual }
    }

    pub fn any_wood(&mut self) -> Appearance {
        if self.chance(0.6) { self.wood } else { self.dark_wood }
    }
}
