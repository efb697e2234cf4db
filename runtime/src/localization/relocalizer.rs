//! Finds the robot in its maps.
//!
//! A lost robot is searched for in all maps. A robot that has begun another map is searched for in the others, while it drives.
//! Scans are searched for one after the other, each from another view. A single scan may fit a wrong place: the robot counts as
//! found only when several, with the robot's own motion between them, name the same place.

use hal::{Pose2, wrap_angle};
use serde::{Deserialize, Serialize};

use crate::snapshot::{SnapshotError, State, remembers};

use super::map_search::{FitLimits, KnownMap, MapQuery, MapSearch, Outcome, RIVAL_SHARE};
use super::scan_points::Stretch;

/// Sightings of one place differ by no more than this, metres and radians: two cells of the map.
const SAME_M: f64 = 0.08;
const SAME_RAD: f64 = 0.04;

/// Why it searches.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub(crate) enum Wanted {
    /// The robot is lost, and rotates on the spot.
    #[default]
    Robot,
    /// The robot drives through a map of its own, and may come to a place of another.
    Meeting,
}

impl Wanted {
    /// Operations of one update, about: 3,000,000 take 5 ms of one core. A lost robot makes no depth and no map meanwhile.
    fn operations(self) -> u64 {
        match self {
            Self::Robot => 3_000_000,
            Self::Meeting => 1_000_000,
        }
    }

    /// A scan is searched for after the robot has moved this far since the last one, metres or radians.
    fn view(self) -> (f64, f64) {
        match self {
            Self::Robot => (0.2, 0.26),
            Self::Meeting => (0.3, 0.5),
        }
    }

    /// Scans that must name the same place, and how far from the newest one of them must be, metres. From one spot, two rooms of the same
    /// size give the same scan; a robot that drives sees more of them.
    fn evidence(self) -> (usize, f64) {
        match self {
            Self::Robot => (3, 0.0),
            Self::Meeting => (5, 1.5),
        }
    }

    /// Measured by `localization --separate` (docs/localization.md). Of three scans from one spot that named a wrong place, one at least
    /// contradicted it by 0.16; three that named a right one contradicted it by 0.01 at most in the median, by more where furniture was
    /// moved. Along a drive, scans that named a wrong place contradicted it by 0.39 and more.
    fn limits(self) -> FitLimits {
        match self {
            Self::Robot => FitLimits { overlap: 0.6, inliers: 0.8, contradictions: 0.1 },
            Self::Meeting => FitLimits { overlap: 0.45, inliers: 0.75, contradictions: 0.3 },
        }
    }

    /// Sightings that are kept. Those of a lost robot all agree: one that contradicts them is the first of the next place. Of a robot
    /// that drives, most scans show things that the other map does not have, and a wrong sighting is outvoted.
    fn kept(self) -> usize {
        match self {
            Self::Robot => 3,
            Self::Meeting => 8,
        }
    }
}

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

/// Where the robot was found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct FoundIn {
    /// Number of the map.
    pub map: u16,
    /// Pose of `odom` in it.
    pub t_map_odom: Pose2,
}

/// The search for the robot.
pub(crate) struct Relocalizer {
    query: Option<MapQuery>,
    /// The pose in `odom` of the scan that is searched for, or that was searched for last.
    view: Option<Pose2>,
    sightings: Vec<Sighting>,
    /// Scans that were searched for since the search began.
    searched: u32,
    wanted: Wanted,
    /// The maps in which the scan has not been searched for, the next one last.
    maps: Vec<u16>,
    /// The scan fits several places of a map that was searched.
    fits_several: bool,
    /// The best place in the maps that were searched, with its map and its score.
    best: Option<(u16, Pose2, f32)>,
    /// The map of each sighting.
    sighted: Vec<u16>,
    search: MapSearch,
}

// `wanted`, `maps`, `fits_several`, `best` and `sighted` are new in layout 14: see `write_layout_14`.
remembers!(Relocalizer: query, view, sightings, searched);

impl Relocalizer {
    pub(crate) fn new(t_base_laser: Pose2) -> Self {
        Self {
            query: None,
            view: None,
            sightings: Vec::new(),
            searched: 0,
            wanted: Wanted::Robot,
            maps: Vec::new(),
            fits_several: false,
            best: None,
            sighted: Vec::new(),
            search: MapSearch::new(t_base_laser),
        }
    }

    /// Begins from nothing: poses in `odom` from before say nothing about now.
    pub(crate) fn begin(&mut self, wanted: Wanted) {
        self.forget_sightings();
        self.view = None;
        self.searched = 0;
        self.wanted = wanted;
        self.restart();
    }

    /// The maps have changed: the scan that is searched for is dropped.
    pub(crate) fn restart(&mut self) {
        self.query = None;
        self.search.forget();
    }

    /// The memory has been restored: what follows from it is made again.
    pub(crate) fn forget_cache(&mut self) {
        self.search.forget();
    }

