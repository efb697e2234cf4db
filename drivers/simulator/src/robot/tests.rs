use std::sync::LazyLock;

use hal::{Base, Camera, CameraMount, Clock, DriveCommand, ErrorKind, Lidar, Range};
use proptest::prelude::*;

use super::*;
use crate::floor::{Body, Disc};
use crate::homes::{self, HomeKind, HomeOptions, Surface};
use crate::odometry::WheelErrors;
use crate::pets::{Pet, PetWalker};
use crate::render::tests::{plain, room};
use crate::scene::Scene;
use crate::world::OpenOptions;

const TICK_NS: u64 = 100_000_000;

/// An empty room of 5 by 4 m.
static ROOM: LazyLock<Arc<World>> = LazyLock::new(|| {
    let scene = Scene {
        triangles: room([5.0, 4.0, 2.5], 0),
        materials: vec![plain([0.5; 3])],
        textures: vec![],
    };
    Arc::new(World::from_scene("room", scene, &crate::floor::Footprint::default()).unwrap())
});

static APARTMENT: LazyLock<Arc<World>> = LazyLock::new(|| {
    Arc::new(World::open("builtin:apartment?seed=1", &OpenOptions::default()).unwrap())
});

fn exact(start: Pose2) -> RobotOptions {
    RobotOptions {
        odometry: OdometryNoise::NONE,
        nuisances: Nuisances::none(),
        camera_latency_s: 0.0,
        floor_tilt_rad: 0.0,
        start: Some(start),
        t_base_camera: CameraMount::LEVEL.t_base_camera(),
        ..small()
    }
}

fn small() -> RobotOptions {
    RobotOptions {
        camera: CameraModel::pinhole(80, 24, std::f64::consts::FRAC_PI_2),
        ..RobotOptions::default()
    }
}

fn robot(options: RobotOptions) -> Devices {
    SimulatedRobot::new(ROOM.clone(), options).unwrap().devices()
}

/// Commands a twist and advances the clock by one tick.
fn tick(devices: &mut Devices, linear_mps: f64, angular_radps: f64) -> WheelFeedback {
    let now_ns = devices.clock.now_ns();
    let twist = Twist2 { linear_mps, angular_radps };
    devices
        .base
        .drive(&DriveCommand { twist, counter: (now_ns / TICK_NS) as u32, plan_age_ns: 0 })
        .unwrap();
    devices.clock.sleep_until_ns(now_ns + TICK_NS);
    devices.base.poll_feedback().unwrap().unwrap()
}

#[test]
fn a_command_moves_the_robot_along_its_arc_and_odometry_measures_it() {
    let start = Pose2::new(1.0, 1.0, 0.2);
    let mut devices = robot(exact(start));
    let feedback = tick(&mut devices, 0.3, 0.5);
    let moved = Twist2 { linear_mps: 0.3, angular_radps: 0.5 }.integrate(0.1);
    assert!(devices.truth.pose().distance_m(&start.compose(&moved)) < 1e-12);
    assert!(
        feedback.odom.distance_m(&moved) < 1e-12
            && !feedback.contact
            && feedback.time_ns == TICK_NS
    );
    // The velocity is measured along the chord.
    assert!(
        (feedback.twist.linear_mps - 0.3).abs() < 1e-3
            && (feedback.twist.angular_radps - 0.5).abs() < 1e-9
    );
    assert!(devices.base.poll_feedback().unwrap().is_none());
}

#[test]
fn a_robot_that_changes_after_half_a_metre_is_as_it_was_until_then() {
    let same = exact(Pose2::new(1.0, 1.0, 0.0));
    let change = Change {
        after_m: 0.5,
        t_base_camera: same.t_base_camera,
        t_base_laser: same.t_base_laser,
        wheels: WheelErrors { left: 0.05, ..WheelErrors::default() },
        camera_late_s: 0.0,
        lidar_late_s: 0.0,
        focal_scale: 1.0,
    };
    let mut usual = robot(same.clone());
    let mut changed = robot(RobotOptions { change: Some(change), ..same });
    let ways = (0..20).map(|_| {
        let driven_m = tick(&mut usual, 0.3, 0.0).odom.x_m;
        (driven_m, tick(&mut changed, 0.3, 0.0).odom.yaw_rad)
    });
    let (before, after): (Vec<_>, Vec<_>) = ways.partition(|(driven_m, _)| *driven_m < 0.49);
    assert!(before.len() > 10 && before.iter().all(|(_, yaw_rad)| *yaw_rad == 0.0), "{before:?}");
    assert!(after.last().is_some_and(|(_, yaw_rad)| *yaw_rad > 0.005), "{after:?}");
}

