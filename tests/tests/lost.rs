//! Robots that are carried while they explore, in simulated homes and virtual time.
#![allow(clippy::unwrap_used, reason = "a test that cannot set up its scene has failed")]

use hal::{Pose2, wrap_angle};
use hil::{Scenario, Sensors, Tick};
use runtime::event::{Event, SafetyEvent};
use runtime::exploration::PolicyKind;
use runtime::localization::{LostReason, Whereabouts};
use runtime::safety::Request;
use simulator::{OpenOptions, World};

/// Explores for half a minute. Returns `t_map_world` and the robot's true poses.
fn explore(scenario: &mut Scenario) -> (Pose2, Vec<Pose2>) {
    let ticks = scenario.ticks(300).unwrap();
    assert!(ticks.iter().all(|tick| tick.decision.lost.is_none()));
    let t_map_world = ticks[0].decision.t_map_base().compose(&ticks[0].pose.inverse());
    (t_map_world, ticks.iter().map(|tick| tick.pose).collect())
}

/// The earlier place that is furthest away, with another heading.
fn elsewhere(poses: &[Pose2]) -> Pose2 {
    let here = poses[poses.len() - 1];
    let farthest = poses.iter().max_by(|a, b| a.distance_m(&here).total_cmp(&b.distance_m(&here)));
    let pose = farthest.unwrap();
    Pose2 { yaw_rad: wrap_angle(pose.yaw_rad + 2.0), ..*pose }
}

/// Ticks until the robot is found. A person arms it when the safety plane asks for one.
fn until_found(scenario: &mut Scenario, most: usize) -> Vec<Tick> {
    let mut ticks = Vec::new();
    let mut was_lost = false;
    for _ in 0..most {
        let tick = scenario.tick().unwrap();
        let needs_person = tick.decision.events.iter().any(|event| {
            matches!(event, Event::Safety { what: SafetyEvent::Faulted { why } } if why.needs_person())
        });
        if needs_person {
            scenario.request(Request::ClearFault);
            scenario.tick().unwrap();
            scenario.request(Request::Arm);
        }
        was_lost |= tick.decision.lost.is_some();
        let is_found = was_lost && tick.decision.lost.is_none();
        ticks.push(tick);
        if is_found {
            break;
        }
    }
    ticks
}

fn assert_right(tick: &Tick, t_map_world: &Pose2) {
    let truth = t_map_world.compose(&tick.pose);
    let error = truth.inverse().compose(&tick.decision.t_map_base());
    let radians = wrap_angle(error.yaw_rad).abs();
    assert!(error.x_m.hypot(error.y_m) < 0.15 && radians < 0.087, "{error:?}");
}

#[test]
fn a_robot_that_is_lifted_and_put_elsewhere_stops_rotates_finds_itself_and_explores_on() {
    let mut scenario = Scenario::new(PolicyKind::Active, &[], 3).unwrap().shadowed().unwrap();
    let (t_map_world, poses) = explore(&mut scenario);
    scenario.carry_to(elsewhere(&poses));
    let ticks = until_found(&mut scenario, 400);
    let lost: Vec<_> = ticks.iter().filter(|tick| tick.decision.lost.is_some()).collect();
    assert!(!lost.is_empty());
    for tick in &lost {
        assert!(tick.decision.desired.linear_mps == 0.0 && tick.decision.map_digest == 0);
        assert!(tick.decision.depth_digest == 0);
    }
    let last = ticks.last().unwrap();
    assert!(last.decision.events.iter().any(|event| matches!(event, Event::Found { .. })));
    assert_right(last, &t_map_world);
    let after = scenario.ticks(100).unwrap();
    assert!(after.iter().all(|tick| tick.decision.lost.is_none()));
    assert!(after.iter().any(|tick| tick.decision.desired.linear_mps > 0.0));
    assert_right(after.last().unwrap(), &t_map_world);
}

