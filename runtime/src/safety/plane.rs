//! The state machine that every velocity command passes before it reaches the wheels.
//!
//! Its output depends only on its inputs and its own state: it reads no clock and no device. It
//! allocates no memory after the first scan. `safety/mod.rs` lists the states and the transitions
//! between them.

use std::f64::consts::{FRAC_PI_4, TAU};

use hal::{LaserScan, Pose2, Range, Twist2, WheelFeedback, wrap_angle};

use super::footprint::Footprint;
use super::rear::RearMemory;
use super::restart::{CREEP_MPS, CREEP_NS, CREEP_RADPS};
use super::surroundings::{HORIZON_M, Obstacle, ScanHealth, Surroundings};
use super::witness::{WheelError, Witness};
use super::{BackOff, Escape, Request, SafetyConfig, SafetyInput, SafetyOutput, SafetyState};
use crate::event::{BackOffEnd, FaultReason, PlanRefusal, SafetyEvent, TripCause};
use crate::snapshot::remembers;

/// Trips closer to each other than this distance and this time count as repeated trips at one
/// place: backing off has not solved the problem.
const SAME_PLACE_M: f64 = 0.5;
const TRIP_MEMORY_NS: u64 = 30_000_000_000;
/// After this many trips at one place the robot escapes: it rotates on the spot and leaves in
/// another direction.
const TRIPS_BEFORE_ESCAPE: usize = 3;
/// An escape may end in a direction with at least this much free distance ahead, metres.
const EXIT_CLEARANCE_M: f64 = 0.5;
/// Free distance that must remain behind the footprint while backing off, metres.
const REAR_GAP_M: f64 = 0.03;
/// Bumper and cliff sensors report no position: the obstacle is assumed this far ahead of the footprint, metres.
const CONTACT_AHEAD_M: f64 = 0.03;
/// A speed limit below this trips the safety plane; otherwise the robot would creep towards the
/// obstacle forever. m/s.
const TRIP_BELOW_MPS: f64 = 0.05;
/// Below both of these speeds the wheels count as standing still.
const STANDSTILL_MPS: f64 = 0.02;
const STANDSTILL_RADPS: f64 = 0.05;
/// The wait for the wheels to stand still ends after this time; backing off then begins while they
/// are still rolling.
const STANDSTILL_TIMEOUT_NS: u64 = 500_000_000;
/// Odometry that changes by more than either of these between two measurements was reset by the
/// base.
const ODOMETRY_JUMP_M: f64 = 0.5;
const ODOMETRY_JUMP_RAD: f64 = 1.0;
/// An escape times out after the time that this many full rotations take, because stuck wheels
/// never complete one.
const ESCAPE_TIMEOUT_ROTATIONS: f64 = 2.0;
/// A step that comes later than this after the previous one was not a late step: the program was
/// stopped, or the computer suspended.
const STALL_S: f64 = 0.5;
/// This many contacts within [`TRIP_MEMORY_NS`] and [`SAME_PLACE_M`] are given up: a hand in a wheel
/// must not be pushed again and again.
const CONTACTS_BEFORE_GIVING_UP: usize = 3;
/// Speed beside an obstacle within the lateral margin, m/s: a touch at this speed moves a chair, but
/// breaks nothing.
const BESIDE_MPS: f64 = 0.1;
/// Speed while the scanner does not see the path ahead, m/s, and the time after which the robot
/// stands: by then it has covered less than half of the paper's stop distance of 0.1 m.
const BLIND_MPS: f64 = 0.15;
const BLIND_NS: u64 = 300_000_000;
/// A plan that leads ahead although the scanner does not see the path is answered again after this
/// time with the place that is blocked: a planner that has only turned a little needs to know that
/// this was not enough.
const STILL_BLIND_NS: u64 = 1_000_000_000;
/// A scanner that repeats a scan while the wheels move by either of these is frozen.
const FROZEN_M: f64 = 0.05;
const FROZEN_RAD: f64 = 0.1;
/// A footprint with corners checks a rotation on the spot this far ahead, in addition to the
/// reaction time, seconds.
const ROTATION_LOOKAHEAD_S: f64 = 0.3;