#[test]
fn without_new_commands_the_watchdog_stops_the_base() {
    let mut devices = robot(exact(Pose2::new(1.0, 2.0, 0.0)));
    devices.base.drive(&forward_command(7)).unwrap();
    devices.clock.sleep_until_ns(10 * TICK_NS);
    assert!(
        (devices.truth.pose().x_m - 1.1).abs() < 1e-9,
        "0.2 s at 0.5 m/s: {:?}",
        devices.truth.pose()
    );
    // A repeated counter does not restart the base.
    devices.base.drive(&forward_command(7)).unwrap();
    devices.clock.sleep_until_ns(12 * TICK_NS);
    assert!((devices.truth.pose().x_m - 1.1).abs() < 1e-9);
    devices.base.drive(&forward_command(8)).unwrap();
    devices.clock.sleep_until_ns(13 * TICK_NS);
    devices.base.stop().unwrap();
    devices.clock.sleep_until_ns(14 * TICK_NS);
    assert!((devices.truth.pose().x_m - 1.15).abs() < 1e-9);
}

fn forward_command(counter: u32) -> DriveCommand {
    DriveCommand { twist: Twist2 { linear_mps: 0.5, angular_radps: 0.0 }, counter, plan_age_ns: 0 }
}

#[test]
fn a_command_that_is_not_finite_is_rejected_and_stops_the_base() {
    let mut devices = robot(exact(Pose2::new(1.0, 2.0, 0.0)));
    tick(&mut devices, 0.5, 0.0);
    let twist = Twist2 { linear_mps: f64::NAN, angular_radps: 0.0 };
    let error =
        devices.base.drive(&DriveCommand { twist, counter: 99, plan_age_ns: 0 }).unwrap_err();
    assert_eq!(hal::Error::kind(&error), ErrorKind::Rejected);
    devices.clock.sleep_until_ns(2 * TICK_NS);
    assert!((devices.truth.pose().x_m - 1.05).abs() < 1e-9);
}

#[test]
fn at_a_wall_the_wheels_stall_and_each_poll_reports_the_contact_since_the_last_one() {
    let mut devices = robot(exact(Pose2::new(4.7, 2.0, 0.0)));
    let feedback: Vec<WheelFeedback> = (0..6).map(|_| tick(&mut devices, 0.5, 0.0)).collect();
    assert!(!feedback[0].contact && feedback[5].contact);
    assert!((devices.truth.pose().x_m - 4.84).abs() < 1e-4);
    assert!((feedback[5].odom.x_m - 0.14).abs() < 1e-4, "{:?}", feedback[5].odom);
    assert!(feedback[5].twist.linear_mps.abs() < 1e-3);
    // A contact in the first of two steps is still reported after the second.
    let twist = Twist2 { linear_mps: 0.5, angular_radps: 0.0 };
    devices.base.drive(&DriveCommand { twist, counter: 1000, plan_age_ns: 0 }).unwrap();
    devices.clock.sleep_until_ns(7 * TICK_NS);
    devices.base.stop().unwrap();
    devices.clock.sleep_until_ns(8 * TICK_NS);
    assert!(devices.base.poll_feedback().unwrap().unwrap().contact && !devices.truth.contact());
    assert!(!tick(&mut devices, -0.5, 0.0).contact);
}

#[test]
fn a_frame_shows_the_current_view_and_is_returned_once() {
    let mut devices = robot(exact(Pose2::new(2.0, 2.0, 0.0)));
    let mut frame = Frame::empty();
    let mut depth = DepthMap::none(0, 0);
    assert!(devices.camera.poll_frame(&mut frame).unwrap());
    assert!(!devices.camera.poll_frame(&mut frame).unwrap());
    assert_eq!((frame.time_ns, frame.sequence, frame.view().unwrap().width()), (0, 0, 80));
    devices.truth.depth(&mut depth);
    assert!((depth.get(40, 11).unwrap() - 3.0).abs() < 1e-3, "the wall x = 5");
    tick(&mut devices, 0.5, 0.0);
    assert!(devices.camera.poll_frame(&mut frame).unwrap());
    devices.truth.depth(&mut depth);
    assert!((depth.get(40, 11).unwrap() - 2.95).abs() < 1e-3);
    assert_eq!((frame.time_ns, frame.sequence), (TICK_NS, 1));
}

