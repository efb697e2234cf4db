//! Finds free floor for furniture without blocking walkways.

use rand::RngExt;
use rand_pcg::Pcg64Mcg;

use super::workshop::Piece;
use crate::homes::geometry::{Rect, Side, WallFrame};

/// Cell size of the walkway check, metres.
const CELL_M: f32 = 0.05;
/// Half the width of a walkway of 0.8 m, less the half cell by which a cell's centre may be off.
const WALK_M: f32 = 0.4 - CELL_M / 2.0;
/// Free floor in front of a door, metres.
pub const DOORWAY_M: f32 = 0.9;
/// Objects higher than this are not placed in front of windows or pictures, metres.
const TALL_M: f32 = 0.84;
/// Minimum fraction of an empty room's walkable floor that furniture leaves free.
const OPEN_SHARE: f32 = 0.28;
/// Gap behind and beside furniture, metres.
const GAP_M: f32 = 0.025;

/// Preferred position of a piece.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stand {
    /// Back to a wall.
    Wall,
    /// Back to a wall, in a corner.
    Corner,
    /// A position away from walls.
    Middle,
}

/// Position of a piece: the wall at its back, and its back left corner.
#[derive(Debug, Clone, Copy)]
pub struct Spot {
    pub side: Side,
    pub at: [f32; 2],
    pub rect: Rect,
}

/// The floor of one room and the parts of it that are occupied.
pub struct RoomFloor {
    rect: Rect,
    taken: Vec<Rect>,
    kept_clear: Vec<Rect>,
    /// Parts of walls that tall objects may not cover.
    shown: Vec<(Side, [f32; 2])>,
    /// Points on walkways that must stay connected: one inside each door.
    anchors: Vec<[f32; 2]>,
    columns: usize,
    rows: usize,
    blocked: Vec<bool>,
    /// Walkable cells of the empty room.
    open: usize,
}

impl RoomFloor {
    pub fn new(rect: Rect) -> Self {
        let [w, d] = rect.size();
        let columns = (w / CELL_M) as usize;
        let rows = (d / CELL_M) as usize;
        let mut floor = Self {
            rect,
            taken: Vec::new(),
            kept_clear: Vec::new(),
            shown: Vec::new(),
            anchors: Vec::new(),
            columns,
            rows,
            blocked: vec![false; columns * rows],
            open: 0,
        };
        let walkable = rect.grown(-WALK_M);
        for i in 0..floor.blocked.len() {
            floor.blocked[i] = !walkable.contains(floor.middle(i));
        }
        floor.open = floor.blocked.iter().filter(|b| !**b).count();
        floor
    }

    /// Keeps the floor in front of a door free.
    pub fn add_door(&mut self, wall: &WallFrame, span: [f32; 2]) {
        self.kept_clear.push(wall.rect([span[0] - 0.05, span[1] + 0.05], [0.0, DOORWAY_M]));
        self.anchors.push(wall.at((span[0] + span[1]) / 2.0, 0.5));
    }

    /// Adds an object that is already in place.
    pub fn add_obstacle(&mut self, rect: Rect) {
        self.block(&rect);
        self.taken.push(rect);
    }

    /// Marks a part of a wall with a window or a picture.
    pub fn add_shown(&mut self, side: Side, span: [f32; 2]) {
        self.shown.push((side, span));
    }

    /// Finds a position for a piece and occupies it.
    pub fn place(&mut self, piece: &Piece, stand: Stand, rng: &mut Pcg64Mcg) -> Option<Spot> {
        for _ in 0..60 {
            let spot = if stand == Stand::Middle {
                self.middle_spot(piece, rng)
            } else {
                self.wall_spot(piece, stand, rng)
            };
            let Some((spot, front)) = spot else { continue };
            if self.fits(&spot.rect, &front) && self.stays_walkable(&spot.rect) {
                self.add_obstacle(spot.rect);
                self.kept_clear.push(front);
                return Some(spot);
            }
        }
        None
    }

    /// Whether a window or a picture is at this part of a wall.
    fn has_shown(&self, side: Side, span: [f32; 2]) -> bool {
        self.shown
            .iter()
            .any(|(other, shown)| *other == side && shown[0] < span[1] && span[0] < shown[1])
    }

