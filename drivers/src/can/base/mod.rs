//! A differential base on a CAN bus: the [`hal::Base`] of the safety thread.
//!
//! Every call makes a few non-blocking system calls. It takes no lock and, after construction,
//! allocates only when the bus is reopened. Nothing is queued: a command that could not be sent is
//! dropped, and the next tick sends the newest one.
//!
//! ```text
//! Disarmed --arm()--> Arming --motors enabled--> Armed --disarm()--> Disarming --0.5 s--> Disarmed
//!                        \______________ any Trip ______/
//!                                          v
//!                                       Tripped --arm()--> Arming
//! ```
//!
//! *Zero is always sent.* While the base is disarmed or tripped, every tick sends a velocity of
//! zero to the motors, which holds them and feeds their watchdogs. Another velocity is sent only
//! while `Armed`, for a command that is younger than the watchdog time and whose plan is younger
//! than its limit.

mod link;
mod report;

use std::sync::Arc;

use hal::{Base, Clock, DriveCommand, ErrorType, PowerReport, StopCause, Twist2, WheelFeedback};

use super::bus::{Backoff, CanBus, ErrorState, SendProblem};
use super::config::BaseConfig;
use super::error::{CanError, Side, Trip};
use super::guard::WheelGuard;
use super::kinematics::{Kinematics, Odometry, Wheels};
use super::limits::Limiter;
use super::messages::SafetyInput;
use super::protocol::{MotorProtocol, MotorStage, MotorStatus, Outbox, power};
use monotonic_clock::MonotonicClock;

use crate::DeviceStatus;

const MS: u64 = 1_000_000;
/// The largest number of bus events that one tick processes. At 100 Hz this is more than a bus of 1
/// Mbit/s can carry (a frame has at least 47 bits), so a storm of error frames costs no more than a
/// full bus.
const EVENTS_PER_TICK: usize = 256;
/// Without a command, zero velocities are sent with this period. It is longer than the control
/// period, so that a loop that drives sends one set of frames per tick.
const IDLE_TICK_NS: u64 = 15 * MS;
/// The motors must be enabled within this time.
const ARMING_NS: u64 = 3_000 * MS;
/// How long the motors hold zero velocity before their power is removed.
const DISARMING_NS: u64 = 500 * MS;
/// When the safety board has sent nothing for longer, its emergency stop counts as pressed.
const SAFETY_NS: u64 = 100 * MS;
/// A motor that was present and sends nothing for this long is lost. It is three repetitions of a
/// request.
const LOST_NS: u64 = 300 * MS;
/// The motors of a base that is not in use are set up again when they have sent nothing for this
/// long: they may have lost their configuration with their power.
const SET_UP_AGAIN_NS: u64 = 1_000 * MS;
/// A wheel that is slower than this counts as standing, m/s.
const STANDING_MPS: f64 = 0.05;
/// Both wheels, in the order of every array in this module.
const SIDES: [Side; 2] = [Side::Left, Side::Right];

/// The state of the base between powerless and moving.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Phase {
    /// The base moves only after [`DifferentialBase::arm`].
    Disarmed,
    /// The motors are confirming their watchdogs and being powered.
    Arming,
    /// The base follows commands.
    Armed,
    /// The base holds zero velocity before power is removed from the motors.
    Disarming,
    /// The base is out of service until it is armed again.
    Tripped(Trip),
}

pub use report::BaseCounts;

