use super::*;
use crate::safety::Plan;
use crate::snapshot::State;
use hal::{Range, ScanGeometry};
use proptest::prelude::*;

pub const FORWARD: Twist2 = Twist2 { linear_mps: 0.3, angular_radps: 0.0 };
pub const TICK_NS: u64 = 100_000_000;

/// A round robot in a square room, with exact ranges and wheels that follow commands exactly.
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
        LaserScan {
            time_ns: self.time_ns,
            geometry,
            ranges: (0..geometry.beams).map(|beam| self.range(geometry.angle_rad(beam))).collect(),
        }
    }

    fn range(&self, beam_rad: f64) -> Range {
        let (sin, cos) = (beam_rad + self.pose.yaw_rad).sin_cos();
        let along_x = self.distance_to_wall_m(self.pose.x_m, cos);
        Range::Hit(along_x.min(self.distance_to_wall_m(self.pose.y_m, sin)) as f32)
    }

    /// Distance along a ray to the walls of one axis: `position` of the ray's start and `slope` of
    /// the ray on that axis.
    fn distance_to_wall_m(&self, position: f64, slope: f64) -> f64 {
        if slope > 1e-9 {
            (self.half_m - position) / slope
        } else if slope < -1e-9 {
            (-self.half_m - position) / slope
        } else {
            f64::INFINITY
        }
    }

    pub fn input<'a>(
        &self,
        desired: Twist2,
        scan: Option<&'a LaserScan>,
        contact: bool,
    ) -> SafetyInput<'a> {
        let twist = self.driving;
        SafetyInput {
            time_ns: self.time_ns,
            scan,
            wheel: Some(WheelFeedback {
                time_ns: self.time_ns,
                odom: self.pose,
                twist,
                contact,
                cliff: false,
            }),
            base_error: None,
            emergency_stop: false,
            suspended: false,
            plan: Some(Plan { twist: desired, time_ns: self.time_ns }),
            request: Some(Request::Arm),
        }
    }

    pub fn step(&mut self, input: &SafetyInput<'_>) -> SafetyOutput {
        let output = self.plane.step(input);
        // The wheels follow exactly and stop at once.
        self.driving = Twist2::ZERO;
        self.pose = self.pose.compose(&output.twist().integrate(0.1));
        self.time_ns += TICK_NS;
        output
    }

    pub fn tick_with(
        &mut self,
        desired: Twist2,
        scan: Option<&LaserScan>,
        contact: bool,
    ) -> SafetyOutput {
        let input = self.input(desired, scan, contact);
        self.step(&input)
    }

    pub fn tick(&mut self, desired: Twist2) -> SafetyOutput {
        let scan = self.scan();
        self.tick_with(desired, Some(&scan), false)
    }

    pub fn until(
        &mut self,
        desired: Twist2,
        mut done: impl FnMut(&SafetyOutput) -> bool,
    ) -> SafetyOutput {
        for _ in 0..2000 {
            let output = self.tick(desired);
            if done(&output) {
                return output;
            }
        }
        panic!("did not happen in 2000 ticks, state {:?}", self.plane.state());
    }
}

/// 40 cm long and 30 cm wide, with the axle 10 cm before the rear end.
pub fn cart() -> SafetyConfig {
    let footprint_m = vec![[0.3, 0.15], [-0.1, 0.15], [-0.1, -0.15], [0.3, -0.15]];
    SafetyConfig { footprint_m, ..SafetyConfig::default() }
}

