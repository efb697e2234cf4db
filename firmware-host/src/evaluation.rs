//! What a simulated run is judged by. Ground truth comes in here and goes nowhere else.

use std::collections::BTreeMap;

use hal::{DepthMap, Pose2};
use runtime::accuracy::{Accuracy, ConstantBaseline, SizeMismatch};
use runtime::event::{Event, SafetyEvent};
use runtime::mapping::{Cell, OccupancyGrid};
use runtime::robot::{Robot, TickPoses};
use runtime::tick::Decision;

use crate::report::coverage::Coverage;
use crate::report::events::EventCounts;
use crate::report::goal_log::GoalLog;
use crate::report::held::HeldMeter;
use crate::report::map_image::Goal;
use crate::report::pose_error::{PoseError, PosePair};
use crate::report::stuck::StuckMeter;
use crate::report::summary::{DepthAccuracy, Summary};

/// Depth is compared with ground truth every few frames: neighbours 3 cm apart give the same answer.
const ACCURACY_EVERY: u64 = 5;

/// Distance from the footprint to an edge of the floor that counts as an approach, metres.
pub const NEAR_EDGE_M: f64 = 0.1;

/// Counts and sums over a run.
pub struct Evaluation {
    coarse: Accuracy,
    dense: Accuracy,
    network: Accuracy,
    /// Of the network, where coarse depth is.
    refined: Accuracy,
    constant: ConstantBaseline,
    coverage: Option<Coverage>,
    stuck: StuckMeter,
    held: HeldMeter,
    events: EventCounts,
    collisions: u64,
    in_contact: bool,
    edge_approaches: u64,
    near_edge: bool,
    fell: bool,
    path_m: f64,
    /// True pose at the last frame.
    last_truth: Option<Pose2>,
    /// Poses in each of the robot's maps. When two become one, only those in the map of the robot are kept: one of the frames is no more.
    poses: BTreeMap<u16, Vec<PosePair>>,
    /// The map in which the robot is.
    map: u16,
    goals: GoalLog,
    trips_m: Vec<[f64; 2]>,
}

/// What is true at one frame.
#[derive(Debug, Clone, Copy)]
pub struct Truth<'a> {
    /// True pose of the robot, `t_world_base`.
    pub pose: Pose2,
    /// Depth of the frame.
    pub depth: Option<&'a DepthMap>,
    /// The footprint touches something.
    pub contact: bool,
    /// The footprint is within [`NEAR_EDGE_M`] of an edge over which it can fall.
    pub near_edge: bool,
    /// The robot fell over such an edge.
    pub fell: bool,
}

impl Evaluation {
    /// An evaluation of no frame yet.
    #[must_use]
    pub fn new(coverage: Option<Coverage>) -> Self {
        Self {
            coarse: Accuracy::new(),
            dense: Accuracy::new(),
            network: Accuracy::new(),
            refined: Accuracy::new(),
            constant: ConstantBaseline::new(),
            coverage,
            stuck: StuckMeter::default(),
            held: HeldMeter::default(),
            events: EventCounts::driving(),
            collisions: 0,
            in_contact: false,
            edge_approaches: 0,
            near_edge: false,
            fell: false,
            path_m: 0.0,
            last_truth: None,
            poses: BTreeMap::new(),
            map: 0,
            goals: GoalLog::default(),
            trips_m: Vec::new(),
        }
    }

    /// Counts one frame.
    ///
    /// # Errors
    /// When ground truth has another size than the depth.
    pub fn frame(
        &mut self,
        truth: &Truth<'_>,
        robot: &Robot,
        decision: &Decision,
    ) -> Result<(), SizeMismatch> {
        if let Some(depth) = truth.depth.filter(|_| decision.tick.is_multiple_of(ACCURACY_EVERY)) {
            self.compare_depth(robot, depth)?;
        }
        self.stuck.frame(truth.pose);
        self.held.frame(decision.desired, decision.sent);
        if let Some(last) = self.last_truth.replace(truth.pose) {
            self.path_m += last.distance_m(&truth.pose);
        }
        let believed = robot.poses();
        self.collisions += u64::from(truth.contact && !self.in_contact);
        self.in_contact = truth.contact;
        self.edge_approaches += u64::from(truth.near_edge && !self.near_edge);
        self.near_edge = truth.near_edge;
        self.fell |= truth.fell;
        self.count_events(decision, believed);
        self.map = robot.map_number();
        if decision.events.contains(&Event::MapsJoined) {
            self.poses.retain(|map, _| *map == self.map);
        }
        if robot.whereabouts().lost().is_some() {
            // A lost robot claims no pose in its map, and maps nothing.
            return Ok(());
        }
        let poses = self.poses.entry(self.map).or_default();
        let is_first = poses.is_empty();
        poses.push(PosePair {
            truth: truth.pose,
            t_odom_base: believed.t_odom_base,
            t_map_base: believed.t_map_base(),
        });
        let t_world_map = truth.pose.compose(&believed.t_map_base().inverse());
        let map = robot.map();
        if is_first {
            // Of a loaded map, all that was known before.
            self.mark_coverage(map, map.known_cells().map(|(cell, _)| cell), &t_world_map);
        } else {
            self.mark_coverage(map, map.newly_known().iter().copied(), &t_world_map);
        }
        Ok(())
    }

