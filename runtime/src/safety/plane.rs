//! The state machine between every wish and the wheels.
//!
//! Pure: what it is told and its past decide, nothing else. It allocates nothing after the first scan.

use std::f64::consts::{FRAC_PI_4, TAU};

use hal::{LaserScan, Pose2, Twist2, WheelFeedback, wrap_angle};

use super::footprint::Footprint;
use super::rear::Rear;
use super::surroundings::{Obstacle, ScanHealth, Surroundings};
use super::{Request, SafetyConfig, SafetyInput, SafetyOutput, SafetyState};
use crate::event::{BackOffEnd, FaultReason, PlanRefusal, SafetyEvent, TripCause};

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
/// A slow-down below this speed is a stop: else the robot would creep towards the obstacle for ever, m/s.
const CREEP_MPS: f64 = 0.05;
/// Below these the wheels stand, m/s and rad/s.
const STANDING: (f64, f64) = (0.02, 0.05);
/// Waiting for the wheels to stand ends after this; backing off then begins while they roll on.
const STANDING_WITHIN_NS: u64 = 500_000_000;
/// Odometry that moves by more than this between two measurements has begun anew, metres.
const ODOMETRY_JUMP_M: f64 = 0.5;
/// A footprint with corners looks this far ahead in a turn on the spot, beyond the reaction time, seconds.
const TURN_AHEAD_S: f64 = 0.3;

/// The safety plane's memory between calls.
#[derive(Debug, Clone)]
pub struct SafetyPlane {
    config: SafetyConfig,
    footprint: Footprint,
    state: SafetyState,
    around: Surroundings,
    rear: Rear,
    /// When the newest scan was complete.
    scan_end_ns: Option<u64>,
    scan_bad: bool,
    good_scans: u32,
    wheel: Option<WheelFeedback>,
    odometry_broken: bool,
    last_call_ns: Option<u64>,
    refused: Option<PlanRefusal>,
    trips: Vec<(u64, [f64; 2])>,
    trip_count: u64,
}

impl SafetyPlane {
    /// Nothing seen yet, nothing allowed.
    #[must_use]
    pub fn new(config: SafetyConfig) -> Self {
        Self {
            footprint: Footprint::new(config.footprint_radius_m, &config.footprint_m),
            state: SafetyState::Disarmed,
            around: Surroundings::new(&config),
            rear: Rear::new(config.rear_memory_s),
            scan_end_ns: None,
            scan_bad: false,
            good_scans: 0,
            wheel: None,
            odometry_broken: false,
            last_call_ns: None,
            refused: None,
            trips: Vec::with_capacity(TRIPS_BEFORE_ESCAPE + 1),
            trip_count: 0,
            config,
        }
    }

    /// What it is doing.
    #[must_use]
    pub fn state(&self) -> SafetyState {
        self.state
    }

    /// Obstacles that it has stopped for since the start.
    #[must_use]
    pub fn trip_count(&self) -> u64 {
        self.trip_count
    }

    /// Sizes, speeds and limits.
    #[must_use]
    pub fn config(&self) -> &SafetyConfig {
        &self.config
    }

    /// One turn of the loop.
    pub fn step(&mut self, input: &SafetyInput<'_>) -> SafetyOutput {
        self.read_wheels(input);
        if let Some(scan) = input.scan {
            self.read_scan(scan);
        }
        let fault = self.fault(input);
        self.last_call_ns = Some(input.time_ns);
        if input.request == Some(Request::Disarm) && self.state != SafetyState::Disarmed {
            self.state = SafetyState::Disarmed;
            return SafetyOutput::STOP.because(SafetyEvent::Disarmed);
        }
        if let Some(why) = fault {
            return self.stand(why);
        }
        let Some(odom) = self.wheel.map(|wheel| wheel.odom) else { return SafetyOutput::STOP };
        match self.state {
            SafetyState::Disarmed => self.wait_for_arming(input),
            SafetyState::Fault(why) => self.leave_fault(why, input),
            SafetyState::Clear | SafetyState::Slow => self.pass_or_trip(input, &odom),
            SafetyState::Tripped { since_ns, blocked_m } => self.come_to_a_stand(input, &odom, since_ns, blocked_m),
            SafetyState::BackingOff { .. } => self.back_off(input, &odom),
            SafetyState::Escaping { direction, turned_rad, last_yaw_rad } => {
                self.escape(&odom, direction, turned_rad + wrap_angle(odom.yaw_rad - last_yaw_rad).abs())
            }
        }
    }

    fn read_wheels(&mut self, input: &SafetyInput<'_>) {
        let Some(wheel) = input.wheel else { return };
        self.odometry_broken = !(wheel.odom.is_finite() && wheel.twist.is_finite());
        if self.odometry_broken {
            return;
        }
        if self.wheel.is_some_and(|last| last.odom.distance_m(&wheel.odom) > ODOMETRY_JUMP_M) {
            self.rear.forget();
        }
        self.rear.stand(input.time_ns, &wheel.odom);
        self.wheel = Some(wheel);
    }

