//! The occupancy grid: log-odds of the cells around the robot.

use hal::{CameraModel, Pose2, Pose3};
use serde::{Deserialize, Serialize};

use super::ground::GroundCell;
use super::window::Window;
use super::{Cell, CellBox, CellState, FrameMapper, MapConfig, MapError, SingleFrameMap, Surfaces};
use crate::perception::DepthEstimate;
use crate::snapshot::{SnapshotError, State, read_bulk, write_bulk};

/// Largest distance from the origin of `odom` at which f32 metres are still accurate enough for
/// cells.
const REACH_M: f64 = 100_000.0;
/// The log-odds of a known cell never come closer to 0 than this: decay reduces the certainty of a
/// cell, but the cell stays free or occupied.
const FAINTEST: f32 = 1e-20;
/// The common factor is multiplied into the cells when it becomes smaller than this: about every
/// 2,000 updates at a decay of 0.98.
const RENORMALISE_BELOW: f64 = 1e-18;

/// Stands for a height in cells that hold a drop instead of an obstacle. Obstacles are at most 2.5 m
/// high.
pub(super) const DROP_CM: u8 = 255;

/// An occupancy grid in `odom` whose window follows the robot.
///
/// Every cell holds log-odds: exactly 0 is unknown, above 0 occupied, below 0 free. Cells are
/// stored divided by a common factor, so that the decay of all cells at each update is a single
/// multiplication of that factor. The evidence of one update is collected and applied at its end:
/// `l <- clamp(decay * l + evidence)`, where an occupied observation of a cell wins over free ones.
#[derive(Debug, Clone)]
pub struct OccupancyGrid {
    pub(super) config: MapConfig,
    pub(super) window: Window,
    /// Log-odds divided by `scale`.
    pub(super) stored: Vec<f32>,
    scale: f64,
    /// Evidence of the current update for each cell; 0 if there is none.
    evidence: Vec<f32>,
    /// The cells with evidence.
    touched: Vec<Cell>,
    /// Height of the obstacle in an occupied cell according to the camera, centimetres; 0 if only
    /// the LiDAR or a collision marked it, [`DROP_CM`] if the floor ends there.
    pub(super) top_cm: Vec<u8>,
    /// The section of the path from which a cell was observed last. The cells of a section move
    /// together when localization corrects the path.
    pub(super) section_of: Vec<u16>,
    /// The section that the robot is on.
    pub(super) section: u16,
    /// Drops that the current update saw, and floor in cells that hold a drop.
    ground: Vec<GroundCell>,
    /// The robot's cell and the radius of the floor under it, in cells.
    standing: Option<(Cell, f64)>,
    pub(super) collisions: Vec<Collision>,
    pub(super) known: Option<CellBox>,
    pub(super) updates: u64,
    newly_known: Vec<Cell>,
    digest: blake3::Hasher,
    changes: Vec<u8>,
    changes_digest: u64,
    mapper: FrameMapper,
    frame: SingleFrameMap,
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct Collision {
    pub(super) cell: Cell,
    /// The update after which the mark is removed.
    pub(super) expires: u64,
}

impl OccupancyGrid {
    /// An empty map around the origin of `odom`.
    ///
    /// # Errors
    /// When the configuration is out of range.
    pub fn new(config: &MapConfig) -> Result<Self, MapError> {
        config.validate()?;
        let cells = config.side_cells * config.side_cells;
        Ok(Self {
            config: config.clone(),
            window: Window::centered(config.side_cells, Cell::default()),
            stored: vec![0.0; cells],
            scale: 1.0,
            evidence: vec![0.0; cells],
            touched: Vec::new(),
            top_cm: vec![0; cells],
            section_of: vec![0; cells],
            section: 0,
            ground: Vec::new(),
            standing: None,
            collisions: Vec::new(),
            known: None,
            updates: 0,
            newly_known: Vec::new(),
            digest: blake3::Hasher::new(),
            changes: Vec::new(),
            changes_digest: 0,
            mapper: FrameMapper::new(config)?,
            frame: SingleFrameMap::default(),
        })
    }

