//! A map that stays: what the robot knows of a home, as bytes for its next run.
//!
//! A map state holds the occupancy grid, the submaps and the graph of localization, the correction that is in force, and the
//! pose at which the robot was. Goals, blacklist and depth belong to one run and are not in it.

use hal::{Pose2, ScanGeometry};
use serde::{Deserialize, Serialize};

use super::location::{Geometry, Location, TickPoses};
use super::map_correction::MapCorrection;
use super::separate_maps::SeparateMaps;
use super::wheel_frame::WheelFrame;
use super::{Robot, RobotConfig};
use crate::localization::{LostReason, PoseSource};
use crate::mapping::{MapConfig, OccupancyGrid};
use crate::snapshot::{SnapshotError, State};

/// Increased whenever the layout of the grid, of localization, or of the map's correction changes. Older map states are then
/// refused, except the one before.
pub const MAP_STATE_VERSION: u32 = 3;
/// The layout before, which lacks the other maps of a robot that has several, and what localization knows of them.
const MAP_STATE_OF_ONE_MAP: u32 = 2;

/// Why a map cannot be used. The robot is unchanged.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum MapStateError {
    /// Another version of this program wrote it.
    #[error(
        "the map has layout {found}, this program knows {MAP_STATE_VERSION}: use the version that saved it, or map the home again"
    )]
    Version {
        /// Layout of the map.
        found: u32,
    },
    /// The bytes are not those of a map.
    #[error("the map is damaged: {0}; map the home again, or use a copy")]
    Damaged(String),
    /// The map belongs to a robot with another configuration.
    #[error(
        "the map was made with {key} = {found}, and this robot has {here}: change the configuration, or save into another file"
    )]
    OtherRobot {
        /// Key of the configuration.
        key: &'static str,
        /// Its value in the map.
        found: String,
        /// Its value in this robot.
        here: String,
    },
}

impl From<SnapshotError> for MapStateError {
    fn from(error: SnapshotError) -> Self {
        match error {
            SnapshotError::Damaged(what) => Self::Damaged(what),
            other => Self::Damaged(other.to_string()),
        }
    }
}

/// What a robot must have in common with a map.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct MadeWith {
    cell_m: f64,
    side_cells: u64,
    t_base_laser: Pose2,
    source: PoseSource,
    /// The scanner that localization used; `None` if no scan had come.
    scanner: Option<Geometry>,
}

impl MadeWith {
    fn of(config: &RobotConfig, location: &Location) -> Self {
        Self {
            cell_m: config.map.cell_m,
            side_cells: config.map.side_cells as u64,
            t_base_laser: config.t_base_laser,
            source: config.localization.source,
            scanner: location.scanner(),
        }
    }

    fn check(&self, config: &RobotConfig) -> Result<(), MapStateError> {
        let here = config.map.side_cells;
        same("map.cell_m", &self.cell_m, &config.map.cell_m)?;
        same("map.side_cells", &self.side_cells, &(here as u64))?;
        same("lidar.forward_m", &self.t_base_laser.x_m, &config.t_base_laser.x_m)?;
        same("lidar.left_m", &self.t_base_laser.y_m, &config.t_base_laser.y_m)?;
        same("lidar.yaw_deg", &degrees(&self.t_base_laser), &degrees(&config.t_base_laser))?;
        same("localization.source", &self.source, &config.localization.source)
    }
}

fn degrees(t_base_laser: &Pose2) -> f64 {
    t_base_laser.yaw_rad.to_degrees()
}

fn same<T: PartialEq + std::fmt::Debug>(
    key: &'static str,
    found: &T,
    here: &T,
) -> Result<(), MapStateError> {
    if found == here {
        return Ok(());
    }
    Err(MapStateError::OtherRobot { key, found: format!("{found:?}"), here: format!("{here:?}") })
}

impl Robot {
    /// What the robot knows of the home, as bytes for [`load_map_state`](Self::load_map_state).
    #[must_use]
    pub fn map_state(&self) -> Vec<u8> {
        let mut bytes = MAP_STATE_VERSION.to_le_bytes().to_vec();
        MadeWith::of(&self.config, &self.location).write(&mut bytes);
        self.poses.write(&mut bytes);
        self.wheel_frame.write(&mut bytes);
        State::write(&self.map, &mut bytes);
        State::write(&self.map_correction, &mut bytes);
        self.separate_maps.write(&mut bytes);
        State::write(&self.location, &mut bytes);
        self.location.write_layout_14(&mut bytes);
        bytes
    }

