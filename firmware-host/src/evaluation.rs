//! What a simulated run is judged by. Ground truth comes in here and goes nowhere else.

use hal::{DepthMap, Pose2};
use runtime::accuracy::{Accuracy, ConstantBaseline, SizeMismatch};
use runtime::event::{Event, SafetyEvent};
use runtime::robot::Robot;
use runtime::tick::Decision;

use crate::report::coverage::Coverage;
use crate::report::events::EventCounts;
use crate::report::stuck::StuckMeter;
use crate::report::summary::{DepthAccuracy, Summary};

/// Depth is compared with ground truth every so many frames: neighbours 3 cm apart say the same.
const ACCURACY_EVERY: u64 = 5;

/// Counts and sums over a run.
pub struct Evaluation {
    coarse: Accuracy,
    network: Accuracy,
    /// Of the network, where coarse depth is.
    refined: Accuracy,
    constant: ConstantBaseline,
    coverage: Option<Coverage>,
    stuck: StuckMeter,
    events: EventCounts,
    collisions: u64,
    in_contact: bool,
    path_m: f64,
    trajectory: Vec<Pose2>,
    goals_m: Vec<[f64; 2]>,
    trips_m: Vec<[f64; 2]>,
    t_world_odom: Pose2,
}

/// What is true at one frame.
#[derive(Debug, Clone, Copy)]
pub struct Truth<'a> {
    /// `t_world_base`.
    pub pose: Pose2,
    /// `t_odom_base` as the robot believes it.
    pub odom: Pose2,
    /// Depth of the frame.
    pub depth: Option<&'a DepthMap>,
    /// The footprint touches something.
    pub contact: bool,
}

impl Evaluation {
    /// Nothing seen yet.
    #[must_use]
    pub fn new(coverage: Option<Coverage>) -> Self {
        Self {
            coarse: Accuracy::new(),
            network: Accuracy::new(),
            refined: Accuracy::new(),
            constant: ConstantBaseline::new(),
            coverage,
            stuck: StuckMeter::default(),
            events: EventCounts::driving(),
            collisions: 0,
            in_contact: false,
            path_m: 0.0,
            trajectory: Vec::new(),
            goals_m: Vec::new(),
            trips_m: Vec::new(),
            t_world_odom: Pose2::IDENTITY,
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
            self.coarse.add(robot.coarse_depth(), depth)?;
            self.constant.add(depth);
            if let Some(network) = robot.network_depth() {
                self.network.add(Some(network), depth)?;
                match robot.coarse_depth() {
                    Some(coarse) => self.refined.add_where(network, &coarse.depth, depth)?,
                    None => self.refined.add(None, depth)?,
                }
            }
        }
        self.stuck.frame(truth.pose);
        if let Some(last) = self.trajectory.last() {
            self.path_m += last.distance_m(&truth.pose);
        }
        self.trajectory.push(truth.pose);
        self.collisions += u64::from(truth.contact && !self.in_contact);
        self.in_contact = truth.contact;
        let t_world_odom = truth.pose.compose(&truth.odom.inverse());
        self.count_events(decision, &t_world_odom, &truth.pose);
        self.mark_coverage(robot, &t_world_odom);
        self.t_world_odom = t_world_odom;
        Ok(())
    }

    fn count_events(&mut self, decision: &Decision, t_world_odom: &Pose2, t_world_base: &Pose2) {
        for event in &decision.events {
            self.events.add(event);
            match event {
                Event::GoalChosen { x_m, y_m, .. } => {
                    self.goals_m.push(t_world_odom.transform(*x_m, *y_m).into());
                }
                Event::Safety { what: SafetyEvent::Tripped { x_m, y_m, .. } } => {
                    self.trips_m.push(t_world_base.transform(*x_m, *y_m).into());
                }
                _ => {}
            }
        }
    }

    fn mark_coverage(&mut self, robot: &Robot, t_world_odom: &Pose2) {
        let Some(coverage) = &mut self.coverage else { return };
        let map = robot.map();
        for cell in map.newly_known() {
            let [x_m, y_m] = map.center_m(*cell);
            let (x_m, y_m) = t_world_odom.transform(x_m, y_m);
            coverage.mark(x_m, y_m, map.cell_m());
        }
    }

    /// Share of the reachable floor that is mapped.
    #[must_use]
    pub fn coverage(&self) -> Option<f64> {
        self.coverage.as_ref().map(Coverage::share)
    }

    /// Where the robot was, in the world.
    #[must_use]
    pub fn trajectory(&self) -> &[Pose2] {
        &self.trajectory
    }

    /// Goals, in the world, metres.
    #[must_use]
    pub fn goals_m(&self) -> &[[f64; 2]] {
        &self.goals_m
    }

    /// What the bumper stopped for, in the world, metres.
    #[must_use]
    pub fn trips_m(&self) -> &[[f64; 2]] {
        &self.trips_m
    }

    /// Where `odom` was in the world at the last frame: moves with the wheels' errors.
    #[must_use]
    pub fn t_world_odom(&self) -> Pose2 {
        self.t_world_odom
    }

    /// Fills in what this knows.
    pub fn summarise(&self, summary: &mut Summary) {
        let network = self.network.rows();
        let constant = self.constant.rows();
        summary.path_m = Some(self.path_m);
        summary.coverage = self.coverage();
        summary.reachable_m2 = self.coverage.as_ref().map(Coverage::reachable_m2);
        summary.collisions = Some(self.collisions);
        summary.stuck_frames = Some(self.stuck.frames());
        summary.stuck_longest_frames = Some(self.stuck.longest());
        summary.events = self.events.clone();
        summary.accuracy = constant.all.is_some().then(|| DepthAccuracy {
            coarse: Some(self.coarse.rows()),
            network: network.all.is_some().then_some(network),
            refined: self.refined.rows().all,
            constant: Some(constant),
        });
    }
}