/// A robot that has rotated once on the spot and therefore knows the ground behind it.
pub fn rotated_once(x_m: f64) -> Room {
    let mut room = Room::new(2.0, Pose2::new(x_m, 0.0, 0.0));
    for _ in 0..105 {
        room.tick(Twist2 { linear_mps: 0.0, angular_radps: 0.6 });
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
    let rotation = Twist2 { linear_mps: 0.0, angular_radps: 0.3 };
    assert_eq!(room.tick(rotation).twist(), rotation);
}

#[test]
fn a_reverse_command_towards_an_obstacle_behind_keeps_only_its_rotation() {
    let mut room = Room::new(3.0, Pose2::IDENTITY);
    let back = Twist2 { linear_mps: -0.3, angular_radps: 0.1 };
    let mut scan = room.scan();
    for (beam, range) in scan.ranges.iter_mut().enumerate() {
        *range = if beam < 4 { Range::Hit(0.17) } else { Range::Hit(3.0) };
    }
    // The rear beams at 135 degrees meet a post at 0.17 m: x = -0.12, y = 0.12, inside the strip
    // behind.
    let output = room.tick_with(back, Some(&scan), false);
    assert_eq!(output.twist(), Twist2 { linear_mps: 0.0, angular_radps: 0.1 });
}

#[test]
fn a_contact_without_a_lidar_return_trips_the_safety_plane() {
    let mut room = Room::new(5.0, Pose2::IDENTITY);
    room.tick(FORWARD);
    let scan = room.scan();
    let output = room.tick_with(FORWARD, Some(&scan), true);
    assert!(matches!(output.event, Some(SafetyEvent::Tripped { by: TripCause::Contact, .. })));
}

#[test]
fn a_silent_lidar_stops_the_robot_with_one_event_and_a_new_scan_clears_the_fault() {
    let mut room = Room::new(5.0, Pose2::IDENTITY);
    room.tick(FORWARD);
    let mut reasons = Vec::new();
    for _ in 0..10 {
        reasons.extend(room.tick_with(FORWARD, None, false).event);
    }
    assert_eq!(reasons, [SafetyEvent::Faulted { why: FaultReason::LidarSilent }]);
    assert_eq!(room.plane.state(), SafetyState::Fault(FaultReason::LidarSilent));
    assert!(restarts_slowly(&mut room));
}

/// Whether the robot creeps for a second and then drives at full speed, as after every stop that
/// ended without a person.
pub fn restarts_slowly(room: &mut Room) -> bool {
    let first = room.tick(FORWARD);
    let creep = Twist2 { linear_mps: CREEP_MPS, angular_radps: 0.0 };
    let creeping = (0..9).all(|_| room.tick(FORWARD).twist() == creep);
    let cleared = room.tick(FORWARD);
    first.event == Some(SafetyEvent::Slowed { limit_mps: CREEP_MPS })
        && creeping
        && (cleared.twist(), cleared.event) == (FORWARD, Some(SafetyEvent::Cleared))
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
fn backing_off_times_out_when_the_wheels_report_no_motion() {
    let config = SafetyConfig { rear_memory_s: 30.0, ..SafetyConfig::default() };
    let mut room = Room::with(config, 2.0, Pose2::IDENTITY);
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
fn the_third_trip_at_one_place_rotates_the_robot_until_the_space_ahead_is_free() {
    let mut room = Room::new(2.0, Pose2::new(1.5, 0.0, 0.0));
    for _ in 0..3 {
        room.until(FORWARD, tripped);
    }
    room.until(FORWARD, |output| matches!(output.event, Some(SafetyEvent::Escaping)));
    room.until(FORWARD, |output| matches!(output.event, Some(SafetyEvent::Cleared)));
    assert!(room.pose.yaw_rad.abs() > std::f64::consts::FRAC_PI_4);
    for _ in 0..10 {
        assert_eq!(room.tick(FORWARD).twist(), FORWARD, "the space ahead is free");
    }
}

#[test]
fn an_escape_without_free_space_ends_after_one_rotation() {
    let mut room = Room::new(0.3, Pose2::IDENTITY);
    for _ in 0..3 {
        room.until(FORWARD, tripped);
    }
    room.until(FORWARD, |output| matches!(output.event, Some(SafetyEvent::Cleared)));
}

#[test]
fn a_robot_in_a_corner_of_a_small_room_keeps_moving_to_other_places() {
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
    fn no_forward_command_ever_brings_the_footprint_into_a_wall(
        commands in proptest::collection::vec((-0.1..0.3f64, -0.4..0.4f64), 1..300),
        yaw in -3.0..3.0f64,
    ) {
        let mut room = Room::new(0.8, Pose2::new(0.1, -0.2, yaw));
        for (linear_mps, angular_radps) in commands {
            // The scanner does not cover the ground behind, so the property holds for forward
            // commands only.
            room.tick(Twist2 { linear_mps: linear_mps.max(0.0), angular_radps });
            let reach = room.pose.x_m.abs().max(room.pose.y_m.abs()) + 0.16;
            prop_assert!(reach < 0.8, "footprint reaches {reach}");
        }
    }
}

/// A realistic robot: control at 100 Hz, braking at 1 m/s2 after a reaction time of 50 ms.
fn real() -> SafetyConfig {
    SafetyConfig {
        period_s: 0.01,
        brake_mps2: 1.0,
        reaction_s: 0.05,
        good_scans: 3,
        ..SafetyConfig::default()
    }
}

/// A room with an armed robot that drives forward.
pub fn driving() -> Room {
    let mut room = Room::new(5.0, Pose2::IDENTITY);
    assert_eq!(room.tick(FORWARD).twist(), FORWARD);
    room
}

#[test]
fn a_robot_that_was_not_armed_does_not_move() {
    let mut room = Room::new(5.0, Pose2::IDENTITY);
    let scan = room.scan();
    for _ in 0..5 {
        let input = SafetyInput { request: None, ..room.input(FORWARD, Some(&scan), false) };
        assert_eq!(room.step(&input).command, None);
    }
    assert_eq!(room.plane.state(), SafetyState::Disarmed);
    assert_eq!(room.tick(FORWARD).event, Some(SafetyEvent::Armed));
    let input =
        SafetyInput { request: Some(Request::Disarm), ..room.input(FORWARD, Some(&scan), false) };
    assert_eq!(room.step(&input), SafetyOutput::STOP.because(SafetyEvent::Disarmed));
}

#[test]
fn after_silence_three_good_scans_in_a_row_come_before_motion() {
    let config = SafetyConfig { good_scans: 3, ..SafetyConfig::default() };
    let mut room = Room::with(config, 5.0, Pose2::IDENTITY);
    let moves: Vec<bool> = (0..4).map(|_| room.tick(FORWARD).twist() == FORWARD).collect();
    assert_eq!(moves, [false, false, true, true], "the start requires them too");
    (0..5).for_each(|_| _ = room.tick_with(FORWARD, None, false));
    let mut bad = room.scan();
    bad.ranges.fill(Range::Error);
    assert_eq!(room.tick(FORWARD).twist(), Twist2::ZERO);
    bad.time_ns = room.time_ns;
    assert_eq!(room.tick_with(FORWARD, Some(&bad), false).twist(), Twist2::ZERO);
    let moves: Vec<f64> = (0..3).map(|_| room.tick(FORWARD).twist().linear_mps).collect();
    assert_eq!(moves, [0.0, 0.0, CREEP_MPS], "a bad scan resets the count");
}

#[test]
fn silent_wheels_stop_the_robot_and_new_feedback_does_not_move_it() {
    let mut room = driving();
    let scan = room.scan();
    let mut stopped_after = 0;
    for tick in 1..=5 {
        let fresh = LaserScan { time_ns: room.time_ns, ..scan.clone() };
        let input = SafetyInput { wheel: None, ..room.input(FORWARD, Some(&fresh), false) };
        if room.step(&input).event == Some(SafetyEvent::Faulted { why: FaultReason::BaseSilent }) {
            stopped_after = tick;
        }
    }
    assert_eq!(stopped_after, 3, "feedback may be 0.2 s old");
    (0..20).for_each(|_| assert_eq!(room.tick(FORWARD).command, None));
}

#[test]
fn a_fault_of_the_base_and_the_emergency_stop_need_a_person() {
    let faults: [fn(&mut SafetyInput<'_>); 2] = [
        |input| input.base_error = Some(FaultReason::BaseFault),
        |input| input.emergency_stop = true,
    ];
    for fault in faults {
        let mut room = driving();
        let scan = room.scan();
        let mut input = room.input(FORWARD, Some(&scan), false);
        fault(&mut input);
        let output = room.step(&input);
        assert!(
            matches!(output.event, Some(SafetyEvent::Faulted { why }) if why.needs_person()),
            "{output:?}"
        );
        assert_eq!(output.command, None);
        for _ in 0..10 {
            assert_eq!(
                room.tick(FORWARD).command,
                None,
                "the cause is gone, but arming alone does not clear the fault"
            );
        }
        let scan = room.scan();
        let mut clear = SafetyInput {
            request: Some(Request::ClearFault),
            ..room.input(FORWARD, Some(&scan), false)
        };
        fault(&mut clear);
        room.step(&clear);
        assert!(
            matches!(room.plane.state(), SafetyState::Fault(_)),
            "the cause is still present, so the fault cannot be cleared"
        );
        let clear = SafetyInput {
            request: Some(Request::ClearFault),
            ..room.input(FORWARD, Some(&scan), false)
        };
        assert_eq!(room.step(&clear).event, Some(SafetyEvent::Disarmed));
        assert_eq!(room.tick(FORWARD).twist(), FORWARD, "armed anew");
    }
}

#[test]
fn silence_after_a_fault_of_the_base_does_not_replace_the_fault() {
    let mut room = driving();
    let scan = room.scan();
    let fault = SafetyInput {
        base_error: Some(FaultReason::BaseFault),
        ..room.input(FORWARD, Some(&scan), false)
    };
    room.step(&fault);
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
        room.step(&input).event,
        Some(SafetyEvent::Faulted { why: FaultReason::OdometryNotFinite })
    );
    assert!(restarts_slowly(&mut room));
}

#[test]
fn a_nan_or_old_or_missing_plan_stops_the_robot_and_the_reason_is_reported_once() {
    let mut room = driving();
    let scan = room.scan();
    let nan = Twist2 { linear_mps: f64::NAN, angular_radps: 0.0 };
    let plans = [
        (Some(Plan { twist: nan, time_ns: room.time_ns }), Some(PlanRefusal::NotFinite)),
        (Some(Plan { twist: nan, time_ns: room.time_ns }), None),
        (Some(Plan { twist: FORWARD, time_ns: 0 }), None),
        (None, None),
    ];
    for (plan, reported) in plans {
        room.time_ns += 50_000_000;
        let fresh = LaserScan { time_ns: room.time_ns, ..scan.clone() };
        let output = room.step(&SafetyInput { plan, ..room.input(FORWARD, Some(&fresh), false) });
        assert_eq!(output.twist(), Twist2::ZERO);
        assert!(
            reported.is_none()
                || output.event == reported.map(|why| SafetyEvent::PlanRefused { why }),
            "{output:?}"
        );
    }
    assert_eq!(room.tick(FORWARD).twist(), FORWARD);
    room.time_ns += 100_000_000;
    let old = Some(Plan { twist: FORWARD, time_ns: room.time_ns - 300_000_001 });
    let fresh = LaserScan { time_ns: room.time_ns, ..scan };
    let output = room.step(&SafetyInput { plan: old, ..room.input(FORWARD, Some(&fresh), false) });
    assert_eq!(output.event, Some(SafetyEvent::PlanRefused { why: PlanRefusal::Stale }));
}

#[test]
fn a_tick_that_is_two_periods_late_stops_the_robot_and_it_continues_slowly() {
    let mut room = driving();
    room.time_ns += 2 * TICK_NS + 1;
    let output = room.tick(FORWARD);
    assert_eq!(output.command, None);
    assert_eq!(output.event, Some(SafetyEvent::Faulted { why: FaultReason::LoopOverrun }));
    assert!(restarts_slowly(&mut room));
}

#[test]
fn a_pause_of_more_than_half_a_second_needs_a_person() {
    for (pause_ns, needs_person) in [(500_000_000, false), (500_000_001, true)] {
        let mut room = driving();
        room.time_ns += pause_ns - TICK_NS;
        room.tick(FORWARD);
        (0..5).for_each(|_| _ = room.tick(FORWARD));
        let state = room.plane.state();
        assert_eq!(
            state == SafetyState::Fault(FaultReason::LoopStalled),
            needs_person,
            "{state:?}"
        );
    }
}

#[test]
fn after_a_stop_that_ends_without_a_person_rotations_are_slow_too() {
    let mut room = driving();
    room.time_ns += 2 * TICK_NS + 1;
    let rotation = Twist2 { linear_mps: 0.0, angular_radps: -0.5 };
    room.tick(rotation);
    assert_eq!(room.tick(rotation).twist().angular_radps, -CREEP_RADPS);
    (0..9).for_each(|_| _ = room.tick(rotation));
    assert_eq!(room.tick(rotation).twist(), rotation);
}

#[test]
fn the_speed_falls_towards_a_wall_and_the_robot_stops_at_the_stop_distance() {
    let mut plane = SafetyPlane::new(real());
    let mut x_m = 0.0_f64;
    let mut speed = 0.0_f64;
    let mut last_allowed = f64::INFINITY;
    let mut slowed = false;
    for tick in 0..800_u64 {
        let time_ns = tick * 10_000_000;
        let scan =
            LaserScan { time_ns, ..crate::safety::surroundings::tests::wall_ahead(1.0 - x_m) };
        let odom = Pose2::new(x_m, 0.0, 0.0);
        let twist = Twist2 { linear_mps: speed, angular_radps: 0.0 };
        let output = plane.step(&SafetyInput {
            time_ns,
            scan: Some(&scan),
            wheel: Some(WheelFeedback { time_ns, odom, twist, contact: false, cliff: false }),
            base_error: None,
            emergency_stop: false,
            suspended: false,
            plan: Some(Plan { twist: Twist2 { linear_mps: 0.5, angular_radps: 0.2 }, time_ns }),
            request: Some(Request::Arm),
        });
        if plane.state() == SafetyState::Slow {
            slowed = true;
            let command = output.twist();
            assert!(command.linear_mps <= last_allowed + 1e-9, "the speed never rises again");
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
fn a_robot_that_is_still_rolling_waits_before_it_backs_off() {
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
fn backing_off_over_unknown_ground_is_limited_to_the_configured_distance() {
    // The robot starts in front of a wall, so the ground behind it is unknown.
    let config = SafetyConfig { blind_back_off_m: 0.05, ..SafetyConfig::default() };
    let mut room = Room::with(config, 2.0, Pose2::new(1.75, 0.0, 0.0));
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
fn a_fault_right_after_a_trip_still_reports_the_blocked_point() {
    let mut room = Room::new(2.0, Pose2::IDENTITY);
    room.until(FORWARD, tripped);
    let scan = room.scan();
    let input = SafetyInput { emergency_stop: true, ..room.input(FORWARD, Some(&scan), false) };
    assert!(room.step(&input).blocked_m.is_some());
}

#[test]
fn a_cart_does_not_rotate_its_corner_into_a_wall_and_may_drive_forward() {
    let corners = vec![[0.3, 0.15], [-0.1, 0.15], [-0.1, -0.15], [0.3, -0.15]];
    let config = SafetyConfig { footprint_m: corners, ..SafetyConfig::default() };
    let mut room = Room::with(config, 2.0, Pose2::new(0.0, 1.84, 0.0));
    let left = Twist2 { linear_mps: 0.0, angular_radps: 0.3 };
    let right = Twist2 { linear_mps: 0.0, angular_radps: -0.3 };
    assert_eq!(room.tick(left).twist(), Twist2::ZERO);
    let beside = room.tick(FORWARD).twist();
    assert_eq!(beside, Twist2 { linear_mps: BESIDE_MPS, angular_radps: 0.0 }, "1 cm beside a wall");
    assert!(room.pose.x_m > 0.0);
    room.pose.y_m = 1.6;
    assert_eq!(room.tick(right).twist(), right);
}

#[test]
fn trips_to_the_left_and_to_the_right_are_not_the_same_place() {
    let mut plane = SafetyPlane::new(SafetyConfig::default());
    for (tick, y_m) in [0.4, -0.4, 0.4, -0.4, 0.4].into_iter().enumerate() {
        plane.trip(tick as u64 * TICK_NS, &Pose2::IDENTITY, TripCause::LidarHit, [0.3, y_m]);
        assert!(matches!(plane.state(), SafetyState::Tripped { .. }), "never an escape");
        assert_eq!(plane.trips.len(), 1, "the trip on the other side is dropped");
    }
}

#[test]
fn a_refused_plan_is_reported_once_and_a_missing_first_plan_is_not() {
    let mut room = Room::new(2.0, Pose2::IDENTITY);
    fn reports_a_refusal(room: &mut Room, plan: Option<Plan>) -> bool {
        let scan = room.scan();
        let input = SafetyInput { plan, ..room.input(FORWARD, Some(&scan), false) };
        matches!(room.step(&input).event, Some(SafetyEvent::PlanRefused { .. }))
    }
    (0..20).for_each(|_| assert!(!reports_a_refusal(&mut room, None)));
    let nonsense =
        Plan { twist: Twist2 { linear_mps: f64::NAN, angular_radps: 0.0 }, time_ns: u64::MAX / 4 };
    assert_eq!((0..20).filter(|_| reports_a_refusal(&mut room, Some(nonsense))).count(), 1);
}

#[test]
fn a_plane_restored_from_a_snapshot_behaves_like_the_original() {
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
        assert_eq!(room.step(&input), goes_on, "tick {tick}");
        states.push(room.plane.state().name());
    }
    for state in ["clear", "tripped", "backing off", "escaping"] {
        assert!(states.contains(&state), "the state {state} was never reached");
    }
    for len in 0..bytes.len() {
        assert!(
            SafetyPlane::new(SafetyConfig::default()).read(&mut &bytes[..len]).is_err(),
            "{len}"
        );
    }
}
