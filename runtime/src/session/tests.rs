//! Tests of the session with simulated devices: a robot in a corridor.

use std::sync::{Arc, Mutex};

use hal::{
    Base, CameraModel, Clock, DriveCommand, ErrorKind, ErrorType, ImageView, LaserScan, Lidar,
    Pose2, Range, RobotDescription, ScanGeometry, Twist2, VirtualClock, WheelFeedback,
};

use super::*;
use crate::event::{Event, SafetyEvent};
use crate::exploration::PolicyKind;
use crate::localization::LostReason;
use crate::robot::{RobotConfig, Stage};
use crate::safety::SentCommand;
use crate::safety::{Request, SafetyConfig, SafetyLoop};
use crate::tick::Command;

const TICK_NS: u64 = 100_000_000;
const STEP_NS: u64 = 10_000_000;

/// A corridor along x that ends in a wall, and a robot in it.
#[derive(Debug, Default)]
struct Corridor {
    now_ns: u64,
    x_m: f64,
    yaw_rad: f64,
    twist: Twist2,
    /// Everything that the motors received.
    received: Vec<SentCommand>,
}

const WALL_M: f64 = 1.5;

type Shared = Arc<Mutex<Corridor>>;

#[derive(Debug)]
struct Never;

impl std::fmt::Display for Never {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("never")
    }
}

impl hal::Error for Never {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Fault
    }
}

struct Motors(Shared);

impl ErrorType for Motors {
    type Error = Never;
}

impl Base for Motors {
    fn drive(&mut self, command: &DriveCommand) -> Result<(), Never> {
        let mut corridor = self.0.lock().unwrap();
        let now_ns = corridor.now_ns;
        corridor.twist = command.twist;
        corridor.received.push(SentCommand::drive(now_ns, command.counter, command.twist));
        Ok(())
    }

    fn stop(&mut self) -> Result<(), Never> {
        let mut corridor = self.0.lock().unwrap();
        let now_ns = corridor.now_ns;
        corridor.twist = Twist2::ZERO;
        corridor.received.push(SentCommand::stop(now_ns));
        Ok(())
    }

    fn poll_feedback(&mut self) -> Result<Option<WheelFeedback>, Never> {
        let corridor = self.0.lock().unwrap();
        Ok(Some(WheelFeedback {
            time_ns: corridor.now_ns,
            odom: Pose2::new(corridor.x_m, 0.0, corridor.yaw_rad),
            twist: corridor.twist,
            contact: false,
            cliff: false,
        }))
    }
}

struct Scanner(Shared);

impl ErrorType for Scanner {
    type Error = Never;
}

impl Lidar for Scanner {
    fn geometry(&self) -> ScanGeometry {
        ScanGeometry::UTM_30LX
    }

    fn poll_scan(&mut self, scan: &mut LaserScan) -> Result<bool, Never> {
        let corridor = self.0.lock().unwrap();
        scan.time_ns = corridor.now_ns.saturating_sub(scan.geometry.period_ns / 2);
        scan.ranges.clear();
        for beam in 0..scan.geometry.beams {
            let angle = scan.geometry.angle_rad(beam) + corridor.yaw_rad;
            let ahead_m = (WALL_M - corridor.x_m) / angle.cos();
            let aside_m = 2.0 / angle.sin().abs();
            let behind_m = 3.0 / (-angle.cos()).max(1e-9);
            let nearest = if ahead_m > 0.0 { ahead_m } else { behind_m }.min(aside_m);
            scan.ranges.push(Range::Hit(nearest as f32));
        }
        Ok(true)
    }
}

struct CorridorClock(VirtualClock, Shared);

impl Clock for CorridorClock {
    fn now_ns(&self) -> u64 {
        self.0.now_ns()
    }

    fn sleep_until_ns(&mut self, deadline_ns: u64) {
        let mut corridor = self.1.lock().unwrap();
        let seconds = deadline_ns.saturating_sub(corridor.now_ns) as f64 * 1e-9;
        corridor.x_m += seconds * corridor.twist.linear_mps * corridor.yaw_rad.cos();
        corridor.yaw_rad += seconds * corridor.twist.angular_radps;
        corridor.now_ns = corridor.now_ns.max(deadline_ns);
        self.0.sleep_until_ns(deadline_ns);
    }
}

/// The devices of a session without a camera: only a clock.
struct Blind<K>(K);

impl<K: Clock> Clock for Blind<K> {
    fn now_ns(&self) -> u64 {
        self.0.now_ns()
    }

    fn sleep_until_ns(&mut self, deadline_ns: u64) {
        self.0.sleep_until_ns(deadline_ns);
    }
}

