//! Several maps whose places in each other are not known.
//!
//! A robot that does not find itself begins another map. The map before waits here, as it is. When localization recognizes a place of one
//! map in another, both become one, with the number of the older: the cells of the other are drawn at their places there.

use hal::Pose2;

use super::Robot;
use super::location::Location;
use crate::event::Event;
use crate::localization::{Joined, Whereabouts};
use crate::mapping::{MapConfig, OccupancyGrid, Wins};
use crate::snapshot::{SnapshotError, State};

/// Maps at most, with that of the robot: a waiting one has 11 bytes a cell, which are 11 MiB by default. A robot that is lost in the last one
/// stands.
pub(super) const MOST_MAPS: usize = 4;
/// Where the memory of what the camera saw in other maps is put: out of sight.
const OUT_OF_SIGHT: Pose2 = Pose2 { x_m: 1e5, y_m: 0.0, yaw_rad: 0.0 };

/// The maps in which the robot is not.
#[derive(Debug, Default)]
pub(super) struct SeparateMaps {
    /// Number of the map in which the robot is.
    current: u16,
    others: Vec<WaitingMap>,
    /// The map of each section; empty until there was a second map.
    map_of: Vec<u16>,
}

#[derive(Debug)]
struct WaitingMap {
    number: u16,
    grid: OccupancyGrid,
    /// Where exploration began in it.
    start: Option<Pose2>,
}

impl SeparateMaps {
    /// Number of maps, with that of the robot.
    pub(super) fn count(&self) -> usize {
        self.others.len() + 1
    }

    /// The map of a section: that of the robot for one that has begun since.
    fn map_of(&self, section: usize) -> u16 {
        self.map_of.get(section).copied().unwrap_or(self.current)
    }

    fn take(&mut self, number: u16) -> Option<WaitingMap> {
        let at = self.others.iter().position(|map| map.number == number)?;
        Some(self.others.remove(at))
    }

    /// The grid of a map in which the robot is not.
    #[cfg(test)]
    pub(super) fn grid(&self, number: u16) -> Option<&OccupancyGrid> {
        self.others.iter().find(|map| map.number == number).map(|map| &map.grid)
    }

    pub(super) fn write(&self, to: &mut Vec<u8>) {
        self.current.write(to);
        self.map_of.write(to);
        (self.others.len() as u64).write(to);
        for map in &self.others {
            map.number.write(to);
            map.start.write(to);
            State::write(&map.grid, to);
        }
    }

    /// Reads maps of this configuration.
    pub(super) fn read(config: &MapConfig, from: &mut &[u8]) -> Result<Self, SnapshotError> {
        let mut maps = Self::default();
        let mut count = 0_u64;
        maps.current.read(from)?;
        maps.map_of.read(from)?;
        count.read(from)?;
        if count >= MOST_MAPS as u64 {
            return Err(SnapshotError::Damaged(format!("{count} other maps")));
        }
        for _ in 0..count {
            let empty = OccupancyGrid::new(config);
            let grid = empty.map_err(|error| SnapshotError::Damaged(error.to_string()))?;
            let mut map = WaitingMap { number: 0, grid, start: None };
            map.number.read(from)?;
            map.start.read(from)?;
            map.grid.read(from)?;
            maps.others.push(map);
        }
        Ok(maps)
    }

    /// Checks that these are the maps of localization.
    pub(super) fn check(&self, location: &Location) -> Result<(), SnapshotError> {
        let mut here: Vec<u16> = self.others.iter().map(|map| map.number).collect();
        here.push(self.current);
        here.sort_unstable();
        if self.current != location.map() || (self.count() > 1 && here != location.maps()) {
            return Err(SnapshotError::Damaged("other maps than those of localization".to_owned()));
        }
        Ok(())
    }
}

impl Robot {
    /// Number of maps whose places in each other are not known: 1, unless the robot has begun another map and has not come to a place
    /// of the one before.
    #[must_use]
    pub fn maps(&self) -> usize {
        self.separate_maps.count()
    }

    /// Number of the map in which the robot is: 0, until it has begun another one. Of two maps that become one, the lower number stays.
    #[must_use]
    pub fn map_number(&self) -> u16 {
        self.separate_maps.current
    }