/// The driver of a differential base.
pub struct DifferentialBase<B, C = MonotonicClock> {
    bus: B,
    clock: C,
    name: Arc<str>,
    config: BaseConfig,
    motors: [Box<dyn MotorProtocol>; 2],
    kinematics: Kinematics,
    limiter: Limiter,
    odometry: Odometry,
    guards: [WheelGuard; 2],
    phase: Phase,
    phase_since_ns: u64,
    wrong_direction: Option<Side>,
    // The command in force.
    target: Twist2,
    command_ns: u64,
    counter: Option<u32>,
    plan_age_ns: u64,
    wheels_mps: Wheels,
    tick_ns: u64,
    ticks: u64,
    // The measurements and inputs.
    position_m: Option<Wheels>,
    feedback_ns: u64,
    returned_ns: u64,
    twist: Twist2,
    polled_ns: u64,
    /// Time at which the loop called again after a pause that was longer than the watchdog time.
    resumed_ns: u64,
    started_ns: u64,
    /// Times at which a frame of any kind last arrived from each motor, and at which silent motors
    /// were last set up again.
    heard_ns: [u64; 2],
    set_up_ns: u64,
    estop: bool,
    /// An emergency stop was pressed at any moment since the last poll, and whether the last poll
    /// reported that. A press may be shorter than a tick.
    estop_seen: bool,
    estop_reported: bool,
    safety: Option<(u64, SafetyInput)>,
    // The state of the bus.
    error_state: ErrorState,
    error_counters: (u8, u8),
    bus_gone: bool,
    blocked_since_ns: Option<u64>,
    healthy_since_ns: u64,
    backoff: Backoff,
    counts: BaseCounts,
    status: DeviceStatus,
}

impl<B: CanBus> DifferentialBase<B> {
    /// Makes a disarmed base on this bus.
    ///
    /// # Errors
    /// [`CanError::Config`] when a number is out of its range.
    pub fn new(bus: B, config: &BaseConfig) -> Result<Self, CanError> {
        Self::with_clock(bus, config, MonotonicClock)
    }
}

impl<B: CanBus, C: Clock> DifferentialBase<B, C> {
    /// As [`new`](DifferentialBase::new), with another clock.
    ///
    /// # Errors
    /// As `new`.
    pub fn with_clock(bus: B, config: &BaseConfig, clock: C) -> Result<Self, CanError> {
        config.validate()?;
        let kinematics = Kinematics { track_m: config.track_m };
        let now_ns = clock.now_ns();
        Ok(Self {
            name: bus.name().into(),
            bus,
            clock,
            motors: config.motors(),
            kinematics,
            limiter: Limiter::new(config.limits),
            odometry: Odometry::new(kinematics, config.slip_m),
            guards: [WheelGuard::default(); 2],
            config: config.clone(),
            phase: Phase::Disarmed,
            phase_since_ns: now_ns,
            wrong_direction: None,
            target: Twist2::ZERO,
            command_ns: 0,
            counter: None,
            plan_age_ns: 0,
            wheels_mps: [0.0; 2],
            tick_ns: 0,
            ticks: 0,
            position_m: None,
            feedback_ns: 0,
            returned_ns: 0,
            twist: Twist2::ZERO,
            polled_ns: now_ns,
            resumed_ns: 0,
            started_ns: now_ns,
            heard_ns: [now_ns; 2],
            set_up_ns: 0,
            estop: false,
            estop_seen: false,
            estop_reported: false,
            safety: None,
            error_state: ErrorState::Active,
            error_counters: (0, 0),
            bus_gone: false,
            blocked_since_ns: None,
            healthy_since_ns: now_ns,
            backoff: Backoff::new(),
            counts: BaseCounts::default(),
            status: DeviceStatus::default(),
        })
    }

    /// Starts arming and clears a trip. The motors confirm their watchdogs again, which takes about
    /// half a second; [`phase`](Self::phase) shows when it is done.
    ///
    /// # Errors
    /// The reason why the base cannot be armed. Nothing has changed then.
    pub fn arm(&mut self) -> Result<(), CanError> {
        let now_ns = self.clock.now_ns();
        self.poll_bus(now_ns);
        if matches!(self.phase, Phase::Armed | Phase::Arming) {
            return Ok(());
        }
        self.check()?;
        for motor in &mut self.motors {
            motor.set_velocity(0.0);
            motor.enable();
        }
        self.enter(Phase::Arming, now_ns);
        Ok(())
    }

