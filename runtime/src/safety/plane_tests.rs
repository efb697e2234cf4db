use super::*;
use crate::safety::Plan;
use crate::snapshot::State;
use hal::{ErrorKind, Range, ScanGeometry};
use proptest::prelude::*;

pub const FORWARD: Twist2 = Twist2 { linear_mps: 0.3, angular_radps: 0.0 };
pub const TICK_NS: u64 = 100_000_000;

/// A round robot in a square room without corners cut: exact ranges, exact wheels.
pub struct Room {
    pub half_m: f64,
    pub pose: Pose2,
    pub time_ns: u64,
    pub plane: SafetyPlane,
    pub driving: Twist2,
}

impl Room {
    pub fn new(half_m: f64, pose: Pose2) -> Self {
        Self::with(SafetyConfig::default(), half_m, pose)
    }

    pub fn with(config: SafetyConfig, half_m: f64, pose: Pose2) -> Self {
        Self { half_m, pose, time_ns: 0, plane: SafetyPlane::new(config), driving: Twist2::ZERO }
    }

    pub fn scan(&self) -> LaserScan {
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
        LaserScan {
            time_ns: self.time_ns,
            geometry,
            ranges: (0..geometry.beams).map(range).collect(),
        }
    }

    pub fn input<'a>(
        &self,
        wanted: Twist2,
        scan: Option<&'a LaserScan>,
        contact: bool,
    ) -> SafetyInput<'a> {
        let twist = self.driving;
        SafetyInput {
            time_ns: self.time_ns,
            scan,
            wheel: Some(WheelFeedback { time_ns: self.time_ns, odom: self.pose, twist, contact }),
            base_error: None,
            emergency_stop: false,
            plan: Some(Plan { twist: wanted, time_ns: self.time_ns }),
            request: Some(Request::Arm),
        }
    }

    pub fn turn(&mut self, input: &SafetyInput<'_>) -> SafetyOutput {
        let output = self.plane.step(input);
        // Exact wheels that stop at once.
        self.driving = Twist2::ZERO;
        self.pose = self.pose.compose(&output.twist().integrate(0.1));
        self.time_ns += TICK_NS;
        output
    }

    pub fn tick_with(
        &mut self,
        wanted: Twist2,
        scan: Option<&LaserScan>,
        contact: bool,
    ) -> SafetyOutput {
        let input = self.input(wanted, scan, contact);
        self.turn(&input)
    }

    pub fn tick(&mut self, wanted: Twist2) -> SafetyOutput {
        let scan = self.scan();
        self.tick_with(wanted, Some(&scan), false)
    }

    pub fn until(
        &mut self,
        wanted: Twist2,
        mut done: impl FnMut(&SafetyOutput) -> bool,
    ) -> SafetyOutput {
        for _ in 0..2000 {
            let output = self.tick(wanted);
            if done(&output) {
                return output;
            }
        }
        panic!("did not happen in 2000 ticks, state {:?}", self.plane.state());
    }
}

/// 40 cm long, 30 cm wide, the axle 10 cm before its end.
pub fn cart() -> SafetyConfig {
    let footprint_m = vec![[0.3, 0.15], [-0.1, 0.15], [-0.1, -0.15], [0.3, -0.15]];
    SafetyConfig { footprint_m, ..SafetyConfig::default() }
}

/// A robot that has turned once round on the spot and therefore knows the ground behind.
pub fn looked_around(x_m: f64) -> Room {
    let mut room = Room::new(2.0, Pose2::new(x_m, 0.0, 0.0));
    for _ in 0..210 {
        room.tick(Twist2 { linear_mps: 0.0, angular_radps: 0.3 });
    }
    room.pose.yaw_rad = 0.0;
    room.tick(Twist2::ZERO);
    room
}

pub fn tripped(output: &SafetyOutput) -> bool {
    matches!(output.event, Some(SafetyEvent::Tripped { .. }))
}

