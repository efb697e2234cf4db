//! The course: forward, left, right, forward, and then no command any more. Everything is measured with the robot's own wheels and
//! scanner, and every command passes the safety plane.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use drivers::stop_line::StopLine;
use hal::{Base, Clock, LaserScan, Lidar, Pose2, Twist2, WheelFeedback, wrap_angle};
use runtime::event::FaultReason;
use runtime::safety::{Orders, Plan, Request, SafetyLoop, SafetyState, scanner_motion};
use serde::{Deserialize, Serialize};

use super::assumed::Assumed;
use crate::run::state_words::state_words;

/// Yaw rate of the rotations, rad/s, and their duration, seconds: 30 degrees.
const TURN_RADPS: f64 = 0.4;
const TURN_S: f64 = 1.3;
/// Durations of the two straight legs, seconds. At the highest speed of 0.2 m/s they are 0.24 m and 0.16 m long.
const FIRST_LEG_S: f64 = 1.2;
const SECOND_LEG_S: f64 = 0.8;
/// The wheels stand below this speed, m/s and rad/s, for this long, seconds: two revolutions of a slow scanner.
const STANDING_MPS: f64 = 0.01;
const STANDING_RADPS: f64 = 0.03;
const STANDS_S: f64 = 0.5;
/// Wheels that still roll after this time do not stop by themselves.
const ROLLING_S: f64 = 5.0;
/// Time until the devices work and the base is armed.
const ARMING_S: f64 = 15.0;
/// Time without commands, seconds: ten times the longest watchdog time.
const SILENT_S: f64 = 1.0;
/// Travel that counts as the first motion, metres: above the resolution of ordinary encoders.
const FIRST_MOTION_M: f64 = 0.002;
/// A stop is timed when the wheels have lost these shares of their speed.
const EARLY: f64 = 0.1;
const LATE: f64 = 0.5;
/// Farther from its start the robot must not get, metres.
const FARTHEST_M: f64 = 0.6;

/// Why the course was not completed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CourseError {
    /// The safety plane did not arm.
    #[error(
        "the robot could not be armed within 15 s ({why}): `firmware-host check --devices` shows what is missing"
    )]
    NotArmed { why: String },
    /// The safety plane stopped the robot.
    #[error("the safety plane stopped the robot ({why}) while it drove {leg}: {way_out}")]
    Stopped { why: String, leg: &'static str, way_out: &'static str },
    /// The wheels turn on.
    #[error("the wheels did not stand still within 5 s after {leg}: check brakes and encoders")]
    StillRolling { leg: &'static str },
    /// The odometry says that the robot is too far away.
    #[error(
        "the wheels report {gone_m:.2} m, more than this course has: check wheel_radius_m, gear_ratio and position units"
    )]
    TooFar { gone_m: f64 },
    /// A signal ended the measurement.
    #[error("interrupted: the robot was stopped, and nothing was written")]
    Interrupted,
}

/// A motion as wheels and scanner measured it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Motion {
    /// Of `base_link`, by the wheels.
    pub wheels: Pose2,
    /// Of the laser, by two scans; `None` if too little of the room was seen.
    pub laser: Option<Pose2>,
}

/// What was measured.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// Speed before the first stop, m/s.
    pub speed_mps: f64,
    /// From the first command to the first motion, seconds.
    pub start_s: f64,
    /// From the command to stop until the wheels began to lose speed, seconds.
    pub response_s: f64,
    /// From the command to stop to standstill, metres.
    pub braking_m: f64,
    /// Speed before the last command, m/s, and the distance from that command to standstill, metres.
    pub last_speed_mps: f64,
    pub roll_out_m: f64,
    pub ahead: Motion,
    pub left: Motion,
    pub right: Motion,
}

/// A stop, measured by the wheels.
struct Stop {
    speed_mps: f64,
    response_s: f64,
    distance_m: f64,
}

/// The robot on its course.
pub struct Course<B, L, C> {
    control: SafetyLoop<B, L>,
    clock: C,
    /// The emergency stop on an input line, if there is one.
    pub stop_line: Option<StopLine>,
    speed_mps: f64,
    t_base_laser: Pose2,
    period_ns: u64,
    due_ns: u64,
    scan: LaserScan,
    wheel: WheelFeedback,
    start: Option<Pose2>,
    ends: Arc<AtomicBool>,
    leg: &'static str,
}

impl<B: Base, L: Lidar, C: Clock> Course<B, L, C> {
    /// A course that has not begun.
    pub fn new(
        control: SafetyLoop<B, L>,
        clock: C,
        assumed: &Assumed,
        ends: Arc<AtomicBool>,
    ) -> Self {
        let scan = LaserScan::empty(control.lidar().geometry());
        let config = control.plane().config();
        Self {
            speed_mps: assumed.course_mps,
            t_base_laser: config.t_base_laser,
            period_ns: (config.period_s * 1e9) as u64,
            due_ns: clock.now_ns(),
            control,
            clock,
            stop_line: None,
            scan,
            wheel: WheelFeedback::default(),
            start: None,
            ends,
            leg: "nothing",
        }
    }