#[test]
fn scans_are_taken_at_most_once_per_period_and_measure_the_room() {
    let mut devices =
        robot(RobotOptions { laser: LaserModel::IDEAL, ..exact(Pose2::new(2.0, 2.0, 0.0)) });
    let mut scan = LaserScan::empty(devices.lidar.geometry());
    assert!(devices.lidar.poll_scan(&mut scan).unwrap());
    let Range::Hit(ahead_m) = scan.ranges[540] else { panic!("{:?}", scan.ranges[540]) };
    assert!((ahead_m - 3.0).abs() < 1e-4);
    devices.clock.sleep_until_ns(24_999_999);
    assert!(!devices.lidar.poll_scan(&mut scan).unwrap());
    devices.clock.sleep_until_ns(25_000_000);
    assert!(devices.lidar.poll_scan(&mut scan).unwrap());
    // The scan is that of the revolution that has just ended.
    assert_eq!((scan.time_ns, scan.middle_ns()), (0, 12_500_000));
    // The scanner measures whether it is polled or not.
    devices.clock.sleep_until_ns(80_000_000);
    assert!(devices.lidar.poll_scan(&mut scan).unwrap());
    assert_eq!(scan.time_ns, 50_000_000);
}

/// Position at which a beam hits, in the frame of the room, if the base was at `pose`, metres.
fn hit_m(scan: &LaserScan, beam: usize, pose: &Pose2) -> [f64; 2] {
    let range_m = f64::from(scan.ranges[beam].hit_m().unwrap());
    let (sin, cos) = scan.geometry.angle_rad(beam).sin_cos();
    let laser = RobotOptions::default().t_base_laser.translation.vector;
    let (x_m, y_m) = pose.transform(laser.x + range_m * cos, laser.y + range_m * sin);
    [x_m, y_m]
}

#[test]
fn a_scan_of_a_moving_robot_is_right_only_at_the_pose_of_each_beam() {
    let start = Pose2::new(2.0, 2.0, 0.0);
    let mut devices = robot(RobotOptions { laser: LaserModel::IDEAL, ..exact(start) });
    let mut scan = LaserScan::empty(devices.lidar.geometry());
    tick(&mut devices, 0.5, 1.5);
    assert!(devices.lidar.poll_scan(&mut scan).unwrap());
    let twist = Twist2 { linear_mps: 0.5, angular_radps: 1.5 };
    let mut distorted_m = 0.0_f64;
    for beam in 0..scan.ranges.len() {
        let after_s = laser::beam_after_ns(&scan.geometry, beam) as f64 * 1e-9;
        let then = start.compose(&twist.integrate(0.075 + after_s));
        assert!(to_wall_m(hit_m(&scan, beam, &then)) < 1e-4, "beam {beam}");
        let middle = start.compose(&twist.integrate(0.0875));
        distorted_m = distorted_m.max(to_wall_m(hit_m(&scan, beam, &middle)));
    }
    assert!(distorted_m > 0.02, "the scan is not rigid: {distorted_m}");
}

/// Distance to the nearest wall of the room, metres.
fn to_wall_m([x_m, y_m]: [f64; 2]) -> f64 {
    [x_m, 5.0 - x_m, y_m, 4.0 - y_m].map(f64::abs).into_iter().fold(f64::INFINITY, f64::min)
}

#[test]
fn a_frame_shows_the_view_of_its_exposure_and_is_stamped_later() {
    let options = RobotOptions { camera_latency_s: 0.05, ..exact(Pose2::new(2.0, 2.0, 0.0)) };
    let mut devices = robot(options);
    let mut frame = Frame::empty();
    let mut depth = DepthMap::none(0, 0);
    tick(&mut devices, 0.5, 0.0);
    devices.camera.poll_frame(&mut frame).unwrap();
    devices.truth.depth(&mut depth);
    assert_eq!(frame.time_ns, TICK_NS);
    let moved_m = 3.0 - f64::from(depth.get(40, 11).unwrap());
    let latency_s = 0.1 - moved_m / 0.5;
    assert!((0.025..0.075).contains(&latency_s), "{latency_s}");
}