    /// Checks whether the base could be armed now, according to the last tick.
    ///
    /// # Errors
    /// The reason why the base cannot be armed.
    pub fn check(&self) -> Result<(), CanError> {
        let now_ns = self.clock.now_ns();
        if let Some(trip) = self.inhibiting_trip(now_ns) {
            return Err(CanError::Tripped(trip));
        }
        SIDES.into_iter().try_for_each(|side| self.check_motor(side, now_ns))
    }

    /// Brakes, and removes power from the motors half a second later.
    pub fn disarm(&mut self) {
        let now_ns = self.clock.now_ns();
        self.stop_at_once();
        if !matches!(self.phase, Phase::Disarming | Phase::Disarmed) {
            self.enter(Phase::Disarming, now_ns);
        }
        self.tick(now_ns);
    }

    /// Sets the state of an emergency stop switch that is not connected to the bus.
    pub fn set_emergency_stop(&mut self, pressed: bool) {
        self.estop = pressed;
        self.estop_seen |= pressed;
        let now_ns = self.clock.now_ns();
        self.supervise(now_ns);
        if pressed {
            self.tick(now_ns);
        }
    }

    /// The current state between powerless and moving.
    #[must_use]
    pub fn phase(&self) -> Phase {
        self.phase
    }

    /// Whether the base follows commands.
    #[must_use]
    pub fn is_armed(&self) -> bool {
        self.phase == Phase::Armed
    }

    /// Mutable access to the clock, for tests that advance it.
    pub fn clock_mut(&mut self) -> &mut C {
        &mut self.clock
    }

    /// The condition that forbids motion now, apart from the state of the motors.
    fn inhibiting_trip(&self, now_ns: u64) -> Option<Trip> {
        let safety_silent = self.config.safety_board
            && self.safety.is_none_or(|(time_ns, _)| now_ns.saturating_sub(time_ns) > SAFETY_NS);
        let pressed =
            self.estop || self.estop_seen || self.safety.is_some_and(|(_, input)| input.estop);
        if self.bus_gone {
            Some(Trip::BusGone)
        } else if !self.backoff.is_over(now_ns) {
            Some(if self.blocked_since_ns.is_some() { Trip::TransmitBlocked } else { Trip::BusOff })
        } else if let Some(side) = self.wrong_direction {
            Some(Trip::WrongDirection(side))
        } else if pressed {
            Some(Trip::EmergencyStop)
        } else {
            safety_silent.then_some(Trip::SafetySilent)
        }
    }

    fn check_motor(&self, side: Side, now_ns: u64) -> Result<(), CanError> {
        let [left, right] = self.motors();
        let motor = if side == Side::Left { left } else { right };
        match (motor.stage, motor.problem) {
            (MotorStage::Refused, Some(problem)) => return Err(CanError::Motor { side, problem }),
            // Enabling the motor clears its fault and confirms its watchdog.
            (MotorStage::Faulted, _) => {}
            (MotorStage::Ready | MotorStage::Enabled, _)
                if motor.watchdog_ms.is_some_and(|ms| ms <= f64::from(self.config.watchdog_ms)) => {
            }
            (_, problem) => return Err(CanError::NotReady { side, problem }),
        }
        match self.silent_motor(now_ns) {
            // A drive that restarted sends nothing before it is configured again, which arming
            // does. It has to stand by the end of arming.
            Some(_) if motor.stage == MotorStage::Faulted => Ok(()),
            Some(error) => Err(error),
            None => self.check_standing(side, motor),
        }
    }

    fn check_standing(&self, side: Side, motor: &MotorStatus) -> Result<(), CanError> {
        let speed_mps = self.at_rim(side, motor.velocity_radps).abs();
        if speed_mps > STANDING_MPS { Err(CanError::Moving { side, speed_mps }) } else { Ok(()) }
    }

    fn enter(&mut self, phase: Phase, now_ns: u64) {
        self.phase = phase;
        self.phase_since_ns = now_ns;
        self.counter = None;
        self.stop_at_once();
    }

