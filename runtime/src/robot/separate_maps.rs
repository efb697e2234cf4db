//! Several maps whose places in each other are not known.
//!
//! A robot that does not find itself begins another map. The map before waits here, as it is. When localization recognizes a place
//! of it, the robot's map becomes a part of it, and its cells are drawn at their places there.

use hal::Pose2;

use super::Robot;
use crate::event::Event;
use crate::localization::Whereabouts;
use crate::mapping::{MapConfig, OccupancyGrid};
use crate::snapshot::{SnapshotError, State};

/// Maps at most, with that of the robot: each takes some 30 MiB. A robot that is lost in the last one stands.
pub(super) const MOST_MAPS: usize = 4;
/// Where the memory of what the camera saw in other maps is put: out of sight.
const OUT_OF_SIGHT: Pose2 = Pose2 { x_m: 1e5, y_m: 0.0, yaw_rad: 0.0 };

/// The maps in which the robot is not.
#[derive(Debug, Default)]
pub(super) struct SeparateMaps {
    /// Number of the map in which the robot is.
    current: u16,
    others: Vec<WaitingMap>,
    /// For each section, whether it belongs to another map.
    is_other: Vec<bool>,
}

#[derive(Debug)]
struct WaitingMap {
    number: u16,
    grid: OccupancyGrid,
}

impl SeparateMaps {
    /// Number of maps, with that of the robot.
    pub(super) fn count(&self) -> usize {
        self.others.len() + 1
    }

    /// Whether a section belongs to a map in which the robot is not.
    fn is_other(&self, section: usize) -> bool {
        self.is_other.get(section).copied().unwrap_or(false)
    }

    pub(super) fn take(&mut self, number: u16) -> Option<OccupancyGrid> {
        let at = self.others.iter().position(|map| map.number == number)?;
        Some(self.others.remove(at).grid)
    }

    pub(super) fn write(&self, to: &mut Vec<u8>) {
        self.current.write(to);
        self.is_other.write(to);
        (self.others.len() as u64).write(to);
        for map in &self.others {
            map.number.write(to);
            State::write(&map.grid, to);
        }
    }

    /// Reads maps of this configuration.
    pub(super) fn read(config: &MapConfig, from: &mut &[u8]) -> Result<Self, SnapshotError> {
        let mut maps = Self::default();
        let mut count = 0_u64;
        maps.current.read(from)?;
        maps.is_other.read(from)?;
        count.read(from)?;
        if count >= MOST_MAPS as u64 {
            return Err(SnapshotError::Damaged(format!("{count} other maps")));
        }
        for _ in 0..count {
            let empty = OccupancyGrid::new(config);
            let grid = empty.map_err(|error| SnapshotError::Damaged(error.to_string()))?;
            let mut map = WaitingMap { number: 0, grid };
            map.number.read(from)?;
            map.grid.read(from)?;
            maps.others.push(map);
        }
        Ok(maps)
    }
}

impl Robot {
    /// Number of maps whose places in each other are not known: 1, unless the robot has begun another map and not come to a place
    /// of the one before.
    #[must_use]
    pub fn maps(&self) -> usize {
        self.separate_maps.count()
    }

    /// Number of the map in which the robot is: 0, until it has begun another one. A map that has become a part of another has the
    /// number of that one.
    #[must_use]
    pub fn map_number(&self) -> u16 {
        self.separate_maps.current
    }

    /// The highest number of a map.
    #[must_use]
    pub fn newest_map(&self) -> u16 {
        let others = self.separate_maps.others.iter().map(|map| map.number);
        others.fold(self.separate_maps.current, u16::max)
    }

    /// Whether a lost robot that has searched on the spot may drive on with another map. A place that a person has sent it to, and the areas
    /// that it must keep out of, are places of the map before.
    pub(super) fn may_begin_map(&self) -> bool {
        self.config.localization.new_map_when_lost
            && self.explorer.is_exploring()
            && self.explorer.keep_out().is_empty()
            && self.maps() < MOST_MAPS
    }

    /// A lost robot begins another map.
    pub(super) fn begin_map(&mut self, events: &mut Vec<Event>) {
        // The configuration has made a grid before.
        let Ok(empty) = OccupancyGrid::new(&self.config.map) else { return };
        events.push(Event::MapBegun);
        self.location.begin_map();
        self.whereabouts = Whereabouts::Localized;
        self.enter_map(empty);
    }

    /// A lost robot was found. Exchanges the map, if it was found in another one than it was in.
    pub(super) fn enter_found_map(&mut self) {
        if let Some(grid) = self.separate_maps.take(self.location.map()) {
            self.enter_map(grid);
        }
    }

    /// The robot is in another map from now on, that of `grid`. Its map before waits.
    fn enter_map(&mut self, grid: OccupancyGrid) {
        let before = std::mem::replace(&mut self.map, grid);
        let maps = &mut self.separate_maps;
        maps.others.push(WaitingMap { number: maps.current, grid: before });
        self.map_correction.jump(&self.location, &mut self.map, self.location.t_map_odom());
        self.poses.t_map_odom = self.map_correction.t_map_odom();
        self.explorer.begin_map();
        self.note_maps(Vec::new());
        self.collision_at = None;
        self.unseen_at = None;
        self.bumped = false;
    }

    /// Localization has made the robot's map a part of another one.
    pub(super) fn join_maps(&mut self, events: &mut Vec<Event>) {
        let Some(other) = self.separate_maps.take(self.location.map()) else { return };
        let before = self.poses.t_map_odom.compose(&self.poses.t_odom_base);
        let newer = std::mem::replace(&mut self.map, other);
        let maps = &self.separate_maps;
        let moved = self.map_correction.join(
            &self.location,
            &mut self.map,
            &newer,
            |section| !maps.is_other(section),
            &self.poses.t_odom_base,
        );
        events.push(Event::MapsJoined { shift_m: moved.shift_m(&before) });
        let map = &self.map;
        self.explorer.join_maps(|place_m| moved.place(map, place_m));
        self.move_blocked_places(&moved);
        self.note_maps(moved.corrections().to_vec());
    }

    /// The sections of the robot's map have moved by `corrections`, and other sections belong to it than before. What the camera saw in the
    /// others is out of sight.
    fn note_maps(&mut self, mut corrections: Vec<Pose2>) {
        let sections = self.map_correction.sections();
        corrections.resize(sections, Pose2::IDENTITY);
        let mut is_other = Vec::with_capacity(sections);
        for (section, correction) in corrections.iter_mut().enumerate() {
            let is_hidden = self.location.map_of(section) != self.location.map();
            match (self.separate_maps.is_other(section), is_hidden) {
                (false, true) => *correction = OUT_OF_SIGHT.compose(correction),
                (true, false) => *correction = correction.compose(&OUT_OF_SIGHT.inverse()),
                _ => {}
            }
            is_other.push(is_hidden);
        }
        self.separate_maps.current = self.location.map();
        self.separate_maps.is_other = is_other;
        self.dense.correct(&corrections);
    }
}