#[test]
fn an_early_time_stamp_is_before_what_the_frame_and_the_scan_show() {
    let options = RobotOptions {
        camera_late_s: -0.02,
        lidar_late_s: -0.02,
        laser: LaserModel::IDEAL,
        ..exact(Pose2::new(2.0, 2.0, 0.0))
    };
    let mut early = robot(options.clone());
    let mut exact = robot(RobotOptions { camera_late_s: 0.0, lidar_late_s: 0.0, ..options });
    let [mut depth, mut exact_depth] = [DepthMap::none(0, 0), DepthMap::none(0, 0)];
    let [mut frame, mut exact_frame] = [Frame::empty(), Frame::empty()];
    let mut scan = LaserScan::empty(early.lidar.geometry());
    let mut exact_scan = scan.clone();
    for devices in [&mut early, &mut exact] {
        tick(devices, 0.5, 0.0);
    }
    early.camera.poll_frame(&mut frame).unwrap();
    exact.camera.poll_frame(&mut exact_frame).unwrap();
    early.truth.depth(&mut depth);
    exact.truth.depth(&mut exact_depth);
    assert_eq!((frame.time_ns, exact_frame.time_ns), (TICK_NS - 20_000_000, TICK_NS));
    assert_eq!(depth.get(40, 11), exact_depth.get(40, 11));
    early.lidar.poll_scan(&mut scan).unwrap();
    exact.lidar.poll_scan(&mut exact_scan).unwrap();
    assert_eq!(scan.time_ns + 20_000_000, exact_scan.time_ns);
    assert_eq!(scan.ranges, exact_scan.ranges);
}

#[test]
fn the_latency_of_a_camera_is_drawn_by_the_seed() {
    let moved: Vec<f32> = [1, 1, 2].into_iter().map(moved_m).collect();
    assert!(moved[0] == moved[1] && moved[0] != moved[2], "{moved:?}");
}

/// Distance by which the wall ahead comes nearer in the frame after 0.1 s, metres.
fn moved_m(seed: u64) -> f32 {
    let start = exact(Pose2::new(2.0, 2.0, 0.0));
    let mut devices = robot(RobotOptions { camera_latency_s: 0.05, seed, ..start });
    let mut depth = DepthMap::none(0, 0);
    tick(&mut devices, 0.5, 0.0);
    devices.camera.poll_frame(&mut Frame::empty()).unwrap();
    devices.truth.depth(&mut depth);
    3.0 - depth.get(40, 11).unwrap()
}

/// A home with stairs, and a pose from which the robot falls within 0.5 m of driving straight ahead.
fn home_with_stairs() -> (World, Pose2) {
    let home = World::open("builtin:apartment?seed=1&stairs=1", &OpenOptions::default()).unwrap();
    let plan = home.floor_plan();
    let start = plan
        .reachable()
        .filter(|[x, y]| plan.drop_distance_m(*x, *y, 0.5).is_some())
        .find_map(|[x, y]| {
            (0..16).map(|i| Pose2::new(x, y, f64::from(i) * 0.4)).find(|pose| {
                let ahead = Twist2 { linear_mps: 0.5, angular_radps: 0.0 };
                plan.drive(pose, &ahead, 1.0, &Body { sliding: false }, &[]).fell
            })
        })
        .unwrap();
    (home, start)
}

#[test]
fn cliff_sensors_report_an_edge_before_the_robot_falls_and_no_wall() {
    let (home, start) = home_with_stairs();
    for cliff_sensors in [false, true] {
        let options = RobotOptions { cliff_sensors, ..exact(start) };
        let mut devices = SimulatedRobot::new(Arc::new(home.clone()), options).unwrap().devices();
        let mut warned = false;
        while !devices.truth.fell() {
            warned |= tick(&mut devices, 0.1, 0.0).cliff;
        }
        assert_eq!(warned, cliff_sensors);
    }
    let at_the_wall = Pose2::new(4.8, 2.0, 0.0);
    let mut devices = robot(RobotOptions { cliff_sensors: true, ..exact(at_the_wall) });
    for _ in 0..20 {
        let feedback = tick(&mut devices, 0.3, 0.1);
        assert!(!feedback.cliff, "{feedback:?}");
    }
}