/// The safety plane: call [`step`](Self::step) once per control period with the newest inputs and
/// send its output to the base.
#[derive(Debug, Clone, PartialEq)]
pub struct SafetyPlane {
    config: SafetyConfig,
    footprint: Footprint,
    /// The footprint with the lateral margin.
    wide: Footprint,
    state: SafetyState,
    surroundings: Surroundings,
    rear: RearMemory,
    /// End time of the newest scan: start of the scan plus the scan period.
    scan_end_ns: Option<u64>,
    scan_bad: bool,
    good_scans: u32,
    wheel: Option<WheelFeedback>,
    odometry_broken: bool,
    /// The odometry was reset between the previous measurement and the one of this tick.
    odometry_jumped: bool,
    last_call_ns: Option<u64>,
    refused: Option<PlanRefusal>,
    /// Time and place (in `odom`, metres) of recent trips at one place.
    trips: Vec<(u64, [f64; 2])>,
    trip_count: u64,
    /// Time and place of the robot (in `odom`, metres) at recent contacts at one place.
    contacts: Vec<(u64, [f64; 2])>,
    /// End of the slow restart after a stop that ended without a person.
    creep_until_ns: u64,
    /// Time since which the scanner has not seen the path ahead, or of the last report of it, and whether
    /// there was one.
    blind_since_ns: Option<u64>,
    view_lost: bool,
    /// Digest of the newest scan, and `t_odom_base` when it was first received.
    scan_digest: u64,
    digest_odom: Pose2,
    scan_frozen: bool,
    witness: Witness,
    wheels_disagree: bool,
}

/// Whether the loop called in time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Timing {
    InTime,
    /// Late by more than two periods, or the time went backwards.
    Late,
    /// Late by more than [`STALL_S`].
    Stalled,
}

impl SafetyPlane {
    /// A disarmed safety plane that has received no scan yet.
    #[must_use]
    pub fn new(config: SafetyConfig) -> Self {
        Self {
            wide: Footprint::new(config.footprint_radius_m, &config.footprint_m)
                .widened(config.lateral_margin_m),
            footprint: Footprint::new(config.footprint_radius_m, &config.footprint_m),
            state: SafetyState::Disarmed,
            surroundings: Surroundings::new(&config),
            rear: RearMemory::new(config.rear_memory_s),
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
            contacts: Vec::with_capacity(CONTACTS_BEFORE_GIVING_UP),
            creep_until_ns: 0,
            blind_since_ns: None,
            view_lost: false,
            scan_digest: 0,
            digest_odom: Pose2::IDENTITY,
            scan_frozen: false,
            witness: Witness::new(config.t_base_laser),
            wheels_disagree: false,
            config,
        }
    }

    #[must_use]
    pub fn state(&self) -> SafetyState {
        self.state
    }

    /// Number of trips (stops for an obstacle) since the start.
    #[must_use]
    pub fn trip_count(&self) -> u64 {
        self.trip_count
    }

    /// How far wheels and scanner disagree.
    #[must_use]
    pub fn wheel_error(&self) -> WheelError {
        self.witness.error()
    }

    #[must_use]
    pub fn config(&self) -> &SafetyConfig {
        &self.config
    }

    /// One control tick: takes in the new measurements and returns the command for the base.
    pub fn step(&mut self, input: &SafetyInput<'_>) -> SafetyOutput {
        let timing = self.check_timing(input.time_ns, input.suspended);
        self.update_wheels(input);
        if let Some(scan) = input.scan {
            self.update_scan(input.time_ns, scan);
        }
        let wheel = self.check_inputs(input, timing);
        SafetyOutput { forbidden: wheel.err(), ..self.step_state(input, wheel) }
    }

    /// The part of a tick that depends on the state. `wheel` is the newest feedback, or the reason
    /// why no motion is allowed.
    fn step_state(
        &mut self,
        input: &SafetyInput<'_>,
        wheel: Result<WheelFeedback, FaultReason>,
    ) -> SafetyOutput {
        if matches!(wheel, Err(FaultReason::BaseSilent | FaultReason::BaseFault)) {
            // A base that was disconnected may restart its odometry anywhere, and a person may have
            // pushed the robot.
            self.rear.forget();
        }
        // Disarming must not clear a fault that needs a person.
        let stays = matches!(self.state, SafetyState::Fault(why) if why.needs_person());
        if input.request == Some(Request::Disarm) && self.state != SafetyState::Disarmed && !stays {
            self.state = SafetyState::Disarmed;
            return SafetyOutput::STOP.because(SafetyEvent::Disarmed);
        }
        let wheel = match wheel {
            Ok(wheel) => wheel,
            Err(why) => return self.enter_fault(why),
        };
        match self.state {
            SafetyState::Disarmed => self.step_disarmed(input, &wheel),
            SafetyState::Fault(why) => self.step_fault(why, input, &wheel),
            SafetyState::Clear | SafetyState::Slow => self.step_driving(input, &wheel),
            SafetyState::Tripped { since_ns, blocked_m } => {
                self.step_tripped(input.time_ns, &wheel, since_ns, blocked_m)
            }
            SafetyState::BackingOff(back_off) => {
                self.step_backing_off(input.time_ns, &wheel, back_off)
            }
            SafetyState::Escaping(escape) => self.step_escaping(input.time_ns, &wheel, escape),
        }
    }

