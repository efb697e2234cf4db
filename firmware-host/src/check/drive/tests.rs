//! The course with a simulated robot, in virtual time.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::convert::Infallible;
use std::path::Path;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use hal::{
    Base, Clock, DriveCommand, ErrorType, LaserScan, Lidar, Pose2, Range, ScanGeometry, Twist2,
    WheelFeedback,
};
use runtime::safety::SafetyLoop;

use super::assumed::Assumed;
use super::judge::{self, Judgement};
use super::measure::{Course, CourseError, Measured};
use super::{confirm, file};
use crate::config::{Commissioning, Config};

const MS: u64 = 1_000_000;
const WATCHDOG_NS: u64 = 100 * MS;
const GEOMETRY: ScanGeometry = ScanGeometry::UTM_30LX;

/// A robot in a room of 6 m by 4 m.
#[derive(Debug, Clone)]
struct Robot {
    now_ns: u64,
    /// True pose, and that of the wheels.
    pose: Pose2,
    odom: Pose2,
    twist: Twist2,
    commands: VecDeque<(u64, Twist2)>,
    target: Twist2,
    commanded_ns: u64,
    scanned_ns: u64,
    // Its properties.
    latency_ns: u64,
    brake_mps2: f64,
    coast_mps2: f64,
    /// True motion per motion of the wheels.
    forward: f64,
    turning: f64,
    lidar_yaw_rad: f64,
}

impl Robot {
    fn new() -> Self {
        Self {
            now_ns: 1_000 * MS,
            pose: Pose2::new(-1.0, 0.3, 0.2),
            odom: Pose2::IDENTITY,
            twist: Twist2::ZERO,
            commands: VecDeque::new(),
            target: Twist2::ZERO,
            commanded_ns: 0,
            scanned_ns: 0,
            latency_ns: 20 * MS,
            brake_mps2: 1.0,
            coast_mps2: 1.0,
            forward: 1.0,
            turning: 1.0,
            lidar_yaw_rad: 0.0,
        }
    }

    fn advance_by_a_millisecond(&mut self) {
        self.now_ns += MS;
        while let Some((sent_ns, twist)) = self.commands.front().copied()
            && sent_ns + self.latency_ns <= self.now_ns
        {
            self.target = twist;
            self.commands.pop_front();
        }
        let is_alone = self.now_ns > self.commanded_ns + WATCHDOG_NS;
        let target_mps = if is_alone { 0.0 } else { self.target.linear_mps };
        let brake_mps2 = if is_alone { self.coast_mps2 } else { self.brake_mps2 };
        let change_mps = target_mps - self.twist.linear_mps;
        self.twist.linear_mps += change_mps.clamp(-1e-3 * brake_mps2, 0.5e-3);
        self.twist.angular_radps = if is_alone { 0.0 } else { self.target.angular_radps };
        self.odom = self.odom.compose(&self.twist.integrate(1e-3));
        let truth = Twist2 {
            linear_mps: self.twist.linear_mps * self.forward,
            angular_radps: self.twist.angular_radps * self.turning,
        };
        self.pose = self.pose.compose(&truth.integrate(1e-3));
    }

    fn range(&self, laser: &Pose2, beam: usize) -> Range {
        let (sin, cos) = (GEOMETRY.angle_rad(beam) + laser.yaw_rad).sin_cos();
        let along_x = (3.0 - laser.x_m * cos.signum()) / cos.abs().max(1e-9);
        let along_y = (2.0 - laser.y_m * sin.signum()) / sin.abs().max(1e-9);
        Range::Hit(along_x.min(along_y) as f32)
    }
}

/// The robot as its own base, scanner and clock.
#[derive(Debug, Clone)]
struct Shared(Rc<RefCell<Robot>>);

impl ErrorType for Shared {
    type Error = Infallible;
}

impl Clock for Shared {
    fn now_ns(&self) -> u64 {
        self.0.borrow().now_ns
    }

    fn sleep_until_ns(&mut self, deadline_ns: u64) {
        while self.now_ns() < deadline_ns {
            self.0.borrow_mut().advance_by_a_millisecond();
        }
    }
}

impl Base for Shared {
    fn drive(&mut self, command: &DriveCommand) -> Result<(), Infallible> {
        let mut robot = self.0.borrow_mut();
        let now_ns = robot.now_ns;
        robot.commanded_ns = now_ns;
        robot.commands.push_back((now_ns, command.twist));
        Ok(())
    }