    fn read_scan(&mut self, scan: &LaserScan) {
        self.scan_end_ns = Some(scan.time_ns.saturating_add(scan.geometry.period_ns));
        self.scan_bad = ScanHealth::of(scan) == ScanHealth::Bad;
        if self.scan_bad {
            self.good_scans = 0;
            return;
        }
        self.good_scans = self.good_scans.saturating_add(1);
        self.around.see(scan);
        if let Some(wheel) = &self.wheel {
            self.rear.see(scan, &wheel.odom.compose(&Pose2::new(self.config.laser_forward_m, 0.0, 0.0)));
        }
    }

    /// What forbids every motion now, the gravest first.
    fn fault(&mut self, input: &SafetyInput<'_>) -> Option<FaultReason> {
        if input.emergency_stop {
            return Some(FaultReason::EmergencyStop);
        }
        if let Some(kind) = input.base_error {
            return Some(FaultReason::of_base(kind));
        }
        if self.odometry_broken {
            return Some(FaultReason::OdometryNotFinite);
        }
        let older = |time_ns: Option<u64>, limit_s: f64| {
            time_ns.is_none_or(|time_ns| input.time_ns.saturating_sub(time_ns) as f64 > limit_s * 1e9)
        };
        if older(self.wheel.map(|wheel| wheel.time_ns), self.config.feedback_timeout_s) {
            return Some(FaultReason::BaseSilent);
        }
        if older(self.scan_end_ns, self.config.scan_timeout_s) {
            self.good_scans = 0;
            return Some(FaultReason::LidarSilent);
        }
        if self.scan_bad {
            return Some(FaultReason::LidarBad);
        }
        if self.last_call_ns.is_some() && older(self.last_call_ns, 3.0 * self.config.period_s) {
            return Some(FaultReason::LoopOverrun);
        }
        None
    }

    fn stand(&mut self, why: FaultReason) -> SafetyOutput {
        let before = self.state;
        match before {
            // Who was not armed does not become armed by a fault that goes away.
            SafetyState::Disarmed => return SafetyOutput::STOP,
            // The reason that needs an operator is not forgotten for one that does not.
            SafetyState::Fault(known) if known == why || !known.clears_itself() => return SafetyOutput::STOP,
            _ => self.state = SafetyState::Fault(why),
        }
        SafetyOutput { blocked_m: blocked_by(&before), ..SafetyOutput::STOP }.because(SafetyEvent::Faulted { why })
    }

    fn wait_for_arming(&mut self, input: &SafetyInput<'_>) -> SafetyOutput {
        if input.request != Some(Request::Arm) || self.good_scans < self.config.good_scans {
            return SafetyOutput::STOP;
        }
        self.state = SafetyState::Clear;
        let odom = self.wheel.map_or(Pose2::IDENTITY, |wheel| wheel.odom);
        let output = self.pass_or_trip(input, &odom);
        if output.event.is_some() { output } else { output.because(SafetyEvent::Armed) }
    }

    fn leave_fault(&mut self, why: FaultReason, input: &SafetyInput<'_>) -> SafetyOutput {
        if why.clears_itself() && self.good_scans >= self.config.good_scans {
            self.state = SafetyState::Clear;
            let odom = self.wheel.map_or(Pose2::IDENTITY, |wheel| wheel.odom);
            let output = self.pass_or_trip(input, &odom);
            return if output.event.is_some() { output } else { output.because(SafetyEvent::Cleared) };
        }
        if input.request == Some(Request::ClearFault) && !why.clears_itself() {
            self.state = SafetyState::Disarmed;
            return SafetyOutput::STOP.because(SafetyEvent::Disarmed);
        }
        SafetyOutput::STOP
    }

    /// The plan's twist, or why it is not followed.
    fn wanted(&self, input: &SafetyInput<'_>) -> Result<Twist2, PlanRefusal> {
        let plan = input.plan.ok_or(PlanRefusal::None)?;
        if !plan.twist.is_finite() {
            return Err(PlanRefusal::NotFinite);
        }
        if input.time_ns.saturating_sub(plan.time_ns) as f64 > self.config.plan_timeout_s * 1e9 {
            return Err(PlanRefusal::Stale);
        }
        Ok(plan.twist)
    }