    /// Begins an update with the robot at `t_odom_base`: moves the window if the robot has come
    /// close to its edge, and applies the decay to all cells.
    ///
    /// # Errors
    /// If the pose is not finite or out of reach; the map is then unchanged.
    pub fn begin_update(&mut self, t_odom_base: &Pose2) -> Result<(), MapError> {
        check_pose2("t_odom_base", t_odom_base)?;
        self.recenter(self.cell_at(t_odom_base.x_m, t_odom_base.y_m));
        self.updates += 1;
        self.newly_known.clear();
        self.changes.clear();
        self.changes_digest = 0;
        self.scale *= f64::from(self.config.decay);
        if self.scale < RENORMALISE_BELOW {
            self.renormalise();
        }
        self.expire_collisions();
        Ok(())
    }

    /// Integrates a depth frame. Returns its single-frame map, for comparison with those of other
    /// frames.
    ///
    /// Where a scan measured `surfaces`, they decide what becomes of the camera's cells near them and behind them
    /// (`frame_evidence.rs`).
    ///
    /// # Errors
    /// As [`FrameMapper::map`]; the map is then unchanged.
    pub fn integrate_depth(
        &mut self,
        estimate: &DepthEstimate,
        camera: &CameraModel,
        t_odom_camera: &Pose3,
        surfaces: &Surfaces,
    ) -> Result<&SingleFrameMap, MapError> {
        let mut frame = core::mem::take(&mut self.frame);
        let result = self.mapper.map(estimate, camera, t_odom_camera, &mut frame);
        if result.is_ok() {
            self.add_frame(&frame, surfaces, camera, t_odom_camera);
            self.add_ground();
        }
        self.frame = frame;
        result.map(|()| &self.frame)
    }

    /// Keeps what the mapper's last frame saw of the ground until the update is finished.
    fn add_ground(&mut self) {
        for seen in self.mapper.ground() {
            let Some(index) = self.window.index(seen.cell) else { continue };
            if seen.evidence > 0.0 || self.holds_drop(index) {
                self.ground.push(*seen);
            }
        }
    }

    /// Whether a cell is occupied because the floor ends there. Rays that pass above such a cell,
    /// of the camera or of the LiDAR, say nothing about its floor.
    pub(super) fn holds_drop(&self, index: usize) -> bool {
        self.stored[index] > 0.0 && self.top_cm[index] == DROP_CM
    }

    pub(super) fn add_camera_obstacle(&mut self, cell: Cell, evidence: f32, height_cm: u8) {
        if let Some(index) = self.window.index(cell) {
            self.top_cm[index] = self.top_cm[index].max(height_cm);
            self.add_evidence(cell, index, evidence);
        }
    }

    /// Records an observation of a cell until the update is finished. The order of observations
    /// does not matter.
    pub(super) fn add_evidence(&mut self, cell: Cell, index: usize, evidence: f32) {
        let so_far = &mut self.evidence[index];
        if *so_far == 0.0 && evidence != 0.0 {
            self.touched.push(cell);
        }
        if evidence > 0.0 {
            *so_far = so_far.max(evidence);
        } else if *so_far <= 0.0 {
            *so_far = so_far.min(evidence);
        }
    }

    /// Marks an obstacle that the robot collided with: a segment across its heading, `ahead_m` in
    /// front of `t_odom_base`. The mark stays until it expires, even if the camera or the LiDAR
    /// observes free floor there.
    ///
    /// # Errors
    /// If the pose or the distance is not finite or out of reach.
    pub fn mark_collision(&mut self, t_odom_base: &Pose2, ahead_m: f64) -> Result<(), MapError> {
        self.mark_across(t_odom_base, ahead_m, self.config.collision_updates)
    }

