//! The global pose: submaps, loop closures and the pose graph, in bounded work per update.

use std::collections::VecDeque;

use hal::Pose2;
use nalgebra::{Matrix3, Rotation3, Vector3};
use serde::{Deserialize, Serialize};

use crate::snapshot::{SnapshotError, State, remembers};

use super::closing::{Closing, Path, Query};
use super::local::Keyframe;
use super::map_search::KnownMap;
use super::pose_graph::{Edge, PoseGraph};
use super::relocalizer::FoundIn;
use super::scan_points::Stretch;
use super::submaps::Submaps;

/// An update begins no further part of a search after this many operations. The last part may be a whole step of the pose graph, or a
/// piece of path with its first headings: 99 % of the updates take less than 1.3 ms for it (docs/localization.md).
const SEARCH_OPERATIONS: u64 = 300_000;
/// Operations of one step of the pose graph, at most, about.
const STEP_OPERATIONS: u64 = 600_000;
/// Steps of the pose graph until it is taken as it is, and steps smaller than this end it: a tenth of a millimetre and of a
/// milliradian.
const MAX_STEPS: u32 = 40;
const AT_REST: f64 = 1e-4;
/// Rounds of weighing closures.
const MAX_ROUNDS: u32 = 8;
/// Drift of one submap that the scans' own covariance does not know of: its standard deviation, and that per metre.
const DRIFT_M: f64 = 0.004;
const DRIFT_PER_METRE: f64 = 0.006;
const DRIFT_RAD: f64 = 0.002;
const DRIFT_RAD_PER_METRE: f64 = 0.001;
/// A robot that was found may have been carried anywhere: 100 m and 100 rad. The chain of drives must not have a hole.
const GAP_INFORMATION: f64 = 1e-4;
/// Standard deviations of the place where it was found. Closed loops make it more exact.
const FOUND_M: f64 = 0.03;
const FOUND_RAD: f64 = 0.01;
/// Standard deviations of wheels that drove on while no scan fitted.
const WHEELS_M: f64 = 0.5;
const WHEELS_RAD: f64 = 0.2;

/// How far the improvement of the poses has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
struct Solving {
    steps: u32,
    rounds: u32,
}

/// Two maps have become one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Joined {
    /// Number of the map that is a part of the other one now.
    pub moved: u16,
    /// How its submaps have moved in `map`: `new = correction * old`.
    pub correction: Pose2,
}

/// Submaps in `map`.
pub(crate) struct GlobalMap {
    submaps: Submaps,
    graph: PoseGraph,
    /// Poses in `map` as of the last correction. The graph's are being improved.
    published: Vec<Pose2>,
    /// The map that each submap belongs to. Poses of different maps say nothing about each other, although all are in `map`.
    map_of: Vec<u16>,
    revision: u64,
    /// Closures that were accepted so far.
    closed: u64,
    /// Finished submaps that have not been searched for.
    queue: VecDeque<u32>,
    query: Option<Query>,
    solving: Option<Solving>,
    closing: Closing,
}

// `map_of` is new in layout 14: see `write_layout_14`.
remembers!(GlobalMap: submaps, graph, published, revision, closed, queue, query, solving);

impl GlobalMap {
    pub(crate) fn new() -> Self {
        Self {
            submaps: Submaps::new(),
            graph: PoseGraph::default(),
            published: Vec::new(),
            map_of: Vec::new(),
            revision: 0,
            closed: 0,
            queue: VecDeque::new(),
            query: None,
            solving: None,
            closing: Closing::new(),
        }
    }

    /// Index of the submap that is being made.
    pub(crate) fn current(&self) -> usize {
        self.published.len().saturating_sub(1)
    }

    pub(crate) fn submap_in_map(&self, index: usize) -> Option<Pose2> {
        self.published.get(index).copied()
    }

    pub(crate) fn submap_in_odom(&self, index: usize) -> Option<Pose2> {
        self.submaps.all().get(index).map(|submap| submap.t_odom)
    }

    pub(crate) fn revision(&self) -> u64 {
        self.revision
    }

    pub(crate) fn closed(&self) -> u64 {
        self.closed
    }