#[test]
fn a_robot_that_is_started_in_a_saved_map_of_this_home_finds_itself() {
    let mut scenario = Scenario::new(PolicyKind::Active, &[], 4).unwrap();
    let (t_map_world, poses) = explore(&mut scenario);
    let known = scenario.robot().map().known_cells().count();
    scenario.robot_mut().lose(LostReason::Loaded);
    scenario.carry_to(elsewhere(&poses));
    let ticks = until_found(&mut scenario, 400);
    let first = &ticks[0].decision;
    assert_eq!(first.lost, Some(LostReason::Loaded));
    assert!(first.events.contains(&Event::Lost { why: LostReason::Loaded }));
    assert_eq!(scenario.robot().whereabouts(), Whereabouts::Localized);
    assert_right(ticks.last().unwrap(), &t_map_world);
    assert!(scenario.robot().map().known_cells().count() >= known);
}

/// A robot in a built-in home. With `&moved=1`, the home's furniture stands elsewhere.
fn in_home(home: &str, seed: u64) -> Scenario {
    let sensors = Sensors { scene: format!("builtin:{home}"), ..Sensors::default() };
    Scenario::with_sensors(PolicyKind::Active, &[], seed, sensors).unwrap()
}

/// How robots found themselves among moved furniture.
#[derive(Debug, Default)]
struct FoundAmong {
    on_the_spot: usize,
    /// After they had begun another map, within two minutes.
    joined: usize,
    not: usize,
}

/// Maps a home, moves its furniture, and starts another robot with the map at some places of the first robot's path. A place that it
/// accepts must be the true one.
fn found_among_moved_furniture(
    home: &str,
    seed: u64,
    places: fn(&[Pose2]) -> Vec<Pose2>,
) -> FoundAmong {
    let mut first = in_home(home, seed);
    let (t_map_world, poses) = explore(&mut first);
    let map = first.robot().map_state();
    let moved = format!("{home}&moved=1");
    let world = World::open(&format!("builtin:{moved}"), &OpenOptions::default()).unwrap();
    let is_free = |pose: &&Pose2| world.floor_plan().fits(pose.x_m, pose.y_m, &[]);
    let free: Vec<Pose2> = poses.iter().filter(is_free).copied().collect();
    let mut found = FoundAmong::default();
    for place in places(&free) {
        let mut again = in_home(&moved, 5);
        again.robot_mut().load_map_state(&map).unwrap();
        again.carry_to(place);
        let ticks = until_found(&mut again, 450);
        assert_eq!(ticks[0].decision.lost, Some(LostReason::Loaded));
        if again.robot().maps() == 1 {
            found.on_the_spot += 1;
        } else if map_events(&mut again, 1200, |event| matches!(event, Event::MapsJoined))
            .is_empty()
        {
            found.not += 1;
            continue;
        } else {
            found.joined += 1;
        }
        assert_right(&again.tick().unwrap(), &t_map_world);
        // And it stays right while it explores on.
        assert_right(again.ticks(50).unwrap().last().unwrap(), &t_map_world);
    }
    found
}

/// All furniture stands elsewhere, which is more than people move between two runs.
#[test]
fn a_robot_in_the_saved_map_of_a_home_whose_furniture_was_moved_finds_itself_and_nowhere_wrongly() {
    let three = |free: &[Pose2]| vec![free[0], free[free.len() / 2], elsewhere(free)];
    let found = found_among_moved_furniture("apartment?seed=1", 4, three);
    // Where the places are depends on the path: of twenty in this home, nine are found on the spot (docs/localization.md).
    assert!(found.not == 0 && found.on_the_spot >= 2, "{found:?}");
    let found = found_among_moved_furniture("apartment?seed=6", 4, three);
    assert!(found.not == 0 && found.joined > 0, "{found:?}");
    // In this home too little of most rooms is as it was. Nowhere wrongly, all the same.
    found_among_moved_furniture("house?seed=1", 4, three);
    let later = |free: &[Pose2]| (4..8).map(|part| free[free.len() * part / 8]).collect();
    let found = found_among_moved_furniture("apartment?seed=3", 6, later);
    // Two and more were found on the spot by limits that accepted wrong places in other homes (docs/localization.md).
    assert!(found.on_the_spot >= 1, "{found:?}");
}

