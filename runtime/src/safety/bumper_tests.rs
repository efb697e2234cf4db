use super::*;
use hal::{Range, ScanGeometry};
use proptest::prelude::*;

const FORWARD: Twist2 = Twist2 { linear_mps: 0.3, angular_radps: 0.0 };
const TICK_NS: u64 = 100_000_000;

/// A round robot in a square room without corners cut: exact ranges, exact wheels.
struct Room {
    half_m: f64,
    pose: Pose2,
    time_ns: u64,
    bumper: Bumper,
}

impl Room {
    fn new(half_m: f64, pose: Pose2) -> Self {
        Self { half_m, pose, time_ns: 0, bumper: Bumper::new(BumperConfig::default()) }
    }

    fn scan(&self) -> LaserScan {
        let geometry = ScanGeometry::UTM_30LX;
        let range = |beam| {
            let angle = geometry.angle_rad(beam) + self.pose.yaw_rad;
            let (sin, cos) = angle.sin_cos();
            let along = |position: f64, slope: f64| match slope {
                s if s > 1e-9 => (self.half_m - position) / s,
                s if s < -1e-9 => (-self.half_m - position) / s,
                _ => f64::INFINITY,
            };
            Range::Hit(along(self.pose.x_m, cos).min(along(self.pose.y_m, sin)) as f32)
        };
        LaserScan { time_ns: self.time_ns, geometry, ranges: (0..geometry.beams).map(range).collect() }
    }

    fn tick_with(&mut self, wanted: Twist2, scan: Option<&LaserScan>, contact: bool) -> BumperOutput {
        let input = BumperInput { time_ns: self.time_ns, odom: self.pose, contact, scan, wanted };
        let output = self.bumper.step(&input);
        self.pose = self.pose.compose(&output.command.integrate(0.1));
        self.time_ns += TICK_NS;
        output
    }

    fn tick(&mut self, wanted: Twist2) -> BumperOutput {
        let scan = self.scan();
        self.tick_with(wanted, Some(&scan), false)
    }

    fn until(&mut self, wanted: Twist2, mut done: impl FnMut(&BumperOutput) -> bool) -> BumperOutput {
        for _ in 0..2000 {
            let output = self.tick(wanted);
            if done(&output) {
                return output;
            }
        }
        panic!("did not happen in 2000 ticks, state {:?}", self.bumper.state());
    }
}

fn tripped(output: &BumperOutput) -> bool {
    matches!(output.event, Some(BumperEvent::Tripped { .. }))
}

#[test]
fn nothing_moves_before_the_first_scan() {
    let mut room = Room::new(3.0, Pose2::IDENTITY);
    assert_eq!(room.tick_with(FORWARD, None, false).command, Twist2::ZERO);
    assert_eq!(room.tick(FORWARD).command, FORWARD);
}

#[test]
fn stops_with_the_stop_distance_left_in_front_of_the_footprint() {
    let mut room = Room::new(2.0, Pose2::IDENTITY);
    let output = room.until(FORWARD, tripped);
    assert_eq!(output.command, Twist2::ZERO);
    let gap_m = room.half_m - room.pose.x_m - 0.16;
    assert!(gap_m > 0.1 - 0.0301 && gap_m <= 0.1, "gap {gap_m}");
}

#[test]
fn backs_off_exactly_0_2_m_then_hands_a_blocked_cell_to_the_planner() {
    let mut room = Room::new(2.0, Pose2::IDENTITY);
    room.until(FORWARD, tripped);
    let stopped_at = room.pose;
    let end = room.until(FORWARD, |output| output.blocked_m.is_some());
    assert!((room.pose.distance_m(&stopped_at) - 0.2).abs() < 1e-3);
    let Some(BumperEvent::BackedOff { distance_m, end: BackOffEnd::Distance }) = end.event else {
        panic!("{:?}", end.event)
    };
    assert!((distance_m - 0.2).abs() < 1e-3);
    let blocked = end.blocked_m.unwrap();
    assert!((blocked[0] - 2.0).abs() < 0.02 && blocked[1].abs() < 0.17, "the wall is at x = 2: {blocked:?}");
    assert_eq!(room.bumper.state(), BumperState::Clear);
}

#[test]
fn turning_on_the_spot_beside_a_wall_is_not_stopped() {
    let mut room = Room::new(2.0, Pose2::new(1.8, 0.0, 0.0));
    let turn = Twist2 { linear_mps: 0.0, angular_radps: 0.3 };
    assert_eq!(room.tick(turn).command, turn);
}

#[test]
fn a_wish_to_drive_back_into_something_seen_behind_keeps_only_its_turn() {
    let mut room = Room::new(3.0, Pose2::IDENTITY);
    let back = Twist2 { linear_mps: -0.3, angular_radps: 0.1 };
    let mut scan = room.scan();
    for (beam, range) in scan.ranges.iter_mut().enumerate() {
        *range = if beam < 4 { Range::Hit(0.17) } else { Range::Hit(3.0) };
    }
    // The rear beams at 135 degrees meet a post at 0.17 m: x = -0.12, y = 0.12, inside the strip behind.
    let output = room.tick_with(back, Some(&scan), false);
    assert_eq!(output.command, Twist2 { linear_mps: 0.0, angular_radps: 0.1 });
}