#[test]
fn a_robot_that_fell_never_moves_again() {
    let (home, start) = home_with_stairs();
    let mut devices = SimulatedRobot::new(Arc::new(home.clone()), exact(start)).unwrap().devices();
    assert!(!devices.truth.fell());
    for _ in 0..10 {
        tick(&mut devices, 0.5, 0.0);
    }
    assert!(devices.truth.fell());
    let there = devices.truth.pose();
    let feedback = tick(&mut devices, -0.5, 0.0);
    assert_eq!((devices.truth.pose(), feedback.twist), (there, Twist2::ZERO));
}

/// What an ideal scanner of the default mount measures at a pose, with these bodies in the world.
fn ideal_scan(world: &World, pose: &Pose2, bodies: &[Capsule]) -> Vec<Range> {
    let model = LaserModel::IDEAL;
    let mut scan = LaserScan::empty(model.geometry);
    let t_world_laser = pose.to_pose3() * RobotOptions::default().t_base_laser;
    let mut rng = stream_rng(LASER_STREAM, 0);
    laser::scan(world.renderer(), |_| t_world_laser, bodies, &model, &mut rng, 0, &mut scan);
    scan.ranges
}

/// Number of pixels of the default camera at a pose that show these bodies.
fn pixels_of(bodies: &[Capsule], pose: &Pose2) -> usize {
    let options = RobotOptions::default();
    let t_world_camera = pose.to_pose3() * options.t_base_camera;
    let depths = [&[], bodies].map(|bodies| {
        let mut depth = DepthMap::none(0, 0);
        let light = options.nuisances.lighting(0);
        let renderer = ROOM.renderer();
        renderer.render(&options.camera, &t_world_camera, bodies, &light, &mut vec![], &mut depth);
        depth
    });
    let pairs = depths[0].values().iter().zip(depths[1].values());
    pairs.filter(|(without, with)| with < without).count()
}

#[test]
fn a_lying_pet_is_lower_than_the_plane_of_the_scanner_and_the_camera_sees_it() {
    let pose = Pose2::new(1.0, 2.0, 0.0);
    let empty = ideal_scan(&ROOM, &pose, &[]);
    let standing = Pet { shoulder_m: 0.45, ..Pet::standing(3.0, 2.0) };
    let lying = Pet { lying: 1.0, ..standing };
    assert_ne!(ideal_scan(&ROOM, &pose, &standing.body()), empty);
    assert_eq!(ideal_scan(&ROOM, &pose, &lying.body()), empty);
    assert!(pixels_of(&standing.body(), &pose) > 1000);
    assert!(pixels_of(&lying.body(), &pose) > 200);
    // From above, its back is at 0.305 of its shoulder height.
    let seen_m = ROOM.renderer().cast([3.0, 2.0, 1.0], [0.0, 0.0, -1.0], 2.0, &lying.body());
    assert!((seen_m.unwrap() - (1.0 - 0.305 * 0.45)).abs() < 1e-9);
}

#[test]
fn a_robot_that_drives_at_a_pet_is_blocked_by_it() {
    let start = Pose2::new(1.0, 2.0, 0.0);
    let robot = SimulatedRobot::new(ROOM.clone(), exact(start)).unwrap();
    let walker = PetWalker::new(vec![[3.0, 2.0]], 1).unwrap();
    let rump = walker.at(0).discs()[0];
    lock(&robot.shared).inhabitants.pets = vec![walker];
    let mut devices = robot.devices();
    while !tick(&mut devices, 0.3, 0.0).contact {
        assert!(devices.truth.pose().x_m < 3.0, "the robot drove through the pet");
    }
    let footprint_m = devices.truth.floor_plan().footprint().radius_m;
    let touches_m = rump.center_m[0] - rump.radius_m - footprint_m;
    assert!((devices.truth.pose().x_m - touches_m).abs() < 1e-4, "{:?}", devices.truth.pose());
}

#[test]
fn pets_leave_the_ways_of_people_as_they_are() {
    let [alone, together] = [0, 3].map(|pets| {
        let nuisances = Nuisances { people: 2, pets, ..Nuisances::none() };
        Inhabitants::new(APARTMENT.floor_plan(), &nuisances, 5)
    });
    assert_eq!(alone.people, together.people);
    assert_eq!([alone.pets.len(), together.pets.len()], [0, 3]);
    let discs: Vec<Disc> = together.discs(0);
    assert_eq!(discs[..2], alone.discs(0));
}