    /// The closures that hold now.
    pub(crate) fn closures(&self) -> &[Edge] {
        self.graph.closures()
    }

    pub(crate) fn t_map_odom(&self) -> Pose2 {
        let current = self.current();
        match (self.submap_in_map(current), self.submap_in_odom(current)) {
            (Some(in_map), Some(in_odom)) => in_map.compose(&in_odom.inverse()),
            _ => Pose2::IDENTITY,
        }
    }

    /// The local tracker made a keyframe at `pose` in `odom`, with its covariance against the keyframes before it.
    pub(crate) fn add(&mut self, pose: &Pose2, stretches: &[Stretch], covariance: &Matrix3<f64>) {
        if self.submaps.is_due(pose) {
            let last = self.submaps.all().last().map(|last| last.t_odom);
            self.submaps.begin(pose);
            match last {
                Some(last) => self.drive(&last, pose, covariance),
                None => {
                    self.graph.begin(*pose);
                    self.published.push(*pose);
                    self.map_of.push(0);
                }
            }
        }
        self.submaps.add(pose, stretches);
    }

    fn drive(&mut self, last: &Pose2, pose: &Pose2, covariance: &Matrix3<f64>) {
        let t_last_new = last.inverse().compose(pose);
        let length_m = t_last_new.x_m.hypot(t_last_new.y_m);
        let drift_m = DRIFT_M + DRIFT_PER_METRE * length_m;
        let drift_rad = DRIFT_RAD + DRIFT_RAD_PER_METRE * length_m;
        let rotation = Rotation3::from_axis_angle(&Vector3::z_axis(), -last.yaw_rad);
        let variances = [drift_m, drift_m, drift_rad].map(|drift| drift * drift);
        let noise = rotation.matrix() * covariance * rotation.matrix().transpose()
            + Matrix3::from_diagonal(&Vector3::from(variances));
        let information = noise.try_inverse().unwrap_or_else(Matrix3::zeros);
        let finished = self.current() as u32;
        self.graph.drive(t_last_new, information);
        if let Some(before) = self.published.last() {
            self.published.push(before.compose(&t_last_new));
            self.map_of.push(self.map());
        }
        self.queue.push_back(finished);
    }

    /// The robot is lost: the submap that it was in gets no more scans.
    pub(crate) fn interrupt(&mut self) {
        self.submaps.finish();
    }

