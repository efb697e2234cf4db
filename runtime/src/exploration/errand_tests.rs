//! Tasks, the return to the start, and the end of exploration, in a round hall that is known from the beginning.

use hal::{LaserScan, Pose2, Range, ScanGeometry, Twist2, wrap_angle};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use super::{ExplorationConfig, Explorer, Observations, PolicyKind};
use crate::event::{DropReason, Event, GoalReason};
use crate::mapping::{MapConfig, OccupancyGrid, Sweep};
use crate::planning::{FollowerConfig, PlanConfig, Primitive};
use crate::snapshot::State;
use crate::task::{AreaChange, HOLD_NS, Task};

const START: Pose2 = Pose2 { x_m: 0.3, y_m: -0.2, yaw_rad: 0.5 };

/// A wall 1.5 m around the origin, and floor within.
fn hall() -> OccupancyGrid {
    let mut map = OccupancyGrid::new(&MapConfig::default()).unwrap();
    let geometry = ScanGeometry::UTM_30LX;
    for _ in 0..5 {
        for yaw_rad in [0.0, std::f64::consts::PI] {
            let pose = Pose2::new(0.0, 0.0, yaw_rad);
            let ranges = vec![Range::Hit(1.5); geometry.beams];
            let scan = LaserScan { time_ns: 0, geometry, ranges };
            map.begin_update(&pose).unwrap();
            map.integrate_scan(&scan, &Sweep::at_rest(pose)).unwrap();
            map.finish_update();
        }
    }
    map
}

/// A robot that does exactly what its policy decides.
struct Drive {
    explorer: Explorer,
    map: OccupancyGrid,
    pose: Pose2,
    tick: u64,
    events: Vec<Event>,
}

impl Drive {
    fn new(config: ExplorationConfig) -> Self {
        let plan = PlanConfig::default();
        let follow = FollowerConfig::default();
        let rng = Pcg64Mcg::seed_from_u64(3);
        let explorer = Explorer::new(PolicyKind::Frontier, config, &plan, &follow, rng).unwrap();
        Self { explorer, map: hall(), pose: START, tick: 0, events: Vec::new() }
    }

    fn time_ns(&self) -> u64 {
        self.tick * 100_000_000
    }

    fn step(&mut self) -> Primitive {
        let senses = Observations {
            tick: self.tick,
            time_ns: self.time_ns(),
            pose: self.pose,
            map: &self.map,
            frame_maps: None,
            bumped: false,
        };
        let primitive = self.explorer.step(&senses, &mut self.events);
        let rotation_rad = 4_f64.to_radians();
        let motion = match primitive {
            Primitive::Forward => Pose2::new(0.03, 0.0, 0.0),
            Primitive::TurnLeft => Pose2::new(0.0, 0.0, rotation_rad),
            Primitive::TurnRight => Pose2::new(0.0, 0.0, -rotation_rad),
            Primitive::ArcLeft => Pose2::new(0.015, 0.0, rotation_rad),
            Primitive::ArcRight => Pose2::new(0.015, 0.0, -rotation_rad),
            Primitive::Stay => Pose2::IDENTITY,
        };
        self.pose = self.pose.compose(&motion);
        self.tick += 1;
        primitive
    }

    fn begin(&mut self, task: Task) {
        self.explorer.begin(task, self.tick, self.time_ns(), &mut self.events);
    }

    /// The last primitives of a drive over some ticks.
    fn steps(&mut self, ticks: usize) -> Vec<Primitive> {
        (0..ticks).map(|_| self.step()).collect()
    }

    fn stands(&mut self) -> bool {
        self.steps(30).iter().all(|step| *step == Primitive::Stay)
    }

    fn count(&self, event: &Event) -> usize {
        self.events.iter().filter(|one| *one == event).count()
    }
}

#[test]
fn when_all_is_seen_it_is_reported_once_and_the_robot_goes_on() {
    let mut drive = Drive::new(ExplorationConfig::default());
    drive.steps(3000);
    assert_eq!(drive.count(&Event::Explored), 1);
    assert!(drive.explorer.is_done());
    assert!(!drive.stands());
}

#[test]
fn a_robot_that_shall_return_stands_at_the_end_where_and_as_it_began() {
    let config = ExplorationConfig { return_to_start: true, ..ExplorationConfig::default() };
    let mut drive = Drive::new(config);
    let mut farthest_m: f64 = 0.0;
    while !drive.explorer.is_done() && drive.tick < 5000 {
        drive.step();
        farthest_m = farthest_m.max(drive.pose.distance_m(&START));
    }
    assert_eq!(drive.count(&Event::Explored), 1);
    assert!(farthest_m > 0.5, "it was elsewhere meanwhile");
    assert!(drive.pose.distance_m(&START) < 0.1, "{:?}", drive.pose);
    assert!(wrap_angle(drive.pose.yaw_rad - START.yaw_rad).abs() < 0.06, "{:?}", drive.pose);
    assert!(drive.stands());
}