#[test]
fn cables_are_drawn_on_the_floor_and_block_nothing() {
    let open = |spec| World::open(spec, &OpenOptions::default()).unwrap();
    let with = open("builtin:apartment?seed=1&cables=1");
    let home =
        homes::build(HomeKind::Apartment, &HomeOptions { cables: true, ..HomeOptions::new(1) });
    let triangles = home.scene.triangles.iter().zip(&home.surfaces);
    let cables = triangles.filter(|(_, surface)| **surface == Surface::Cable);
    let tops = cables.map(|(triangle, _)| triangle.vertices.map(|v| v.position_m.map(f64::from)));
    let tops: Vec<_> = tops.filter(|corners| corners.iter().all(|c| c[2] > 0.007)).collect();
    let plan = with.floor_plan();
    let mut seen = 0;
    let mut driven_over = 0;
    for corners in &tops {
        let [x, y] = [0, 1].map(|axis| corners.iter().map(|c| c[axis]).sum::<f64>() / 3.0);
        let below_m = with.renderer().cast([x, y, 0.05], [0.0, 0.0, -1.0], 1.0, &[]);
        seen += usize::from(below_m.is_some_and(|below_m| (below_m - 0.042).abs() < 1e-5));
        driven_over += usize::from(plan.is_reachable(x, y));
    }
    assert!(seen * 2 > tops.len() && driven_over * 4 > tops.len(), "{seen} {driven_over}");
    let without = APARTMENT.floor_plan();
    assert!(plan.reachable_floor().eq(without.reachable_floor()));
    assert!(plan.reachable().eq(without.reachable()));
    let pose = without.start_pose(1);
    assert_eq!(ideal_scan(&with, &pose, &[]), ideal_scan(&APARTMENT, &pose, &[]));
}

#[test]
fn an_uneven_floor_tilts_the_view() {
    let start = Pose2::new(2.0, 2.0, 0.0);
    let depths = [0.0, 0.0035].map(|floor_tilt_rad| {
        let mut devices = robot(RobotOptions { floor_tilt_rad, ..exact(start) });
        let mut depth = DepthMap::none(0, 0);
        devices.camera.poll_frame(&mut Frame::empty()).unwrap();
        devices.truth.depth(&mut depth);
        depth
    });
    // The floor 2 m ahead is seen at another row.
    let [flat_m, tilted_m] = depths.map(|depth| depth.get(40, 23).unwrap());
    assert!(flat_m != tilted_m && (flat_m / tilted_m - 1.0).abs() < 0.1, "{flat_m} {tilted_m}");
}

#[test]
fn a_start_inside_a_wall_is_refused_with_the_nearest_free_place() {
    match refused_start(4.95, 2.0) {
        Some(SceneError::StartBlocked { x_m, nearest_x_m, nearest_y_m, .. }) => {
            assert!(
                (x_m - 4.95).abs() < 1e-9
                    && (nearest_x_m - 4.8).abs() < 0.06
                    && (nearest_y_m - 2.0).abs() < 0.06
            );
        }
        other => panic!("{other:?}"),
    }
    assert!(matches!(refused_start(40.0, 2.0), Some(SceneError::StartBlocked { .. })));
    assert!(matches!(
        refused_start(f64::NAN, 2.0),
        Some(SceneError::Option { option: "start pose", .. })
    ));
}

fn refused_start(x: f64, y: f64) -> Option<SceneError> {
    SimulatedRobot::new(ROOM.clone(), exact(Pose2::new(x, y, 0.0))).err()
}

#[test]
fn impossible_options_are_refused_by_name() {
    assert_eq!(
        refused_option(RobotOptions {
            camera: CameraModel { fx: f64::NAN, ..small().camera },
            ..small()
        }),
        "camera model"
    );
    assert_eq!(refused_option(RobotOptions { watchdog_ns: 0, ..small() }), "watchdog");
    let late = RobotOptions { camera_latency_s: 3.0, ..small() };
    assert_eq!(refused_option(late), "camera latency");
    assert_eq!(refused_option(RobotOptions { floor_tilt_rad: -0.1, ..small() }), "floor tilt");
    let sunk = Pose3::translation(0.0, 0.0, f64::INFINITY);
    assert_eq!(refused_option(RobotOptions { t_base_camera: sunk, ..small() }), "camera mount");
    let nuisances = Nuisances { flicker: 2.0, ..Nuisances::none() };
    let error = SimulatedRobot::new(ROOM.clone(), RobotOptions { nuisances, ..small() }).err();
    assert!(matches!(error, Some(SceneError::Nuisance(_))));
}