    fn compare_depth(&mut self, robot: &Robot, truth: &DepthMap) -> Result<(), SizeMismatch> {
        self.coarse.add(robot.coarse_depth(), truth)?;
        self.dense.add(robot.dense_depth(), truth)?;
        self.constant.add(truth);
        let Some(network) = robot.network_depth() else { return Ok(()) };
        self.network.add(Some(network), truth)?;
        match robot.coarse_depth() {
            Some(coarse) => self.refined.add_where(network, &coarse.depth, truth),
            None => self.refined.add(None, truth),
        }
    }

    fn count_events(&mut self, decision: &Decision, believed: &TickPoses) {
        for event in &decision.events {
            self.events.add(event);
            self.goals.note(event);
            if let Event::Safety { what: SafetyEvent::Tripped { x_m, y_m, .. } } = event {
                self.trips_m.push(believed.t_map_base().transform(*x_m, *y_m).into());
            }
            if matches!(event, Event::MapBegun | Event::MapChanged | Event::MapsJoined) {
                self.trips_m.clear();
            }
        }
    }

    /// Marks what became known at the place that was really observed, whatever the drift of the
    /// map: `t_world_map` is where the map would have to be for the robot to be where it is.
    fn mark_coverage(
        &mut self,
        map: &OccupancyGrid,
        cells: impl Iterator<Item = Cell>,
        t_world_map: &Pose2,
    ) {
        let Some(coverage) = &mut self.coverage else { return };
        for cell in cells {
            let [x_m, y_m] = map.center_m(cell);
            let (x_m, y_m) = t_world_map.transform(x_m, y_m);
            coverage.mark(x_m, y_m, map.cell_m());
        }
    }

    /// The reachable floor and what of it was mapped.
    #[must_use]
    pub fn coverage(&self) -> Option<&Coverage> {
        self.coverage.as_ref()
    }

    /// True and believed pose at every frame in the map of the end.
    #[must_use]
    pub fn poses(&self) -> &[PosePair] {
        self.poses.get(&self.map).map_or(&[], Vec::as_slice)
    }

    /// Goals and what became of them, in the map, metres.
    #[must_use]
    pub fn goals(&self) -> &[Goal] {
        self.goals.goals()
    }

    /// What the safety plane stopped for in the map of the end, metres.
    #[must_use]
    pub fn trips_m(&self) -> &[[f64; 2]] {
        &self.trips_m
    }

    /// The map's pose in the world that makes the first believed pose right. A map without drift
    /// then lies on the true home.
    #[must_use]
    pub fn t_world_map(&self) -> Pose2 {
        self.poses()
            .first()
            .map_or(Pose2::IDENTITY, |first| first.truth.compose(&first.t_map_base.inverse()))
    }

    /// The believed pose in each frame, in the world by [`t_world_map`](Self::t_world_map).
    #[must_use]
    pub fn believed_path(&self) -> Vec<Pose2> {
        let t_world_map = self.t_world_map();
        self.poses().iter().map(|pair| t_world_map.compose(&pair.t_map_base)).collect()
    }

    /// Fills in what this knows.
    pub fn summarise(&self, summary: &mut Summary) {
        let network = self.network.rows();
        let dense = self.dense.rows();
        let constant = self.constant.rows();
        summary.path_m = Some(self.path_m);
        summary.coverage = self.coverage.as_ref().map(Coverage::share);
        summary.reachable_m2 = self.coverage.as_ref().map(Coverage::reachable_m2);
        summary.pose_error = PoseError::of(self.poses());
        summary.collisions = Some(self.collisions);
        summary.edge_approaches = (self.edge_approaches > 0).then_some(self.edge_approaches);
        summary.fell = self.fell.then_some(true);
        summary.held_frames = Some(self.held.frames());
        summary.stuck_frames = Some(self.stuck.frames());
        summary.stuck_longest_frames = Some(self.stuck.longest());
        summary.events = self.events.clone();
        summary.accuracy = constant.all.is_some().then(|| DepthAccuracy {
            coarse: Some(self.coarse.rows()),
            dense: dense.all.is_some().then_some(dense),
            network: network.all.is_some().then_some(network),
            refined: self.refined.rows().all,
            constant: Some(constant),
        });
    }
}