    /// Marks an obstacle of the same size at a place that the scanner does not see, for `unseen_updates`: the robot may see it
    /// from elsewhere. A mark of a collision at the same place stays for longer.
    ///
    /// # Errors
    /// If the pose or the distance is not finite or out of reach.
    pub fn mark_unseen(&mut self, t_odom_base: &Pose2, ahead_m: f64) -> Result<(), MapError> {
        self.mark_across(t_odom_base, ahead_m, self.config.unseen_updates)
    }

    fn mark_across(
        &mut self,
        t_odom_base: &Pose2,
        ahead_m: f64,
        updates: u64,
    ) -> Result<(), MapError> {
        let middle = t_odom_base.compose(&Pose2::new(ahead_m, 0.0, 0.0));
        check_pose2("t_odom_base and ahead_m", &middle)?;
        let half_m = self.config.collision_width_m / 2.0;
        let steps =
            (self.config.collision_width_m / self.config.cell_m * 2.0).ceil().max(1.0) as i32;
        let expires = self.updates + updates;
        for step in 0..=steps {
            let across_m = half_m * (2.0 * f64::from(step) / f64::from(steps) - 1.0);
            let (x_m, y_m) = middle.transform(0.0, across_m);
            let cell = self.cell_at(x_m, y_m);
            match self.collisions.iter_mut().find(|collision| collision.cell == cell) {
                Some(known) => known.expires = known.expires.max(expires),
                None => self.collisions.push(Collision { cell, expires }),
            }
        }
        Ok(())
    }

    /// Marks the floor under the robot as free: everything within `radius_m` of `t_odom_base`
    /// except collision marks.
    ///
    /// # Errors
    /// If the pose or the radius is not finite or out of reach.
    pub fn mark_standing(&mut self, t_odom_base: &Pose2, radius_m: f64) -> Result<(), MapError> {
        check_pose2("t_odom_base", t_odom_base)?;
        if !(0.0..=5.0).contains(&radius_m) {
            return Err(MapError::Config { field: "radius_m", value: radius_m, allowed: "0 to 5" });
        }
        self.standing =
            Some((self.cell_at(t_odom_base.x_m, t_odom_base.y_m), radius_m / self.config.cell_m));
        Ok(())
    }

    /// Ends the update and applies all evidence.
    pub fn finish_update(&mut self) {
        let touched = core::mem::take(&mut self.touched);
        for cell in &touched {
            let Some(index) = self.window.index(*cell) else { continue };
            let evidence = core::mem::take(&mut self.evidence[index]);
            let old = self.log_odds_at(index);
            let new = (old + evidence).clamp(-self.config.limit, self.config.limit);
            // Evidence that cancels the old value exactly must not make a known cell unknown.
            let new = if new.abs() < FAINTEST { FAINTEST.copysign(evidence) } else { new };
            self.write(*cell, index, new);
        }
        self.touched = touched;
        self.touched.clear();
        self.apply_ground();
        self.apply_standing();
        self.apply_collisions();
        self.digest.reset();
        self.digest.update(&self.changes);
        let [a, b, c, d, e, f, g, h, ..] = *self.digest.finalize().as_bytes();
        self.changes_digest = u64::from_le_bytes([a, b, c, d, e, f, g, h]);
    }

    /// Marks drops, and clears those where the floor was seen. Rays that passed above a cell may
    /// have cleared it before: that counts for nothing against a drop.
    fn apply_ground(&mut self) {
        let mut ground = core::mem::take(&mut self.ground);
        // A drop wins over floor that the same update saw in its cell.
        ground.sort_by(|a, b| a.cell.cmp(&b.cell).then(b.evidence.total_cmp(&a.evidence)));
        ground.dedup_by_key(|seen| seen.cell);
        for seen in &ground {
            let Some(index) = self.window.index(seen.cell) else { continue };
            let old = self.log_odds_at(index);
            let from = if seen.evidence > 0.0 { old.max(0.0) } else { old };
            let new = (from + seen.evidence).clamp(-self.config.limit, self.config.limit);
            let new = if new.abs() < FAINTEST { FAINTEST.copysign(seen.evidence) } else { new };
            self.write(seen.cell, index, new);
            if seen.evidence > 0.0 {
                self.top_cm[index] = DROP_CM;
            }
        }
        ground.clear();
        self.ground = ground;
    }