    /// Drives the whole course.
    ///
    /// # Errors
    /// The robot could not be armed, was stopped, or does not stop.
    pub fn drive(&mut self) -> Result<Measured, CourseError> {
        self.arm()?;
        let forward = Twist2 { linear_mps: self.speed_mps, angular_radps: 0.0 };
        let turn = Twist2 { linear_mps: 0.0, angular_radps: TURN_RADPS };
        let back = Twist2 { linear_mps: 0.0, angular_radps: -TURN_RADPS };
        let (ahead, (start_s, stop)) = self.observed("ahead", |course| {
            let start_s = course.go(forward, FIRST_LEG_S)?;
            Ok((start_s, course.stop()?))
        })?;
        let (left, _) = self.observed("to the left", |course| course.turn(turn))?;
        let (right, _) = self.observed("to the right", |course| course.turn(back))?;
        self.leg = "ahead without a stop";
        self.go(forward, SECOND_LEG_S)?;
        let (last_speed_mps, roll_out_m) = self.fall_silent()?;
        Ok(Measured {
            speed_mps: stop.speed_mps,
            start_s,
            response_s: stop.response_s,
            braking_m: stop.distance_m,
            last_speed_mps,
            roll_out_m,
            ahead,
            left,
            right,
        })
    }

    /// Brakes and releases the motors.
    pub fn finish(self) {
        let Self { control, mut clock, period_ns, stop_line: _stop_line, .. } = self;
        // Half a second of zeros before the power is removed, as at the end of a run.
        let mut control = control;
        let steps = (0.6e9 / period_ns as f64) as u64;
        for step in 0..steps {
            clock.sleep_until_ns(clock.now_ns() + period_ns);
            let request = (step == 0).then_some(Request::Disarm);
            control.step(clock.now_ns(), &Orders { request, ..Orders::default() });
        }
        let _ = control.shut_down();
    }

    /// Waits until the devices work, and arms the robot: the person who confirmed has asked for it.
    fn arm(&mut self) -> Result<(), CourseError> {
        let steps = (ARMING_S * 1e9 / self.period_ns as f64) as u64;
        let settled = (STANDS_S * 1e9 / self.period_ns as f64) as u64;
        for step in 0..steps {
            let request = match step {
                // Scanner and motors have answered by then, or are given the rest of the time.
                at if at == 2 * settled => Some(Request::ClearFault),
                at if at == 3 * settled => Some(Request::Arm),
                _ => None,
            };
            self.step(Twist2::ZERO, request)?;
            if !self.control.plane().state().is_in_charge() {
                return self.stand();
            }
        }
        Err(CourseError::NotArmed { why: words(self.control.plane().state()) })
    }

    /// One step of the safety loop.
    fn step(&mut self, twist: Twist2, request: Option<Request>) -> Result<(), CourseError> {
        self.due_ns = (self.due_ns + self.period_ns).max(self.clock.now_ns());
        self.clock.sleep_until_ns(self.due_ns);
        let now_ns = self.clock.now_ns();
        let emergency_stop = self.stop_line.as_ref().is_some_and(|line| line.is_pressed(now_ns));
        let plan = Some(Plan { twist, time_ns: now_ns });
        let orders = Orders { plan, request, emergency_stop, ..Orders::default() };
        let step = self.control.step(now_ns, &orders);
        if let Some(scan) = step.scan {
            self.scan.clone_from(scan);
        }
        self.wheel = step.wheel.unwrap_or(self.wheel);
        if self.ends.load(Ordering::Relaxed) {
            return Err(CourseError::Interrupted);
        }
        Ok(())
    }

    /// A step that must not be changed by the safety plane.
    fn follow(&mut self, twist: Twist2) -> Result<(), CourseError> {
        self.step(twist, None)?;
        let state = self.control.plane().state();
        if state != SafetyState::Clear {
            let why = words(state);
            return Err(CourseError::Stopped { why, leg: self.leg, way_out: way_out(state) });
        }
        let start = *self.start.get_or_insert(self.wheel.odom);
        let gone_m = start.distance_m(&self.wheel.odom);
        if gone_m > FARTHEST_M { Err(CourseError::TooFar { gone_m }) } else { Ok(()) }
    }

    /// Drives with a twist for some time; returns the time until the first motion, seconds.
    fn go(&mut self, twist: Twist2, seconds: f64) -> Result<f64, CourseError> {
        let from = self.wheel.odom;
        let began_ns = self.due_ns + self.period_ns;
        let mut moved_ns = None;
        while self.clock.now_ns() < began_ns + (seconds * 1e9) as u64 {
            self.follow(twist)?;
            if from.distance_m(&self.wheel.odom) > FIRST_MOTION_M {
                moved_ns.get_or_insert(self.wheel.time_ns);
            }
        }
        let moved_ns = moved_ns.unwrap_or(self.wheel.time_ns);
        Ok(moved_ns.saturating_sub(began_ns) as f64 * 1e-9)
    }