    /// Whether this call is on time. When the time went backwards, the ages of all stored
    /// measurements are wrong, so they are discarded.
    fn check_timing(&mut self, now_ns: u64, suspended: bool) -> Timing {
        if self.last_call_ns.is_some_and(|last_ns| now_ns < last_ns) {
            self.wheel = None;
            self.scan_end_ns = None;
            self.rear.forget();
            self.trips.clear();
            self.contacts.clear();
            self.creep_until_ns = 0;
        }
        if is_older(self.scan_end_ns, now_ns, self.config.scan_timeout_s) {
            self.good_scans = 0;
        }
        let last_ns = self.last_call_ns.replace(now_ns).unwrap_or(now_ns);
        let late_s = 3.0 * self.config.period_s;
        if suspended || is_older(Some(last_ns), now_ns, late_s.max(STALL_S)) {
            Timing::Stalled
        } else if last_ns > now_ns || is_older(Some(last_ns), now_ns, late_s) {
            Timing::Late
        } else {
            Timing::InTime
        }
    }

    /// Whether a measurement claims to be newer than now by more than one period. Within one
    /// period, a measurement may arrive from another thread that read the clock later.
    fn is_in_future(&self, time_ns: u64, now_ns: u64) -> bool {
        is_older(Some(now_ns), time_ns, self.config.period_s)
    }

    fn update_wheels(&mut self, input: &SafetyInput<'_>) {
        self.odometry_jumped = false;
        let Some(wheel) = input.wheel else { return };
        let overtaken = self.wheel.is_some_and(|last| wheel.time_ns < last.time_ns);
        if overtaken || self.is_in_future(wheel.time_ns, input.time_ns) {
            return;
        }
        self.odometry_broken = !(wheel.odom.is_finite() && wheel.twist.is_finite());
        if self.odometry_broken {
            return;
        }
        self.odometry_jumped = self.wheel.is_some_and(|last| {
            last.odom.distance_m(&wheel.odom) > ODOMETRY_JUMP_M
                || wrap_angle(last.odom.yaw_rad - wheel.odom.yaw_rad).abs() > ODOMETRY_JUMP_RAD
        });
        if self.odometry_jumped {
            self.rear.forget();
            self.witness.forget();
            self.digest_odom = wheel.odom;
        }
        self.rear.record_pose(input.time_ns, &wheel.odom);
        self.wheel = Some(wheel);
    }

    fn update_scan(&mut self, now_ns: u64, scan: &LaserScan) {
        let end_ns = scan.time_ns.saturating_add(scan.geometry.period_ns);
        let known = self.scan_end_ns.is_some_and(|newest_ns| end_ns <= newest_ns);
        if known || self.is_in_future(scan.time_ns, now_ns) {
            return;
        }
        self.scan_end_ns = Some(end_ns);
        self.scan_bad = ScanHealth::of(scan) == ScanHealth::Bad;
        if self.scan_bad {
            self.good_scans = 0;
            return;
        }
        self.check_frozen(scan);
        self.good_scans = if self.scan_frozen { 0 } else { self.good_scans.saturating_add(1) };
        self.surroundings.update(scan);
        if let Some(wheel) = &self.wheel {
            self.wheels_disagree |= self.witness.observe(scan, &wheel.odom);
            let t_odom_laser = wheel.odom.compose(&self.config.t_base_laser);
            self.rear.record_scan(scan, &t_odom_laser, &self.surroundings);
        }
    }

    /// Noise makes every scan of a working scanner different, even while the robot stands.
    fn check_frozen(&mut self, scan: &LaserScan) {
        let odom = self.wheel.map_or(self.digest_odom, |wheel| wheel.odom);
        let digest = digest_of(scan);
        if digest != self.scan_digest {
            self.scan_digest = digest;
            self.digest_odom = odom;
            self.scan_frozen = false;
        }
        let turned_rad = wrap_angle(odom.yaw_rad - self.digest_odom.yaw_rad).abs();
        self.scan_frozen |=
            odom.distance_m(&self.digest_odom) > FROZEN_M || turned_rad > FROZEN_RAD;
    }

