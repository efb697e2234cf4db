//! Layout of rooms, doors and windows of a home, before any geometry is built.

use rand_pcg::Pcg64Mcg;

use super::geometry::Rect;
use super::openings::{self, Door, Leaf, WALL_M, Window};
use super::plan::{self, Cell};
use super::stairs::Stairwell;
use super::{HomeKind, Room};

#[derive(Debug, Clone, PartialEq)]
pub struct Layout {
    pub cells: Vec<Cell>,
    pub rooms: Vec<Room>,
    pub doors: Vec<Door>,
    pub windows: Vec<Window>,
    pub leaves: Vec<Leaf>,
    /// Stairs down, in homes that have them.
    pub stairwell: Option<Stairwell>,
}

impl Layout {
    /// Draws random plans until doors can connect all rooms, which the first plan nearly always
    /// allows.
    pub fn draw(kind: HomeKind, height_m: f32, rng: &mut Pcg64Mcg) -> Self {
        loop {
            let cells = plan::cells(kind, rng);
            let Some(doors) = openings::doors(&cells, rng) else { continue };
            let rooms = rooms(&cells, height_m);
            let windows = openings::windows(&cells, &rooms, rng);
            let leaves = openings::leaves(&doors, &rooms, rng);
            return Self { cells, rooms, doors, windows, leaves, stairwell: None };
        }
    }
}

/// The rooms inside their walls, named by purpose and number.
fn rooms(cells: &[Cell], height_m: f32) -> Vec<Room> {
    let mut rooms: Vec<Room> = Vec::with_capacity(cells.len());
    for cell in cells {
        let number = 1 + rooms.iter().filter(|r| r.kind == cell.kind).count();
        let rect: Rect = cell.rect.grown(-WALL_M / 2.0);
        rooms.push(Room {
            name: format!("{}-{number}", cell.kind),
            kind: cell.kind,
            rect,
            height_m,
        });
    }
    rooms
}