    fn pass_or_trip(&mut self, input: &SafetyInput<'_>, odom: &Pose2) -> SafetyOutput {
        let wanted = match self.wanted(input) {
            Ok(wanted) => wanted,
            Err(why) => {
                let news = self.refused.replace(why) != Some(why) && why != PlanRefusal::None;
                let halt = SafetyOutput { in_charge: false, ..SafetyOutput::drive(Twist2::ZERO) };
                return if news { halt.because(SafetyEvent::PlanRefused { why }) } else { halt };
            }
        };
        self.refused = None;
        let pass = SafetyOutput { in_charge: false, ..SafetyOutput::drive(wanted) };
        if wanted.linear_mps < 0.0 {
            let behind = self.around.first_met(&self.footprint, &wanted, REAR_GAP_M).is_some();
            return if behind {
                SafetyOutput { command: Some(Twist2 { linear_mps: 0.0, ..wanted }), ..pass }
            } else {
                pass
            };
        }
        if wanted.linear_mps == 0.0 {
            return if self.corner_would_meet(wanted.angular_radps) {
                SafetyOutput { command: Some(Twist2::ZERO), ..pass }
            } else {
                pass
            };
        }
        self.pass_forward(input, odom, wanted, pass)
    }

    fn pass_forward(
        &mut self,
        input: &SafetyInput<'_>,
        odom: &Pose2,
        wanted: Twist2,
        pass: SafetyOutput,
    ) -> SafetyOutput {
        let speed = wanted.linear_mps.max(self.wheel.map_or(0.0, |wheel| wheel.twist.linear_mps));
        let braking_m = speed * self.config.reaction_s + speed * speed / (2.0 * self.config.brake_mps2);
        let met = self.around.first_met(&self.footprint, &wanted, self.config.stop_distance_m + braking_m);
        let contact = self.wheel.is_some_and(|wheel| wheel.contact);
        let allowed_mps = met.map_or(f64::INFINITY, |(_, gap_m)| self.allowed_mps(gap_m));
        let tripped = allowed_mps < CREEP_MPS;
        if contact && !tripped {
            let ahead_m = self.footprint.straight_edge_m() + CONTACT_AHEAD_M;
            return self.trip(input, odom, TripCause::Contact, [ahead_m, 0.0]);
        }
        match met {
            Some((obstacle, _)) if tripped => self.trip(input, odom, cause_of(&obstacle), obstacle.point_m()),
            Some(_) if allowed_mps < wanted.linear_mps => self.slow(wanted, allowed_mps, pass),
            _ => {
                let was_slow = self.state == SafetyState::Slow;
                self.state = SafetyState::Clear;
                if was_slow { pass.because(SafetyEvent::Cleared) } else { pass }
            }
        }
    }

    /// The speed from which the robot still stops `stop_distance_m` before something that is `gap_m` ahead: the root of
    /// v^2 / 2b + v t = way, with brake b and reaction time t.
    fn allowed_mps(&self, gap_m: f64) -> f64 {
        let (brake, reaction) = (self.config.brake_mps2, self.config.reaction_s);
        let way_m = (gap_m - self.config.stop_distance_m).max(0.0);
        let lag = brake * reaction;
        (lag * lag + 2.0 * brake * way_m).sqrt() - lag
    }

    fn slow(&mut self, wanted: Twist2, allowed_mps: f64, pass: SafetyOutput) -> SafetyOutput {
        // Both by the same factor: the robot stays on the arc that it wanted.
        let factor = allowed_mps / wanted.linear_mps;
        let twist = Twist2 { linear_mps: allowed_mps, angular_radps: wanted.angular_radps * factor };
        let was_slow = self.state == SafetyState::Slow;
        self.state = SafetyState::Slow;
        let output = SafetyOutput { command: Some(twist), ..pass };
        if was_slow { output } else { output.because(SafetyEvent::Slowed { limit_mps: allowed_mps }) }
    }

    fn corner_would_meet(&self, angular_radps: f64) -> bool {
        let turn_rad = angular_radps * (self.config.reaction_s + TURN_AHEAD_S);
        self.around.obstacles().iter().any(|obstacle| self.footprint.meets_when_turned(obstacle.point_m(), turn_rad))
    }

    fn trip(&mut self, input: &SafetyInput<'_>, odom: &Pose2, by: TripCause, [x_m, y_m]: [f64; 2]) -> SafetyOutput {
        self.trip_count += 1;
        let (blocked_x_m, blocked_y_m) = odom.transform(x_m, y_m);
        let blocked_m = [blocked_x_m, blocked_y_m];
        self.trips.retain(|(when_ns, place)| {
            let near = (place[0] - blocked_m[0]).hypot(place[1] - blocked_m[1]) < SAME_PLACE_M;
            near && input.time_ns.saturating_sub(*when_ns) < SAME_PROBLEM_NS
        });
        if self.trips.len() < TRIPS_BEFORE_ESCAPE {
            self.trips.push((input.time_ns, blocked_m));
        }
        self.state = SafetyState::Tripped { since_ns: input.time_ns, blocked_m };
        SafetyOutput::STOP.because(SafetyEvent::Tripped { by, x_m, y_m })
    }