impl<K: Clock> Devices for Blind<K> {
    fn poll_frame(&mut self) -> Option<u64> {
        None
    }

    fn frame(&self) -> Option<ImageView<'_>> {
        None
    }
}

/// The observer keeps what a recording would contain.
#[derive(Default)]
struct Record {
    ticks: Vec<(Decision, SafetyReport)>,
    inputs: Vec<(Option<OutsideInput>, WheelFeedback)>,
}

impl StageTimer for Record {
    fn ended(&mut self, _stage: Stage) {}
}

impl Observer for Record {
    type Error = ();

    fn before(&mut self, _robot: &mut Robot, _input: &TickInput<'_>) -> Result<(), ()> {
        Ok(())
    }

    fn after(
        &mut self,
        _robot: &mut Robot,
        input: &TickInput<'_>,
        decision: &Decision,
    ) -> Result<(), ()> {
        self.ticks.push((decision.clone(), input.safety.clone()));
        self.inputs.push((input.outside, input.wheel));
        Ok(())
    }
}

fn robot() -> Robot {
    let camera = CameraModel::pinhole(64, 32, 1.5);
    let default = RobotConfig::of(&RobotDescription::default(), camera, PolicyKind::Forward, 1);
    // It has no camera, and drives by its scanner and its wheels.
    let config = RobotConfig { stop_without_frames: None, ..default };
    Robot::new(config, None).unwrap()
}

type Corridors = Session<Blind<VirtualTime<CorridorClock, Motors, Scanner>>>;

fn session() -> (Corridors, Shared) {
    let corridor = Shared::default();
    let config = SafetyConfig { period_s: 0.01, good_scans: 3, ..SafetyConfig::default() };
    let motors = Motors(Arc::clone(&corridor));
    let scanner = Scanner(Arc::clone(&corridor));
    let (task, port) = safety_link(SafetyLoop::new(config, motors, scanner));
    let clock = CorridorClock(VirtualClock::default(), Arc::clone(&corridor));
    let mut time = VirtualTime::new(clock, task, STEP_NS);
    time.request(Request::Arm);
    (Session::new(Blind(time), robot(), port, TICK_NS), corridor)
}

fn recorded(session: &mut Corridors, ticks: usize) -> Record {
    let mut record = Record::default();
    for _ in 0..ticks {
        session.wait();
        session.tick(&mut record).unwrap();
    }
    record
}

#[test]
fn the_record_holds_every_command_that_the_motors_received_through_stops_and_back_offs() {
    let (mut session, corridor) = session();
    let record = recorded(&mut session, 400);
    let sent: Vec<SentCommand> =
        record.ticks.iter().flat_map(|(_, report)| report.sent.clone()).collect();
    let received = &corridor.lock().unwrap().received;
    assert_eq!(sent, received[..sent.len()]);
    assert!(received.len() - sent.len() <= 10, "only those after the last tick are missing");
    assert!(sent.iter().any(|sent| sent.linear_mps < 0.0), "it backed off from the wall");
    assert!(
        sent.iter().any(|sent| sent.counter.is_none())
            && sent.iter().any(|sent| sent.linear_mps > 0.25)
    );
    let tripped =
        |event: &Event| matches!(event, Event::Safety { what: SafetyEvent::Tripped { .. } });
    assert!(record.ticks.iter().any(|(decision, _)| decision.events.iter().any(tripped)));
}

#[test]
fn a_decision_holds_the_desired_command_and_the_sent_one_that_was_in_force() {
    let (mut session, _) = session();
    let record = recorded(&mut session, 400);
    for (decision, report) in &record.ticks {
        assert_eq!(decision.sent, report.sent.last().map(SentCommand::command));
    }
    let backing_off = record
        .ticks
        .iter()
        .find(|(decision, _)| decision.sent.is_some_and(|sent| sent.linear_mps < 0.0))
        .expect("it backs off");
    assert_eq!(backing_off.0.desired, Command::default(), "the policy waits meanwhile");
}

#[test]
fn the_safety_loop_steps_ten_times_between_two_ticks() {
    let (mut session, _) = session();
    let record = recorded(&mut session, 20);
    assert!(record.ticks[1..].iter().all(|(_, report)| report.sent.len() == 10));
    let counters: Vec<u32> = record
        .ticks
        .iter()
        .flat_map(|(_, report)| report.sent.iter().filter_map(|sent| sent.counter))
        .collect();
    assert!(counters.windows(2).all(|pair| pair[1] == pair[0] + 1), "{counters:?}");
}

