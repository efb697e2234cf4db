//! Recomposes the map from its sections after localization has corrected the path.
//!
//! The path is divided into sections of a few metres, and every cell knows the section from which it was observed last. When a
//! loop is closed, each section gets a correction of its own, and its cells move with it. Where moved sections overlap, the later
//! section wins, as its observations would have done on the corrected path.
//!
//! One call places a limited number of cells, so that a tick keeps its time budget. The old map stays in use until
//! the last call, which replaces it as a whole. The robot continues to map in between: its current section is
//! placed last.

use hal::Pose2;
use serde::{Deserialize, Serialize};

use super::grid::Collision;
use super::{Cell, CellBox, OccupancyGrid};
use crate::snapshot::{SnapshotError, State, read_bulk, write_bulk};

/// A correction moves points of the map: `new = correction * old`.
pub type Corrections = Vec<Pose2>;

/// A recomposition of the map that has begun.
#[derive(Debug, Clone, Default)]
pub struct Recomposition {
    corrections: Corrections,
    /// The cells of each section, in the old map.
    boxes: Vec<Option<CellBox>>,
    next: usize,
    /// The window at the beginning of the work. If the window moves, its memory holds other cells, and the work
    /// starts again.
    window: Option<CellBox>,
    /// The cells of the new map, in the order of the window's memory: the index of the old cell plus 1, or 0 for an
    /// unknown cell.
    source: Vec<u32>,
}

/// Whether a recomposition is finished.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Recomposed {
    /// Cells are left to be placed, and the map is unchanged; call again.
    Unfinished,
    /// The map has been replaced.
    Done,
}

/// Which cells count where two maps are merged.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wins {
    /// Those of the map that is kept.
    Kept,
    /// Those of the map that is added.
    Added,
}

impl OccupancyGrid {
    /// Assigns all cells that are observed from now on to this section of the path. Section numbers increase.
    pub fn begin_section(&mut self, section: u16) {
        self.section = section;
    }

    /// The section of the path that observed cells belong to now.
    #[must_use]
    pub fn section(&self) -> u16 {
        self.section
    }

    /// The section from which the cell at a point was observed last; `None` where nothing is known.
    #[must_use]
    pub fn section_at(&self, x_m: f64, y_m: f64) -> Option<u16> {
        let index = self.window.index(self.cell_at(x_m, y_m))?;
        (self.stored[index] != 0.0).then(|| self.section_of[index])
    }

    /// Begins a recomposition. `corrections` has one entry per section; a section without an entry stays where it is.
    #[must_use]
    pub fn begin_recomposition(&self, corrections: Corrections) -> Recomposition {
        Recomposition {
            boxes: self.known.map_or(Vec::new(), |known| self.boxes_of_sections(known)),
            corrections,
            next: 0,
            window: Some(self.window.cells()),
            source: vec![0; self.stored.len()],
        }
    }

    /// Continues the recomposition with about `cells` cells. The section must not change before it is done.
    pub fn recompose(&mut self, work: &mut Recomposition, cells: usize) -> Recomposed {
        // The work comes from a snapshot of a map of another size.
        if work.source.len() != self.stored.len() {
            work.window = None;
        }
        if work.window != Some(self.window.cells()) {
            *work = self.begin_recomposition(core::mem::take(&mut work.corrections));
        }
        let current = usize::from(self.section);
        let mut done = 0;
        while work.next < work.boxes.len() {
            let section = work.next;
            if section != current {
                done += self.place_section(work, section);
            }
            work.next += 1;
            if done >= cells {
                return Recomposed::Unfinished;
            }
        }
        // The current section has grown since the beginning, also over cells of other sections.
        for source in &mut work.source {
            let from = source.checked_sub(1).map(|from| from as usize);
            if from.is_some_and(|from| usize::from(self.section_of[from]) == current) {
                *source = 0;
            }
        }
        if work.boxes.len() <= current {
            work.boxes.resize(current + 1, None);
        }
        if let Some(slot) = work.boxes.get_mut(current) {
            *slot = self.box_of_section(self.section);
            self.place_section(work, current);
        }
        self.exchange(work);
        Recomposed::Done
    }

    /// For each section, the box around its cells within `area`.
    fn boxes_of_sections(&self, area: CellBox) -> Vec<Option<CellBox>> {
        let mut boxes = vec![None; usize::from(self.section) + 1];
        for y in area.min.y..=area.max.y {
            for x in area.min.x..=area.max.x {
                let cell = Cell::new(x, y);
                let Some(index) = self.window.index(cell) else { continue };
                if self.stored[index] != 0.0
                    && let Some(slot) = boxes.get_mut(usize::from(self.section_of[index]))
                {
                    *slot =
                        Some(slot.map_or(CellBox::of(cell), |seen: CellBox| seen.including(cell)));
                }
            }
        }
        boxes
    }