    /// The newest wheel feedback, or the most serious reason why no motion is allowed now.
    fn check_inputs(
        &self,
        input: &SafetyInput<'_>,
        timing: Timing,
    ) -> Result<WheelFeedback, FaultReason> {
        if input.emergency_stop {
            return Err(FaultReason::EmergencyStop);
        }
        if timing == Timing::Stalled {
            return Err(FaultReason::LoopStalled);
        }
        if let Some(why) = input.base_error {
            return Err(why);
        }
        // After a late step, old measurements are expected, because the loop itself did not poll
        // for newer ones.
        if timing == Timing::Late {
            return Err(FaultReason::LoopOverrun);
        }
        if self.odometry_broken {
            return Err(FaultReason::OdometryNotFinite);
        }
        let wheel = self.wheel.ok_or(FaultReason::BaseSilent)?;
        if is_older(Some(wheel.time_ns), input.time_ns, self.config.feedback_timeout_s) {
            return Err(FaultReason::BaseSilent);
        }
        if is_older(self.scan_end_ns, input.time_ns, self.config.scan_timeout_s) {
            return Err(FaultReason::LidarSilent);
        }
        if self.scan_bad {
            return Err(FaultReason::LidarBad);
        }
        if self.scan_frozen {
            return Err(FaultReason::LidarFrozen);
        }
        if self.wheels_disagree {
            return Err(FaultReason::WheelsDisagree);
        }
        Ok(wheel)
    }

    fn enter_fault(&mut self, why: FaultReason) -> SafetyOutput {
        let before = self.state;
        self.witness.forget();
        self.wheels_disagree = false;
        match before {
            // A fault that resumes on evidence leads to `Clear`, so a disarmed robot must not enter
            // it: it would become armed. At the start, the motors are silent until they are set up.
            // The emergency stop is entered all the same, so that `health` shows it.
            SafetyState::Disarmed if why != FaultReason::EmergencyStop => {
                return SafetyOutput::STOP;
            }
            // A fault that needs a person is not replaced by another one.
            SafetyState::Fault(known) if known == why || known.needs_person() => {
                return SafetyOutput::STOP;
            }
            _ => self.state = SafetyState::Fault(why),
        }
        SafetyOutput { blocked_m: blocked_point_m(&before), ..SafetyOutput::STOP }
            .because(SafetyEvent::Faulted { why })
    }

    fn step_disarmed(&mut self, input: &SafetyInput<'_>, wheel: &WheelFeedback) -> SafetyOutput {
        if input.request != Some(Request::Arm) || self.good_scans < self.config.good_scans {
            return SafetyOutput::STOP;
        }
        self.state = SafetyState::Clear;
        let output = self.step_driving(input, wheel);
        if output.event.is_some() { output } else { output.because(SafetyEvent::Armed) }
    }

    fn step_fault(
        &mut self,
        why: FaultReason,
        input: &SafetyInput<'_>,
        wheel: &WheelFeedback,
    ) -> SafetyOutput {
        if !why.needs_person() && self.good_scans >= self.config.good_scans {
            self.state = SafetyState::Clear;
            self.creep_until_ns = input.time_ns.saturating_add(CREEP_NS);
            let output = self.step_driving(input, wheel);
            return if output.event.is_some() {
                output
            } else {
                output.because(SafetyEvent::Cleared)
            };
        }
        if input.request == Some(Request::ClearFault) && why.needs_person() {
            self.state = SafetyState::Disarmed;
            return SafetyOutput::STOP.because(SafetyEvent::Disarmed);
        }
        SafetyOutput::STOP
    }

    /// The twist that the planner asks for, or why the plan is refused.
    fn desired_twist(&self, input: &SafetyInput<'_>) -> Result<Twist2, PlanRefusal> {
        let plan = input.plan.ok_or(PlanRefusal::None)?;
        if !plan.twist.is_finite() {
            return Err(PlanRefusal::NotFinite);
        }
        let old = is_older(Some(plan.time_ns), input.time_ns, self.config.plan_timeout_s);
        if old || self.is_in_future(plan.time_ns, input.time_ns) {
            return Err(PlanRefusal::Stale);
        }
        Ok(plan.twist)
    }

    fn step_driving(&mut self, input: &SafetyInput<'_>, wheel: &WheelFeedback) -> SafetyOutput {
        let desired = match self.desired_twist(input) {
            Ok(desired) => desired,
            Err(why) => {
                let news = self.refused.replace(why) != Some(why) && why != PlanRefusal::None;
                let halt = SafetyOutput::pass(Twist2::ZERO);
                return if news { halt.because(SafetyEvent::PlanRefused { why }) } else { halt };
            }
        };
        self.refused = None;
        if let Some(by) = touch(wheel).filter(|_| desired != Twist2::ZERO) {
            // A stop because of an obstacle that the scanner sees takes precedence, because it
            // gives the better reason.
            return self
                .trip_by_scan(input.time_ns, wheel, &desired)
                .unwrap_or_else(|| self.trip_by_touch(input.time_ns, &wheel.odom, by));
        }
        if desired.linear_mps > 0.0 {
            return self.drive_forward(input.time_ns, wheel, desired);
        }
        let desired = self.restrained(input.time_ns, desired);
        if desired.linear_mps < 0.0 && self.is_clear_behind(input.time_ns, &wheel.odom, &desired) {
            return SafetyOutput::pass(desired);
        }
        let rotation = Twist2 { linear_mps: 0.0, ..desired };
        SafetyOutput::pass(if self.rotation_would_collide(rotation.angular_radps) {
            Twist2::ZERO
        } else {
            rotation
        })
    }