    fn stop(&mut self) -> Result<(), Infallible> {
        let mut robot = self.0.borrow_mut();
        let now_ns = robot.now_ns;
        robot.commands.push_back((now_ns, Twist2::ZERO));
        Ok(())
    }

    fn poll_feedback(&mut self) -> Result<Option<WheelFeedback>, Infallible> {
        let robot = self.0.borrow();
        Ok(Some(WheelFeedback {
            time_ns: robot.now_ns,
            odom: robot.odom,
            twist: robot.twist,
            contact: false,
            cliff: false,
        }))
    }
}

impl Lidar for Shared {
    fn geometry(&self) -> ScanGeometry {
        GEOMETRY
    }

    fn poll_scan(&mut self, scan: &mut LaserScan) -> Result<bool, Infallible> {
        let mut robot = self.0.borrow_mut();
        if robot.now_ns < robot.scanned_ns + GEOMETRY.period_ns {
            return Ok(false);
        }
        robot.scanned_ns = robot.now_ns;
        let forward_m = Config::default().lidar.forward_m;
        let laser = robot.pose.compose(&Pose2::new(forward_m, 0.0, robot.lidar_yaw_rad));
        scan.time_ns = robot.now_ns - GEOMETRY.period_ns;
        scan.ranges.clear();
        scan.ranges.extend((0..GEOMETRY.beams).map(|beam| robot.range(&laser, beam)));
        Ok(true)
    }
}

fn assumed() -> Assumed {
    let mut config = Config::default();
    config.run.reaction_s = 0.08;
    Assumed::new(&config)
}

fn course(robot: Robot, ends: bool) -> Course<Shared, Shared, Shared> {
    let assumed = assumed();
    let robot = Shared(Rc::new(RefCell::new(robot)));
    let control = SafetyLoop::new(assumed.safety.clone(), robot.clone(), robot.clone());
    Course::new(control, robot, &assumed, Arc::new(AtomicBool::new(ends)))
}

fn driven(robot: Robot) -> (Measured, Vec<Judgement>) {
    let measured = course(robot, false).drive().unwrap();
    (measured, judge::all(&measured, &assumed()))
}

fn worse(robot: Robot) -> Vec<&'static str> {
    let (_, judgements) = driven(robot);
    judgements.iter().filter(|one| one.is_worse).map(|one| one.what).collect()
}

#[test]
fn a_robot_that_is_as_assumed_is_measured_as_it_is_and_nothing_is_worse() {
    let (measured, judgements) = driven(Robot::new());
    assert!(judgements.iter().all(|one| !one.is_worse), "{}", judge::table(&judgements));
    assert!((measured.speed_mps - 0.2).abs() < 1e-9);
    assert!((0.015..0.04).contains(&measured.response_s), "{measured:?}");
    // 20 ms of latency and 2 cm of braking.
    assert!((0.022..0.03).contains(&measured.braking_m), "{measured:?}");
    // The watchdog's 100 ms at 0.2 m/s come before the coasting.
    assert!((0.035..0.05).contains(&measured.roll_out_m), "{measured:?}");
    assert!(judge::lidar_yaw_deg(&measured).unwrap().abs() < 1.0);
}

#[test]
fn whatever_is_worse_than_assumed_is_named() {
    let robot = Robot::new;
    let late = Robot { latency_ns: 120 * MS, ..robot() };
    assert_eq!(worse(late), ["reaction time"]);
    let weak = Robot { brake_mps2: 0.4, ..robot() };
    assert_eq!(worse(weak), ["braking distance"]);
    let coasting = Robot { coast_mps2: 0.1, ..robot() };
    assert_eq!(worse(coasting), ["roll-out without commands"]);
    let large_wheels = Robot { forward: 1.4, ..robot() };
    assert_eq!(worse(large_wheels), ["way ahead"]);
    let narrow = Robot { turning: 1.3, ..robot() };
    assert_eq!(worse(narrow), ["rotation to the left", "rotation to the right"]);
}

#[test]
fn wheels_that_turn_the_wrong_way_end_the_course_and_are_named() {
    for (forward, turning) in [(-1.0, -1.0), (1.0, -1.0)] {
        let robot = Robot { forward, turning, ..Robot::new() };
        let said = course(robot, false).drive().unwrap_err().to_string();
        assert!(said.contains("swap_wheels") && said.contains("invert_left"), "{said}");
    }
}

