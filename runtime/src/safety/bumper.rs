//! Stop, back off by odometry, hand the blocked place to the planner; when that does not help, turn and leave.

use hal::{LaserScan, Pose2, Twist2, wrap_angle};
use serde::{Deserialize, Serialize};

use super::zone::{Obstacle, ScanHealth, StopZone};
use crate::event::{BackOffEnd, BumperEvent, TripCause};

/// Trips nearer to each other than this, in place and time, are one problem that backing off has not solved.
const SAME_PLACE_M: f64 = 0.5;
const SAME_PROBLEM_NS: u64 = 30_000_000_000;
/// Trips at one place after which the robot turns and leaves.
const TRIPS_BEFORE_ESCAPE: usize = 3;
/// Free way that makes a direction a way out, metres.
const WAY_OUT_M: f64 = 0.5;
/// Free way that must remain behind while backing off, metres.
const REAR_GAP_M: f64 = 0.03;
/// A touch has no position: the obstacle is taken to be just ahead of the footprint, metres.
const CONTACT_AHEAD_M: f64 = 0.03;

/// Sizes, speeds and time limits of the bumper.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BumperConfig {
    /// Radius of the round footprint, metres.
    pub footprint_radius_m: f64,
    /// Free way in front of the footprint below which the robot stops, metres (0.1 in the paper).
    pub stop_distance_m: f64,
    /// How far it backs off, metres by wheel odometry.
    pub back_off_m: f64,
    /// Backing-off and escaping speed, m/s.
    pub back_off_mps: f64,
    /// Turn rate while escaping, rad/s.
    pub escape_radps: f64,
    /// Backing off ends after this time, whatever the wheels say, seconds.
    pub back_off_timeout_s: f64,
    /// A scan older than this is no longer driven by, seconds.
    pub scan_timeout_s: f64,
    /// Where the laser sits in front of `base_link`'s origin, metres.
    pub laser_forward_m: f64,
    /// Time between two calls, seconds.
    pub period_s: f64,
}

impl Default for BumperConfig {
    fn default() -> Self {
        Self {
            footprint_radius_m: 0.16,
            stop_distance_m: 0.1,
            back_off_m: 0.2,
            back_off_mps: 0.3,
            escape_radps: 20f64.to_radians(),
            back_off_timeout_s: 5.0,
            scan_timeout_s: 0.2,
            laser_forward_m: 0.0,
            period_s: 0.1,
        }
    }
}

/// What the bumper is doing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum BumperState {
    /// Passing commands through.
    Clear,
    /// Driving back from an obstacle.
    BackingOff {
        /// Where it began, in `odom`.
        from: Pose2,
        /// When it began.
        since_ns: u64,
        /// The obstacle, in `odom`, metres.
        blocked_m: [f64; 2],
    },
    /// Turning on the spot to find a way out.
    Escaping {
        /// +1 turns left, -1 right.
        direction: f64,
        /// Turned so far, radians.
        turned_rad: f64,
        /// Heading at the last call.
        last_yaw_rad: f64,
    },
    /// Standing: no scan to drive by.
    Blind,
}

/// What the bumper knows at one call.
#[derive(Debug, Clone, Copy)]
pub struct BumperInput<'a> {
    /// Now, monotonic.
    pub time_ns: u64,
    /// `t_odom_base`.
    pub odom: Pose2,
    /// The base feels an obstacle.
    pub contact: bool,
    /// A new scan, if one came.
    pub scan: Option<&'a LaserScan>,
    /// What the policy wants.
    pub wanted: Twist2,
}

/// What the bumper lets through, and what it has to say.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BumperOutput {
    /// The command for the base.
    pub command: Twist2,
    /// A change of state.
    pub event: Option<BumperEvent>,
    /// A place that the planner should treat as blocked, in `odom`, metres: set once, when backing off has ended.
    pub blocked_m: Option<[f64; 2]>,
    /// True while the bumper drives by itself; the policy's wish has no effect.
    pub in_charge: bool,
}

