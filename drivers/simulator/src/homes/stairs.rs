//! A stairwell: stairs down in an opening of the floor, without a railing.

use rand::RngExt;
use rand_pcg::Pcg64Mcg;

use super::fixtures::Reserved;
use super::furniture::DOORWAY_M;
use super::geometry::{Rect, Side, WallFrame};
use super::joinery::LEAF_REACH_M;
use super::layout::Layout;
use super::material_set::Appearance;
use super::mesh::Mesh;
use super::openings::{side_of, span_of};
use super::styles::HomeStyle;
use super::{RoomKind, Surface};

/// Depth of a step and its height, metres: 2 rises and 1 run are 0.63 m, the length of a stride.
const RUN_M: f32 = 0.27;
const RISE_M: f32 = 0.18;
/// Width of the stairs and number of their steps. The second one is for small rooms.
const SIZES: [(f32, usize); 2] = [(1.0, 9), (0.8, 6)];
/// Furniture stays as far from the edge, metres.
const WALKWAY_M: f32 = 0.1;
/// Floor that stays between the stairs and the wall across, metres.
const PASSAGE_M: f32 = 1.2;

/// Stairs down along a wall.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stairwell {
    pub room: usize,
    pub side: Side,
    /// Part of the wall, metres along it.
    pub span: [f32; 2],
    pub width_m: f32,
    steps: usize,
    /// Whether the steps go down towards the end of the wall.
    forward: bool,
}

impl Stairwell {
    /// Chooses a place in the largest room that has one; no door leads onto the stairs.
    pub fn place(layout: &Layout, rng: &mut Pcg64Mcg) -> Option<Self> {
        let mut rooms: Vec<usize> = (0..layout.rooms.len()).collect();
        rooms.retain(|room| {
            !matches!(layout.rooms[*room].kind, RoomKind::Bath | RoomKind::Corridor)
        });
        rooms.sort_by(|a, b| {
            let area_a = layout.rooms[*a].rect.area_m2();
            let area_b = layout.rooms[*b].rect.area_m2();
            area_b.total_cmp(&area_a)
        });
        let forward = rng.random_bool(0.5);
        for (width_m, steps) in SIZES {
            for &room in &rooms {
                let places = places(layout, room, width_m, steps, forward);
                if !places.is_empty() {
                    return Some(places[rng.random_range(0..places.len())]);
                }
            }
        }
        None
    }

    /// The opening in the floor.
    pub fn opening(&self, layout: &Layout) -> Rect {
        self.wall(layout).rect(self.span, [0.0, self.width_m])
    }

    /// The floor that furniture leaves free: the opening, and a walkway around it.
    pub fn reserved(&self) -> Reserved {
        let [from, to] = self.span;
        let span = [from - WALKWAY_M, to + WALKWAY_M];
        Reserved { room: self.room, side: self.side, span, depth_m: self.width_m + WALKWAY_M }
    }

    fn wall(&self, layout: &Layout) -> WallFrame {
        layout.rooms[self.room].rect.wall(self.side)
    }

    /// Builds the steps and the walls around them.
    pub fn build(&self, layout: &Layout, style: &HomeStyle, mesh: &mut Mesh) {
        let mark = mesh.mark();
        let ground_m = -RISE_M * (self.steps as f32 + 1.0);
        for step in 0..self.steps {
            let from = step as f32 * RUN_M;
            let to = from + RUN_M;
            let below = -RISE_M * (step as f32 + 1.0);
            let wall = style.rooms[self.room].wall;
            self.face(
                [(from, 0.0), (from, 1.0)],
                [below + RISE_M, below],
                layout,
                style.leaf,
                mesh,
            );
            self.tread([from, to], below, layout, style.leaf, mesh);
            for side in [0.0, 1.0] {
                self.face([(from, side), (to, side)], [0.0, ground_m], layout, wall, mesh);
            }
        }
        let end = self.steps as f32 * RUN_M;
        let wall = style.rooms[self.room].wall;
        self.face([(end, 0.0), (end, 1.0)], [0.0, ground_m], layout, wall, mesh);
        mesh.tag(mark, self.room, Surface::Opening);
    }

    /// A point of the stairs: metres down the stairs, share of their width, and height.
    fn point(&self, down_m: f32, across: f32, z: f32, layout: &Layout) -> [f32; 3] {
        let s = if self.forward { self.span[0] + down_m } else { self.span[1] - down_m };
        self.wall(layout).at3(s, across * self.width_m, z)
    }

    /// A vertical face between two points of the plan and two heights.
    fn face(
        &self,
        [a, b]: [(f32, f32); 2],
        [top, bottom]: [f32; 2],
        layout: &Layout,
        appearance: Appearance,
        mesh: &mut Mesh,
    ) {
        let corners = [(a, bottom), (b, bottom), (b, top), (a, top)]
            .map(|((down_m, across), z)| self.point(down_m, across, z, layout));
        let length = ((b.0 - a.0).hypot((b.1 - a.1) * self.width_m)) / appearance.tile_m;
        let start = a.0 / appearance.tile_m;
        let [low, high] = [bottom, top].map(|z| -z / appearance.tile_m);
        let uv = [[start, low], [start + length, low], [start + length, high], [start, high]];
        mesh.quad(corners, uv, appearance);
    }

    fn tread(
        &self,
        [from, to]: [f32; 2],
        z: f32,
        layout: &Layout,
        appearance: Appearance,
        mesh: &mut Mesh,
    ) {
        let corners = [(from, 0.0), (to, 0.0), (to, 1.0), (from, 1.0)]
            .map(|(down_m, across)| self.point(down_m, across, z, layout));
        mesh.quad(corners, corners.map(|c| [0, 1].map(|i| c[i] / appearance.tile_m)), appearance);
    }
}

/// The places along the walls of a room: at both ends and in the middle of each.
fn places(
    layout: &Layout,
    room: usize,
    width_m: f32,
    steps: usize,
    forward: bool,
) -> Vec<Stairwell> {
    let rect = layout.rooms[room].rect;
    let length_m = steps as f32 * RUN_M;
    let mut places = Vec::new();
    for side in Side::ALL {
        let wall = rect.wall(side);
        let across_m = rect.wall(Side::ALL[(side.quarter_rotations() + 1) % 4]).length_m;
        let slack = wall.length_m - length_m;
        if slack < 0.0 || across_m < width_m + PASSAGE_M {
            continue;
        }
        for share in [0.0, 0.5, 1.0] {
            let span = [slack * share, slack * share + length_m];
            let place = Stairwell { room, side, span, width_m, steps, forward };
            if is_clear(layout, room, &place.opening(layout)) {
                places.push(place);
            }
        }
    }
    places
}

/// Whether no door and no open leaf is beside an opening in the floor.
fn is_clear(layout: &Layout, room: usize, opening: &Rect) -> bool {
    let rect = layout.rooms[room].rect;
    let beside = opening.grown(0.2);
    let doors = layout.doors.iter().filter(|door| door.rooms.contains(&room)).map(|door| {
        let wall = rect.wall(side_of(door, &rect));
        wall.rect(span_of(door, &wall), [0.0, DOORWAY_M + 0.3])
    });
    let leaves = layout
        .leaves
        .iter()
        .filter(|leaf| leaf.room == room)
        .map(|leaf| rect.wall(leaf.side).rect(leaf.span, [0.0, LEAF_REACH_M]));
    doors.chain(leaves).all(|taken| !taken.overlaps(&beside))
}