#[test]
fn nothing_moves_before_the_first_good_scans() {
    let mut room = Room::new(3.0, Pose2::IDENTITY);
    assert_eq!(room.tick_with(FORWARD, None, false).twist(), Twist2::ZERO);
    assert_eq!(room.tick(FORWARD).twist(), FORWARD);
}

#[test]
fn stops_with_the_stop_distance_left_in_front_of_the_footprint() {
    let mut room = Room::new(2.0, Pose2::IDENTITY);
    let output = room.until(FORWARD, tripped);
    assert_eq!(output.twist(), Twist2::ZERO);
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
    let Some(SafetyEvent::BackedOff { distance_m, end: BackOffEnd::Distance }) = end.event else {
        panic!("{:?}", end.event)
    };
    assert!((distance_m - 0.2).abs() < 1e-3);
    let blocked = end.blocked_m.unwrap();
    assert!(
        (blocked[0] - 2.0).abs() < 0.02 && blocked[1].abs() < 0.17,
        "the wall is at x = 2: {blocked:?}"
    );
    assert_eq!(room.plane.state(), SafetyState::Clear);
}

#[test]
fn turning_on_the_spot_beside_a_wall_is_not_stopped() {
    let mut room = Room::new(2.0, Pose2::new(1.8, 0.0, 0.0));
    let turn = Twist2 { linear_mps: 0.0, angular_radps: 0.3 };
    assert_eq!(room.tick(turn).twist(), turn);
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
    assert_eq!(output.twist(), Twist2 { linear_mps: 0.0, angular_radps: 0.1 });
}

#[test]
fn a_touch_that_no_laser_saw_trips_and_blocks_the_place_just_ahead() {
    let mut room = Room::new(5.0, Pose2::IDENTITY);
    room.tick(FORWARD);
    let scan = room.scan();
    let output = room.tick_with(FORWARD, Some(&scan), true);
    assert!(matches!(output.event, Some(SafetyEvent::Tripped { by: TripCause::Contact, .. })));
}

#[test]
fn silence_of_the_laser_stops_the_robot_once_with_a_reason_and_a_new_scan_lets_it_go_on() {
    let mut room = Room::new(5.0, Pose2::IDENTITY);
    room.tick(FORWARD);
    let mut reasons = Vec::new();
    for _ in 0..10 {
        reasons.extend(room.tick_with(FORWARD, None, false).event);
    }
    assert_eq!(reasons, [SafetyEvent::Faulted { why: FaultReason::LidarSilent }]);
    assert_eq!(room.plane.state(), SafetyState::Fault(FaultReason::LidarSilent));
    let output = room.tick(FORWARD);
    assert_eq!((output.twist(), output.event), (FORWARD, Some(SafetyEvent::Cleared)));
}

#[test]
fn a_scan_of_nothing_but_errors_stops_the_robot() {
    let mut room = Room::new(5.0, Pose2::IDENTITY);
    room.tick(FORWARD);
    let mut scan = room.scan();
    scan.ranges.fill(Range::Error);
    let output = room.tick_with(FORWARD, Some(&scan), false);
    assert_eq!(output.twist(), Twist2::ZERO);
    assert_eq!(output.event, Some(SafetyEvent::Faulted { why: FaultReason::LidarBad }));
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
        if let Some(SafetyEvent::BackedOff { end: why, .. }) = output.event {
            end = Some(why);
            break;
        }
    }
    assert_eq!(end, Some(BackOffEnd::Timeout));
    assert!(matches!(room.plane.state(), SafetyState::Escaping(_)));
}

#[test]
fn the_third_trip_at_one_place_turns_the_robot_until_there_is_a_way_out() {
    let mut room = Room::new(2.0, Pose2::new(1.5, 0.0, 0.0));
    for _ in 0..3 {
        room.until(FORWARD, tripped);
    }
    room.until(FORWARD, |output| matches!(output.event, Some(SafetyEvent::Escaping)));
    room.until(FORWARD, |output| matches!(output.event, Some(SafetyEvent::Cleared)));
    assert!(room.pose.yaw_rad.abs() > std::f64::consts::FRAC_PI_4);
    for _ in 0..10 {
        assert_eq!(room.tick(FORWARD).twist(), FORWARD, "the way out is free");
    }
}