#[test]
fn a_tick_that_takes_too_long_is_counted_and_not_made_up_for() {
    let (mut session, corridor) = session();
    recorded(&mut session, 5);
    session.devices_mut().sleep_until_ns(5 * TICK_NS + 3 * TICK_NS / 2);
    let record = recorded(&mut session, 2);
    let times: Vec<u64> = record.ticks.iter().map(|(decision, _)| decision.time_ns).collect();
    assert_eq!((times, session.skipped()), (vec![7 * TICK_NS, 8 * TICK_NS], 1));
    assert_eq!(corridor.lock().unwrap().now_ns, 8 * TICK_NS);
}

fn drive(linear_mps: f64, angular_radps: f64) -> Task {
    Task::Drive { linear_mps, angular_radps }
}

#[test]
fn a_person_who_drives_at_the_wall_by_hand_is_stopped_by_the_safety_plane() {
    let (mut session, corridor) = session();
    recorded(&mut session, 5);
    let mut nearest_m = f64::INFINITY;
    let mut drove = 0;
    for _ in 0..150 {
        session.give(drive(0.25, 0.0)).unwrap();
        let (decision, report) = recorded(&mut session, 1).ticks.remove(0);
        drove += usize::from(decision.desired == Command { linear_mps: 0.25, angular_radps: 0.0 });
        assert!(report.in_charge || decision.desired.linear_mps == 0.25, "{decision:?}");
        nearest_m = nearest_m.min(WALL_M - corridor.lock().unwrap().x_m);
    }
    assert!(drove > 30, "it drove in {drove} ticks");
    // The footprint's radius, and what is left of the stop distance of 0.1 m where the robot drives aslant at the wall.
    assert!((0.16 + 0.03..0.5).contains(&nearest_m), "{nearest_m} m");
}

#[test]
fn a_faster_hand_than_the_robot_drives_at_its_highest_speed_on_the_same_arc_and_lets_go_after_0_4_s()
 {
    let (mut session, _) = session();
    recorded(&mut session, 5);
    session.give(drive(-3.0, 0.5)).unwrap();
    let ticks = recorded(&mut session, 6).ticks;
    let desired: Vec<Command> = ticks.iter().map(|(decision, _)| decision.desired).collect();
    let Command { linear_mps, angular_radps } = desired[0];
    assert!((linear_mps + 0.3).abs() < 1e-12 && (angular_radps - 0.05).abs() < 1e-12);
    assert_eq!(desired[1..4], [desired[0]; 3]);
    assert_eq!(desired[4..], [Command::default(); 2]);
    assert!(session.give(drive(f64::NAN, 0.0)).is_err());
    assert!(session.give(drive(0.0, f64::INFINITY)).is_err());
}

#[test]
fn a_lost_robot_searches_its_place_unless_a_person_has_paused_it_and_can_be_driven_by_hand() {
    let (mut session, _) = session();
    recorded(&mut session, 5);
    session.robot_mut().lose(LostReason::Carried);
    session.give(Task::Pause).unwrap();
    let moves =
        |record: Record| record.ticks.iter().any(|(it, _)| it.desired != Command::default());
    let paused = recorded(&mut session, 20);
    assert!(paused.ticks.iter().all(|(decision, _)| decision.lost.is_some()));
    assert!(!moves(paused));
    session.give(drive(0.0, 0.2)).unwrap();
    assert!(moves(recorded(&mut session, 1)));
}

#[test]
fn two_sessions_of_the_same_devices_decide_the_same() {
    assert_eq!(decisions(), decisions());
}

fn decisions() -> Vec<(Decision, SafetyReport)> {
    let (mut session, _) = session();
    recorded(&mut session, 150).ticks
}

#[test]
fn a_pose_from_outside_enters_one_tick_with_the_wheels_of_its_own_time() {
    let (mut session, _) = session();
    let before = recorded(&mut session, 12);
    let (_, wheel) = before.inputs[9];
    assert!(wheel.odom.x_m > 0.1, "the robot drives");
    let outside = OutsidePose { time_ns: wheel.time_ns, pose: Pose2::new(9.0, 9.0, 1.0) };
    session.give_pose(OutsidePose { time_ns: 1, ..outside });
    session.give_pose(outside);
    let after = recorded(&mut session, 2);
    let taken = after.inputs[0].0.unwrap();
    assert_eq!(taken, OutsideInput { outside, wheel_odom: wheel.odom });
    assert_ne!(after.inputs[0].1.odom, wheel.odom, "the robot has driven on since");
    assert_eq!(after.inputs[1].0, None);
}