    fn wall_spot(&self, piece: &Piece, stand: Stand, rng: &mut Pcg64Mcg) -> Option<(Spot, Rect)> {
        let side = Side::ALL[rng.random_range(0..4)];
        let wall = self.rect.wall(side);
        let [w, d, h] = piece.size;
        let slack = wall.length_m - w - 2.0 * GAP_M;
        if slack < 0.0 {
            return None;
        }
        let share = match (stand, rng.random_range(0..4)) {
            (Stand::Corner, k) | (_, k @ 0..=1) => (k % 2) as f32,
            _ => rng.random_range(0.0..=1.0),
        };
        let s = [GAP_M + slack * share, GAP_M + slack * share + w];
        if h > TALL_M && self.has_shown(side, s) {
            return None;
        }
        let rect = wall.rect(s, [GAP_M, GAP_M + d]);
        let front = wall.rect([s[0] + 0.05, s[1] - 0.05], [GAP_M + d, GAP_M + d + piece.front_m]);
        Some((Spot { side, at: wall.at(s[0], GAP_M), rect }, front))
    }

    fn middle_spot(&self, piece: &Piece, rng: &mut Pcg64Mcg) -> Option<(Spot, Rect)> {
        let side = Side::ALL[rng.random_range(0..4)];
        let wall = self.rect.wall(side);
        let depth = self.rect.size()[1 - side.quarter_rotations() % 2];
        let [w, d, _] = piece.size;
        let slack = wall.length_m - w;
        let slack_depth = depth - d;
        if slack < 0.0 || slack_depth < 0.0 {
            return None;
        }
        let s = slack * rng.random_range(0.1..=0.9);
        let t = slack_depth * rng.random_range(0.1..=0.9);
        let rect = wall.rect([s, s + w], [t, t + d]);
        Some((Spot { side, at: wall.at(s, t), rect }, rect))
    }

    fn fits(&self, rect: &Rect, front: &Rect) -> bool {
        let grown = rect.grown(GAP_M);
        self.rect.grown(1e-3).covers(rect)
            && self.rect.covers(front)
            && !self.taken.iter().any(|t| t.overlaps(&grown) || t.overlaps(front))
            && !self.kept_clear.iter().any(|c| c.overlaps(rect))
    }

    fn middle(&self, cell: usize) -> [f32; 2] {
        let x = cell % self.columns;
        let y = cell / self.columns;
        [self.rect.min[0] + (x as f32 + 0.5) * CELL_M, self.rect.min[1] + (y as f32 + 0.5) * CELL_M]
    }

    fn cell(&self, p: [f32; 2]) -> usize {
        cell_index(p[1] - self.rect.min[1], self.rows) * self.columns
            + cell_index(p[0] - self.rect.min[0], self.columns)
    }

    fn block(&mut self, rect: &Rect) {
        let near = rect.grown(WALK_M);
        let low = self.cell(near.min);
        let high = self.cell(near.max);
        for y in low / self.columns..=high / self.columns {
            for x in low % self.columns..=high % self.columns {
                let i = y * self.columns + x;
                self.blocked[i] |= rect.distance_m(self.middle(i)) < WALK_M;
            }
        }
    }

    /// Whether all doors stay connected by walkways, and almost no floor is cut off, with one more
    /// object in place.
    fn stays_walkable(&mut self, rect: &Rect) -> bool {
        let before = self.blocked.clone();
        self.block(rect);
        let free = self.blocked.iter().filter(|b| !**b).count();
        let reached = self.reached();
        let joined = self.anchors.iter().all(|a| reached[self.cell(*a)]);
        let count = reached.iter().filter(|r| **r).count();
        self.blocked = before;
        joined && count * 20 >= free * 19 && count as f32 >= OPEN_SHARE * self.open as f32
    }

    /// Cells that can be walked to from the first door.
    fn reached(&self) -> Vec<bool> {
        let mut reached = vec![false; self.blocked.len()];
        let mut open: Vec<usize> =
            self.anchors.first().map(|a| self.cell(*a)).into_iter().collect();
        open.retain(|c| !self.blocked[*c]);
        for cell in &open {
            reached[*cell] = true;
        }
        while let Some(cell) = open.pop() {
            let x = cell % self.columns;
            let y = cell / self.columns;
            let next = [
                (x > 0).then(|| cell - 1),
                (x + 1 < self.columns).then_some(cell + 1),
                (y > 0).then(|| cell - self.columns),
                (y + 1 < self.rows).then_some(cell + self.columns),
            ];
            for n in next.into_iter().flatten() {
                if !self.blocked[n] && !reached[n] {
                    reached[n] = true;
                    open.push(n);
                }
            }
        }
        reached
    }
}

fn cell_index(offset_m: f32, n: usize) -> usize {
    ((offset_m / CELL_M).max(0.0) as usize).min(n - 1)
}