    fn apply_standing(&mut self) {
        let Some((center, radius)) = self.standing.take() else { return };
        let reach = radius.floor() as i32;
        for dy in -reach..=reach {
            for dx in -reach..=reach {
                let cell = center.offset(dx, dy);
                if f64::from(dx * dx + dy * dy) <= radius * radius
                    && let Some(index) = self.window.index(cell)
                {
                    let new = self.log_odds_at(index).min(-self.config.free_decrement);
                    self.write(cell, index, new);
                }
            }
        }
    }

    fn apply_collisions(&mut self) {
        let collisions = core::mem::take(&mut self.collisions);
        for collision in &collisions {
            if let Some(index) = self.window.index(collision.cell) {
                self.write(collision.cell, index, self.config.collision_log_odds);
            }
        }
        self.collisions = collisions;
    }

    /// Removes expired collision marks. Their cells become unknown and have to be observed again.
    fn expire_collisions(&mut self) {
        self.collisions.retain(|collision| {
            let stays = collision.expires > self.updates;
            if !stays && let Some(index) = self.window.index(collision.cell) {
                self.stored[index] = 0.0;
                self.top_cm[index] = 0;
            }
            stays
        });
    }

    fn write(&mut self, cell: Cell, index: usize, log_odds: f32) {
        if self.stored[index] == 0.0 {
            self.newly_known.push(cell);
            self.known = Some(self.known.map_or(CellBox::of(cell), |known| known.including(cell)));
        }
        if log_odds < 0.0 {
            self.top_cm[index] = 0;
        }
        let stored = self.stored_as(log_odds);
        self.stored[index] = stored;
        self.section_of[index] = self.section;
        for word in [cell.x as u32, cell.y as u32, stored.to_bits()] {
            self.changes.extend_from_slice(&word.to_le_bytes());
        }
    }

    /// The value that a cell of these log-odds has in memory.
    pub(super) fn stored_as(&self, log_odds: f32) -> f32 {
        (f64::from(log_odds) / self.scale) as f32
    }

    fn renormalise(&mut self) {
        let scale = self.scale as f32;
        for stored in &mut self.stored {
            if *stored != 0.0 {
                let value = *stored * scale;
                *stored = if value.abs() < FAINTEST { FAINTEST.copysign(*stored) } else { value };
            }
        }
        self.scale = 1.0;
    }

    /// Moves the window as little as necessary, because cells that leave it become unknown and are
    /// explored again.
    pub(super) fn recenter(&mut self, robot: Cell) {
        let old = self.window.center();
        let limit = self.config.follow_cells();
        let center = Cell::new(
            old.x.clamp(robot.x.saturating_sub(limit), robot.x.saturating_add(limit)),
            old.y.clamp(robot.y.saturating_sub(limit), robot.y.saturating_add(limit)),
        );
        if center == old {
            return;
        }
        self.window.recenter(center, |range| {
            self.stored[range.clone()].fill(0.0);
            self.evidence[range.clone()].fill(0.0);
            self.top_cm[range].fill(0);
        });
        let cells = self.window.cells();
        self.known = self.known.and_then(|known| known.intersection(cells));
        self.collisions.retain(|collision| cells.contains(collision.cell));
        self.touched.retain(|cell| cells.contains(*cell));
    }

    pub(super) fn log_odds_at(&self, index: usize) -> f32 {
        (f64::from(self.stored[index]) * self.scale) as f32
    }

    pub(super) fn index(&self, cell: Cell) -> Option<usize> {
        self.window.index(cell)
    }