    /// All surfaces, and the map that the robot is in. They do not change while the revision stays, and while
    /// [`settle_poses`](Self::settle_poses) has nothing to do.
    pub(crate) fn known(&self) -> KnownMap<'_> {
        KnownMap {
            submaps: self.submaps.all(),
            poses: &self.published,
            map_of: &self.map_of,
            map: self.map(),
        }
    }

    /// Number of the map that the robot is in.
    pub(crate) fn map(&self) -> u16 {
        self.map_of.last().copied().unwrap_or(0)
    }

    /// Number of the map that a submap belongs to: that of the robot for one that has not begun.
    pub(crate) fn map_of(&self, submap: usize) -> u16 {
        self.map_of.get(submap).copied().unwrap_or_else(|| self.map())
    }

    /// Whether there are maps in which the robot is not.
    pub(crate) fn has_other_maps(&self) -> bool {
        self.map_of.iter().any(|map| *map != self.map())
    }

    /// The numbers of all maps, the newest last.
    pub(crate) fn maps(&self) -> impl Iterator<Item = u16> {
        let newest = self.map_of.iter().copied().max();
        (0..=newest.unwrap_or(0)).filter(|map| self.map_of.contains(map))
    }

    /// A lost robot is found at `pose` in `odom`. Begins a submap there, with what it has seen lately. The new submap is joined to
    /// the nearest one of the map by that place alone, because the robot may have been carried.
    pub(crate) fn join<'a>(
        &mut self,
        pose: &Pose2,
        found: &FoundIn,
        keyframes: impl Iterator<Item = &'a Keyframe>,
    ) {
        let in_map = found.t_map_odom.compose(pose);
        let Some(last) = self.graph.poses().last() else { return };
        let t_last_new = last.inverse().compose(&in_map);
        let to = self.published.len() as u32;
        self.close_at(found.map, to, &in_map);
        self.graph.drive(t_last_new, Matrix3::from_diagonal_element(GAP_INFORMATION));
        self.begin_after_gap(pose, in_map, found.map, keyframes);
    }

    /// Joins submap `to`, which is at `in_map`, to the nearest submap of a map.
    fn close_at(&mut self, map: u16, to: u32, in_map: &Pose2) {
        let submaps = self.published.iter().zip(&self.map_of).enumerate();
        let of_map = submaps.filter(|(_, (_, of))| **of == map);
        let distances = of_map.map(|(index, (pose, _))| (index, pose.distance_m(in_map)));
        let Some((from, _)) = distances.min_by(|a, b| a.1.total_cmp(&b.1)) else { return };
        let t_from_to = self.published[from].inverse().compose(in_map);
        let information = precision(FOUND_M, FOUND_RAD);
        self.graph.close(Edge { from: from as u32, to, t_from_to, information, weight: 1.0 });
    }

    /// Begins another map with a submap at `pose` in `odom`: where that is in the maps before is not known. Its frame is chosen so
    /// that the pose in `map` does not jump.
    pub(crate) fn begin_map<'a>(
        &mut self,
        pose: &Pose2,
        keyframes: impl Iterator<Item = &'a Keyframe>,
    ) {
        let Some(newest) = self.map_of.iter().max() else { return };
        let map = newest + 1;
        let in_map = self.t_map_odom().compose(pose);
        let Some(last) = self.graph.poses().last() else { return };
        let t_last_new = last.inverse().compose(&in_map);
        self.graph.drive(t_last_new, Matrix3::from_diagonal_element(GAP_INFORMATION));
        self.begin_after_gap(pose, in_map, map, keyframes);
    }

    /// The robot's map and another one, where it was found, have met, and no loop is being closed. That with the higher number becomes a part
    /// of the other, and loops between both are searched for. `None` if the robot was found in its own map.
    pub(crate) fn join_maps(&mut self, found: &FoundIn) -> Option<Joined> {
        let here = self.map();
        if found.map == here {
            return None;
        }
        let to_other = found.t_map_odom.compose(&self.t_map_odom().inverse());
        let (stays, moved, correction) = match found.map < here {
            true => (found.map, here, to_other),
            false => (here, found.map, to_other.inverse()),
        };
        let newest = self.current() as u32;
        for index in 0..self.published.len() {
            if self.map_of[index] == moved {
                self.published[index] = correction.compose(&self.published[index]);
                self.graph.set_pose(index, self.published[index]);
                self.queue.extend(Some(index as u32).filter(|index| *index != newest));
            }
        }
        let in_map = self.published[newest as usize];
        self.close_at(found.map, newest, &in_map);
        for map in &mut self.map_of {
            if *map == moved {
                *map = stays;
            }
        }
        // What it has made for submaps that are searched for again was without the other map.
        self.closing.forget();
        self.solving = Some(Solving { steps: 0, rounds: 0 });
        self.revision += 1;
        Some(Joined { moved, correction })
    }

    /// A lost robot is where its wheels say, at `pose` in `odom`. Begins a submap there.
    pub(crate) fn continue_at<'a>(
        &mut self,
        pose: &Pose2,
        keyframes: impl Iterator<Item = &'a Keyframe>,
    ) {
        let (Some(last), Some(before)) = (self.submaps.all().last(), self.published.last()) else {
            return;
        };
        let t_last_new = last.t_odom.inverse().compose(pose);
        let in_map = before.compose(&t_last_new);
        self.graph.drive(t_last_new, precision(WHEELS_M, WHEELS_RAD));
        self.begin_after_gap(pose, in_map, self.map(), keyframes);
    }

    fn begin_after_gap<'a>(
        &mut self,
        pose: &Pose2,
        in_map: Pose2,
        map: u16,
        keyframes: impl Iterator<Item = &'a Keyframe>,
    ) {
        self.queue.push_back(self.current() as u32);
        self.submaps.begin(pose);
        for keyframe in keyframes {
            self.submaps.add(&keyframe.pose, &keyframe.stretches);
        }
        self.published.push(in_map);
        self.map_of.push(map);
        self.revision += 1;
    }

    /// Continues to improve the poses after the last closures, with the work of one update. False when there is nothing to do.
    pub(crate) fn settle_poses(&mut self) -> bool {
        if let Some(solving) = self.solving {
            self.improve(solving);
        }
        self.solving.is_some()
    }

    /// Goes on closing loops, for the work of one update.
    pub(crate) fn work(&mut self) {
        let mut operations = 0;
        while operations < SEARCH_OPERATIONS && self.is_busy() {
            operations += self.work_step();
        }
    }

    /// Does all the work that is left.
    pub(crate) fn settle(&mut self) {
        while self.is_busy() {
            self.work_step();
        }
    }

    /// Whether a search has begun and is not over.
    #[cfg(test)]
    pub(crate) fn is_searching(&self) -> bool {
        self.query.as_ref().is_some_and(Query::is_searching)
    }

    pub(crate) fn is_busy(&self) -> bool {
        self.solving.is_some() || self.query.is_some() || !self.queue.is_empty()
    }

    /// Returns the operations that it took.
    fn work_step(&mut self) -> u64 {
        if let Some(solving) = self.solving {
            return self.improve(solving);
        }
        if let Some(query) = &mut self.query {
            let path = Path { submaps: &self.submaps, graph: &self.graph, map_of: &self.map_of };
            let operations = self.closing.step(query, &path);
            if operations == 0 {
                self.conclude();
            }
            return operations + 1;
        }
        let Some(submap) = self.queue.pop_front() else { return 1 };
        let path = Path { submaps: &self.submaps, graph: &self.graph, map_of: &self.map_of };
        self.query = Some(self.closing.query(submap, &path));
        300 * self.submaps.all().len() as u64 + 1
    }

    fn conclude(&mut self) {
        let closures = self.query.take().map_or_else(Vec::new, Query::closures);
        if closures.is_empty() {
            return;
        }
        self.closed += closures.len() as u64;
        for closure in closures {
            self.graph.close(closure);
        }
        self.solving = Some(Solving { steps: 0, rounds: 0 });
    }

    fn improve(&mut self, mut solving: Solving) -> u64 {
        let change = self.graph.step(STEP_OPERATIONS);
        solving.steps += 1;
        self.solving = Some(solving);
        if change < AT_REST || solving.steps >= MAX_STEPS {
            solving = Solving { steps: 0, rounds: solving.rounds + 1 };
            let again = self.graph.weigh() && solving.rounds < MAX_ROUNDS;
            self.solving = again.then_some(solving);
            if !again {
                self.published.clear();
                self.published.extend_from_slice(self.graph.poses());
                self.revision += 1;
            }
        }
        STEP_OPERATIONS
    }

    /// Whether there is no submap yet.
    pub(crate) fn is_empty(&self) -> bool {
        self.published.is_empty()
    }

    pub(crate) fn restore(&mut self, from: &mut &[u8]) -> Result<(), SnapshotError> {
        State::read(self, from)?;
        self.closing.forget();
        self.map_of.clear();
        self.map_of.resize(self.published.len(), 0);
        Ok(())
    }

    pub(crate) fn write_layout_14(&self, to: &mut Vec<u8>) {
        self.map_of.write(to);
    }

    /// Restores what [`write_layout_14`](Self::write_layout_14) wrote, after the rest of the memory.
    pub(crate) fn read_layout_14(&mut self, from: &mut &[u8]) -> Result<(), SnapshotError> {
        self.map_of.read(from)?;
        if self.map_of.len() != self.published.len() {
            return Err(SnapshotError::Damaged("submaps that belong to no map".to_owned()));
        }
        Ok(())
    }
}

/// Inverse covariance of independent errors of these standard deviations.
fn precision(metres: f64, radians: f64) -> Matrix3<f64> {
    let diagonal = [metres, metres, radians].map(|deviation| 1.0 / (deviation * deviation));
    Matrix3::from_diagonal(&Vector3::from(diagonal))
}