/// The free place that is furthest from everything that the robot has mapped.
fn unknown_place(scenario: &Scenario, world: &World, t_map_world: &Pose2) -> Pose2 {
    let known: Vec<[f64; 2]> = {
        let map = scenario.robot().map();
        map.known_cells().step_by(7).map(|(cell, _)| map.center_m(cell)).collect()
    };
    let plan = world.floor_plan();
    let mut best = (0.0, Pose2::IDENTITY);
    for x in 0..200 {
        for y in 0..200 {
            let place = Pose2::new(0.1 * f64::from(x) - 10.0, 0.1 * f64::from(y) - 10.0, 1.0);
            if !plan.fits(place.x_m, place.y_m, &[]) {
                continue;
            }
            let (x_m, y_m) = t_map_world.transform(place.x_m, place.y_m);
            let nearest = known.iter().map(|[kx, ky]| (kx - x_m).hypot(ky - y_m));
            let nearest_m = nearest.fold(f64::INFINITY, f64::min);
            if nearest_m > best.0 {
                best = (nearest_m, place);
            }
        }
    }
    best.1
}

/// What happened in some ticks to the robot's place and its maps. A person arms the robot when the safety plane asks for one.
fn map_events(scenario: &mut Scenario, ticks: usize, until: fn(&Event) -> bool) -> Vec<Event> {
    let mut found = Vec::new();
    for _ in 0..ticks {
        let events = scenario.tick().unwrap().decision.events;
        let is_over = events.iter().any(until);
        for event in events {
            match &event {
                Event::Safety { what: SafetyEvent::Faulted { why } } if why.needs_person() => {
                    scenario.request(Request::ClearFault);
                    scenario.tick().unwrap();
                    scenario.request(Request::Arm);
                }
                Event::Lost { .. }
                | Event::Found { .. }
                | Event::StandsLost
                | Event::MapBegun
                | Event::MapChanged
                | Event::MapsJoined => found.push(event),
                _ => {}
            }
        }
        if is_over {
            break;
        }
    }
    found
}

/// The second robot of a shadowed scenario goes on from snapshots, also while there are two maps and in the tick in which they are joined.
#[test]
fn a_robot_that_is_put_into_rooms_it_has_never_seen_begins_another_map_and_joins_both_where_they_meet()
 {
    let home = "house?seed=2";
    let mut scenario = in_home(home, 4).shadowed().unwrap();
    let (t_map_world, _) = explore(&mut scenario);
    let known = scenario.robot().map().free_m2();
    let world = World::open(&format!("builtin:{home}"), &OpenOptions::default()).unwrap();
    scenario.carry_to(unknown_place(&scenario, &world, &t_map_world));
    let first_events = map_events(&mut scenario, 500, |event| *event == Event::MapBegun);
    assert!(matches!(first_events[..], [Event::Lost { .. }, Event::MapBegun]), "{first_events:?}");
    assert_eq!((scenario.robot().map_number(), scenario.robot().maps()), (1, 2));
    assert!(scenario.robot().map().free_m2() < 0.5, "the other map is empty");
    let drives = scenario.ticks(100).unwrap();
    assert!(drives.iter().all(|tick| tick.decision.lost.is_none()));
    assert!(drives.iter().any(|tick| tick.decision.desired.linear_mps > 0.0));
    let later_events = map_events(&mut scenario, 600, |event| matches!(event, Event::MapsJoined));
    assert!(matches!(later_events[..], [Event::MapsJoined]), "{later_events:?}");
    assert_eq!((scenario.robot().map_number(), scenario.robot().maps()), (0, 1));
    assert_right(&scenario.tick().unwrap(), &t_map_world);
    assert!(scenario.robot().map().free_m2() > known + 3.0, "the floor of both is in it");
    let after = scenario.ticks(150).unwrap();
    assert_right(after.last().unwrap(), &t_map_world);
    assert_walls_are_right(&scenario, &world, &t_map_world);
}

/// Nearly all occupied cells are within 15 cm of a true wall or piece of furniture.
fn assert_walls_are_right(scenario: &Scenario, world: &World, t_map_world: &Pose2) {
    let map = scenario.robot().map();
    let t_world_map = t_map_world.inverse();
    let mut occupied = 0_usize;
    let mut off = 0_usize;
    for (cell, log_odds) in map.known_cells() {
        if log_odds > 0.0 {
            let [x_m, y_m] = map.center_m(cell);
            let (x_m, y_m) = t_world_map.transform(x_m, y_m);
            occupied += 1;
            off += usize::from(world.floor_plan().clearance_m(x_m, y_m) > 0.15);
        }
    }
    assert!(occupied > 1000 && off * 20 < occupied, "{off} of {occupied}");
}