    fn turn(&mut self, twist: Twist2) -> Result<(), CourseError> {
        self.go(twist, TURN_S)?;
        self.stand()
    }

    /// Commands zero, and measures until the wheels stand still.
    fn stop(&mut self) -> Result<Stop, CourseError> {
        let speed_mps = self.wheel.twist.linear_mps;
        let commanded_ns = self.due_ns + self.period_ns;
        let from = self.where_at(commanded_ns);
        let mut early_s = None;
        let mut late_s = None;
        let mut still_ns = 0;
        let within_ns = commanded_ns + (ROLLING_S * 1e9) as u64;
        while still_ns < (STANDS_S * 1e9) as u64 {
            self.follow(Twist2::ZERO)?;
            let since_s = self.wheel.time_ns.saturating_sub(commanded_ns) as f64 * 1e-9;
            for (lost, at_s) in [(EARLY, &mut early_s), (LATE, &mut late_s)] {
                if self.wheel.twist.linear_mps < (1.0 - lost) * speed_mps {
                    at_s.get_or_insert(since_s);
                }
            }
            still_ns = if is_standing(&self.wheel) { still_ns + self.period_ns } else { 0 };
            if self.clock.now_ns() > within_ns {
                return Err(CourseError::StillRolling { leg: self.leg });
            }
        }
        let distance_m = from.distance_m(&self.wheel.odom);
        // The line through both points, back to the full speed.
        let early_s = early_s.unwrap_or(0.0);
        let late_s = late_s.unwrap_or(0.0);
        let response_s = (early_s - (late_s - early_s) * EARLY / (LATE - EARLY)).max(0.0);
        Ok(Stop { speed_mps, response_s, distance_m })
    }

    fn stand(&mut self) -> Result<(), CourseError> {
        self.stop().map(drop)
    }

    /// Sends nothing any more, as a program that died; returns the speed and the distance until the wheels stood still.
    fn fall_silent(&mut self) -> Result<(f64, f64), CourseError> {
        let speed_mps = self.wheel.twist.linear_mps;
        let from = self.where_at(self.due_ns);
        self.clock.sleep_until_ns(self.clock.now_ns() + (SILENT_S * 1e9) as u64);
        let within_ns = self.clock.now_ns() + (ROLLING_S * 1e9) as u64;
        let mut still_ns = 0;
        // The safety loop stands after such a pause. It only listens to the wheels.
        while still_ns < (STANDS_S * 1e9) as u64 {
            self.step(Twist2::ZERO, None)?;
            still_ns = if is_standing(&self.wheel) { still_ns + self.period_ns } else { 0 };
            if self.clock.now_ns() > within_ns {
                return Err(CourseError::StillRolling { leg: "the commands ended" });
            }
        }
        Ok((speed_mps, from.distance_m(&self.wheel.odom)))
    }

    /// The pose in `odom` at a time a little after the newest feedback.
    fn where_at(&self, time_ns: u64) -> Pose2 {
        let since_s = time_ns.saturating_sub(self.wheel.time_ns) as f64 * 1e-9;
        self.wheel.odom.compose(&self.wheel.twist.integrate(since_s))
    }

    /// A leg that begins and ends at standstill, with the motion that wheels and scanner saw.
    fn observed<T>(
        &mut self,
        leg: &'static str,
        drive: impl FnOnce(&mut Self) -> Result<T, CourseError>,
    ) -> Result<(Motion, T), CourseError> {
        self.leg = leg;
        let scan_before = self.scan.clone();
        let odom_before = self.wheel.odom;
        let result = drive(self)?;
        let wheels = odom_before.inverse().compose(&self.wheel.odom);
        let guess = self.t_base_laser.inverse().compose(&wheels).compose(&self.t_base_laser);
        let laser = scanner_motion(&scan_before, &self.scan, &guess);
        Ok((Motion { wheels, laser }, result))
    }
}

fn is_standing(wheel: &WheelFeedback) -> bool {
    wheel.twist.linear_mps.abs() < STANDING_MPS && wheel.twist.angular_radps.abs() < STANDING_RADPS
}

/// What to do about a stop on the course.
fn way_out(state: SafetyState) -> &'static str {
    if state == SafetyState::Fault(FaultReason::WheelsDisagree) {
        return "if the robot did not follow the commanded motion, check `swap_wheels`, `invert_left` and `invert_right`; if it did, \
                check that the LiDAR points ahead and is not upside down, then `wheel_radius_m`, `gear_ratio` and `track_m`";
    }
    "put it where 1 m ahead is free, and start again"
}

fn words(state: SafetyState) -> String {
    state_words(&state)
}

impl Motion {
    /// Yaw of the wheels' motion and of the scanner's, radians.
    pub fn yaws_rad(&self) -> (f64, Option<f64>) {
        (wrap_angle(self.wheels.yaw_rad), self.laser.map(|laser| wrap_angle(laser.yaw_rad)))
    }
}