    fn box_of_section(&self, section: u16) -> Option<CellBox> {
        let boxes = self.boxes_of_sections(self.known?);
        boxes.get(usize::from(section)).copied().flatten()
    }

    /// Places the cells of a section in the new map; returns how many cells it went through.
    fn place_section(&self, work: &mut Recomposition, section: usize) -> usize {
        let Some(old_box) = work.boxes.get(section).copied().flatten() else { return 0 };
        let correction = work.corrections.get(section).copied().unwrap_or(Pose2::IDENTITY);
        let new_box = self.moved_box(old_box, &correction);
        let Some(new_box) = new_box.intersection(self.window.cells()) else { return 0 };
        self.move_cells(&correction, new_box, |cell, from| {
            if let Some(to) = self.window.index(cell)
                && usize::from(self.section_of[from]) == section
            {
                work.source[to] = from as u32 + 1;
            }
        });
        new_box.width() * new_box.height()
    }

    /// For each cell of `new_box` on which a known cell comes to lie, calls `place` with it and the index of the old one.
    fn move_cells(&self, correction: &Pose2, new_box: CellBox, mut place: impl FnMut(Cell, usize)) {
        let back = correction.inverse();
        let (sin, cos) = back.yaw_rad.sin_cos();
        let cell_m = self.config.cell_m;
        for y in new_box.min.y..=new_box.max.y {
            for x in new_box.min.x..=new_box.max.x {
                let [x_m, y_m] = Cell::new(x, y).center_m(cell_m);
                let old = Cell::containing(
                    back.x_m + cos * x_m - sin * y_m,
                    back.y_m + sin * x_m + cos * y_m,
                    cell_m,
                );
                let Some(from) = self.window.index(old) else { continue };
                if self.stored[from] != 0.0 {
                    place(Cell::new(x, y), from);
                }
            }
        }
    }

    /// Adds the cells of another map of the same configuration, moved as a whole. `wins` says which of both counts where both know a cell.
    /// The window follows the robot, which is at `t_map_base`: cells outside of it are dropped, as always.
    pub fn merge(&mut self, added: &Self, correction: &Pose2, t_map_base: &Pose2, wins: Wins) {
        self.recenter(self.cell_at(t_map_base.x_m, t_map_base.y_m));
        let new_box = added.known.map(|known| added.moved_box(known, correction));
        if let Some(new_box) = new_box.and_then(|new_box| new_box.intersection(self.window.cells()))
        {
            added.move_cells(correction, new_box, |cell, from| {
                let Some(to) = self.window.index(cell) else { return };
                if wins == Wins::Added || self.stored[to] == 0.0 {
                    self.stored[to] = self.stored_as(added.log_odds_at(from));
                    self.top_cm[to] = added.top_cm[from];
                    self.section_of[to] = added.section_of[from];
                }
            });
        }
        self.section = self.section.max(added.section);
        self.known = self.box_of_known();
        self.merge_collisions(added, correction);
    }

    /// The marks of collisions of an added map, which stay for as long as they would have stayed there.
    fn merge_collisions(&mut self, added: &Self, correction: &Pose2) {
        for collision in &added.collisions {
            let [x_m, y_m] = collision.cell.center_m(self.config.cell_m);
            let (x_m, y_m) = correction.transform(x_m, y_m);
            let cell = self.cell_at(x_m, y_m);
            let expires = self.updates + collision.expires.saturating_sub(added.updates);
            self.collisions.retain(|known| known.cell != cell);
            self.collisions.push(Collision { cell, expires });
        }
    }

    fn moved_box(&self, old: CellBox, correction: &Pose2) -> CellBox {
        let cell_m = self.config.cell_m;
        let corners = [
            Cell::new(old.min.x, old.min.y),
            Cell::new(old.max.x, old.min.y),
            Cell::new(old.min.x, old.max.y),
            Cell::new(old.max.x, old.max.y),
        ];
        let moved = corners.map(|corner| {
            let [x_m, y_m] = corner.center_m(cell_m);
            let (x_m, y_m) = correction.transform(x_m, y_m);
            Cell::containing(x_m, y_m, cell_m)
        });
        moved.into_iter().fold(CellBox::of(moved[0]), CellBox::including).grown(1)
    }

