//! Furniture: pieces are built from the home's materials and placed so that walkways stay free.

mod clutter;
mod place;
mod recipes;
mod seating;
mod storage;
mod tables;
mod wet;
mod workshop;

pub use place::DOORWAY_M;

use super::fixtures::Reserved;
use super::geometry::Rect;
use super::joinery::{CURTAIN_M, LEAF_REACH_M};
use super::layout::Layout;
use super::material_set::MaterialSet;
use super::mesh::Mesh;
use super::openings::{side_of, span_of};
use super::{HomeKind, Surface, stream};
use place::RoomFloor;
use workshop::Workshop;

/// A placed piece of furniture.
#[derive(Debug, Clone, PartialEq)]
pub struct Furniture {
    pub name: String,
    pub room: usize,
    /// Floor area that the piece covers, including space for sitting and overhangs, metres.
    pub rect: Rect,
}

/// Builds and places furniture. The pieces are the same whether `moved` is set or not; their
/// positions differ.
pub fn furnish(
    kind: HomeKind,
    layout: &Layout,
    reserved: &[Reserved],
    materials: &mut MaterialSet,
    mesh: &mut Mesh,
    seed: u64,
    moved: bool,
) -> Vec<Furniture> {
    let mut shop = Workshop::new(materials, stream(seed, 6), stream(seed, 9));
    let mut rng = stream(seed, if moved { 8 } else { 7 });
    let mut placed = Vec::new();
    for (index, room) in layout.rooms.iter().enumerate() {
        let mut floor = room_floor(layout, index, reserved);
        for request in recipes::recipe(kind, room, &mut shop) {
            let spot = request
                .pieces
                .iter()
                .find_map(|p| floor.place(p, request.stand, &mut rng).map(|s| (p, s)));
            let Some((piece, spot)) = spot else { continue };
            let mark = mesh.mark();
            mesh.append_at_wall(&piece.mesh, [spot.at[0], spot.at[1], 0.0], spot.side);
            mesh.tag(mark, index, Surface::Furniture);
            placed.push(Furniture { name: piece.name.to_owned(), room: index, rect: spot.rect });
        }
    }
    placed
}

/// A room's floor with its doors, open leaves, windows and fixtures.
fn room_floor(layout: &Layout, index: usize, reserved: &[Reserved]) -> RoomFloor {
    let rect = layout.rooms[index].rect;
    let mut floor = RoomFloor::new(rect);
    for door in layout.doors.iter().filter(|d| d.rooms.contains(&index)) {
        let wall = rect.wall(side_of(door, &rect));
        floor.add_door(&wall, span_of(door, &wall));
    }
    for leaf in layout.leaves.iter().filter(|l| l.room == index) {
        floor.add_obstacle(rect.wall(leaf.side).rect(leaf.span, [0.0, LEAF_REACH_M]));
    }
    for window in layout.windows.iter().filter(|w| w.room == index) {
        floor.add_shown(
            window.side,
            [window.span[0] - CURTAIN_M - 0.06, window.span[1] + CURTAIN_M + 0.06],
        );
    }
    for item in reserved.iter().filter(|r| r.room == index) {
        if item.depth_m > 0.0 {
            floor.add_obstacle(rect.wall(item.side).rect(item.span, [0.0, item.depth_m]));
        } else {
            floor.add_shown(item.side, item.span);
        }
    }
    floor
}