    /// The twist on the same arc within the limits of a slow restart.
    fn restrained(&self, time_ns: u64, twist: Twist2) -> Twist2 {
        if time_ns >= self.creep_until_ns { twist } else { twist.within(CREEP_MPS, CREEP_RADPS) }
    }

    /// Whether the robot may reverse with `twist` until the next call and can then still stop on
    /// ground that is known to be free.
    fn is_clear_behind(&self, time_ns: u64, odom: &Pose2, twist: &Twist2) -> bool {
        let speed = -twist.linear_mps;
        let needed_m = self.config.stopping_distance_m(speed) + speed * self.config.period_s;
        let needed_gap_m = REAR_GAP_M + needed_m;
        needed_m < f64::from(HORIZON_M)
            && self.surroundings.first_obstacle(&self.footprint, twist, needed_gap_m).is_none()
            && self.rear.known_free_m(time_ns, odom, &self.footprint, needed_m) >= needed_m
    }

    fn drive_forward(
        &mut self,
        time_ns: u64,
        wheel: &WheelFeedback,
        desired: Twist2,
    ) -> SafetyOutput {
        if let Some(trip) = self.trip_by_scan(time_ns, wheel, &desired) {
            return trip;
        }
        let (_, free_m) = self.free_ahead(wheel, &desired);
        if let Some(stands) = self.stand_if_blind(time_ns, &wheel.odom, &desired) {
            return stands;
        }
        let creep_mps = self.restrained(time_ns, desired).linear_mps;
        let blind_mps = if self.blind_since_ns.is_some() { BLIND_MPS } else { f64::INFINITY };
        let limit_mps = self
            .config
            .speed_limit_mps(free_m)
            .min(creep_mps)
            .min(blind_mps)
            .min(self.limit_beside_mps(wheel, &desired));
        if limit_mps < desired.linear_mps {
            return self.slow_down(desired, limit_mps);
        }
        let was_slow = self.state == SafetyState::Slow;
        self.state = SafetyState::Clear;
        let pass = SafetyOutput::pass(desired);
        if was_slow { pass.because(SafetyEvent::Cleared) } else { pass }
    }

    /// Records whether the scanner sees the path of a forward twist. The robot stands if the
    /// scanner has not seen it for too long; rotations stay possible, so that the robot can face
    /// another direction. The place ahead is reported as unseen, again and again while plans lead
    /// ahead, so that the planner takes another path.
    fn stand_if_blind(
        &mut self,
        time_ns: u64,
        odom: &Pose2,
        desired: &Twist2,
    ) -> Option<SafetyOutput> {
        if !self.surroundings.is_blind_ahead(&self.footprint, desired) {
            self.blind_since_ns = None;
            self.view_lost = false;
            return None;
        }
        let since_ns = *self.blind_since_ns.get_or_insert(time_ns);
        let passed_ns = time_ns.saturating_sub(since_ns);
        if !self.view_lost && passed_ns < BLIND_NS {
            return None;
        }
        let collides = self.rotation_would_collide(desired.angular_radps);
        let rotation = Twist2 { linear_mps: 0.0, ..*desired };
        let output = SafetyOutput::pass(if collides { Twist2::ZERO } else { rotation });
        self.state = SafetyState::Slow;
        let is_news = !std::mem::replace(&mut self.view_lost, true);
        if !is_news && passed_ns < STILL_BLIND_NS {
            return Some(output);
        }
        self.blind_since_ns = Some(time_ns);
        let ahead_m = self.footprint.front_edge_m() + self.config.stop_distance_m;
        let unseen_m = Some(odom.transform(ahead_m, 0.0).into());
        let output = SafetyOutput { unseen_m, ..output };
        Some(if is_news { output.because(SafetyEvent::ViewLost) } else { output })
    }

    /// The highest speed with regard to obstacles that pass within the lateral margin.
    fn limit_beside_mps(&self, wheel: &WheelFeedback, desired: &Twist2) -> f64 {
        let speed = desired.linear_mps.max(wheel.twist.linear_mps);
        let reach_m = self.config.stop_distance_m + self.config.stopping_distance_m(speed);
        self.surroundings.first_obstacle(&self.wide, desired, reach_m).map_or(
            f64::INFINITY,
            |(_, gap_m)| {
                // The margin widens the front, too, where it is part of the stop distance.
                self.config.speed_limit_mps(gap_m + self.config.lateral_margin_m).max(BESIDE_MPS)
            },
        )
    }

