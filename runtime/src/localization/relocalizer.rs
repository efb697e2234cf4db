//! Finds a lost robot in the map.
//!
//! Scans are searched for one after the other, each from another view. A single scan may fit a wrong place: the robot counts as
//! found only when several in a row, with the robot's own motion between them, name the same place.

use hal::{Pose2, wrap_angle};
use serde::{Deserialize, Serialize};

use crate::snapshot::remembers;

use super::map_search::{KnownMap, MapQuery, MapSearch, Outcome};
use super::scan_points::Stretch;

/// Operations of one update, about: 5 ms of one core. A lost robot makes no depth and no map meanwhile.
const OPERATIONS: u64 = 3_000_000;
/// A scan is searched for after the robot has moved this far since the last one.
const VIEW_M: f64 = 0.2;
const VIEW_RAD: f64 = 0.26;
/// Scans in a row that must name the same place.
const SIGHTINGS: usize = 3;
/// Sightings of one place differ by no more than this, metres and radians: two cells of the map.
const SAME_M: f64 = 0.08;
const SAME_RAD: f64 = 0.04;

/// A scan has named a place.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct Sighting {
    t_odom_base: Pose2,
    t_map_base: Pose2,
}

impl Sighting {
    fn t_map_odom(&self) -> Pose2 {
        self.t_map_base.compose(&self.t_odom_base.inverse())
    }

    /// Whether both name the same place, with the robot's motion between them.
    fn agrees(&self, other: &Self) -> bool {
        let here = self.t_map_odom().compose(&other.t_odom_base);
        here.distance_m(&other.t_map_base) < SAME_M
            && wrap_angle(here.yaw_rad - other.t_map_base.yaw_rad).abs() < SAME_RAD
    }
}

/// The search for the robot.
pub(crate) struct Relocalizer {
    query: Option<MapQuery>,
    /// The pose in `odom` of the scan that is searched for, or that was searched for last.
    view: Option<Pose2>,
    /// They agree with each other.
    sightings: Vec<Sighting>,
    /// Scans that were searched for since the robot was lost.
    searched: u32,
    search: MapSearch,
}

remembers!(Relocalizer: query, view, sightings, searched);

impl Relocalizer {
    pub(crate) fn new(t_base_laser: Pose2) -> Self {
        Self {
            query: None,
            view: None,
            sightings: Vec::new(),
            searched: 0,
            search: MapSearch::new(t_base_laser),
        }
    }

    /// Begins from nothing: the robot was lost, perhaps once more, and poses in `odom` from before say nothing about now.
    pub(crate) fn begin(&mut self) {
        self.query = None;
        self.view = None;
        self.sightings.clear();
        self.searched = 0;
        self.search.forget();
    }

    /// The memory has been restored: what follows from it is made again.
    pub(crate) fn forget_cache(&mut self) {
        self.search.forget();
    }

    /// Scans that were searched for since the robot was lost.
    pub(crate) fn searched(&self) -> u32 {
        self.searched
    }

    /// Takes the stretches of a scan that was taken at `pose` in `odom`, if one is wanted.
    pub(crate) fn offer(&mut self, stretches: &[Stretch], pose: &Pose2) {
        let is_new = self.view.is_none_or(|view| {
            view.distance_m(pose) > VIEW_M
                || wrap_angle(view.yaw_rad - pose.yaw_rad).abs() > VIEW_RAD
        });
        if self.query.is_none() && is_new {
            self.query = Some(MapQuery::new(stretches));
            self.view = Some(*pose);
        }
    }

    /// Continues the search with the work of one update. Returns `t_map_odom` when the robot is found.
    pub(crate) fn work(&mut self, map: &KnownMap<'_>) -> Option<Pose2> {
        let mut operations = 0;
        while operations < OPERATIONS {
            let query = self.query.as_mut()?;
            operations += self.search.step(query, map);
            if query.is_done() {
                let outcome = query.outcome();
                self.query = None;
                self.searched += 1;
                return self.conclude(outcome);
            }
        }
        None
    }

    fn conclude(&mut self, outcome: Outcome) -> Option<Pose2> {
        match outcome {
            // Neither for nor against the place of earlier scans.
            Outcome::Several => return None,
            Outcome::Nowhere => {
                self.sightings.clear();
                return None;
            }
            Outcome::Here(t_map_base) => {
                let sighting = Sighting { t_odom_base: self.view?, t_map_base };
                if self.sightings.iter().any(|earlier| !earlier.agrees(&sighting)) {
                    self.sightings.clear();
                }
                self.sightings.push(sighting);
            }
        }
        let newest = self.sightings.last()?;
        (self.sightings.len() >= SIGHTINGS).then(|| newest.t_map_odom())
    }
}