    /// Puts the robot into the map that [`map_state`](Self::map_state) wrote, before its first tick. It is lost there until it has
    /// recognized its place.
    ///
    /// # Errors
    /// When the bytes are of another version or of another robot, or damaged. The robot is then unchanged.
    pub fn load_map_state(&mut self, state: &[u8]) -> Result<(), MapStateError> {
        let mut from = state;
        let (version, made_with) = read_made_with(&mut from)?;
        made_with.check(&self.config)?;
        let mut known = Known::empty(&self.config.map)?;
        known.read(&mut from, version)?;
        let location = Location::new(self.config.localization.clone(), self.config.t_base_laser);
        let mut location = location.map_err(|error| MapStateError::Damaged(error.to_string()))?;
        location.read(&mut from)?;
        if version > MAP_STATE_OF_ONE_MAP {
            location.read_layout_14(&mut from)?;
            known.separate_maps.check(&location)?;
        }
        if !from.is_empty() {
            return Err(MapStateError::Damaged(format!("{} bytes are left over", from.len())));
        }
        self.poses = known.poses;
        self.wheel_frame = known.wheel_frame;
        self.wheel_frame.resume();
        self.map = known.map;
        self.map_correction = known.map_correction;
        self.location = location;
        self.separate_maps = known.separate_maps;
        self.lose(LostReason::Loaded);
        Ok(())
    }

    /// The scanner by which the robot localizes; `None` before its first scan.
    #[must_use]
    pub fn scanner(&self) -> Option<ScanGeometry> {
        self.location.scanner().map(Into::into)
    }
}

/// The version, and what the map was made with.
fn read_made_with(from: &mut &[u8]) -> Result<(u32, MadeWith), MapStateError> {
    let (version, rest) = from
        .split_first_chunk()
        .ok_or_else(|| MapStateError::Damaged("it is truncated".to_owned()))?;
    let found = u32::from_le_bytes(*version);
    if !(MAP_STATE_OF_ONE_MAP..=MAP_STATE_VERSION).contains(&found) {
        return Err(MapStateError::Version { found });
    }
    *from = rest;
    let (made_with, rest) = postcard::take_from_bytes(rest)
        .map_err(|error| MapStateError::Damaged(error.to_string()))?;
    *from = rest;
    Ok((found, made_with))
}

/// The part of a map state that can be read without a scanner.
struct Known {
    poses: TickPoses,
    wheel_frame: WheelFrame,
    map: OccupancyGrid,
    map_correction: MapCorrection,
    separate_maps: SeparateMaps,
}

impl Known {
    fn empty(config: &MapConfig) -> Result<Self, MapStateError> {
        let map = OccupancyGrid::new(config);
        Ok(Self {
            poses: TickPoses::START,
            wheel_frame: WheelFrame::default(),
            map: map.map_err(|error| MapStateError::Damaged(error.to_string()))?,
            map_correction: MapCorrection::default(),
            separate_maps: SeparateMaps::default(),
        })
    }

    fn read(&mut self, from: &mut &[u8], version: u32) -> Result<(), MapStateError> {
        self.poses.read(from)?;
        self.wheel_frame.read(from)?;
        self.map.read(from)?;
        self.map_correction.read(from)?;
        if version > MAP_STATE_OF_ONE_MAP {
            self.separate_maps = SeparateMaps::read(self.map.config(), from)?;
        }
        if !self.poses.t_map_base().is_finite() {
            return Err(MapStateError::Damaged("its pose is not finite".to_owned()));
        }
        Ok(())
    }
}

/// A map without a robot, to show and to export.
#[derive(Debug)]
pub struct SavedMap {
    /// The occupancy grid, in `map`.
    pub grid: OccupancyGrid,
    /// Number of maps whose places in each other are not known. The grid is of that in which the robot was.
    pub maps: usize,
    /// Where the robot was when the map was saved.
    pub t_map_base: Pose2,
    /// Number of submaps of localization.
    pub submaps: usize,
    /// The scanner that the map was made with; `None` if no scan had come.
    pub scanner: Option<ScanGeometry>,
}

impl SavedMap {
    /// Reads a map state.
    ///
    /// # Errors
    /// When the bytes are of another version, or damaged.
    pub fn read(state: &[u8]) -> Result<Self, MapStateError> {
        let mut from = state;
        let (version, made_with) = read_made_with(&mut from)?;
        let mut known = Known::empty(&grid_config(&made_with))?;
        known.read(&mut from, version)?;
        Ok(Self {
            maps: known.separate_maps.count(),
            t_map_base: known.poses.t_map_base(),
            submaps: known.map_correction.sections(),
            grid: known.map,
            scanner: made_with.scanner.map(Into::into),
        })
    }
}

/// A configuration for a grid of this size that is only shown: with the shortest ranges, every size that a robot may have is
/// allowed.
fn grid_config(made_with: &MadeWith) -> MapConfig {
    MapConfig {
        cell_m: made_with.cell_m,
        side_cells: made_with.side_cells as usize,
        recenter_cells: 0,
        mark_range_m: 0.1,
        clear_range_m: 0.1,
        lidar_range_m: 0.1,
        ..MapConfig::default()
    }
}