    /// The nearest obstacle on the path of a forward twist, if it is within reach, and the free
    /// distance ahead, metres.
    fn free_ahead(&self, wheel: &WheelFeedback, desired: &Twist2) -> (Option<Obstacle>, f64) {
        let speed = desired.linear_mps.max(wheel.twist.linear_mps);
        let reach_m = self.config.stop_distance_m + self.config.stopping_distance_m(speed);
        let nearest = self.surroundings.first_obstacle(&self.footprint, desired, reach_m);
        // An obstacle may stand just beyond the horizon, so the free distance is never more than
        // the visible one.
        let visible_m = self.surroundings.visible_ahead_m(&self.footprint);
        let free_m = nearest.map_or(visible_m, |(_, gap_m)| gap_m.min(visible_m));
        (nearest.map(|(obstacle, _)| obstacle), free_m)
    }

    /// Trips if a forward twist leads into an obstacle in the stop zone.
    fn trip_by_scan(
        &mut self,
        time_ns: u64,
        wheel: &WheelFeedback,
        desired: &Twist2,
    ) -> Option<SafetyOutput> {
        if desired.linear_mps <= 0.0 {
            return None;
        }
        let (nearest, free_m) = self.free_ahead(wheel, desired);
        let obstacle = nearest.filter(|_| self.config.speed_limit_mps(free_m) < TRIP_BELOW_MPS)?;
        Some(self.trip(time_ns, &wheel.odom, cause_of(&obstacle), obstacle.point_m()))
    }

    /// Trips because of a contact or a cliff sensor, or gives up after repeated ones.
    fn trip_by_touch(&mut self, time_ns: u64, odom: &Pose2, by: TripCause) -> SafetyOutput {
        let ahead_m = self.footprint.front_edge_m() + CONTACT_AHEAD_M;
        let tripped = self.trip(time_ns, odom, by, [ahead_m, 0.0]);
        if self.counts_to_giving_up(time_ns, odom) {
            return self.enter_fault(FaultReason::RepeatedContact);
        }
        tripped
    }

    /// Counts a contact, and returns whether there have been too many at this place.
    fn counts_to_giving_up(&mut self, time_ns: u64, odom: &Pose2) -> bool {
        let here = [odom.x_m, odom.y_m];
        forget_others(&mut self.contacts, time_ns, here);
        self.contacts.push((time_ns, here));
        let gives_up = self.contacts.len() >= CONTACTS_BEFORE_GIVING_UP;
        if gives_up {
            self.contacts.clear();
        }
        gives_up
    }

    fn slow_down(&mut self, desired: Twist2, limit_mps: f64) -> SafetyOutput {
        // Both speeds are scaled by the same factor, so the robot stays on the desired arc.
        let factor = limit_mps / desired.linear_mps;
        let twist = Twist2 { linear_mps: limit_mps, angular_radps: desired.angular_radps * factor };
        let was_slow = self.state == SafetyState::Slow;
        self.state = SafetyState::Slow;
        let output = SafetyOutput::pass(twist);
        if was_slow { output } else { output.because(SafetyEvent::Slowed { limit_mps }) }
    }

    fn rotation_would_collide(&self, angular_radps: f64) -> bool {
        let rotation_rad =
            (angular_radps * (self.config.reaction_s + ROTATION_LOOKAHEAD_S)).clamp(-TAU, TAU);
        self.surroundings
            .obstacles()
            .iter()
            .any(|obstacle| self.footprint.collides_when_rotated(obstacle.point_m(), rotation_rad))
    }

    fn trip(
        &mut self,
        time_ns: u64,
        odom: &Pose2,
        by: TripCause,
        [x_m, y_m]: [f64; 2],
    ) -> SafetyOutput {
        self.trip_count += 1;
        let blocked_m = <[f64; 2]>::from(odom.transform(x_m, y_m));
        forget_others(&mut self.trips, time_ns, blocked_m);
        if self.trips.len() < TRIPS_BEFORE_ESCAPE {
            self.trips.push((time_ns, blocked_m));
        }
        self.state = SafetyState::Tripped { since_ns: time_ns, blocked_m };
        SafetyOutput::STOP.because(SafetyEvent::Tripped { by, x_m, y_m })
    }

