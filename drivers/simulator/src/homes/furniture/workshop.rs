//! Where pieces are made: one home's woods, cloths and colours.

use rand::RngExt;
use rand_pcg::Pcg64Mcg;

use crate::homes::looks::{Look, Looks};
use crate::homes::mesh::Mesh;
use crate::homes::texture::Skin;

/// One thing that stands on the floor, built along the south wall: x from 0 to its width, y from 0 (back) to its depth.
#[derive(Debug, Clone)]
pub struct Piece {
    pub name: &'static str,
    pub mesh: Mesh,
    /// Width, depth and height, metres.
    pub size: [f32; 3],
    /// Free floor that it needs in front, metres.
    pub front_m: f32,
}

impl Piece {
    pub fn new(name: &'static str, size: [f32; 3], front_m: f32) -> Self {
        Self { name, mesh: Mesh::default(), size, front_m }
    }

    /// Adds another piece, its back left corner at `at`, facing the same way or (`turned`) the opposite way.
    pub fn with(&mut self, other: &Self, at: [f32; 2], turned: bool) {
        let (x, y) =
            if turned { (at[0] + other.size[0], at[1] + other.size[1]) } else { (at[0], at[1]) };
        let side = if turned {
            crate::homes::geometry::Side::North
        } else {
            crate::homes::geometry::Side::South
        };
        self.mesh.append_at_wall(&other.mesh, [x, y, 0.0], side);
    }
}

/// Materials of one home and the randomness that pieces are drawn from.
pub struct Workshop<'a> {
    pub looks: &'a mut Looks,
    pub rng: Pcg64Mcg,
    pub wood: Look,
    pub dark_wood: Look,
    pub white: Look,
    pub metal: Look,
    pub black: Look,
    pub ceramic: Look,
    pub stone: Look,
    pub linen: Look,
    pub leaf: Look,
    pub carton: Look,
    pub cloths: Vec<Look>,
    pub books: Vec<Look>,
    pub paints: Vec<Look>,
}

impl<'a> Workshop<'a> {
    pub fn new(looks: &'a mut Looks, mut rng: Pcg64Mcg) -> Self {
        let woods = [[226, 190, 146], [196, 152, 108], [176, 128, 88], [232, 214, 188]];
        let darks = [[120, 82, 56], [92, 66, 50], [146, 104, 70]];
        let wood = looks.look("wood", woods[rng.random_range(0..woods.len())], Skin::Grain);
        let dark_wood =
            looks.look("dark wood", darks[rng.random_range(0..darks.len())], Skin::Grain);
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
            .map(|(c, i)| looks.look("cloth", *c, Skin::Cloth(i % 3)))
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
        let books = books.iter().map(|c| looks.look("book", *c, Skin::Spines)).collect();
        let paints = [
            [196, 96, 78],
            [88, 132, 164],
            [222, 190, 104],
            [120, 156, 118],
            [226, 222, 214],
            [82, 88, 98],
        ];
        let paints = paints.iter().map(|c| looks.look("glaze", *c, Skin::Smudge)).collect();
        Self {
            wood,
            dark_wood,
            white: looks.look("white lacquer", [228, 226, 220], Skin::Smudge),
            metal: looks.look("steel", [168, 170, 174], Skin::Smudge),
            black: looks.look("black", [52, 52, 56], Skin::Smudge),
            ceramic: looks.look("ceramic", [236, 236, 232], Skin::Smudge),
            stone: looks.look("worktop", [150, 146, 142], Skin::Stone),
            linen: looks.look("linen", [222, 218, 208], Skin::Cloth(0)),
            leaf: looks.look("leaf", [255, 255, 255], Skin::Leaf),
            carton: looks.look("carton", [190, 156, 116], Skin::Smudge),
            cloths,
            books,
            paints,
            looks,
            rng,
        }
    }

    pub fn between(&mut self, low: f32, high: f32) -> f32 {
        self.rng.random_range(low..=high)
    }

    pub fn chance(&mut self, p: f64) -> bool {
        self.rng.random_bool(p)
    }

    pub fn cloth(&mut self) -> Look {
        self.cloths[self.rng.random_range(0..self.cloths.len())]
    }

    pub fn book(&mut self) -> Look {
        self.books[self.rng.random_range(0..self.books.len())]
    }

    pub fn paint(&mut self) -> Look {
        self.paints[self.rng.random_range(0..self.paints.len())]
    }

    pub fn any_wood(&mut self) -> Look {
        if self.chance(0.6) { self.wood } else { self.dark_wood }
    }
}