    fn exchange(&mut self, work: &Recomposition) {
        let mut stored = vec![0.0; self.stored.len()];
        let mut top_cm = vec![0; self.stored.len()];
        let mut section_of = vec![0; self.stored.len()];
        for (to, source) in work.source.iter().enumerate() {
            let Some(from) = source.checked_sub(1) else { continue };
            let from = from as usize;
            stored[to] = self.stored[from];
            top_cm[to] = self.top_cm[from];
            section_of[to] = self.section_of[from];
        }
        self.move_collisions(work);
        self.stored = stored;
        self.top_cm = top_cm;
        self.section_of = section_of;
        self.known = self.box_of_known();
    }

    /// A collision mark moves with the section of its cell.
    fn move_collisions(&mut self, work: &Recomposition) {
        let cell_m = self.config.cell_m;
        let mut collisions = core::mem::take(&mut self.collisions);
        for collision in &mut collisions {
            let [x_m, y_m] = collision.cell.center_m(cell_m);
            let section = self.section_at(x_m, y_m).unwrap_or(self.section);
            let correction = work.corrections.get(usize::from(section)).copied();
            let (x_m, y_m) = correction.unwrap_or(Pose2::IDENTITY).transform(x_m, y_m);
            collision.cell = Cell::containing(x_m, y_m, cell_m);
        }
        self.collisions = collisions;
    }

    fn box_of_known(&self) -> Option<CellBox> {
        // The new map may extend further than the old one.
        let boxes = self.boxes_of_sections(self.window.cells());
        boxes.into_iter().flatten().reduce(|all, one| all.including(one.min).including(one.max))
    }
}

impl Recomposition {
    /// The corrections that this recomposition applies, one per section.
    #[must_use]
    pub fn corrections(&self) -> &[Pose2] {
        &self.corrections
    }
}

impl State for Recomposition {
    fn write(&self, to: &mut Vec<u8>) {
        self.corrections.write(to);
        self.boxes.write(to);
        self.next.write(to);
        self.window.write(to);
        write_bulk(&self.source, to);
    }

    fn read(&mut self, from: &mut &[u8]) -> Result<(), SnapshotError> {
        self.corrections.read(from)?;
        self.boxes.read(from)?;
        self.next.read(from)?;
        self.window.read(from)?;
        read_bulk(&mut self.source, MOST_CELLS, from)
    }
}