    fn trip(&mut self, trip: Trip, now_ns: u64) {
        if let Trip::WrongDirection(side) = trip {
            self.wrong_direction = Some(side);
        }
        if matches!(self.phase, Phase::Armed | Phase::Arming) {
            self.enter(Phase::Tripped(trip), now_ns);
        }
    }

    /// Sets every velocity to zero at once, without the limiter.
    fn stop_at_once(&mut self) {
        self.target = Twist2::ZERO;
        self.limiter.stop();
        self.wheels_mps = [0.0; 2];
        self.guards = [WheelGuard::default(); 2];
        self.motors.iter_mut().for_each(|motor| motor.set_velocity(0.0));
    }

    /// Converts an angle or velocity of the motor's shaft to the wheel's rim: rad to m, rad/s to
    /// m/s.
    fn at_rim(&self, side: Side, shaft: f64) -> f64 {
        shaft / self.config.gear_ratio * self.config.radius_m(side)
    }

    fn signs(&self) -> Wheels {
        [self.config.invert_left, self.config.invert_right]
            .map(|inverted| if inverted { -1.0 } else { 1.0 })
    }

    /// Processes the pending events of the bus, updates the odometry, and checks for trips.
    fn poll_bus(&mut self, now_ns: u64) {
        for _ in 0..EVENTS_PER_TICK {
            let Some(received) = self.bus.receive(now_ns) else { break };
            self.on_event(&received.event, received.time_ns, now_ns);
        }
        self.measure(now_ns);
        self.supervise(now_ns);
        self.polled_ns = now_ns;
    }

    /// Updates the odometry when both motors have sent new feedback.
    fn measure(&mut self, now_ns: u64) {
        let [left, right] = self.motors();
        let time_ns = left.feedback_ns.min(right.feedback_ns);
        if time_ns <= self.feedback_ns {
            return;
        }
        let [left_sign, right_sign] = self.signs();
        let position_m = [
            left_sign * self.at_rim(Side::Left, left.position_rad),
            right_sign * self.at_rim(Side::Right, right.position_rad),
        ];
        let velocity_mps = [
            left_sign * self.at_rim(Side::Left, left.velocity_radps),
            right_sign * self.at_rim(Side::Right, right.velocity_radps),
        ];
        self.twist = self.kinematics.twist(velocity_mps);
        let elapsed_s = (time_ns - self.feedback_ns) as f64 * 1e-9;
        let mut restarted = None;
        if let (Some([l0, r0]), [l1, r1]) = (self.position_m, position_m) {
            let travel = [l1 - l0, r1 - r0];
            // More travel than twice that of the fastest wheel plus 5 cm means that a controller
            // restarted its position counter.
            let limits = &self.config.limits;
            let fastest = limits.linear_mps + limits.angular_radps * self.config.track_m / 2.0;
            let [left_m, right_m] = travel.map(f64::abs);
            if left_m.max(right_m) <= 2.0 * fastest * elapsed_s + 0.05 {
                self.odometry.advance(travel);
                for (guard, travel_m) in self.guards.iter_mut().zip(travel) {
                    guard.measured(travel_m);
                }
            } else {
                self.status.bad += 1;
                let side = if left_m > right_m { Side::Left } else { Side::Right };
                restarted = Some(side);
            }
        }
        if let Some(side) = restarted
            && self.phase == Phase::Armed
        {
            self.trip(Trip::MotorRestarted(side), now_ns);
        }
        self.position_m = Some(position_m);
        self.feedback_ns = time_ns;
        self.status.good += 1;
        self.status.last_good_ns = time_ns;
    }