    fn step_tripped(
        &mut self,
        time_ns: u64,
        wheel: &WheelFeedback,
        since_ns: u64,
        blocked_m: [f64; 2],
    ) -> SafetyOutput {
        let standing = wheel.twist.linear_mps.abs() < STANDSTILL_MPS
            && wheel.twist.angular_radps.abs() < STANDSTILL_RADPS;
        if !standing && time_ns.saturating_sub(since_ns) < STANDSTILL_TIMEOUT_NS {
            return SafetyOutput::STOP;
        }
        let from = wheel.odom;
        let known_free_m =
            self.rear.known_free_m(time_ns, &from, &self.footprint, self.config.back_off_m);
        let back_off = BackOff {
            from,
            since_ns: time_ns,
            known_free_m,
            touching: wheel.contact,
            at_cliff: wheel.cliff,
            blocked_m,
        };
        self.step_backing_off(time_ns, wheel, back_off)
    }

    /// Distance from the start of a back-off within which the ground was known to be free then and
    /// is so now, metres. It is checked in every step, because knowledge ages while the robot
    /// reverses. What was observed from the start counts as well as what is observed from here.
    fn known_free_behind_m(&self, time_ns: u64, back_off: &BackOff, odom: &Pose2) -> f64 {
        let from = &back_off.from;
        let gone_m = odom.distance_m(from);
        let left_m = (self.config.back_off_m - gone_m).max(0.0);
        let known_m =
            |pose, limit_m| self.rear.known_free_m(time_ns, pose, &self.footprint, limit_m);
        let from_there_m = known_m(from, self.config.back_off_m);
        let from_here_m = known_m(odom, left_m);
        from_there_m.max(gone_m + from_here_m).min(back_off.known_free_m)
    }

    fn step_backing_off(
        &mut self,
        time_ns: u64,
        wheel: &WheelFeedback,
        back_off: BackOff,
    ) -> SafetyOutput {
        let gone_m = wheel.odom.distance_m(&back_off.from);
        let left_m = self.config.back_off_m - gone_m;
        let known_free_m = self.known_free_behind_m(time_ns, &back_off, &wheel.odom);
        let known_m = known_free_m + self.config.blind_back_off_m;
        let late = is_older(Some(back_off.since_ns), time_ns, self.config.back_off_timeout_s);
        let back = Twist2 { linear_mps: -self.config.back_off_mps, angular_radps: 0.0 };
        let rear_m =
            REAR_GAP_M + self.config.stopping_distance_m(wheel.twist.linear_mps.min(0.0).abs());
        // A bumper that caused the trip stays pressed for a moment. A contact after it was
        // released, or at this distance from the obstacle, comes from something behind the robot.
        let touching = back_off.touching && wheel.contact && gone_m < CONTACT_AHEAD_M;
        // The cliff ahead is reported until the robot has left it. One after that is behind the robot.
        let at_cliff = back_off.at_cliff && wheel.cliff;
        let touched = wheel.contact && !touching || wheel.cliff && !at_cliff;
        let end = if self.odometry_jumped {
            BackOffEnd::RearUnknown
        } else if left_m < 1e-3 {
            BackOffEnd::Distance
        } else if touched
            || self.surroundings.first_obstacle(&self.footprint, &back, rear_m).is_some()
        {
            BackOffEnd::RearBlocked
        } else if known_m - gone_m < 1e-3 {
            BackOffEnd::RearUnknown
        } else if late {
            BackOffEnd::Timeout
        } else {
            // The last step covers exactly the distance that is left, so that the robot does not
            // overshoot by one step.
            let step_m = left_m.min(known_m - gone_m);
            let braking_mps = (2.0 * self.config.brake_mps2 * step_m).sqrt();
            let speed_mps =
                self.config.back_off_mps.min(step_m / self.config.period_s).min(braking_mps);
            self.state = SafetyState::BackingOff(BackOff { touching, at_cliff, ..back_off });
            return SafetyOutput::drive(Twist2 { linear_mps: -speed_mps, angular_radps: 0.0 });
        };
        if touched && self.counts_to_giving_up(time_ns, &wheel.odom) {
            return self.enter_fault(FaultReason::RepeatedContact);
        }
        let wedged = end != BackOffEnd::Distance || self.trips.len() >= TRIPS_BEFORE_ESCAPE;
        self.state = if wedged {
            SafetyState::Escaping(Escape {
                since_ns: None,
                direction: self.surroundings.side_with_more_space(),
                turned_rad: 0.0,
                last_yaw_rad: wheel.odom.yaw_rad,
            })
        } else {
            SafetyState::Clear
        };
        let event = SafetyEvent::BackedOff { distance_m: gone_m, end };
        SafetyOutput { blocked_m: Some(back_off.blocked_m), ..SafetyOutput::STOP }.because(event)
    }