#[test]
fn an_escape_without_any_way_out_ends_after_one_round() {
    let mut room = Room::new(0.3, Pose2::IDENTITY);
    for _ in 0..3 {
        room.until(FORWARD, tripped);
    }
    room.until(FORWARD, |output| matches!(output.event, Some(SafetyEvent::Cleared)));
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

/// A robot of flesh: turned a hundred times a second, brakes at 1 m/s2 after 50 ms.
fn real() -> SafetyConfig {
    SafetyConfig {
        period_s: 0.01,
        brake_mps2: 1.0,
        reaction_s: 0.05,
        good_scans: 3,
        ..SafetyConfig::default()
    }
}

/// A room whose robot is armed and drives.
pub fn driving() -> Room {
    let mut room = Room::new(5.0, Pose2::IDENTITY);
    assert_eq!(room.tick(FORWARD).twist(), FORWARD);
    room
}

#[test]
fn nobody_drives_a_robot_that_was_not_armed() {
    let mut room = Room::new(5.0, Pose2::IDENTITY);
    let scan = room.scan();
    for _ in 0..5 {
        let input = SafetyInput { request: None, ..room.input(FORWARD, Some(&scan), false) };
        assert_eq!(room.turn(&input).command, None);
    }
    assert_eq!(room.plane.state(), SafetyState::Disarmed);
    assert_eq!(room.tick(FORWARD).event, Some(SafetyEvent::Armed));
    let input =
        SafetyInput { request: Some(Request::Disarm), ..room.input(FORWARD, Some(&scan), false) };
    assert_eq!(room.turn(&input), SafetyOutput::STOP.because(SafetyEvent::Disarmed));
}

#[test]
fn after_silence_three_good_scans_in_a_row_come_before_motion() {
    let config = SafetyConfig { good_scans: 3, ..SafetyConfig::default() };
    let mut room = Room::with(config, 5.0, Pose2::IDENTITY);
    let moves: Vec<bool> = (0..4).map(|_| room.tick(FORWARD).twist() == FORWARD).collect();
    assert_eq!(moves, [false, false, true, true], "also at the start");
    (0..5).for_each(|_| _ = room.tick_with(FORWARD, None, false));
    let mut bad = room.scan();
    bad.ranges.fill(Range::Error);
    assert_eq!(room.tick(FORWARD).twist(), Twist2::ZERO);
    bad.time_ns = room.time_ns;
    assert_eq!(room.tick_with(FORWARD, Some(&bad), false).twist(), Twist2::ZERO);
    let moves: Vec<bool> = (0..3).map(|_| room.tick(FORWARD).twist() == FORWARD).collect();
    assert_eq!(moves, [false, false, true], "a bad one begins the count anew");
}

#[test]
fn silence_of_the_wheels_stops_the_robot_and_their_word_lets_it_go_on() {
    let mut room = driving();
    let scan = room.scan();
    let mut stopped_after = 0;
    for turn in 1..=5 {
        let fresh = LaserScan { time_ns: room.time_ns, ..scan.clone() };
        let input = SafetyInput { wheel: None, ..room.input(FORWARD, Some(&fresh), false) };
        if room.turn(&input).event == Some(SafetyEvent::Faulted { why: FaultReason::BaseSilent }) {
            stopped_after = turn;
        }
    }
    assert_eq!(stopped_after, 3, "feedback may be 0.2 s old");
    assert_eq!(room.tick(FORWARD).event, Some(SafetyEvent::Cleared));
}

#[test]
fn a_fault_of_the_base_and_the_emergency_stop_need_a_person() {
    let faults: [fn(&mut SafetyInput<'_>); 2] =
        [|input| input.base_error = Some(ErrorKind::Fault), |input| input.emergency_stop = true];
    for fault in faults {
        let mut room = driving();
        let scan = room.scan();
        let mut input = room.input(FORWARD, Some(&scan), false);
        fault(&mut input);
        let output = room.turn(&input);
        assert!(
            matches!(output.event, Some(SafetyEvent::Faulted { why }) if !why.clears_itself()),
            "{output:?}"
        );
        assert_eq!(output.command, None);
        for _ in 0..10 {
            assert_eq!(
                room.tick(FORWARD).command,
                None,
                "gone, but nobody has said so, and arming alone does not"
            );
        }
        let scan = room.scan();
        let mut clear = SafetyInput {
            request: Some(Request::ClearFault),
            ..room.input(FORWARD, Some(&scan), false)
        };
        fault(&mut clear);
        room.turn(&clear);
        assert!(
            matches!(room.plane.state(), SafetyState::Fault(_)),
            "it is still there: nothing to clear"
        );
        let clear = SafetyInput {
            request: Some(Request::ClearFault),
            ..room.input(FORWARD, Some(&scan), false)
        };
        assert_eq!(room.turn(&clear).event, Some(SafetyEvent::Disarmed));
        assert_eq!(room.tick(FORWARD).twist(), FORWARD, "armed anew");
    }
}

#[test]
fn silence_after_a_fault_of_the_base_does_not_make_it_one_that_passes() {
    let mut room = driving();
    let scan = room.scan();
    let fault = SafetyInput {
        base_error: Some(ErrorKind::Fault),
        ..room.input(FORWARD, Some(&scan), false)
    };
    room.turn(&fault);
    (0..5).for_each(|_| _ = room.tick_with(FORWARD, None, false));
    assert_eq!(room.plane.state(), SafetyState::Fault(FaultReason::BaseFault));
}

#[test]
fn odometry_that_is_nan_stops_the_robot_and_is_never_used() {
    let mut room = driving();
    let scan = room.scan();
    let mut input = room.input(FORWARD, Some(&scan), false);
    input.wheel =
        input.wheel.map(|wheel| WheelFeedback { odom: Pose2::new(f64::NAN, 0.0, 0.0), ..wheel });
    assert_eq!(
        room.turn(&input).event,
        Some(SafetyEvent::Faulted { why: FaultReason::OdometryNotFinite })
    );
    assert_eq!(room.tick(FORWARD).event, Some(SafetyEvent::Cleared));
}

#[test]
fn a_plan_that_is_nan_or_old_or_missing_is_refused_with_a_reason_said_once() {
    let mut room = driving();
    let scan = room.scan();
    let nan = Twist2 { linear_mps: f64::NAN, angular_radps: 0.0 };
    let plans = [
        (Some(Plan { twist: nan, time_ns: room.time_ns }), Some(PlanRefusal::NotFinite)),
        (Some(Plan { twist: nan, time_ns: room.time_ns }), None),
        (Some(Plan { twist: FORWARD, time_ns: 0 }), None),
        (None, None),
    ];
    for (plan, said) in plans {
        room.time_ns += 50_000_000;
        let fresh = LaserScan { time_ns: room.time_ns, ..scan.clone() };
        let output = room.turn(&SafetyInput { plan, ..room.input(FORWARD, Some(&fresh), false) });
        assert_eq!(output.twist(), Twist2::ZERO);
        assert!(
            said.is_none() || output.event == said.map(|why| SafetyEvent::PlanRefused { why }),
            "{output:?}"
        );
    }
    assert_eq!(room.tick(FORWARD).twist(), FORWARD);
    room.time_ns += 100_000_000;
    let old = Some(Plan { twist: FORWARD, time_ns: room.time_ns - 300_000_001 });
    let fresh = LaserScan { time_ns: room.time_ns, ..scan };
    let output = room.turn(&SafetyInput { plan: old, ..room.input(FORWARD, Some(&fresh), false) });
    assert_eq!(output.event, Some(SafetyEvent::PlanRefused { why: PlanRefusal::Stale }));
}

#[test]
fn a_loop_that_comes_two_periods_late_stands_for_that_turn_and_goes_on_without_a_burst() {
    let mut room = driving();
    room.time_ns += 2 * TICK_NS + 1;
    let output = room.tick(FORWARD);
    assert_eq!(
        output,
        SafetyOutput::STOP.because(SafetyEvent::Faulted { why: FaultReason::LoopOverrun })
    );
    assert_eq!(room.tick(FORWARD).twist(), FORWARD);
}

#[test]
fn the_nearer_the_wall_the_slower_and_it_stops_with_the_distance_left_however_it_brakes() {
    let mut plane = SafetyPlane::new(real());
    let (mut x_m, mut speed, mut last_allowed) = (0.0_f64, 0.0_f64, f64::INFINITY);
    let mut slowed = false;
    for turn in 0..800_u64 {
        let time_ns = turn * 10_000_000;
        let scan =
            LaserScan { time_ns, ..crate::safety::surroundings::tests::wall_ahead(1.0 - x_m) };
        let odom = Pose2::new(x_m, 0.0, 0.0);
        let twist = Twist2 { linear_mps: speed, angular_radps: 0.0 };
        let output = plane.step(&SafetyInput {
            time_ns,
            scan: Some(&scan),
            wheel: Some(WheelFeedback { time_ns, odom, twist, contact: false }),
            base_error: None,
            emergency_stop: false,
            plan: Some(Plan { twist: Twist2 { linear_mps: 0.5, angular_radps: 0.2 }, time_ns }),
            request: Some(Request::Arm),
        });
        if plane.state() == SafetyState::Slow {
            slowed = true;
            let command = output.twist();
            assert!(command.linear_mps <= last_allowed + 1e-9, "never faster again");
            assert!(
                (command.angular_radps / command.linear_mps - 0.4).abs() < 1e-9,
                "the arc is kept"
            );
            last_allowed = command.linear_mps;
        }
        if matches!(plane.state(), SafetyState::Tripped { .. }) {
            break;
        }
        // A base that follows within its acceleration of 1 m/s2.
        speed += (output.twist().linear_mps - speed).clamp(-0.01, 0.01);
        x_m += speed * 0.01;
    }
    assert!(slowed && matches!(plane.state(), SafetyState::Tripped { .. }), "{:?}", plane.state());
    let left_m = 1.0 - x_m - 0.16 - speed * speed / 2.0;
    assert!((0.095..0.115).contains(&left_m), "{left_m} m are left");
}

#[test]
fn a_robot_that_rolls_on_waits_until_it_stands_before_it_drives_back() {
    let mut room = Room::new(2.0, Pose2::new(1.7, 0.0, 0.0));
    room.until(FORWARD, tripped);
    for _ in 0..4 {
        room.driving = FORWARD;
        assert_eq!(room.tick(FORWARD).command, None);
        assert!(matches!(room.plane.state(), SafetyState::Tripped { .. }));
    }
    assert!(room.tick(FORWARD).twist().linear_mps < 0.0);
}

#[test]
fn it_never_backs_off_blindly_for_longer_than_configured() {
    // Put down before a wall: nobody knows what is behind.
    let mut room = Room::new(2.0, Pose2::new(1.75, 0.0, 0.0));
    room.until(FORWARD, tripped);
    let stopped_at = room.pose;
    let output = room.until(FORWARD, |output| output.blocked_m.is_some());
    assert!(
        matches!(output.event, Some(SafetyEvent::BackedOff { end: BackOffEnd::RearUnknown, .. })),
        "{output:?}"
    );
    let gone_m = room.pose.distance_m(&stopped_at);
    assert!(gone_m > 0.0 && gone_m < 0.051, "{gone_m}");
    room.until(FORWARD, |output| output.event == Some(SafetyEvent::Cleared));
}

#[test]
fn a_fault_while_backing_off_still_tells_the_planner_what_is_blocked() {
    let mut room = Room::new(2.0, Pose2::IDENTITY);
    room.until(FORWARD, tripped);
    let scan = room.scan();
    let input = SafetyInput { emergency_stop: true, ..room.input(FORWARD, Some(&scan), false) };
    assert!(room.turn(&input).blocked_m.is_some());
}

#[test]
fn a_cart_does_not_turn_its_corner_into_a_wall_and_drives_on_ahead() {
    let corners = vec![[0.3, 0.15], [-0.1, 0.15], [-0.1, -0.15], [0.3, -0.15]];
    let config = SafetyConfig { footprint_m: corners, ..SafetyConfig::default() };
    let mut room = Room::with(config, 2.0, Pose2::new(0.0, 1.84, 0.0));
    let left = Twist2 { linear_mps: 0.0, angular_radps: 0.3 };
    let right = Twist2 { linear_mps: 0.0, angular_radps: -0.3 };
    assert_eq!(room.tick(left).twist(), Twist2::ZERO);
    assert_eq!(room.tick(FORWARD).twist(), FORWARD);
    assert!(room.pose.x_m > 0.0);
    room.pose.y_m = 1.6;
    assert_eq!(room.tick(right).twist(), right);
}

#[test]
fn trips_to_the_left_and_to_the_right_are_not_the_same_place() {
    let mut plane = SafetyPlane::new(SafetyConfig::default());
    for (turn, y_m) in [0.4, -0.4, 0.4, -0.4, 0.4].into_iter().enumerate() {
        plane.trip(turn as u64 * TICK_NS, &Pose2::IDENTITY, TripCause::LidarHit, [0.3, y_m]);
        assert!(matches!(plane.state(), SafetyState::Tripped { .. }), "never an escape");
        assert_eq!(plane.trips.len(), 1, "the other side is forgotten");
    }
}

#[test]
fn a_refused_plan_is_said_once_and_waiting_for_the_first_not_at_all() {
    let mut room = Room::new(2.0, Pose2::IDENTITY);
    let said = |room: &mut Room, plan: Option<Plan>| {
        let scan = room.scan();
        let input = SafetyInput { plan, ..room.input(FORWARD, Some(&scan), false) };
        matches!(room.turn(&input).event, Some(SafetyEvent::PlanRefused { .. }))
    };
    (0..20).for_each(|_| assert!(!said(&mut room, None)));
    let nonsense =
        Plan { twist: Twist2 { linear_mps: f64::NAN, angular_radps: 0.0 }, time_ns: u64::MAX / 4 };
    assert_eq!((0..20).filter(|_| said(&mut room, Some(nonsense))).count(), 1);
}

#[test]
fn a_plane_that_takes_up_a_snapshot_goes_on_as_the_one_that_wrote_it() {
    let mut room = Room::new(2.0, Pose2::new(1.0, 0.0, 0.0));
    let mut bytes = Vec::new();
    let mut states = Vec::new();
    let mut other = SafetyPlane::new(SafetyConfig::default());
    for tick in 0..600 {
        if tick % 7 == 0 {
            bytes.clear();
            State::write(&room.plane, &mut bytes);
            other = SafetyPlane::new(SafetyConfig::default());
            let mut rest = bytes.as_slice();
            other.read(&mut rest).unwrap();
            assert!(rest.is_empty());
        }
        let scan = room.scan();
        let input = room.input(FORWARD, Some(&scan), false);
        let goes_on = other.step(&input);
        assert_eq!(room.turn(&input), goes_on, "turn {tick}");
        states.push(room.plane.state().name());
    }
    for state in ["clear", "tripped", "backing off", "escaping"] {
        assert!(states.contains(&state), "{state} was never looked at");
    }
    for len in 0..bytes.len() {
        assert!(
            SafetyPlane::new(SafetyConfig::default()).read(&mut &bytes[..len]).is_err(),
            "{len}"
        );
    }
}
