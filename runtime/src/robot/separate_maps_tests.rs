//! Robots that were given the map of another room.

use hal::{Pose2, wrap_angle};

use super::test_robot::{cells, config, drive, robot, standing_in};
use super::*;
use crate::recording::RecordedTick;
use crate::session::recompute;
use crate::task::Task;

/// Half of the sides of the room in which the robot is, metres. Nothing in it is like the mapped one.
const OTHER_ROOM_M: [f64; 2] = [0.8, 4.5];
/// Two rotations at 20 degrees per second take 36 s.
const TICKS: u64 = 450;

/// A robot with the map of the first room, in the other one. `prepare` changes the input of its first tick.
fn lost_in_another_room(
    config: RobotConfig,
    prepare: impl Fn(&mut RecordedTick),
) -> (Robot, Vec<Event>) {
    let mut first = robot();
    drive(&mut first);
    let mut second = Robot::new(config, None).unwrap();
    second.load_map_state(&first.map_state()).unwrap();
    let mut events = Vec::new();
    let mut pose = Pose2::new(0.1, -1.0, 0.2);
    let mut wheel = Pose2::IDENTITY;
    for tick in 0..TICKS {
        let mut input = standing_in(OTHER_ROOM_M, tick, &pose, wheel);
        if tick == 0 {
            prepare(&mut input);
        }
        let decision = recompute(&mut second, &input).unwrap();
        let yaw_rad = 0.1 * decision.desired.angular_radps;
        pose.yaw_rad = wrap_angle(pose.yaw_rad + yaw_rad);
        wheel.yaw_rad = wrap_angle(wheel.yaw_rad + yaw_rad);
        events.extend(decision.events);
        if second.whereabouts().lost().is_none() {
            break;
        }
    }
    (second, events)
}

fn nothing(_: &mut RecordedTick) {}

#[test]
fn a_robot_that_does_not_find_itself_begins_another_map_and_the_one_before_stays_as_it_is() {
    let (robot, events) = lost_in_another_room(config(), nothing);
    assert!(events.contains(&Event::MapBegun) && !events.contains(&Event::StandsLost));
    assert_eq!((robot.map_number(), robot.maps()), (1, 2));
    assert_eq!(robot.map().known_cells().count(), 0);
    assert_eq!(robot.explorer().goal(), None);
    // The map before is in what is saved, and comes back as it was.
    let mut again = super::test_robot::robot();
    again.load_map_state(&robot.map_state()).unwrap();
    assert_eq!((again.map_number(), again.maps()), (1, 2));
    assert_eq!(SavedMap::read(&robot.map_state()).unwrap().maps, 2);
    let mut first = super::test_robot::robot();
    drive(&mut first);
    assert_eq!(cells(again.separate_maps.grid(0).unwrap()), cells(first.map()));
    assert!(!robot.is_in_map_of_first(first.submaps()));
    assert!(robot.is_in_map_of_first(robot.submaps()));
}

#[test]
fn a_robot_with_two_maps_goes_on_from_a_snapshot() {
    let (mut first, _) = lost_in_another_room(config(), nothing);
    let mut second = robot();
    second.restore(&first.snapshot()).unwrap();
    let input = |step: u64| {
        let pose = Pose2::new(0.1, -1.0 + 0.03 * step as f64, 1.5);
        standing_in(OTHER_ROOM_M, TICKS + step, &pose, Pose2::new(0.03 * step as f64, 0.0, 0.0))
    };
    for step in 0..20 {
        let decision = recompute(&mut first, &input(step)).unwrap();
        assert_eq!(recompute(&mut second, &input(step)).unwrap(), decision, "{step}");
    }
    assert!(second.snapshot() == first.snapshot());
}

#[test]
fn a_robot_that_may_not_begin_another_map_stands() {
    let mut stays = config();
    stays.localization.new_map_when_lost = false;
    let (robot, events) = lost_in_another_room(stays, nothing);
    assert!(events.contains(&Event::StandsLost) && !events.contains(&Event::MapBegun));
    assert_eq!(robot.maps(), 1);
}

#[test]
fn a_robot_with_a_task_or_with_closed_areas_of_its_map_begins_no_other() {
    let go_to = |input: &mut RecordedTick| input.task = Some(Task::GoTo { x_m: 1.0, y_m: 0.0 });
    let (robot, events) = lost_in_another_room(config(), go_to);
    assert!(events.contains(&Event::StandsLost) && robot.maps() == 1);
    let mut closed = config();
    closed.plan.keep_out_m = vec![vec![[1.0, 1.0], [2.0, 1.0], [2.0, 2.0]]];
    let (robot, events) = lost_in_another_room(closed, nothing);
    assert!(events.contains(&Event::StandsLost) && robot.maps() == 1);
}