    /// Number of submaps of all maps.
    #[must_use]
    pub fn submaps(&self) -> usize {
        self.map_correction.sections()
    }

    /// Whether one of the first `submaps` belongs to the map in which the robot is.
    #[must_use]
    pub fn is_in_map_of_first(&self, submaps: usize) -> bool {
        (0..submaps).any(|submap| self.location.map_of(submap) == self.location.map())
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
        self.enter_map(empty, None, events);
    }

    /// A lost robot was found. Exchanges the map, if it was found in another one than it was in, and returns whether it was.
    pub(super) fn enter_found_map(&mut self, events: &mut Vec<Event>) -> bool {
        let Some(found) = self.separate_maps.take(self.location.map()) else { return false };
        events.push(Event::MapChanged);
        self.enter_map(found.grid, found.start, events);
        true
    }

    /// The robot is in another map from now on, that of `grid`. Its map before waits.
    fn enter_map(&mut self, grid: OccupancyGrid, start: Option<Pose2>, events: &mut Vec<Event>) {
        let before = std::mem::replace(&mut self.map, grid);
        let start = self.explorer.enter_map(start, events);
        let maps = &mut self.separate_maps;
        maps.others.push(WaitingMap { number: maps.current, grid: before, start });
        self.map_correction.jump(&self.location, &mut self.map, self.location.t_map_odom());
        self.poses.t_map_odom = self.map_correction.t_map_odom();
        self.note_maps(vec![Pose2::IDENTITY; self.map_correction.sections()]);
        self.collision_at = None;
        self.unseen_at = None;
        self.bumped = false;
    }

    /// Localization has made one map of that of the robot and another one.
    pub(super) fn join_maps(&mut self, joined: &Joined, events: &mut Vec<Event>) {
        let maps = &mut self.separate_maps;
        let moves = joined.moved == maps.current;
        let other = if moves { self.location.map() } else { joined.moved };
        let Some(other) = maps.take(other) else { return };
        let maps = &self.separate_maps;
        let corrections = self
            .map_correction
            .join(&self.location, joined, moves, |section| maps.map_of(section) == joined.moved);
        let t_map_base = self.map_correction.t_map_odom().compose(&self.poses.t_odom_base);
        if moves {
            let newer = std::mem::replace(&mut self.map, other.grid);
            self.map.merge(&newer, &joined.correction, &t_map_base, Wins::Added);
            self.move_places(&joined.correction, other.start);
        } else {
            self.map.merge(&other.grid, &joined.correction, &t_map_base, Wins::Kept);
        }
        self.map_correction.begin_section(&self.location, &mut self.map);
        events.push(Event::MapsJoined);
        self.frame_maps.clear();
        self.note_maps(corrections);
    }

    /// The robot's map has moved as a whole, into one where exploration began at `start`.
    fn move_places(&mut self, correction: &Pose2, start: Option<Pose2>) {
        let moved = |[x_m, y_m]: [f64; 2]| correction.transform(x_m, y_m).into();
        self.explorer.move_places(moved);
        self.explorer.begin_at(start);
        for place_m in [&mut self.collision_at, &mut self.unseen_at].into_iter().flatten() {
            *place_m = moved(*place_m);
        }
    }

    /// The sections have moved by `corrections`, and others belong to the robot's map than before. What the camera saw in other maps is out
    /// of sight.
    fn note_maps(&mut self, mut corrections: Vec<Pose2>) {
        let mut map_of = Vec::with_capacity(corrections.len());
        for (section, correction) in corrections.iter_mut().enumerate() {
            let was_hidden = self.separate_maps.map_of(section) != self.separate_maps.current;
            let number = self.location.map_of(section);
            match (was_hidden, number != self.location.map()) {
                (false, true) => *correction = OUT_OF_SIGHT.compose(correction),
                (true, false) => *correction = correction.compose(&OUT_OF_SIGHT.inverse()),
                _ => {}
            }
            map_of.push(number);
        }
        self.separate_maps.current = self.location.map();
        self.separate_maps.map_of = map_of;
        self.dense.correct(&corrections);
    }
}