#[test]
fn a_turned_scanner_is_measured_within_a_degree() {
    for turned_deg in [-8.0, 5.0] {
        let robot = Robot { lidar_yaw_rad: f64::to_radians(turned_deg), ..Robot::new() };
        let (measured, _) = driven(robot);
        let yaw_deg = judge::lidar_yaw_deg(&measured).unwrap();
        assert!((yaw_deg - turned_deg).abs() < 1.0, "{yaw_deg} of {turned_deg}");
        let unset = judged(&measured, 0.0);
        assert!(unset.is_worse && unset.advice.starts_with("set `lidar.yaw_deg = "));
        assert!(!judged(&measured, turned_deg).is_worse, "as configured");
    }
}

fn judged(measured: &Measured, lidar_yaw_deg: f64) -> Judgement {
    let judgements = judge::all(measured, &Assumed { lidar_yaw_deg, ..assumed() });
    judgements.into_iter().find(|one| one.what == "yaw of the LiDAR").unwrap()
}

#[test]
fn an_obstacle_ahead_ends_the_course_with_the_reason() {
    let near = Robot { pose: Pose2::new(2.6, 0.0, 0.0), ..Robot::new() };
    let error = course(near, false).drive().unwrap_err();
    assert!(matches!(error, CourseError::Stopped { leg: "ahead", .. }), "{error}");
}

#[test]
fn a_signal_ends_the_course_before_anything_moves() {
    let robot = Robot::new();
    let mut course = course(robot, true);
    assert_eq!(course.drive().unwrap_err(), CourseError::Interrupted);
    course.finish();
}

#[test]
fn only_the_word_yes_starts_the_robot() {
    confirm(&mut "yes\n".as_bytes()).unwrap();
    for answer in ["", "y\n", "no\n", "yes please\n"] {
        let said = confirm(&mut answer.as_bytes()).unwrap_err().to_string();
        assert!(said.contains("nothing was driven"), "{said}");
    }
}

#[test]
fn the_file_has_the_date_the_numbers_and_what_is_worse() {
    let folder = tempfile::tempdir().unwrap();
    let (measured, judgements) = driven(Robot { brake_mps2: 0.4, ..Robot::new() });
    let path = folder.path().join("robot.toml");
    let path = file::write(&Config::default(), &path, &measured, &assumed(), &judgements).unwrap();
    assert!(path.ends_with("commissioning.toml"));
    let written: toml::Table = std::fs::read_to_string(path).unwrap().parse().unwrap();
    assert!(written["date"].as_str().unwrap().ends_with('Z'));
    assert_eq!(written["worse"].as_array().unwrap()[0].as_str(), Some("braking distance"));
    let advice = written["advice"].as_array().unwrap()[0].as_str().unwrap();
    assert!(advice.contains("run.brake_mps2 = 0."), "{advice}");
}

#[test]
fn a_room_that_the_scanner_does_not_see_is_not_measured_and_not_good() {
    let (measured, _) = driven(Robot::new());
    let unseen = super::measure::Motion { laser: None, ..measured.ahead };
    let measured = Measured { ahead: unseen, ..measured };
    let judgements = judge::all(&measured, &assumed());
    let not_measured: Vec<_> = judgements.iter().filter(|one| one.is_worse).collect();
    assert_eq!(not_measured.len(), 2);
    assert!(not_measured.iter().all(|one| one.measured == "not measured"));
}

#[test]
fn run_starts_only_beside_a_measurement_that_bears_out_what_it_assumes() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("robot.toml");
    let mut config = Config::default();
    file::require(&config, &path).unwrap();
    config.run.commissioning = Commissioning::Measured;
    let why = refusal(&config, &path);
    assert!(why.contains("check --drive") && why.contains("commissioning.toml"), "{why}");
    let (measured, judgements) = driven(Robot::new());
    file::write(&config, &path, &measured, &assumed(), &judgements).unwrap();
    file::require(&config, &path).unwrap();

    let mut other = config.clone();
    other.devices.base.track_m *= 1.2;
    let why = refusal(&other, &path);
    assert!(why.contains("devices.base.track_m has changed"), "{why}");
    let mut hopeful = config.clone();
    hopeful.run.brake_mps2 = 5.0;
    let why = refusal(&hopeful, &path);
    assert!(why.contains("braking distance was measured as"), "{why}");
    assert!(why.contains("run.brake_mps2 = "), "{why}");
    hopeful.run.commissioning = Commissioning::ByHand;
    file::require(&hopeful, &path).unwrap();
    std::fs::write(folder.path().join("commissioning.toml"), "measured = 1").unwrap();
    let why = refusal(&config, &path);
    assert!(why.contains("commissioning.toml: "), "{why}");
}

fn refusal(config: &Config, path: &Path) -> String {
    file::require(config, path).unwrap_err().to_string()
}