    fn come_to_a_stand(
        &mut self,
        input: &SafetyInput<'_>,
        odom: &Pose2,
        since_ns: u64,
        blocked_m: [f64; 2],
    ) -> SafetyOutput {
        let standing = self.wheel.is_some_and(|wheel| {
            wheel.twist.linear_mps.abs() < STANDING.0 && wheel.twist.angular_radps.abs() < STANDING.1
        });
        if !standing && input.time_ns.saturating_sub(since_ns) < STANDING_WITHIN_NS {
            return SafetyOutput::STOP;
        }
        let known_free_m = self.rear.known_free_m(input.time_ns, odom, &self.footprint, self.config.back_off_m);
        self.state = SafetyState::BackingOff { from: *odom, since_ns: input.time_ns, known_free_m, blocked_m };
        self.back_off(input, odom)
    }

    fn back_off(&mut self, input: &SafetyInput<'_>, odom: &Pose2) -> SafetyOutput {
        let SafetyState::BackingOff { from, since_ns, known_free_m, blocked_m } = self.state else {
            return SafetyOutput::STOP;
        };
        let gone_m = odom.distance_m(&from);
        let left_m = self.config.back_off_m - gone_m;
        let known_m = known_free_m + self.config.blind_back_off_m;
        let late = input.time_ns.saturating_sub(since_ns) as f64 > self.config.back_off_timeout_s * 1e9;
        let back = Twist2 { linear_mps: -self.config.back_off_mps, angular_radps: 0.0 };
        let touched = gone_m > 0.0 && self.wheel.is_some_and(|wheel| wheel.contact);
        let end = if left_m < 1e-3 {
            BackOffEnd::Distance
        } else if touched || self.around.first_met(&self.footprint, &back, REAR_GAP_M).is_some() {
            BackOffEnd::RearBlocked
        } else if known_m - gone_m < 1e-3 {
            BackOffEnd::RearUnknown
        } else if late {
            BackOffEnd::Timeout
        } else {
            // The last step is as long as what is left, so that it ends at the distance and not a step behind it.
            let step_m = left_m.min(known_m - gone_m);
            let braking_mps = (2.0 * self.config.brake_mps2 * step_m).sqrt();
            let speed_mps = self.config.back_off_mps.min(step_m / self.config.period_s).min(braking_mps);
            return SafetyOutput::drive(Twist2 { linear_mps: -speed_mps, angular_radps: 0.0 });
        };
        let wedged = end != BackOffEnd::Distance || self.trips.len() >= TRIPS_BEFORE_ESCAPE;
        self.state = if wedged {
            SafetyState::Escaping { direction: self.around.open_side(), turned_rad: 0.0, last_yaw_rad: odom.yaw_rad }
        } else {
            SafetyState::Clear
        };
        let event = SafetyEvent::BackedOff { distance_m: gone_m, end };
        SafetyOutput { blocked_m: Some(blocked_m), ..SafetyOutput::STOP }.because(event)
    }

    fn escape(&mut self, odom: &Pose2, direction: f64, turned_rad: f64) -> SafetyOutput {
        let ahead = Twist2 { linear_mps: self.config.back_off_mps, angular_radps: 0.0 };
        let way_out = self.around.first_met(&self.footprint, &ahead, WAY_OUT_M).is_none();
        let wanted_radps = direction * self.config.escape_radps;
        // Once round without a way out, or wedged by a corner: the planner knows better than another round.
        let over = turned_rad >= TAU || self.corner_would_meet(wanted_radps);
        if over || (way_out && turned_rad > FRAC_PI_4) {
            self.state = SafetyState::Clear;
            self.trips.clear();
            return SafetyOutput::STOP.because(SafetyEvent::Cleared);
        }
        self.state = SafetyState::Escaping { direction, turned_rad, last_yaw_rad: odom.yaw_rad };
        let output = SafetyOutput::drive(Twist2 { linear_mps: 0.0, angular_radps: wanted_radps });
        if turned_rad == 0.0 { output.because(SafetyEvent::Escaping) } else { output }
    }
}

fn cause_of(obstacle: &Obstacle) -> TripCause {
    if obstacle.too_near { TripCause::LidarTooNear } else { TripCause::LidarHit }
}

/// The obstacle that the robot was leaving when something else stopped it: the planner should know of it all the same.
fn blocked_by(state: &SafetyState) -> Option<[f64; 2]> {
    match state {
        SafetyState::Tripped { blocked_m, .. } | SafetyState::BackingOff { blocked_m, .. } => Some(*blocked_m),
        _ => None,
    }
}

#[cfg(test)]
#[path = "plane_tests.rs"]
mod tests;