#[test]
fn a_task_is_driven_to_its_place_and_the_robot_stands_there_until_it_may_explore_again() {
    let mut drive = Drive::new(ExplorationConfig::default());
    drive.steps(20);
    let x_m = -0.6;
    let y_m = 0.4;
    drive.begin(Task::GoTo { x_m, y_m });
    drive.steps(600);
    let chosen = Event::GoalChosen { x_m, y_m, why: GoalReason::Task };
    assert_eq!((drive.count(&chosen), drive.count(&Event::GoalReached)), (1, 1));
    assert!(drive.pose.distance_m(&Pose2::new(x_m, y_m, 0.0)) < 0.1, "{:?}", drive.pose);
    assert!(drive.stands() && drive.explorer.goal().is_none());
    drive.begin(Task::Return);
    drive.steps(600);
    assert!(drive.pose.distance_m(&START) < 0.1 && drive.stands());
    drive.begin(Task::Explore);
    assert!(!drive.stands());
}

#[test]
fn a_place_that_cannot_be_reached_is_tried_three_times_and_then_the_robot_stands() {
    let mut drive = Drive::new(ExplorationConfig::default());
    drive.begin(Task::GoTo { x_m: 1.9, y_m: 0.0 });
    drive.steps(700);
    assert_eq!(drive.count(&Event::GoalDropped { why: DropReason::Unreachable }), 3);
    assert!(drive.stands() && drive.pose == START);
}

#[test]
fn a_new_task_takes_the_place_of_the_one_before() {
    let mut drive = Drive::new(ExplorationConfig::default());
    drive.begin(Task::GoTo { x_m: -0.6, y_m: 0.4 });
    drive.steps(10);
    drive.begin(Task::GoTo { x_m: 0.0, y_m: -0.7 });
    assert_eq!(drive.count(&Event::GoalDropped { why: DropReason::Task }), 1);
    drive.steps(600);
    assert!(drive.pose.distance_m(&Pose2::new(0.0, -0.7, 0.0)) < 0.1, "{:?}", drive.pose);
}

#[test]
fn a_pause_stands_at_once_and_the_robot_explores_when_it_may_again() {
    let mut drive = Drive::new(ExplorationConfig::default());
    drive.steps(20);
    let here = drive.pose;
    drive.begin(Task::Pause);
    assert!(drive.stands() && drive.explorer.stands() && drive.pose == here);
    drive.begin(Task::Explore);
    assert!(!drive.stands() && !drive.explorer.stands());
}

#[test]
fn a_robot_that_is_paused_on_its_return_is_not_done_and_returns_when_it_may_go_on() {
    let config = ExplorationConfig { return_to_start: true, ..ExplorationConfig::default() };
    let mut drive = Drive::new(config);
    while drive.count(&Event::Explored) == 0 && drive.tick < 5000 {
        drive.step();
    }
    assert!(drive.pose.distance_m(&START) > 0.1, "it is elsewhere when all is seen");
    drive.begin(Task::Pause);
    assert!(drive.stands() && !drive.explorer.is_done());
    drive.begin(Task::Explore);
    while !drive.explorer.is_done() && drive.tick < 8000 {
        drive.step();
    }
    assert!(drive.explorer.is_done() && drive.pose.distance_m(&START) < 0.1, "{:?}", drive.pose);
}

#[test]
fn places_move_with_the_map() {
    let mut drive = Drive::new(ExplorationConfig::default());
    drive.steps(5);
    drive.begin(Task::Return);
    let shift = Pose2::new(0.2, -0.1, 0.3);
    drive.explorer.move_places(|[x_m, y_m]| shift.transform(x_m, y_m).into());
    drive.steps(600);
    let moved = shift.compose(&START);
    assert!(drive.pose.distance_m(&moved) < 0.1, "{:?}", drive.pose);
    assert!(wrap_angle(drive.pose.yaw_rad - moved.yaw_rad).abs() < 0.06, "{:?}", drive.pose);
}

