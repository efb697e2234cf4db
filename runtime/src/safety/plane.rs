//! The state machine between every wish and the wheels.
//!
//! Pure: what it is told and its past decide, nothing else. It allocates nothing after the first scan.

use std::f64::consts::{FRAC_PI_4, TAU};

use hal::{LaserScan, Pose2, Twist2, WheelFeedback, wrap_angle};

use super::footprint::Footprint;
use super::rear::Rear;
use super::surroundings::{HORIZON_M, Obstacle, ScanHealth, Surroundings};
use super::{BackOff, Escape, Request, SafetyConfig, SafetyInput, SafetyOutput, SafetyState};
use crate::event::{BackOffEnd, FaultReason, PlanRefusal, SafetyEvent, TripCause};
use crate::snapshot::remembers;

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
/// Odometry that moves by more than this between two measurements has begun anew, metres and radians.
const ODOMETRY_JUMP: (f64, f64) = (0.5, 1.0);
/// Escaping ends after so many times the time that one round takes: wheels that are stuck never turn it.
const ESCAPE_PATIENCE: f64 = 2.0;
/// A footprint with corners looks this far ahead in a turn on the spot, beyond the reaction time, seconds.
const TURN_AHEAD_S: f64 = 0.3;

/// The safety plane's memory between calls.
#[derive(Debug, Clone, PartialEq)]
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
    /// It has begun anew in this turn.
    odometry_jumped: bool,
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
            odometry_jumped: false,
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
        let in_time = self.keep_time(input.time_ns);
        self.read_wheels(input);
        if let Some(scan) = input.scan {
            self.read_scan(input.time_ns, scan);
        }
        let wheel = self.may_move(input, in_time);
        if matches!(wheel, Err(FaultReason::BaseSilent | FaultReason::BaseFault)) {
            // A base that was away may count from anywhere, and may have been pushed.
            self.rear.forget();
        }
        // A fault that needs an operator is not forgotten on the way through `Disarmed`.
        let stays = matches!(self.state, SafetyState::Fault(why) if !why.clears_itself());
        if input.request == Some(Request::Disarm) && self.state != SafetyState::Disarmed && !stays {
            self.state = SafetyState::Disarmed;
            return SafetyOutput::STOP.because(SafetyEvent::Disarmed);
        }
        let wheel = match wheel {
            Ok(wheel) => wheel,
            Err(why) => return self.stand(why),
        };
        match self.state {
            SafetyState::Disarmed => self.wait_for_arming(input, &wheel),
            SafetyState::Fault(why) => self.leave_fault(why, input, &wheel),
            SafetyState::Clear | SafetyState::Slow => self.pass_or_trip(input, &wheel),
            SafetyState::Tripped { since_ns, blocked_m } => {
                self.come_to_a_stand(input.time_ns, &wheel, since_ns, blocked_m)
            }
            SafetyState::BackingOff(back_off) => self.back_off(input.time_ns, &wheel, back_off),
            SafetyState::Escaping(escape) => self.escape(input.time_ns, &wheel.odom, escape),
        }
    }

    /// Whether this call comes in time. When time itself has gone back, nothing that is known is as young as it seems.
    fn keep_time(&mut self, now_ns: u64) -> bool {
        if self.last_call_ns.is_some_and(|last_ns| now_ns < last_ns) {
            (self.wheel, self.scan_end_ns) = (None, None);
            self.rear.forget();
            self.trips.clear();
        }
        if is_older(self.scan_end_ns, now_ns, self.config.scan_timeout_s) {
            self.good_scans = 0;
        }
        let last_ns = self.last_call_ns.replace(now_ns).unwrap_or(now_ns);
        last_ns <= now_ns && !is_older(Some(last_ns), now_ns, 3.0 * self.config.period_s)
    }

    /// Whether something claims to have been measured later than now, by more than two threads' clocks can differ.
    fn is_ahead(&self, time_ns: u64, now_ns: u64) -> bool {
        is_older(Some(now_ns), time_ns, self.config.period_s)
    }

    fn read_wheels(&mut self, input: &SafetyInput<'_>) {
        self.odometry_jumped = false;
        let Some(wheel) = input.wheel else { return };
        let overtaken = self.wheel.is_some_and(|last| wheel.time_ns < last.time_ns);
        if overtaken || self.is_ahead(wheel.time_ns, input.time_ns) {
            return;
        }
        self.odometry_broken = !(wheel.odom.is_finite() && wheel.twist.is_finite());
        if self.odometry_broken {
            return;
        }
        self.odometry_jumped = self.wheel.is_some_and(|last| {
            last.odom.distance_m(&wheel.odom) > ODOMETRY_JUMP.0
                || wrap_angle(last.odom.yaw_rad - wheel.odom.yaw_rad).abs() > ODOMETRY_JUMP.1
        });
        if self.odometry_jumped {
            self.rear.forget();
        }
        self.rear.stand(input.time_ns, &wheel.odom);
        self.wheel = Some(wheel);
    }

    fn read_scan(&mut self, now_ns: u64, scan: &LaserScan) {
        let end_ns = scan.time_ns.saturating_add(scan.geometry.period_ns);
        let known = self.scan_end_ns.is_some_and(|newest_ns| end_ns <= newest_ns);
        if known || self.is_ahead(scan.time_ns, now_ns) {
            return;
        }
        self.scan_end_ns = Some(end_ns);
        self.scan_bad = ScanHealth::of(scan) == ScanHealth::Bad;
        if self.scan_bad {
            self.good_scans = 0;
            return;
        }
        self.good_scans = self.good_scans.saturating_add(1);
        self.around.see(scan);
        if let Some(wheel) = &self.wheel {
            let t_odom_laser =
                wheel.odom.compose(&Pose2::new(self.config.laser_forward_m, 0.0, 0.0));
            self.rear.see(scan, &t_odom_laser, &self.around);
        }
    }

    /// What the wheels say, or what forbids every motion now, the gravest first.
    fn may_move(
        &self,
        input: &SafetyInput<'_>,
        in_time: bool,
    ) -> Result<WheelFeedback, FaultReason> {
        if input.emergency_stop {
            return Err(FaultReason::EmergencyStop);
        }
        if let Some(kind) = input.base_error {
            return Err(FaultReason::of_base(kind));
        }
        if self.odometry_broken {
            return Err(FaultReason::OdometryNotFinite);
        }
        let is_new = |wheel: &WheelFeedback| {
            !is_older(Some(wheel.time_ns), input.time_ns, self.config.feedback_timeout_s)
        };
        let wheel = self.wheel.filter(is_new).ok_or(FaultReason::BaseSilent)?;
        if is_older(self.scan_end_ns, input.time_ns, self.config.scan_timeout_s) {
            return Err(FaultReason::LidarSilent);
        }
        if self.scan_bad {
            return Err(FaultReason::LidarBad);
        }
        if in_time { Ok(wheel) } else { Err(FaultReason::LoopOverrun) }
    }

    fn stand(&mut self, why: FaultReason) -> SafetyOutput {
        let before = self.state;
        match before {
            // Who was not armed does not become armed by a fault that goes away. An emergency stop is kept all the same:
            // whoever asked for motion before it was pressed has to ask again.
            SafetyState::Disarmed if why != FaultReason::EmergencyStop => {
                return SafetyOutput::STOP;
            }
            // The reason that needs an operator is not forgotten for one that does not.
            SafetyState::Fault(known) if known == why || !known.clears_itself() => {
                return SafetyOutput::STOP;
            }
            _ => self.state = SafetyState::Fault(why),
        }
        SafetyOutput { blocked_m: blocked_by(&before), ..SafetyOutput::STOP }
            .because(SafetyEvent::Faulted { why })
    }

    fn wait_for_arming(&mut self, input: &SafetyInput<'_>, wheel: &WheelFeedback) -> SafetyOutput {
        if input.request != Some(Request::Arm) || self.good_scans < self.config.good_scans {
            return SafetyOutput::STOP;
        }
        self.state = SafetyState::Clear;
        let output = self.pass_or_trip(input, wheel);
        if output.event.is_some() { output } else { output.because(SafetyEvent::Armed) }
    }

    fn leave_fault(
        &mut self,
        why: FaultReason,
        input: &SafetyInput<'_>,
        wheel: &WheelFeedback,
    ) -> SafetyOutput {
        if why.clears_itself() && self.good_scans >= self.config.good_scans {
            self.state = SafetyState::Clear;
            let output = self.pass_or_trip(input, wheel);
            return if output.event.is_some() {
                output
            } else {
                output.because(SafetyEvent::Cleared)
            };
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
        let old = is_older(Some(plan.time_ns), input.time_ns, self.config.plan_timeout_s);
        if old || self.is_ahead(plan.time_ns, input.time_ns) {
            return Err(PlanRefusal::Stale);
        }
        Ok(plan.twist)
    }

    fn pass_or_trip(&mut self, input: &SafetyInput<'_>, wheel: &WheelFeedback) -> SafetyOutput {
        let wanted = match self.wanted(input) {
            Ok(wanted) => wanted,
            Err(why) => {
                let news = self.refused.replace(why) != Some(why) && why != PlanRefusal::None;
                let halt = SafetyOutput::pass(Twist2::ZERO);
                return if news { halt.because(SafetyEvent::PlanRefused { why }) } else { halt };
            }
        };
        self.refused = None;
        if wanted.linear_mps > 0.0 {
            return self.pass_forward(input.time_ns, wheel, wanted);
        }
        if wanted.linear_mps < 0.0 && self.is_free_behind(input.time_ns, &wheel.odom, &wanted) {
            return SafetyOutput::pass(wanted);
        }
        let turn = Twist2 { linear_mps: 0.0, ..wanted };
        SafetyOutput::pass(if self.corner_would_meet(turn.angular_radps) {
            Twist2::ZERO
        } else {
            turn
        })
    }

    /// Whether the robot may drive back by `twist` until the next call: it can then still stop on ground that is known.
    fn is_free_behind(&self, time_ns: u64, odom: &Pose2, twist: &Twist2) -> bool {
        let speed = -twist.linear_mps;
        let way_m = self.stopping_m(speed) + speed * self.config.period_s;
        way_m < f64::from(HORIZON_M)
            && self.around.first_met(&self.footprint, twist, REAR_GAP_M + way_m).is_none()
            && self.rear.known_free_m(time_ns, odom, &self.footprint, way_m) >= way_m
    }

    fn pass_forward(
        &mut self,
        time_ns: u64,
        wheel: &WheelFeedback,
        wanted: Twist2,
    ) -> SafetyOutput {
        let speed = wanted.linear_mps.max(wheel.twist.linear_mps);
        let reach_m = self.config.stop_distance_m + self.stopping_m(speed);
        let met = self.around.first_met(&self.footprint, &wanted, reach_m);
        // Whatever stands beyond the horizon is as near as the horizon.
        let sight_m = self.around.sight_m(&self.footprint);
        let allowed_mps = self.allowed_mps(met.map_or(sight_m, |(_, gap_m)| gap_m.min(sight_m)));
        match met {
            Some((obstacle, _)) if allowed_mps < CREEP_MPS => {
                self.trip(time_ns, &wheel.odom, cause_of(&obstacle), obstacle.point_m())
            }
            _ if wheel.contact => {
                let ahead_m = self.footprint.straight_edge_m() + CONTACT_AHEAD_M;
                self.trip(time_ns, &wheel.odom, TripCause::Contact, [ahead_m, 0.0])
            }
            _ if allowed_mps < wanted.linear_mps => self.slow(wanted, allowed_mps),
            _ => {
                let was_slow = self.state == SafetyState::Slow;
                self.state = SafetyState::Clear;
                let pass = SafetyOutput::pass(wanted);
                if was_slow { pass.because(SafetyEvent::Cleared) } else { pass }
            }
        }
    }

    /// The way from the wish to stop until the robot stands, metres.
    fn stopping_m(&self, speed_mps: f64) -> f64 {
        speed_mps * self.config.reaction_s + speed_mps * speed_mps / (2.0 * self.config.brake_mps2)
    }

    /// The speed from which the robot still stops `stop_distance_m` before something that is `gap_m` ahead: the root of
    /// v^2 / 2b + v t = way, with brake b and reaction time t.
    fn allowed_mps(&self, gap_m: f64) -> f64 {
        let (brake, reaction) = (self.config.brake_mps2, self.config.reaction_s);
        let way_m = (gap_m - self.config.stop_distance_m).max(0.0);
        let lag = brake * reaction;
        (lag * lag + 2.0 * brake * way_m).sqrt() - lag
    }

    fn slow(&mut self, wanted: Twist2, allowed_mps: f64) -> SafetyOutput {
        // Both by the same factor: the robot stays on the arc that it wanted.
        let factor = allowed_mps / wanted.linear_mps;
        let twist =
            Twist2 { linear_mps: allowed_mps, angular_radps: wanted.angular_radps * factor };
        let was_slow = self.state == SafetyState::Slow;
        self.state = SafetyState::Slow;
        let output = SafetyOutput::pass(twist);
        if was_slow {
            output
        } else {
            output.because(SafetyEvent::Slowed { limit_mps: allowed_mps })
        }
    }

    fn corner_would_meet(&self, angular_radps: f64) -> bool {
        let turn_rad = (angular_radps * (self.config.reaction_s + TURN_AHEAD_S)).clamp(-TAU, TAU);
        self.around
            .obstacles()
            .iter()
            .any(|obstacle| self.footprint.meets_when_turned(obstacle.point_m(), turn_rad))
    }

    fn trip(
        &mut self,
        time_ns: u64,
        odom: &Pose2,
        by: TripCause,
        [x_m, y_m]: [f64; 2],
    ) -> SafetyOutput {
        self.trip_count += 1;
        let (blocked_x_m, blocked_y_m) = odom.transform(x_m, y_m);
        let blocked_m = [blocked_x_m, blocked_y_m];
        self.trips.retain(|(when_ns, place)| {
            let near = (place[0] - blocked_m[0]).hypot(place[1] - blocked_m[1]) < SAME_PLACE_M;
            near && time_ns.saturating_sub(*when_ns) < SAME_PROBLEM_NS
        });
        if self.trips.len() < TRIPS_BEFORE_ESCAPE {
            self.trips.push((time_ns, blocked_m));
        }
        self.state = SafetyState::Tripped { since_ns: time_ns, blocked_m };
        SafetyOutput::STOP.because(SafetyEvent::Tripped { by, x_m, y_m })
    }

    fn come_to_a_stand(
        &mut self,
        time_ns: u64,
        wheel: &WheelFeedback,
        since_ns: u64,
        blocked_m: [f64; 2],
    ) -> SafetyOutput {
        let standing = wheel.twist.linear_mps.abs() < STANDING.0
            && wheel.twist.angular_radps.abs() < STANDING.1;
        if !standing && time_ns.saturating_sub(since_ns) < STANDING_WITHIN_NS {
            return SafetyOutput::STOP;
        }
        let (from, touching) = (wheel.odom, wheel.contact);
        let known_free_m =
            self.rear.known_free_m(time_ns, &from, &self.footprint, self.config.back_off_m);
        self.back_off(
            time_ns,
            wheel,
            BackOff { from, since_ns: time_ns, known_free_m, touching, blocked_m },
        )
    }

    fn back_off(&mut self, time_ns: u64, wheel: &WheelFeedback, back_off: BackOff) -> SafetyOutput {
        let gone_m = wheel.odom.distance_m(&back_off.from);
        let left_m = self.config.back_off_m - gone_m;
        let known_m = back_off.known_free_m + self.config.blind_back_off_m;
        let late = is_older(Some(back_off.since_ns), time_ns, self.config.back_off_timeout_s);
        let back = Twist2 { linear_mps: -self.config.back_off_mps, angular_radps: 0.0 };
        let rear_m = REAR_GAP_M + self.stopping_m(wheel.twist.linear_mps.min(0.0).abs());
        // A bumper ahead stays pressed for a moment; whatever is felt after it was let go, or so far away from it, is behind.
        let touching = back_off.touching && wheel.contact && gone_m < CONTACT_AHEAD_M;
        let touched = wheel.contact && !touching;
        let end = if self.odometry_jumped {
            BackOffEnd::RearUnknown
        } else if left_m < 1e-3 {
            BackOffEnd::Distance
        } else if touched || self.around.first_met(&self.footprint, &back, rear_m).is_some() {
            BackOffEnd::RearBlocked
        } else if known_m - gone_m < 1e-3 {
            BackOffEnd::RearUnknown
        } else if late {
            BackOffEnd::Timeout
        } else {
            // The last step is as long as what is left, so that it ends at the distance and not a step behind it.
            let step_m = left_m.min(known_m - gone_m);
            let braking_mps = (2.0 * self.config.brake_mps2 * step_m).sqrt();
            let speed_mps =
                self.config.back_off_mps.min(step_m / self.config.period_s).min(braking_mps);
            self.state = SafetyState::BackingOff(BackOff { touching, ..back_off });
            return SafetyOutput::drive(Twist2 { linear_mps: -speed_mps, angular_radps: 0.0 });
        };
        let wedged = end != BackOffEnd::Distance || self.trips.len() >= TRIPS_BEFORE_ESCAPE;
        self.state = if wedged {
            let (direction, last_yaw_rad) = (self.around.open_side(), wheel.odom.yaw_rad);
            SafetyState::Escaping(Escape {
                since_ns: None,
                direction,
                turned_rad: 0.0,
                last_yaw_rad,
            })
        } else {
            SafetyState::Clear
        };
        let event = SafetyEvent::BackedOff { distance_m: gone_m, end };
        SafetyOutput { blocked_m: Some(back_off.blocked_m), ..SafetyOutput::STOP }.because(event)
    }

    fn escape(&mut self, time_ns: u64, odom: &Pose2, escape: Escape) -> SafetyOutput {
        let turned_rad = escape.turned_rad + wrap_angle(odom.yaw_rad - escape.last_yaw_rad).abs();
        let ahead = Twist2 { linear_mps: self.config.back_off_mps, angular_radps: 0.0 };
        let way_out = self.around.first_met(&self.footprint, &ahead, WAY_OUT_M).is_none();
        let wanted_radps = escape.direction * self.config.escape_radps;
        let since_ns = escape.since_ns.unwrap_or(time_ns);
        let late =
            is_older(Some(since_ns), time_ns, ESCAPE_PATIENCE * TAU / self.config.escape_radps);
        // Once round without a way out, or wedged: the planner knows better than another round.
        let over = turned_rad >= TAU || late || self.corner_would_meet(wanted_radps);
        if over || (way_out && turned_rad > FRAC_PI_4) {
            self.state = SafetyState::Clear;
            self.trips.clear();
            return SafetyOutput::STOP.because(SafetyEvent::Cleared);
        }
        let (since_ns, last_yaw_rad) = (Some(since_ns), odom.yaw_rad);
        self.state = SafetyState::Escaping(Escape { since_ns, turned_rad, last_yaw_rad, ..escape });
        let output = SafetyOutput::drive(Twist2 { linear_mps: 0.0, angular_radps: wanted_radps });
        if escape.since_ns.is_none() { output.because(SafetyEvent::Escaping) } else { output }
    }
}