    /// An error for the first motor whose feedback is too old. While the base is arming, a motor
    /// that is being configured sends responses instead of feedback; after a pause of the loop, drives
    /// that send feedback on request have not been asked for it.
    fn silent_motor(&self, now_ns: u64) -> Option<CanError> {
        let limit_ms = u64::from(self.config.feedback_timeout_ms);
        let is_arming = self.phase == Phase::Arming;
        SIDES.into_iter().zip(&self.motors).zip(self.heard_ns).find_map(
            |((side, motor), heard_ns)| {
                let heard_ns = if is_arming { heard_ns.max(self.phase_since_ns) } else { 0 };
                let resumed_ns = if self.phase == Phase::Armed { 0 } else { self.resumed_ns };
                let asked_ns = self.started_ns.max(heard_ns).max(resumed_ns);
                let last_ns = motor.status().feedback_ns.max(asked_ns);
                let age_ms = now_ns.saturating_sub(last_ns) / MS;
                (age_ms > limit_ms
                    || (age_ms == limit_ms && now_ns.saturating_sub(last_ns) > limit_ms * MS))
                    .then_some(CanError::Silent { side, age_ms, limit_ms })
            },
        )
    }

    /// Checks every condition that trips the base, and advances the phase.
    fn supervise(&mut self, now_ns: u64) {
        let stalled =
            now_ns.saturating_sub(self.polled_ns) > u64::from(self.config.watchdog_ms) * MS;
        if stalled {
            self.resumed_ns = now_ns;
            if self.phase == Phase::Armed {
                self.trip(Trip::LoopStalled, now_ns);
            }
        }
        if let Some(trip) = self.inhibiting_trip(now_ns) {
            self.trip(trip, now_ns);
        }
        if let Some(CanError::Silent { side, .. }) = self.silent_motor(now_ns) {
            self.trip(Trip::FeedbackSilent(side), now_ns);
        }
        let stages = self.motors.each_ref().map(|motor| motor.status().stage);
        for (side, stage) in SIDES.into_iter().zip(stages) {
            let has_failed = match self.phase {
                Phase::Armed => stage != MotorStage::Enabled,
                Phase::Arming => matches!(stage, MotorStage::Faulted | MotorStage::Refused),
                _ => false,
            };
            if has_failed {
                self.trip(Trip::MotorFault(side), now_ns);
            }
        }
        if !matches!(self.phase, Phase::Armed | Phase::Arming) {
            self.set_up_again(now_ns);
        }
        for (side, guard) in SIDES.into_iter().zip(self.guards) {
            if self.phase == Phase::Armed && guard.is_wrong_direction() {
                self.trip(Trip::WrongDirection(side), now_ns);
            }
        }
        let waited_ns = now_ns.saturating_sub(self.phase_since_ns);
        match self.phase {
            Phase::Arming if stages == [MotorStage::Enabled; 2] && self.stands() => {
                self.enter(Phase::Armed, now_ns);
            }
            Phase::Arming if waited_ns > ARMING_NS => {
                let side = if stages.first() == Some(&MotorStage::Enabled) {
                    Side::Right
                } else {
                    Side::Left
                };
                self.trip(Trip::MotorFault(side), now_ns);
            }
            Phase::Disarming if waited_ns >= DISARMING_NS => {
                self.motors.iter_mut().for_each(|motor| motor.disable());
                self.enter(Phase::Disarmed, now_ns);
            }
            _ => {}
        }
    }

    /// Sets silent motors up again. They stay without power.
    fn set_up_again(&mut self, now_ns: u64) {
        let set_up_ns = self.set_up_ns;
        for (motor, heard_ns) in self.motors.iter_mut().zip(&self.heard_ns) {
            let was_heard = *heard_ns > self.started_ns;
            let last_ns = (*heard_ns).max(set_up_ns);
            if was_heard && now_ns.saturating_sub(last_ns) >= SET_UP_AGAIN_NS {
                motor.restart();
                self.set_up_ns = now_ns;
            }
        }
    }

    /// Whether a motor that was present sends nothing any more, neither feedback nor responses.
    fn has_lost_motor(&self, now_ns: u64) -> bool {
        self.heard_ns.into_iter().any(|heard_ns| {
            let heard_ns = heard_ns.max(self.resumed_ns);
            heard_ns > self.started_ns && now_ns.saturating_sub(heard_ns) > LOST_NS
        })
    }