/// `side_cells` is at most 4,096.
const MOST_CELLS: usize = 4096 * 4096;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mapping::{CellState, MapConfig};

    fn grid() -> OccupancyGrid {
        let config = MapConfig { side_cells: 256, recenter_cells: 20, ..MapConfig::default() };
        OccupancyGrid::new(&config).unwrap()
    }

    /// Marks the floor around each pose, each from a section of its own.
    fn drive(map: &mut OccupancyGrid, poses: &[Pose2]) {
        for (section, pose) in poses.iter().enumerate() {
            map.begin_section(section as u16);
            map.begin_update(pose).unwrap();
            map.mark_standing(pose, 0.3).unwrap();
            map.finish_update();
        }
    }

    fn recompose(map: &mut OccupancyGrid, corrections: Corrections, cells: usize) -> usize {
        let mut work = map.begin_recomposition(corrections);
        let mut calls = 1;
        while map.recompose(&mut work, cells) == Recomposed::Unfinished {
            calls += 1;
        }
        calls
    }

    fn known(map: &OccupancyGrid) -> Vec<Cell> {
        map.known_cells().map(|(cell, _)| cell).collect()
    }

    #[test]
    fn corrections_that_move_nothing_leave_every_cell_as_it_was() {
        let mut map = grid();
        drive(&mut map, &[Pose2::IDENTITY, Pose2::new(0.5, 0.1, 0.0), Pose2::new(1.0, 0.0, 0.3)]);
        let before: Vec<_> = map.known_cells().collect();
        recompose(&mut map, vec![Pose2::IDENTITY; 3], usize::MAX);
        assert_eq!(map.known_cells().collect::<Vec<_>>(), before);
    }

    #[test]
    fn a_section_moves_by_whole_cells_without_a_hole() {
        let mut map = grid();
        drive(&mut map, &[Pose2::IDENTITY, Pose2::new(1.5, 0.0, 0.0)]);
        let first = Cell::containing(0.0, 0.0, map.cell_m());
        let cells = known(&map);
        let cell_m = map.cell_m();
        let shift = Pose2::new(5.0 * cell_m, -7.0 * cell_m, 0.0);
        recompose(&mut map, vec![Pose2::IDENTITY, shift], usize::MAX);
        let moved: Vec<Cell> = cells
            .iter()
            .map(|cell| if cell.x > first.x + 20 { cell.offset(5, -7) } else { *cell })
            .collect();
        let mut found = known(&map);
        found.sort_unstable();
        let mut expected = moved;
        expected.sort_unstable();
        assert_eq!(found, expected);
    }

    #[test]
    fn a_rotated_disc_of_floor_stays_a_disc_without_holes() {
        let mut map = grid();
        drive(&mut map, &[Pose2::new(1.0, 0.0, 0.0)]);
        let before = known(&map).len();
        recompose(&mut map, vec![Pose2::new(0.0, 0.0, 0.4)], usize::MAX);
        let (x_m, y_m) = (0.4_f64.cos(), 0.4_f64.sin());
        let inside = known(&map).into_iter().filter(|cell| {
            let [cx, cy] = cell.center_m(map.cell_m());
            (cx - x_m).hypot(cy - y_m) < 0.3 + map.cell_m()
        });
        assert_eq!(inside.count(), known(&map).len());
        assert!(known(&map).len().abs_diff(before) < before / 20);
        assert_eq!(map.state_at(x_m, y_m), CellState::Free);
    }

    #[test]
    fn small_portions_of_work_give_the_same_map_as_one_large_one() {
        let poses: Vec<Pose2> = (0..6).map(|k| Pose2::new(0.3 * f64::from(k), 0.0, 0.0)).collect();
        let corrections: Corrections =
            (0..6).map(|k| Pose2::new(0.0, 0.04 * f64::from(k), 0.01 * f64::from(k))).collect();
        let mut at_once = grid();
        drive(&mut at_once, &poses);
        let mut in_portions = at_once.clone();
        assert_eq!(recompose(&mut at_once, corrections.clone(), usize::MAX), 1);
        assert!(recompose(&mut in_portions, corrections, 1) > 3);
        let all: Vec<_> = at_once.known_cells().collect();
        assert_eq!(in_portions.known_cells().collect::<Vec<_>>(), all);
    }

    /// The robot of the added map is half a metre beside a wall of it.
    #[test]
    fn a_merged_map_has_the_cells_of_both_at_their_places_and_the_winner_counts_where_both_know_one()
     {
        let here = Pose2::new(1.0, 0.0, 0.0);
        let mut kept = grid();
        drive(&mut kept, &[Pose2::IDENTITY, here]);
        let mut added = grid();
        added.begin_section(2);
        added.begin_update(&Pose2::IDENTITY).unwrap();
        added.mark_collision(&Pose2::IDENTITY, 0.45).unwrap();
        added.mark_standing(&Pose2::IDENTITY, 0.3).unwrap();
        added.finish_update();
        // Its origin is at (1.4, 0) of the kept map, and it is rotated by 180 degrees: its wall is at x = 0.95.
        let correction = Pose2::new(1.4, 0.0, std::f64::consts::PI);
        for (wins, beside) in [(Wins::Kept, CellState::Free), (Wins::Added, CellState::Occupied)] {
            let mut map = kept.clone();
            map.merge(&added, &correction, &here, wins);
            assert_eq!(map.state_at(0.1, 0.0), CellState::Free, "{wins:?}: of the kept map");
            assert_eq!(map.state_at(1.6, 0.0), CellState::Free, "{wins:?}: of the added map");
            assert_eq!(map.state_at(0.95, 0.0), beside, "{wins:?}");
            assert_eq!(map.section_at(1.6, 0.0), Some(2));
            // The mark of the collision counts in both, from the next update on.
            map.begin_update(&here).unwrap();
            map.finish_update();
            assert_eq!(map.state_at(0.95, 0.0), CellState::Occupied, "{wins:?}");
        }
    }

    #[test]
    fn what_the_robot_maps_while_the_map_is_drawn_anew_is_in_the_new_map() {
        let mut map = grid();
        drive(&mut map, &[Pose2::IDENTITY, Pose2::new(1.0, 0.0, 0.0)]);
        let shift = Pose2::new(0.0, 0.3, 0.0);
        let mut work = map.begin_recomposition(vec![shift, shift]);
        assert_eq!(map.recompose(&mut work, 1), Recomposed::Unfinished);
        let here = Pose2::new(2.0, 0.0, 0.0);
        map.begin_update(&here).unwrap();
        map.mark_standing(&here, 0.3).unwrap();
        map.finish_update();
        while map.recompose(&mut work, 1) == Recomposed::Unfinished {}
        assert_eq!(map.state_at(2.0, 0.3), CellState::Free);
        assert_eq!(map.state_at(2.0, -0.2), CellState::Unknown);
    }
}