fn refused_option(options: RobotOptions) -> &'static str {
    match SimulatedRobot::new(ROOM.clone(), options).err() {
        Some(SceneError::Option { option, .. }) => option,
        other => panic!("{other:?}"),
    }
}

/// All frames, scans, feedback and poses of a fixed drive, as bytes.
fn device_log(options: RobotOptions, threads: usize) -> Vec<u8> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool.install(|| {
        let mut devices = SimulatedRobot::new(APARTMENT.clone(), options).unwrap().devices();
        let mut frame = Frame::empty();
        let mut scan = LaserScan::empty(devices.lidar.geometry());
        let mut bytes = Vec::new();
        for step in 0..12 {
            let feedback = tick(&mut devices, 0.4, f64::from(step % 5) * 0.3 - 0.5);
            devices.camera.poll_frame(&mut frame).unwrap();
            devices.lidar.poll_scan(&mut scan).unwrap();
            bytes.extend(&frame.data);
            bytes.extend(
                format!("{feedback:?} {:?} {:?}", scan.ranges, devices.truth.pose()).bytes(),
            );
        }
        bytes
    })
}

#[test]
fn the_seed_alone_determines_all_device_data_on_any_number_of_threads() {
    let nuisances =
        Nuisances { shutter_s: 0.02, people: 2, exposure_drift_stops: 0.5, ..Nuisances::default() };
    let one = device_log(options_with(5, &nuisances), 1);
    assert!(
        one == device_log(options_with(5, &nuisances), 2)
            && one == device_log(options_with(5, &nuisances), 5)
    );
    assert!(one != device_log(options_with(6, &nuisances), 1));
}

fn options_with(seed: u64, nuisances: &Nuisances) -> RobotOptions {
    RobotOptions { nuisances: nuisances.clone(), seed, ..small() }
}

#[test]
fn motion_blur_grows_with_the_shutter_time() {
    let sharp = frame_with_shutter(0.0);
    let short = byte_difference(&frame_with_shutter(0.002), &sharp);
    let long = byte_difference(&frame_with_shutter(0.08), &sharp);
    assert!(short < long / 3, "{short} and {long}");
}

fn byte_difference(image: &[u8], sharp: &[u8]) -> u64 {
    sharp.iter().zip(image).map(|(a, b)| u64::from(a.abs_diff(*b))).sum::<u64>()
}

fn frame_with_shutter(shutter_s: f64) -> Vec<u8> {
    let nuisances = Nuisances { shutter_s, ..Nuisances::none() };
    let options = RobotOptions { nuisances, start: None, ..exact(Pose2::IDENTITY) };
    let mut devices = SimulatedRobot::new(APARTMENT.clone(), options).unwrap().devices();
    tick(&mut devices, 0.0, 1.0);
    let mut frame = Frame::empty();
    devices.camera.poll_frame(&mut frame).unwrap();
    frame.data
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn without_noise_the_frame_of_the_odometry_never_moves(
        seed: u64,
        sliding: bool,
        drives in prop::collection::vec((-1.0..1.0, -2.0..2.0), 1..30),
    ) {
        let options = RobotOptions { sliding, seed, start: None, ..exact(Pose2::IDENTITY) };
        let mut devices = robot(options);
        let start = devices.truth.pose();
        for (linear_mps, angular_radps) in drives {
            tick(&mut devices, linear_mps, angular_radps);
            let t_world_odom = devices.truth.t_world_odom();
            prop_assert!(t_world_odom.distance_m(&start) < 1e-9, "{t_world_odom:?}");
            let pose = devices.truth.pose();
            prop_assert!(devices.truth.floor_plan().fits(pose.x_m, pose.y_m, &[]));
        }
    }
}

const NO_IMU_NOISE: ImuNoise = ImuNoise {
    period_ns: 10_000_000,
    bias_radps: 0.0,
    bias_walk_radps: 0.0,
    scale: 0.0,
    angle_rad: 0.0,
    force_mps2: 0.0,
};