/// Whether something is older than allowed; what never was, is.
fn is_older(time_ns: Option<u64>, now_ns: u64, limit_s: f64) -> bool {
    time_ns.is_none_or(|time_ns| now_ns.saturating_sub(time_ns) as f64 > limit_s * 1e9)
}

fn cause_of(obstacle: &Obstacle) -> TripCause {
    if obstacle.too_near { TripCause::LidarTooNear } else { TripCause::LidarHit }
}

/// The obstacle that the robot was leaving when something else stopped it: the planner should know of it all the same.
fn blocked_by(state: &SafetyState) -> Option<[f64; 2]> {
    match state {
        SafetyState::Tripped { blocked_m, .. }
        | SafetyState::BackingOff(BackOff { blocked_m, .. }) => Some(*blocked_m),
        _ => None,
    }
}

remembers!(
    SafetyPlane: state, around, rear, scan_end_ns, scan_bad, good_scans, wheel, odometry_broken, odometry_jumped, last_call_ns, refused,
    trips, trip_count
);

#[cfg(test)]
#[path = "plane_tests.rs"]
mod tests;

#[cfg(test)]
#[path = "doubt_tests.rs"]
mod doubt_tests;

#[cfg(test)]
#[path = "reach_tests.rs"]
mod reach_tests;