    fn step_escaping(
        &mut self,
        time_ns: u64,
        wheel: &WheelFeedback,
        escape: Escape,
    ) -> SafetyOutput {
        if let Some(by) = touch(wheel) {
            return self.trip_by_touch(time_ns, &wheel.odom, by);
        }
        let odom = &wheel.odom;
        let turned_rad = escape.turned_rad + wrap_angle(odom.yaw_rad - escape.last_yaw_rad).abs();
        let ahead = Twist2 { linear_mps: self.config.back_off_mps, angular_radps: 0.0 };
        let exit_is_clear =
            self.surroundings.first_obstacle(&self.footprint, &ahead, EXIT_CLEARANCE_M).is_none();
        let desired_radps = escape.direction * self.config.escape_radps;
        let since_ns = escape.since_ns.unwrap_or(time_ns);
        let late = is_older(
            Some(since_ns),
            time_ns,
            ESCAPE_TIMEOUT_ROTATIONS * TAU / self.config.escape_radps,
        );
        // After one full rotation without an exit, or when a corner is wedged, the planner decides
        // what to do next.
        let over = turned_rad >= TAU || late || self.rotation_would_collide(desired_radps);
        if over || (exit_is_clear && turned_rad > FRAC_PI_4) {
            self.state = SafetyState::Clear;
            self.trips.clear();
            return SafetyOutput::STOP.because(SafetyEvent::Cleared);
        }
        self.state = SafetyState::Escaping(Escape {
            since_ns: Some(since_ns),
            turned_rad,
            last_yaw_rad: odom.yaw_rad,
            ..escape
        });
        let output = SafetyOutput::drive(Twist2 { linear_mps: 0.0, angular_radps: desired_radps });
        if escape.since_ns.is_none() { output.because(SafetyEvent::Escaping) } else { output }
    }
}

/// Whether a time stamp is more than `limit_s` in the past. A missing time stamp counts as too old.
fn is_older(time_ns: Option<u64>, now_ns: u64, limit_s: f64) -> bool {
    time_ns.is_none_or(|time_ns| now_ns.saturating_sub(time_ns) as f64 > limit_s * 1e9)
}

/// Keeps the entries that are close to `here` in place and time.
fn forget_others(entries: &mut Vec<(u64, [f64; 2])>, time_ns: u64, here: [f64; 2]) {
    entries.retain(|(when_ns, place)| {
        let near = (place[0] - here[0]).hypot(place[1] - here[1]) < SAME_PLACE_M;
        near && time_ns.saturating_sub(*when_ns) < TRIP_MEMORY_NS
    });
}

/// FNV-1a over the bits of all ranges.
fn digest_of(scan: &LaserScan) -> u64 {
    scan.ranges.iter().fold(0xcbf2_9ce4_8422_2325, |digest: u64, range| {
        let bits = match range {
            Range::Hit(range_m) => u64::from(range_m.to_bits()),
            Range::NoReturn => 1 << 32,
            Range::TooNear => 2 << 32,
            Range::Error => 3 << 32,
        };
        (digest ^ bits).wrapping_mul(0x0000_0100_0000_01b3)
    })
}

/// What the base itself reports about the place where it stands.
fn touch(wheel: &WheelFeedback) -> Option<TripCause> {
    if wheel.cliff {
        return Some(TripCause::Cliff);
    }
    wheel.contact.then_some(TripCause::Contact)
}

fn cause_of(obstacle: &Obstacle) -> TripCause {
    if obstacle.too_near { TripCause::LidarTooNear } else { TripCause::LidarHit }
}

/// The obstacle that the robot was backing away from. When a fault interrupts the back-off, the
/// planner still has to be informed of it.
fn blocked_point_m(state: &SafetyState) -> Option<[f64; 2]> {
    match state {
        SafetyState::Tripped { blocked_m, .. }
        | SafetyState::BackingOff(BackOff { blocked_m, .. }) => Some(*blocked_m),
        _ => None,
    }
}

remembers!(
    SafetyPlane: state, surroundings, rear, scan_end_ns, scan_bad, good_scans, wheel, odometry_broken, odometry_jumped, last_call_ns, refused,
    trips, trip_count, contacts, creep_until_ns, blind_since_ns, view_lost, scan_digest, digest_odom, scan_frozen, witness, wheels_disagree
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

#[cfg(test)]
#[path = "back_off_tests.rs"]
mod back_off_tests;

#[cfg(test)]
#[path = "contact_tests.rs"]
mod contact_tests;

#[cfg(test)]
#[path = "cliff_tests.rs"]
mod cliff_tests;

#[cfg(test)]
#[path = "view_tests.rs"]
mod view_tests;