    fn stands(&self) -> bool {
        let motors = self.motors();
        SIDES.into_iter().zip(motors).all(|(side, motor)| self.check_standing(side, motor).is_ok())
    }

    /// Sends one set of frames to the motors and publishes the state of the base.
    fn tick(&mut self, now_ns: u64) {
        let elapsed_ns = now_ns.saturating_sub(self.tick_ns).min(5 * IDLE_TICK_NS);
        self.tick_ns = now_ns;
        if !self.backoff.is_over(now_ns) {
            return;
        }
        self.update_setpoints(now_ns, elapsed_ns);
        let mut first_problem = None;
        let mut out = Outbox::new();
        for k in 0..2 {
            out.clear();
            if let Some(motor) = self.motors.get_mut(k) {
                motor.tick(now_ns, &mut out);
            }
            for frame in &out {
                self.send(frame, &mut first_problem);
            }
        }
        self.publish_state(&mut first_problem);
        self.check_transmission(first_problem, now_ns);
    }

    /// Computes the wheel velocities of this tick.
    fn update_setpoints(&mut self, now_ns: u64, elapsed_ns: u64) {
        let fresh =
            now_ns.saturating_sub(self.command_ns) < u64::from(self.config.watchdog_ms) * MS;
        let target = if self.phase == Phase::Armed && fresh { self.target } else { Twist2::ZERO };
        if self.phase != Phase::Armed {
            self.wheels_mps = [0.0; 2];
            return;
        }
        let measured = self.kinematics.wheels(&self.twist);
        for ((guard, commanded), measured) in
            self.guards.iter_mut().zip(self.wheels_mps).zip(measured)
        {
            guard.commanded(commanded, measured, elapsed_ns);
        }
        let twist =
            self.limiter.step(&target, elapsed_ns.max(1) as f64 * 1e-9).unwrap_or(Twist2::ZERO);
        self.wheels_mps = self.kinematics.wheels(&twist);
        let [left_m, right_m] = [Side::Left, Side::Right].map(|side| self.config.radius_m(side));
        let [left_sign, right_sign] = self.signs();
        let gear_ratio = self.config.gear_ratio;
        let per_metre = [left_sign * gear_ratio / left_m, right_sign * gear_ratio / right_m];
        for ((motor, wheel_mps), per_metre) in
            self.motors.iter_mut().zip(self.wheels_mps).zip(per_metre)
        {
            motor.set_velocity(wheel_mps * per_metre);
        }
    }

    fn contact(&self) -> bool {
        self.safety.is_some_and(|(_, input)| input.bumper)
            || self.guards.iter().any(WheelGuard::is_stalled)
    }

    /// Checks whether a command may move the base.
    fn accept(&mut self, command: &DriveCommand) -> Result<(), CanError> {
        let limit_ms = u64::from(self.config.plan_age_limit_ms);
        let Twist2 { linear_mps, angular_radps } = command.twist;
        match self.phase {
            Phase::Tripped(trip) => return Err(CanError::Tripped(trip)),
            Phase::Armed => {}
            _ => return Err(CanError::NotArmed),
        }
        if let Some(last) = self.counter {
            let step = command.counter.wrapping_sub(last);
            if step == 0 || step > u32::MAX / 2 {
                return Err(CanError::Counter { found: command.counter, last });
            }
            self.counts.skipped += u64::from(step - 1);
        }
        self.counter = Some(command.counter);
        if !command.twist.is_finite() {
            self.target = Twist2::ZERO;
            return Err(CanError::NotFinite { linear_mps, angular_radps });
        }
        if command.plan_age_ns > limit_ms * MS {
            self.target = Twist2::ZERO;
            return Err(CanError::PlanTooOld { age_ms: command.plan_age_ns / MS, limit_ms });
        }
        Ok(())
    }
}

impl<B, C> ErrorType for DifferentialBase<B, C> {
    type Error = CanError;
}