/// The bumper's memory between calls.
#[derive(Debug, Clone)]
pub struct Bumper {
    config: BumperConfig,
    state: BumperState,
    scan_time_ns: Option<u64>,
    front: Option<Obstacle>,
    rear: Option<Obstacle>,
    way_out: bool,
    scan_bad: bool,
    /// Side with more room at the last scan: +1 left, -1 right.
    open_side: f64,
    trips: Vec<(u64, [f64; 2])>,
    trip_count: u64,
}

impl Bumper {
    /// A bumper that has seen nothing yet, and therefore lets nothing move forward or back.
    #[must_use]
    pub fn new(config: BumperConfig) -> Self {
        Self {
            config,
            state: BumperState::Blind,
            scan_time_ns: None,
            front: None,
            rear: None,
            way_out: false,
            scan_bad: false,
            open_side: 1.0,
            trips: Vec::with_capacity(TRIPS_BEFORE_ESCAPE + 1),
            trip_count: 0,
        }
    }

    /// What it is doing.
    #[must_use]
    pub fn state(&self) -> BumperState {
        self.state
    }

    /// Obstacles that it has stopped for since the start.
    #[must_use]
    pub fn trip_count(&self) -> u64 {
        self.trip_count
    }

    /// One turn of the loop.
    pub fn step(&mut self, input: &BumperInput<'_>) -> BumperOutput {
        if let Some(scan) = input.scan {
            self.read_scan(scan);
        }
        if let Some(cause) = self.blindness(input.time_ns) {
            return self.stand_blind(cause);
        }
        match self.state {
            BumperState::Blind => {
                self.state = BumperState::Clear;
                BumperOutput { event: Some(BumperEvent::Cleared), ..self.pass_or_trip(input) }
            }
            BumperState::Clear => self.pass_or_trip(input),
            BumperState::BackingOff { from, since_ns, blocked_m } => self.back_off(input, from, since_ns, blocked_m),
            BumperState::Escaping { direction, turned_rad, last_yaw_rad } => {
                self.escape(input, direction, turned_rad + wrap_angle(input.odom.yaw_rad - last_yaw_rad).abs())
            }
        }
    }

    fn read_scan(&mut self, scan: &LaserScan) {
        let zone = |distance_m| StopZone { radius_m: self.config.footprint_radius_m, distance_m };
        let forward = self.config.laser_forward_m;
        self.scan_time_ns = Some(scan.time_ns);
        self.scan_bad = ScanHealth::of(scan) == ScanHealth::Bad;
        self.front = zone(self.config.stop_distance_m).nearest(scan, forward, 1.0);
        self.rear = zone(REAR_GAP_M).nearest(scan, forward, -1.0);
        self.way_out = zone(WAY_OUT_M).nearest(scan, forward, 1.0).is_none();
        let room = |side: f64| -> f32 {
            scan.hits().filter(|(angle, _)| angle * side > 0.0).map(|(_, range)| range.min(2.0)).sum()
        };
        self.open_side = if room(1.0) >= room(-1.0) { 1.0 } else { -1.0 };
    }

    fn blindness(&self, time_ns: u64) -> Option<TripCause> {
        let timeout_ns = (self.config.scan_timeout_s * 1e9) as u64;
        match self.scan_time_ns {
            Some(scan_ns) if time_ns.saturating_sub(scan_ns) <= timeout_ns => {
                self.scan_bad.then_some(TripCause::BadScan)
            }
            _ => Some(TripCause::StaleScan),
        }
    }

    fn stand_blind(&mut self, by: TripCause) -> BumperOutput {
        let event = (self.state != BumperState::Blind).then_some(BumperEvent::Tripped { by, x_m: 0.0, y_m: 0.0 });
        self.state = BumperState::Blind;
        BumperOutput { command: Twist2::ZERO, event, blocked_m: None, in_charge: true }
    }