#[test]
fn a_touch_that_no_laser_saw_trips_and_blocks_the_place_just_ahead() {
    let mut room = Room::new(5.0, Pose2::IDENTITY);
    room.tick(FORWARD);
    let scan = room.scan();
    let output = room.tick_with(FORWARD, Some(&scan), true);
    assert!(matches!(output.event, Some(BumperEvent::Tripped { by: TripCause::Contact, .. })));
}

#[test]
fn silence_of_the_laser_stops_the_robot_once_with_a_reason_and_a_new_scan_lets_it_go_on() {
    let mut room = Room::new(5.0, Pose2::IDENTITY);
    room.tick(FORWARD);
    let mut reasons = Vec::new();
    for _ in 0..10 {
        reasons.extend(room.tick_with(FORWARD, None, false).event);
    }
    assert_eq!(reasons, [BumperEvent::Tripped { by: TripCause::StaleScan, x_m: 0.0, y_m: 0.0 }]);
    assert_eq!(room.bumper.state(), BumperState::Blind);
    let output = room.tick(FORWARD);
    assert_eq!((output.command, output.event), (FORWARD, Some(BumperEvent::Cleared)));
}

#[test]
fn a_scan_of_nothing_but_errors_stops_the_robot() {
    let mut room = Room::new(5.0, Pose2::IDENTITY);
    room.tick(FORWARD);
    let mut scan = room.scan();
    scan.ranges.fill(Range::Error);
    let output = room.tick_with(FORWARD, Some(&scan), false);
    assert_eq!(output.command, Twist2::ZERO);
    assert!(matches!(output.event, Some(BumperEvent::Tripped { by: TripCause::BadScan, .. })));
}

#[test]
fn backing_off_ends_by_time_when_the_wheels_report_no_motion() {
    let mut room = Room::new(2.0, Pose2::IDENTITY);
    room.until(FORWARD, tripped);
    let stuck_at = room.pose;
    let mut end = None;
    for _ in 0..100 {
        let scan = room.scan();
        let output = room.tick_with(FORWARD, Some(&scan), false);
        room.pose = stuck_at;
        if let Some(BumperEvent::BackedOff { end: why, .. }) = output.event {
            end = Some(why);
            break;
        }
    }
    assert_eq!(end, Some(BackOffEnd::Timeout));
    assert!(matches!(room.bumper.state(), BumperState::Escaping { .. }));
}

#[test]
fn the_third_trip_at_one_place_turns_the_robot_until_there_is_a_way_out() {
    let mut room = Room::new(2.0, Pose2::new(1.5, 0.0, 0.0));
    for _ in 0..3 {
        room.until(FORWARD, tripped);
    }
    room.until(FORWARD, |output| matches!(output.event, Some(BumperEvent::Escaping)));
    room.until(FORWARD, |output| matches!(output.event, Some(BumperEvent::Cleared)));
    assert!(room.pose.yaw_rad.abs() > std::f64::consts::FRAC_PI_4);
    for _ in 0..10 {
        assert_eq!(room.tick(FORWARD).command, FORWARD, "the way out is free");
    }
}

#[test]
fn an_escape_without_any_way_out_ends_after_one_round() {
    let mut room = Room::new(0.3, Pose2::IDENTITY);
    for _ in 0..3 {
        room.until(FORWARD, tripped);
    }
    room.until(FORWARD, |output| matches!(output.event, Some(BumperEvent::Cleared)));
}

#[test]
fn the_robot_always_drives_on_to_somewhere_else_whatever_room_it_is_put_in() {
    let mut room = Room::new(1.0, Pose2::new(0.7, 0.7, 0.3));
    let mut seen = std::collections::BTreeSet::new();
    for _ in 0..3000 {
        room.tick(FORWARD);
        seen.insert(((room.pose.x_m * 4.0).round() as i32, (room.pose.y_m * 4.0).round() as i32));
    }
    assert!(seen.len() > 5, "{seen:?}");
}

proptest! {
    #[test]
    fn no_wish_ever_brings_the_footprint_into_a_wall(
        wishes in proptest::collection::vec((-0.1..0.3f64, -0.4..0.4f64), 1..300),
        yaw in -3.0..3.0f64,
    ) {
        let mut room = Room::new(0.8, Pose2::new(0.1, -0.2, yaw));
        for (linear_mps, angular_radps) in wishes {
            // Behind is partly blind; a policy that drives back does so on its own map. Forward is the promise here.
            room.tick(Twist2 { linear_mps: linear_mps.max(0.0), angular_radps });
            let reach = room.pose.x_m.abs().max(room.pose.y_m.abs()) + 0.16;
            prop_assert!(reach < 0.8, "footprint reaches {reach}");
        }
    }
}
