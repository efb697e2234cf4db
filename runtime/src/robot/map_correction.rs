//! Moves the map when localization corrects the path.
//!
//! The map is drawn with a `t_map_odom` that is *in force*. When a loop is closed, localization knows better poses for all its
//! submaps. The map is then drawn anew over several ticks ([`Recomposition`]); only when it is finished, the new `t_map_odom` comes
//! into force. So map, goals and pose always agree with each other.

use hal::{Pose2, wrap_angle};

use super::location::Location;
use crate::localization::Joined;
use crate::mapping::{OccupancyGrid, Recomposed, Recomposition};
use crate::snapshot::{SnapshotError, State};

/// Smaller corrections do not pay: a cell of the map has 3 cm.
const SHIFT_M: f64 = 0.02;
const YAW_RAD: f64 = 0.005;
/// Cells that one tick moves. 200,000 cells take about 1 ms on one core of 2.5 GHz.
const CELLS_PER_TICK: usize = 200_000;

/// The map's part in localization.
#[derive(Debug, Default)]
pub(super) struct MapCorrection {
    /// For each section of the map, the pose in `map` of its submap as it was drawn.
    drawn: Vec<Pose2>,
    /// `t_map_odom` that the map is drawn with.
    in_force: Pose2,
    /// The revision of localization's path that the map agrees with.
    revision: u64,
    /// The revision that the map is being drawn for.
    next_revision: u64,
    work: Option<Recomposition>,
}

/// The map has been exchanged.
#[derive(Debug)]
pub(super) struct Moved {
    corrections: Vec<Pose2>,
    current: Pose2,
}

impl Moved {
    /// How each section moved: `new = correction * old`.
    pub(super) fn corrections(&self) -> &[Pose2] {
        &self.corrections
    }

    /// Where a place of the old map is in the new one: it moves with the section that shows it.
    pub(super) fn place(&self, map: &OccupancyGrid, place_m: [f64; 2]) -> [f64; 2] {
        let candidates = self.corrections.iter().enumerate().rev();
        let shown = candidates.map(|(section, correction)| {
            let (x_m, y_m) = correction.transform(place_m[0], place_m[1]);
            (map.section_at(x_m, y_m) == u16::try_from(section).ok(), [x_m, y_m])
        });
        let found = shown.into_iter().find(|(is_shown, _)| *is_shown).map(|(_, place_m)| place_m);
        found.unwrap_or_else(|| self.current.transform(place_m[0], place_m[1]).into())
    }

    /// By how much the robot's own place moved, metres.
    pub(super) fn shift_m(&self, robot: &Pose2) -> f64 {
        self.current.compose(robot).distance_m(robot)
    }
}

impl MapCorrection {
    /// `t_map_odom` that the map is drawn with.
    pub(super) fn t_map_odom(&self) -> Pose2 {
        self.in_force
    }

    /// The robot was found: its cells belong to a new submap from now on, whose place says where the robot is. The map stays as it
    /// is; a correction that had begun starts again.
    pub(super) fn jump(&mut self, location: &Location, map: &mut OccupancyGrid, to: Pose2) {
        self.work = None;
        let before = self.in_force;
        while self.drawn.len() < location.submap() {
            let t_odom_submap = location.submap_in_odom(self.drawn.len());
            self.drawn.push(before.compose(&t_odom_submap.unwrap_or(Pose2::IDENTITY)));
        }
        self.in_force = to;
        self.begin_section(location, map);
    }

    /// Two maps have become one. The sections for which `is_moved` is true belong to the one that moved; with `robot_moves`, that is the
    /// robot's. Returns how each section has moved; smaller differences are corrected later.
    pub(super) fn join(
        &mut self,
        location: &Location,
        joined: &Joined,
        robot_moves: bool,
        is_moved: impl Fn(usize) -> bool,
    ) -> Vec<Pose2> {
        self.work = None;
        self.begin_sections(location);
        let mut corrections = vec![Pose2::IDENTITY; self.drawn.len()];
        for (section, drawn) in self.drawn.iter_mut().enumerate() {
            if is_moved(section) {
                corrections[section] = joined.correction;
                *drawn = joined.correction.compose(drawn);
            }
        }
        if robot_moves {
            self.in_force = joined.correction.compose(&self.in_force);
        }
        corrections
    }

    /// Number of sections of the map: one for each submap.
    pub(super) fn sections(&self) -> usize {
        self.drawn.len()
    }

    /// Goes on with the map's correction. Returns how the map moved in the tick in which it is exchanged.
    pub(super) fn update(&mut self, location: &Location, map: &mut OccupancyGrid) -> Option<Moved> {
        if self.work.is_none() {
            self.begin_section(location, map);
            self.begin(location, map);
        }
        let work = self.work.as_mut()?;
        if map.recompose(work, CELLS_PER_TICK) == Recomposed::Unfinished {
            return None;
        }
        let corrections = work.corrections().to_vec();
        self.work = None;
        self.revision = self.next_revision;
        for (drawn, correction) in self.drawn.iter_mut().zip(&corrections) {
            *drawn = correction.compose(drawn);
        }
        let current = corrections.get(usize::from(map.section())).copied();
        let current = current.unwrap_or(Pose2::IDENTITY);
        self.in_force = current.compose(&self.in_force);
        Some(Moved { corrections, current })
    }

    /// Cells that are observed from now on belong to the current submap. Submaps that began while the map was drawn anew have no
    /// cells.
    pub(super) fn begin_section(&mut self, location: &Location, map: &mut OccupancyGrid) {
        self.begin_sections(location);
        if let Ok(section) = u16::try_from(location.submap()) {
            map.begin_section(section);
        }
    }

    fn begin_sections(&mut self, location: &Location) {
        while self.drawn.len() <= location.submap() {
            let t_odom_submap = location.submap_in_odom(self.drawn.len());
            self.drawn.push(self.in_force.compose(&t_odom_submap.unwrap_or(Pose2::IDENTITY)));
        }
    }

    fn begin(&mut self, location: &Location, map: &OccupancyGrid) {
        if location.revision() == self.revision {
            return;
        }
        let mut corrections = Vec::with_capacity(self.drawn.len());
        let mut pays = false;
        for (submap, drawn) in self.drawn.iter().enumerate() {
            // Other maps are corrected when the robot is in them.
            let is_here = location.map_of(submap) == location.map();
            let now = location.submap_in_map(submap).filter(|_| is_here).unwrap_or(*drawn);
            pays |= now.distance_m(drawn) > SHIFT_M
                || wrap_angle(now.yaw_rad - drawn.yaw_rad).abs() > YAW_RAD;
            corrections.push(now.compose(&drawn.inverse()));
        }
        if pays {
            self.next_revision = location.revision();
            self.work = Some(map.begin_recomposition(corrections));
        }
    }
}

impl State for MapCorrection {
    fn write(&self, to: &mut Vec<u8>) {
        self.drawn.write(to);
        self.in_force.write(to);
        self.revision.write(to);
        self.next_revision.write(to);
        self.work.is_some().write(to);
        if let Some(work) = &self.work {
            work.write(to);
        }
    }

    fn read(&mut self, from: &mut &[u8]) -> Result<(), SnapshotError> {
        self.drawn.read(from)?;
        self.in_force.read(from)?;
        self.revision.read(from)?;
        self.next_revision.read(from)?;
        let mut works = false;
        works.read(from)?;
        self.work = None;
        if works {
            let mut work = Recomposition::default();
            work.read(from)?;
            self.work = Some(work);
        }
        Ok(())
    }
}