fn samples(imu: &mut SimImu) -> Vec<hal::ImuSample> {
    std::iter::from_fn(|| hal::Imu::poll_sample(imu).unwrap()).collect()
}

#[test]
fn the_inertial_unit_measures_the_rotation_in_every_period_once() {
    let options = RobotOptions { imu: NO_IMU_NOISE, ..exact(Pose2::new(1.0, 1.0, 0.2)) };
    let mut devices = robot(options);
    tick(&mut devices, 0.3, 0.5);
    let measured = samples(&mut devices.imu);
    assert_eq!(measured.len(), 10);
    for (number, sample) in measured.iter().enumerate() {
        assert_eq!(sample.time_ns, 10_000_000 * number as u64 + 5_000_000);
        let [x, y, z] = sample.angular_radps;
        assert!(x.abs() < 1e-9 && y.abs() < 1e-9 && (z - 0.5).abs() < 1e-9, "{sample:?}");
        assert!((sample.force_mps2.unwrap()[2] - 9.81).abs() < 1e-9);
    }
    assert!(samples(&mut devices.imu).is_empty());
}

#[test]
fn the_inertial_unit_measures_that_the_robot_was_rotated_while_it_was_carried() {
    let options = RobotOptions { imu: NO_IMU_NOISE, ..exact(Pose2::new(1.0, 1.0, 0.2)) };
    let robot = SimulatedRobot::new(ROOM.clone(), options).unwrap();
    let mut devices = robot.devices();
    robot.carry_to(Pose2::new(2.0, 1.0, 1.7));
    let mut rotated_rad = 0.0;
    for _ in 0..10 {
        tick(&mut devices, 0.0, 0.0);
        for sample in samples(&mut devices.imu) {
            assert!(sample.angular_radps[2].abs() < 2.01, "{sample:?}");
            rotated_rad += 0.01 * sample.angular_radps[2];
        }
    }
    assert!((rotated_rad - 1.5).abs() < 1e-9, "{rotated_rad}");
}

#[test]
fn at_rest_the_inertial_unit_rotates_by_its_bias_and_its_noise() {
    let noise = ImuNoise { bias_walk_radps: 0.0, ..ImuNoise::BMI160 };
    let mut ends = Vec::new();
    for seed in 0..200 {
        let options = RobotOptions { imu: noise, seed, ..exact(Pose2::new(1.0, 1.0, 0.2)) };
        let mut devices = robot(options);
        let halves = [(); 2].map(|()| {
            for _ in 0..5 {
                tick(&mut devices, 0.0, 0.0);
            }
            let measured = samples(&mut devices.imu);
            measured.iter().map(|sample| 0.01 * sample.angular_radps[2]).sum::<f64>()
        });
        ends.push(halves);
    }
    let rms = |of: &dyn Fn(&[f64; 2]) -> f64| {
        (ends.iter().map(|ends| of(ends).powi(2)).sum::<f64>() / ends.len() as f64).sqrt()
    };
    let bias_radps = rms(&|[first, second]| first + second);
    let noise_rad = rms(&|[first, second]| first - second);
    assert!((bias_radps / noise.bias_radps - 1.0).abs() < 0.15, "{bias_radps}");
    assert!((noise_rad / noise.angle_rad - 1.0).abs() < 0.15, "{noise_rad}");
}

#[test]
fn samples_that_nothing_fetched_for_a_second_are_lost() {
    let options = RobotOptions { imu: NO_IMU_NOISE, ..exact(Pose2::new(1.0, 1.0, 0.2)) };
    let mut devices = robot(options);
    for _ in 0..30 {
        tick(&mut devices, 0.0, 0.3);
    }
    let measured = samples(&mut devices.imu);
    assert_eq!(measured.len(), 90);
    assert!(measured.iter().all(|sample| (sample.angular_radps[2] - 0.3).abs() < 1e-9));
}

#[test]
fn an_inertial_unit_that_is_no_number_is_refused() {
    let noise = ImuNoise { scale: f64::NAN, ..ImuNoise::BMI160 };
    let options = RobotOptions { imu: noise, ..small() };
    assert!(matches!(SimulatedRobot::new(ROOM.clone(), options), Err(SceneError::Option { .. })));
}