    /// Whether the planar LiDAR may mark this cell as free: the cell is unknown, or the camera did
    /// not mark it as occupied.
    pub(super) fn lidar_may_clear(&self, index: usize) -> bool {
        let stored = self.stored[index];
        stored == 0.0 || (stored > 0.0 && self.top_cm[index] == 0)
    }

    /// The stored values of row `y` from column `min_x` on, as one or two slices. The sign is the
    /// cell's state; 0 is unknown.
    pub(crate) fn row(&self, y: i32, min_x: i32, width: usize) -> (&[f32], &[f32]) {
        self.window.row(&self.stored, y, min_x, width)
    }

    /// Which cells of a [`row`](Self::row) hold a drop; `None` if none does.
    pub(crate) fn drops_in_row(
        &self,
        y: i32,
        min_x: i32,
        width: usize,
    ) -> Option<impl Iterator<Item = bool> + '_> {
        let (left, right) = self.window.row(&self.top_cm, y, min_x, width);
        if !(left.contains(&DROP_CM) || right.contains(&DROP_CM)) {
            return None;
        }
        let tops = left.iter().chain(right);
        let (left, right) = self.row(y, min_x, width);
        let values = left.iter().chain(right);
        Some(values.zip(tops).map(|(stored, top_cm)| *stored > 0.0 && *top_cm == DROP_CM))
    }

    /// The value in [`row`](Self::row) that corresponds to these log-odds.
    pub(crate) fn row_value(&self, log_odds: f32) -> f32 {
        self.stored_as(log_odds)
    }

    /// Log-odds of a cell; 0 outside the window.
    #[must_use]
    pub fn log_odds(&self, cell: Cell) -> f32 {
        self.window.index(cell).map_or(0.0, |index| self.log_odds_at(index))
    }

    /// State of a cell; unknown outside the window.
    #[must_use]
    pub fn state(&self, cell: Cell) -> CellState {
        self.window
            .index(cell)
            .map_or(CellState::Unknown, |index| CellState::of(self.stored[index]))
    }

    /// State of the cell that contains a point in `odom`, metres.
    #[must_use]
    pub fn state_at(&self, x_m: f64, y_m: f64) -> CellState {
        self.state(self.cell_at(x_m, y_m))
    }

    /// The cell that contains a point in `odom`, metres.
    #[must_use]
    pub fn cell_at(&self, x_m: f64, y_m: f64) -> Cell {
        Cell::containing(x_m, y_m, self.config.cell_m)
    }

    /// The centre of a cell in `odom`, metres.
    #[must_use]
    pub fn center_m(&self, cell: Cell) -> [f64; 2] {
        cell.center_m(self.config.cell_m)
    }

    /// Edge length of a cell, metres.
    #[must_use]
    pub fn cell_m(&self) -> f64 {
        self.config.cell_m
    }

    /// The cells that the map window covers now.
    #[must_use]
    pub fn window(&self) -> CellBox {
        self.window.cells()
    }

    /// A box that contains every known cell; `None` if no cell is known.
    #[must_use]
    pub fn known_box(&self) -> Option<CellBox> {
        self.known
    }

    /// Area of the free cells, square metres.
    #[must_use]
    pub fn free_m2(&self) -> f64 {
        let free = self.known_cells().filter(|(cell, _)| self.state(*cell) == CellState::Free);
        free.count() as f64 * self.config.cell_m * self.config.cell_m
    }

    /// The states of all cells of the [known box](Self::known_box), row by row: for viewers, which want all of them at once.
    #[must_use]
    pub fn known_states(&self) -> Vec<CellState> {
        let Some(known) = self.known else { return Vec::new() };
        let mut states = Vec::with_capacity(known.width() * known.height());
        for y in known.min.y..=known.max.y {
            let (left, right) = self.row(y, known.min.x, known.width());
            states.extend(left.iter().chain(right).map(|stored| CellState::of(*stored)));
        }
        states
    }