    /// Scans that were searched for since the search began.
    pub(crate) fn searched(&self) -> u32 {
        self.searched
    }

    /// Takes the stretches of a scan that was taken at `pose` in `odom`, if one is wanted, to search for it in `maps`, from the last to the
    /// first.
    pub(crate) fn offer(
        &mut self,
        stretches: &[Stretch],
        pose: &Pose2,
        maps: impl Iterator<Item = u16>,
    ) {
        let (view_m, view_rad) = self.wanted.view();
        let is_new = self.view.is_none_or(|view| {
            view.distance_m(pose) > view_m
                || wrap_angle(view.yaw_rad - pose.yaw_rad).abs() > view_rad
        });
        if self.query.is_none() && is_new {
            self.maps.clear();
            self.maps.extend(maps);
            self.fits_several = false;
            self.best = None;
            self.query = Some(MapQuery::new(stretches));
            self.view = Some(*pose);
        }
    }

    /// Continues the search with the work of one update, in the maps that the scan was offered for.
    pub(crate) fn work(&mut self, known: &KnownMap<'_>) -> Option<FoundIn> {
        let mut operations = 0;
        while operations < self.wanted.operations() {
            let query = self.query.as_mut()?;
            let Some(map) = self.maps.last().copied() else {
                self.query = None;
                self.searched += 1;
                return self.conclude();
            };
            let limits = self.wanted.limits();
            operations += self.search.step(query, &KnownMap { map, ..*known }, &limits);
            if query.is_done() {
                let outcome = query.outcome();
                query.again();
                self.maps.pop();
                self.compare(map, outcome);
            }
        }
        None
    }

    /// Compares what was found in one map with what was found in those before.
    fn compare(&mut self, map: u16, outcome: Outcome) {
        let (pose, score) = match outcome {
            Outcome::Here(pose, score) => (pose, score),
            Outcome::Several => {
                self.fits_several = true;
                return;
            }
            Outcome::Nowhere => return,
        };
        let before = self.best.map_or(0.0, |(_, _, score)| score);
        self.fits_several |= before.min(score) > RIVAL_SHARE * before.max(score);
        if score > before {
            self.best = Some((map, pose, score));
        }
    }

    /// The scan was searched for in all maps. One that fits several places says nothing for or against the place of earlier scans.
    fn conclude(&mut self) -> Option<FoundIn> {
        if self.fits_several {
            return None;
        }
        let Some((map, t_map_base, _)) = self.best else {
            if self.wanted == Wanted::Robot {
                self.forget_sightings();
            }
            return None;
        };
        let newest = Sighting { t_odom_base: self.view?, t_map_base };
        let contradicts = self.sightings.iter().any(|earlier| !earlier.agrees(&newest))
            || self.sighted.iter().any(|sighted| *sighted != map);
        if contradicts && self.wanted == Wanted::Robot {
            self.forget_sightings();
        }
        if self.sightings.len() >= self.wanted.kept() {
            self.sightings.remove(0);
            self.sighted.remove(0);
        }
        self.sightings.push(newest);
        self.sighted.push(map);
        self.is_enough(&newest, map).then(|| FoundIn { map, t_map_odom: newest.t_map_odom() })
    }

    /// Whether enough sightings in the map agree with the newest one.
    fn is_enough(&self, newest: &Sighting, map: u16) -> bool {
        let (count, apart_m) = self.wanted.evidence();
        let agreeing = || {
            let all = self.sightings.iter().zip(&self.sighted);
            all.filter(|(earlier, sighted)| **sighted == map && earlier.agrees(newest))
        };
        let distances =
            agreeing().map(|(earlier, _)| earlier.t_odom_base.distance_m(&newest.t_odom_base));
        agreeing().count() >= count && distances.fold(0.0, f64::max) >= apart_m
    }

    fn forget_sightings(&mut self) {
        self.sightings.clear();
        self.sighted.clear();
    }

    pub(crate) fn write_layout_14(&self, to: &mut Vec<u8>) {
        self.wanted.write(to);
        self.maps.write(to);
        self.fits_several.write(to);
        self.best.write(to);
        self.sighted.write(to);
    }

    pub(crate) fn read_layout_14(&mut self, from: &mut &[u8]) -> Result<(), SnapshotError> {
        self.wanted.read(from)?;
        self.maps.read(from)?;
        self.fits_several.read(from)?;
        self.best.read(from)?;
        self.sighted.read(from)?;
        match self.sighted.len() == self.sightings.len() {
            true => Ok(()),
            false => Err(SnapshotError::Damaged("sightings without a map".to_owned())),
        }
    }

    /// What robots with one map remember: those of earlier layouts.
    pub(crate) fn forget_layout_14(&mut self) {
        self.wanted = Wanted::Robot;
        self.maps.clear();
        self.maps.extend(self.query.is_some().then_some(0));
        self.fits_several = false;
        self.best = None;
        self.sighted.clear();
        self.sighted.resize(self.sightings.len(), 0);
    }
}