impl<B: CanBus, C: Clock> Base for DifferentialBase<B, C> {
    /// The first attempt after a trip reports the trip, so that the caller can decide whether the
    /// base may be armed again.
    fn arm(&mut self) -> Result<bool, CanError> {
        if let Phase::Tripped(trip) = self.phase {
            let now_ns = self.clock.now_ns();
            self.enter(Phase::Disarmed, now_ns);
            return Err(CanError::Tripped(trip));
        }
        Self::arm(self)?;
        Ok(self.is_armed())
    }

    fn disarm(&mut self) {
        Self::disarm(self);
    }

    fn stop_cause(&self) -> Option<StopCause> {
        let now_ns = self.clock.now_ns();
        match (self.inhibiting_trip(now_ns), self.phase) {
            (Some(Trip::EmergencyStop), _) | (_, Phase::Tripped(Trip::EmergencyStop)) => {
                Some(StopCause::EmergencyStop)
            }
            _ if self.estop_reported => Some(StopCause::EmergencyStop),
            _ if self.has_lost_motor(now_ns) => Some(StopCause::MotorsLost),
            (Some(Trip::SafetySilent), _) | (_, Phase::Tripped(Trip::SafetySilent)) => {
                Some(StopCause::SafetyBoardSilent)
            }
            (_, Phase::Tripped(Trip::LoopStalled)) => Some(StopCause::LoopStalled),
            _ => None,
        }
    }

    fn power(&self) -> PowerReport {
        let now_ns = self.clock.now_ns();
        power::combined(self.motors().map(|motor| motor.power.report(now_ns)))
    }

    fn drive(&mut self, command: &DriveCommand) -> Result<(), CanError> {
        let now_ns = self.clock.now_ns();
        self.poll_bus(now_ns);
        let accepted = self.accept(command);
        match accepted {
            Ok(()) => {
                self.target = command.twist;
                self.plan_age_ns = command.plan_age_ns;
                self.command_ns = now_ns;
            }
            Err(_) => self.counts.refused += 1,
        }
        self.tick(now_ns);
        accepted
    }

    fn stop(&mut self) -> Result<(), CanError> {
        let now_ns = self.clock.now_ns();
        self.poll_bus(now_ns);
        self.stop_at_once();
        self.tick(now_ns);
        if self.bus_gone {
            return Err(CanError::Bus { bus: Arc::clone(&self.name), problem: SendProblem::Gone });
        }
        Ok(())
    }

    fn finish(&mut self) {
        // A motor that may still be powered keeps its watchdog.
        if self.phase != Phase::Disarmed {
            return;
        }
        let mut out = Outbox::new();
        self.motors.iter_mut().for_each(|motor| motor.finish(&mut out));
        let mut first_problem = None;
        for frame in &out {
            self.send(frame, &mut first_problem);
        }
    }

    fn poll_feedback(&mut self) -> Result<Option<WheelFeedback>, CanError> {
        let now_ns = self.clock.now_ns();
        self.poll_bus(now_ns);
        self.estop_reported = std::mem::take(&mut self.estop_seen);
        if now_ns.saturating_sub(self.tick_ns) >= IDLE_TICK_NS {
            self.tick(now_ns);
        }
        if self.bus_gone {
            return Err(CanError::Bus { bus: Arc::clone(&self.name), problem: SendProblem::Gone });
        }
        if let Some(error) = self.silent_motor(now_ns) {
            return Err(error);
        }
        let feedback = WheelFeedback {
            time_ns: self.feedback_ns,
            odom: self.odometry.pose(),
            twist: self.twist,
            contact: self.contact(),
            cliff: self.safety.is_some_and(|(_, input)| input.cliff),
        };
        let is_new = self.feedback_ns > std::mem::replace(&mut self.returned_ns, self.feedback_ns);
        Ok(is_new.then_some(feedback))
    }
}

impl<B, C> std::fmt::Debug for DifferentialBase<B, C> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("DifferentialBase")
            .field("bus", &self.name)
            .field("phase", &self.phase)
            .finish_non_exhaustive()
    }
}