    /// Every known cell with its log-odds, row by row.
    pub fn known_cells(&self) -> impl Iterator<Item = (Cell, f32)> + '_ {
        let rows = self
            .known
            .into_iter()
            .flat_map(|known| (known.min.y..=known.max.y).map(move |y| (known, y)));
        rows.flat_map(move |(known, y)| {
            let (left, right) = self.row(y, known.min.x, known.width());
            left.iter()
                .chain(right)
                .zip(known.min.x..)
                .filter(|(stored, _)| **stored != 0.0)
                .map(move |(stored, x)| (Cell::new(x, y), (f64::from(*stored) * self.scale) as f32))
        })
    }

    /// Cells that became known in the last finished update, in the order in which they were
    /// written.
    #[must_use]
    pub fn newly_known(&self) -> &[Cell] {
        &self.newly_known
    }

    /// First 8 bytes of the BLAKE3 digest of all cells that the last update wrote, with their new
    /// values.
    #[must_use]
    pub fn changes_digest(&self) -> u64 {
        self.changes_digest
    }

    /// Number of updates begun so far.
    #[must_use]
    pub fn updates(&self) -> u64 {
        self.updates
    }

    #[must_use]
    pub fn config(&self) -> &MapConfig {
        &self.config
    }

    /// Whether all numbers are finite and the known cells lie within the window, as in every map that was not read from bytes.
    fn is_sound(&self) -> bool {
        let window = self.window.cells();
        let is_inside = self.known.is_none_or(|known| known.intersection(window) == Some(known));
        is_inside
            && self.scale.is_finite()
            && self.scale > 0.0
            && self.stored.iter().all(|value| value.is_finite())
    }
}

/// A snapshot is taken between two updates. Data that only reports use is left out.
impl State for OccupancyGrid {
    fn write(&self, to: &mut Vec<u8>) {
        self.window.write(to);
        self.scale.write(to);
        self.collisions.write(to);
        self.known.write(to);
        self.updates.write(to);
        self.changes_digest.write(to);
        write_bulk(&self.stored, to);
        write_bulk(&self.top_cm, to);
        write_bulk(&self.section_of, to);
        self.section.write(to);
    }

    fn read(&mut self, from: &mut &[u8]) -> Result<(), SnapshotError> {
        let cells = self.stored.len();
        self.window.read(from)?;
        self.scale.read(from)?;
        self.collisions.read(from)?;
        self.known.read(from)?;
        self.updates.read(from)?;
        self.changes_digest.read(from)?;
        read_bulk(&mut self.stored, cells, from)?;
        read_bulk(&mut self.top_cm, cells, from)?;
        read_bulk(&mut self.section_of, cells, from)?;
        self.section.read(from)?;
        let sizes = [self.stored.len(), self.top_cm.len(), self.section_of.len()];
        if sizes != [cells; 3] {
            return Err(SnapshotError::Damaged("a map of another size".to_owned()));
        }
        if !self.is_sound() {
            return Err(SnapshotError::Damaged("a map that no robot makes".to_owned()));
        }
        Ok(())
    }
}

pub(super) fn check_pose2(pose: &'static str, value: &Pose2) -> Result<(), MapError> {
    if !value.is_finite() {
        return Err(MapError::PoseNotFinite { pose, value: format!("{value:?}") });
    }
    check_reach(pose, value.x_m.hypot(value.y_m))
}

pub(super) fn check_pose3(pose: &'static str, value: &Pose3) -> Result<(), MapError> {
    let finite = value
        .translation
        .vector
        .iter()
        .chain(value.rotation.coords.iter())
        .all(|number| number.is_finite());
    if !finite {
        return Err(MapError::PoseNotFinite { pose, value: format!("{value}") });
    }
    check_reach(pose, value.translation.vector.norm())
}

fn check_reach(pose: &'static str, distance_m: f64) -> Result<(), MapError> {
    if distance_m > REACH_M {
        return Err(MapError::PoseOutOfReach { pose, distance_m, limit_m: REACH_M });
    }
    Ok(())
}

#[cfg(test)]
mod tests;