#[test]
fn a_robot_that_is_driven_by_hand_keeps_the_velocity_until_0_4_s_after_the_last_order() {
    let mut drive = Drive::new(ExplorationConfig::default());
    drive.steps(20);
    let forward = Twist2 { linear_mps: 0.2, angular_radps: -0.3 };
    let order =
        Task::Drive { linear_mps: forward.linear_mps, angular_radps: forward.angular_radps };
    for _ in 0..10 {
        drive.begin(order);
        assert_eq!(drive.explorer.hand_velocity(drive.time_ns()), Some(forward));
        assert_eq!(drive.step(), Primitive::Stay);
        assert!(!drive.explorer.stands());
    }
    let last_ns = drive.time_ns() - 100_000_000;
    assert_eq!(drive.explorer.hand_velocity(last_ns + HOLD_NS - 1), Some(forward));
    assert_eq!(drive.explorer.hand_velocity(last_ns + HOLD_NS), None);
    assert!(drive.explorer.stands() && drive.stands());
    drive.begin(Task::Explore);
    assert!(!drive.stands());
}

#[test]
fn a_hand_that_lets_go_with_an_order_to_stand_stops_the_robot_at_once() {
    let mut drive = Drive::new(ExplorationConfig::default());
    drive.begin(Task::Drive { linear_mps: 0.2, angular_radps: 0.0 });
    drive.begin(Task::Drive { linear_mps: 0.0, angular_radps: 0.0 });
    assert_eq!(drive.explorer.hand_velocity(drive.time_ns()), Some(Twist2::ZERO));
}

/// A line that a robot at [`START`] cannot pass.
const FENCE: AreaChange =
    AreaChange::Close { corners_m: [[-0.5, -2.0], [-0.5, 2.0], [-0.5, 2.0], [-0.5, -2.0]] };

#[test]
fn a_line_that_is_drawn_while_the_robot_drives_is_not_crossed_until_it_is_opened() {
    let mut drive = Drive::new(ExplorationConfig::default());
    let beyond = Task::GoTo { x_m: -1.0, y_m: 0.0 };
    drive.begin(beyond);
    drive.steps(40);
    assert!(drive.explorer.goal().is_some(), "it is on its way");
    drive.explorer.change_areas(FENCE);
    drive.steps(700);
    assert_eq!(drive.count(&Event::GoalDropped { why: DropReason::Unreachable }), 3);
    assert!(drive.stands() && drive.pose.x_m > -0.5, "{:?}", drive.pose);
    drive.explorer.change_areas(AreaChange::OpenAll);
    drive.begin(beyond);
    drive.steps(600);
    assert!(drive.pose.distance_m(&Pose2::new(-1.0, 0.0, 0.0)) < 0.1, "{:?}", drive.pose);
}

#[test]
fn drawn_areas_and_a_drive_by_hand_are_in_a_snapshot() {
    let mut drive = Drive::new(ExplorationConfig::default());
    drive.explorer.change_areas(FENCE);
    drive.begin(Task::Drive { linear_mps: 0.1, angular_radps: 0.0 });
    let mut bytes = Vec::new();
    drive.explorer.write(&mut bytes);
    let mut restored = Drive::new(ExplorationConfig::default());
    restored.explorer.read(&mut bytes.as_slice()).unwrap();
    assert_eq!(restored.explorer.keep_out(), drive.explorer.keep_out());
    assert!(restored.explorer.hand_velocity(HOLD_NS - 1).is_some());
}

#[test]
fn another_policy_drives_from_the_next_tick_on_and_is_in_a_snapshot() {
    let mut drive = Drive::new(ExplorationConfig::default());
    drive.steps(20);
    drive.begin(Task::Pause);
    drive.begin(Task::ExploreBy { policy: PolicyKind::Forward });
    assert_eq!(drive.explorer.policy(), PolicyKind::Forward);
    assert_eq!(drive.steps(10), [Primitive::Forward; 10]);
    assert!(drive.explorer.goal().is_none());
    let mut bytes = Vec::new();
    drive.explorer.write(&mut bytes);
    let mut restored = Drive::new(ExplorationConfig::default());
    restored.explorer.read(&mut bytes.as_slice()).unwrap();
    assert_eq!(restored.steps(10), [Primitive::Forward; 10]);
    // The alternation of `active` starts over, with frontiers.
    drive.begin(Task::ExploreBy { policy: PolicyKind::Active });
    drive.events.clear();
    drive.steps(50);
    assert!(
        !drive.events.iter().any(|event| matches!(event, Event::PolicySwitched { .. })),
        "{:?}",
        drive.events
    );
}

#[test]
fn a_policy_without_paths_only_rotates_while_an_area_is_closed() {
    let mut drive = Drive::new(ExplorationConfig::default());
    drive.begin(Task::ExploreBy { policy: PolicyKind::Forward });
    drive.explorer.change_areas(FENCE);
    assert_eq!(drive.steps(20), [Primitive::TurnLeft; 20]);
    drive.explorer.change_areas(AreaChange::OpenAll);
    assert_eq!(drive.steps(5), [Primitive::Forward; 5]);
}