    fn pass_or_trip(&mut self, input: &BumperInput<'_>) -> BumperOutput {
        let pass = BumperOutput { command: input.wanted, event: None, blocked_m: None, in_charge: false };
        if input.wanted.linear_mps < 0.0 && self.rear.is_some() {
            return BumperOutput { command: Twist2 { linear_mps: 0.0, ..input.wanted }, ..pass };
        }
        if input.wanted.linear_mps <= 0.0 {
            return pass;
        }
        let touch_x_m = self.config.footprint_radius_m + CONTACT_AHEAD_M;
        let (by, x_m, y_m) = match self.front {
            Some(obstacle) if obstacle.too_near => (TripCause::LidarTooNear, obstacle.x_m, obstacle.y_m),
            Some(obstacle) => (TripCause::LidarHit, obstacle.x_m, obstacle.y_m),
            None if input.contact => (TripCause::Contact, touch_x_m, 0.0),
            None => return pass,
        };
        self.trip_count += 1;
        let (blocked_x_m, blocked_y_m) = input.odom.transform(x_m, y_m);
        let blocked_m = [blocked_x_m, blocked_y_m];
        self.remember_trip(input.time_ns, blocked_m);
        self.state = BumperState::BackingOff { from: input.odom, since_ns: input.time_ns, blocked_m };
        // One turn at a stand before driving back: the wheels have to stop first.
        let event = Some(BumperEvent::Tripped { by, x_m, y_m });
        BumperOutput { command: Twist2::ZERO, event, blocked_m: None, in_charge: true }
    }

    fn remember_trip(&mut self, time_ns: u64, at_m: [f64; 2]) {
        self.trips.retain(|(when_ns, place)| {
            let near = (place[0] - at_m[0]).hypot(place[1] - at_m[1]) < SAME_PLACE_M;
            near && time_ns.saturating_sub(*when_ns) < SAME_PROBLEM_NS
        });
        self.trips.push((time_ns, at_m));
    }

    fn back_off(&mut self, input: &BumperInput<'_>, from: Pose2, since_ns: u64, blocked_m: [f64; 2]) -> BumperOutput {
        let gone_m = input.odom.distance_m(&from);
        let left_m = self.config.back_off_m - gone_m;
        let late = input.time_ns.saturating_sub(since_ns) as f64 > self.config.back_off_timeout_s * 1e9;
        let end = if left_m < 1e-3 {
            BackOffEnd::Distance
        } else if self.rear.is_some() || (input.contact && gone_m > 0.0) {
            BackOffEnd::RearBlocked
        } else if late {
            BackOffEnd::Timeout
        } else {
            // The last step is as long as what is left, so that it ends at the distance and not a step behind it.
            let speed_mps = self.config.back_off_mps.min(left_m / self.config.period_s);
            let command = Twist2 { linear_mps: -speed_mps, angular_radps: 0.0 };
            return BumperOutput { command, event: None, blocked_m: None, in_charge: true };
        };
        let event = Some(BumperEvent::BackedOff { distance_m: gone_m, end });
        let wedged = end != BackOffEnd::Distance || self.trips.len() >= TRIPS_BEFORE_ESCAPE;
        self.state = if wedged {
            BumperState::Escaping { direction: self.open_side, turned_rad: 0.0, last_yaw_rad: input.odom.yaw_rad }
        } else {
            BumperState::Clear
        };
        BumperOutput { command: Twist2::ZERO, event, blocked_m: Some(blocked_m), in_charge: true }
    }

    fn escape(&mut self, input: &BumperInput<'_>, direction: f64, turned_rad: f64) -> BumperOutput {
        use std::f64::consts::{FRAC_PI_4, TAU};
        let just_begun = turned_rad == 0.0;
        // Once round without a way out: whatever is left to try, the planner knows better than another round.
        if (self.way_out && turned_rad > FRAC_PI_4) || turned_rad >= TAU {
            self.state = BumperState::Clear;
            self.trips.clear();
            let event = Some(BumperEvent::Cleared);
            return BumperOutput { command: Twist2::ZERO, event, blocked_m: None, in_charge: true };
        }
        self.state = BumperState::Escaping { direction, turned_rad, last_yaw_rad: input.odom.yaw_rad };
        let command = Twist2 { linear_mps: 0.0, angular_radps: direction * self.config.escape_radps };
        let event = just_begun.then_some(BumperEvent::Escaping);
        BumperOutput { command, event, blocked_m: None, in_charge: true }
    }
}

#[cfg(test)]
#[path = "bumper_tests.rs"]
mod tests;
