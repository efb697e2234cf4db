//! One step of the safety loop: scan and wheel feedback in, state machine, command out.
//!
//! # Who may arm
//!
//! A request to arm gives the loop *authority* to arm the base. The authority ends with every event
//! that needs a person ([`STOPS`](super::STOPS)), with a request to disarm, and if the base cannot be
//! armed within [`ARM_WITHIN_NS`]. So no wheel rotates unless a person asked for it after the last such
//! event. While the authority lasts, a base that has to be armed again after a stop that resumes on
//! evidence is armed without a new request.

use hal::{Base, DriveCommand, Error, ErrorKind, LaserScan, Lidar, StopCause, WheelFeedback};

use super::power::PowerWatch;
use super::sent::SentCommand;
use super::{Plan, Request, SafetyConfig, SafetyInput, SafetyOutput, SafetyPlane, SafetyState};
use crate::event::{FaultReason, SafetyEvent};

/// A request to arm that could not be followed for this long is cancelled: the person who gave it may be
/// at work on the robot by then. Motors, scanner and first scans need about 2 s.
const ARM_WITHIN_NS: u64 = 10_000_000_000;

/// What one step gets from outside the safety loop.
#[derive(Debug, Clone, Copy, Default)]
pub struct Orders {
    /// The newest plan of the exploration loop.
    pub plan: Option<Plan>,
    /// The operator's request. It has to be given in one step only, because the loop stores it.
    pub request: Option<Request>,
    /// The operator's own emergency stop is pressed. The base does not read it.
    pub emergency_stop: bool,
    /// The computer was suspended since the last step.
    pub suspended: bool,
}

/// The permission to arm, from a request until an event that needs a person.
#[derive(Debug, Clone, Copy)]
struct Authority {
    since_ns: u64,
}

/// The devices that have been present since the start. The absence of any other one is the start of
/// the device; the absence of these is an event that needs a person.
#[derive(Debug, Clone, Copy, Default)]
struct Seen {
    motors: bool,
    board: bool,
}

/// The answer of the base to an attempt to arm it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Readiness {
    /// The loop did not try.
    NotTried,
    /// The base is powering its motors, or follows commands.
    Arming,
    /// The base cannot be reached, or its motors are silent.
    Absent,
    /// The base is present and not ready yet.
    NotYet,
    /// The base reports a fault, or an emergency stop holds it.
    Refused,
}

impl Readiness {
    fn of(kind: ErrorKind) -> Self {
        match kind {
            ErrorKind::Timeout | ErrorKind::Disconnected => Self::Absent,
            ErrorKind::Rejected => Self::NotYet,
            _ => Self::Refused,
        }
    }
}

/// The result of one step.
#[derive(Debug, Clone, Copy)]
pub struct SafetyStep<'a> {
    /// The state machine's answer.
    pub output: SafetyOutput,
    /// The state after the step.
    pub state: SafetyState,
    /// The command that the base received, or the stop that took its place.
    pub sent: SentCommand,
    /// A new scan, if one came.
    pub scan: Option<&'a LaserScan>,
    /// New wheel feedback, if some came.
    pub wheel: Option<WheelFeedback>,
    /// The scanner's current error.
    pub lidar_error: Option<ErrorKind>,
    /// The base's current error.
    pub base_error: Option<ErrorKind>,
}

/// The owner of the one handle that moves the robot. It is generic over the devices: a thread of its own steps it on a real
/// robot, and [`VirtualTime`](crate::session::VirtualTime) steps it in simulation. A step allocates nothing after the first
/// scan and takes no lock.
#[derive(Debug)]
pub struct SafetyLoop<B, L> {
    base: B,
    lidar: L,
    plane: SafetyPlane,
    scan: LaserScan,
    counter: u32,
    authority: Option<Authority>,
    seen: Seen,
    power: PowerWatch,
    /// Why the base refused to be armed or driven in the last step.
    refusal: Option<FaultReason>,
}

impl<B: Base, L: Lidar> SafetyLoop<B, L> {
    /// Takes the devices. Nothing moves before an order to arm.
    pub fn new(config: SafetyConfig, base: B, lidar: L) -> Self {
        let scan = LaserScan::empty(lidar.geometry());
        let power = PowerWatch::new(&config);
        let plane = SafetyPlane::new(config);
        Self {
            base,
            lidar,
            plane,
            scan,
            counter: 0,
            authority: None,
            seen: Seen::default(),
            power,
            refusal: None,
        }
    }

    /// One step at `now_ns`, monotonic.
    pub fn step(&mut self, now_ns: u64, orders: &Orders) -> SafetyStep<'_> {
        let (has_scan, lidar_error) = match self.lidar.poll_scan(&mut self.scan) {
            Ok(has_scan) => (has_scan, None),
            Err(error) => (false, Some(error.kind())),
        };
        let (wheel, feedback_error) = match self.base.poll_feedback() {
            Ok(wheel) => (wheel, None),
            // One corrupt message is not a fault; silence will be.
            Err(error) if error.kind() == ErrorKind::Corrupt => (None, None),
            Err(error) => (None, Some(error.kind())),
        };
        let (request, readiness) = self.arming(now_ns, orders.request);
        let stop_cause = self.base.stop_cause();
        let power = self.base.power();
        let low_battery = self.power.is_low(now_ns, &power).then_some(FaultReason::LowBattery);
        let base_error = match stop_cause {
            Some(StopCause::SafetyBoardSilent) => Some(FaultReason::SafetyBoardSilent),
            _ => feedback_error.map(FaultReason::of_base).or(self.refusal).or(low_battery),
        };
        self.refusal = None;
        let mut output = self.plane.step(&SafetyInput {
            time_ns: now_ns,
            scan: has_scan.then_some(&self.scan),
            wheel,
            base_error,
            emergency_stop: orders.emergency_stop || stop_cause == Some(StopCause::EmergencyStop),
            suspended: orders.suspended,
            plan: orders.plan,
            request,
        });
        // Motions of the safety plane's own are slow already.
        if !output.in_charge {
            output.command = output.command.map(|twist| self.power.slowed(twist, &power));
        }
        self.disarm_after(output.event);
        let is_board_silent = stop_cause == Some(StopCause::SafetyBoardSilent);
        let are_motors_silent = feedback_error.map(Readiness::of) == Some(Readiness::Absent);
        let lost = if self.seen.board && is_board_silent {
            Some(FaultReason::SafetyBoardSilent)
        } else if stop_cause == Some(StopCause::MotorsLost) || self.seen.motors && are_motors_silent
        {
            Some(FaultReason::BaseSilent)
        } else {
            None
        };
        self.seen.board |= !is_board_silent;
        self.seen.motors |= wheel.is_some();
        if let Some(why) = lost.or_else(|| self.lapse(now_ns, output.forbidden, readiness))
            && self.authority.is_some()
            && self.plane.state() == SafetyState::Disarmed
        {
            self.disarm();
            output.event = output.event.or(Some(SafetyEvent::ArmingLapsed { why }));
        }
        let plan_age_ns = orders.plan.map_or(0, |plan| now_ns.saturating_sub(plan.time_ns));
        let sent = self.command(now_ns, &output, plan_age_ns);
        SafetyStep {
            output,
            state: self.plane.state(),
            sent,
            scan: has_scan.then_some(&self.scan),
            wheel,
            lidar_error,
            base_error: feedback_error,
        }
    }

    /// Arms the base while the loop has the authority to do so, and passes the request on to the
    /// state machine once the base is ready. A base that has to be armed again after a stop that
    /// resumes on evidence is armed in the same way.
    fn arming(&mut self, now_ns: u64, request: Option<Request>) -> (Option<Request>, Readiness) {
        let state = self.plane.state();
        let is_held = matches!(state, SafetyState::Fault(why) if why.needs_person());
        match request {
            // The fault has to be cleared first.
            Some(Request::Arm) if is_held => {}
            Some(Request::Arm) => {
                self.authority = Some(Authority { since_ns: now_ns });
            }
            Some(Request::Disarm) => self.disarm(),
            Some(Request::ClearFault) | None => {}
        }
        let passing_fault = match state {
            SafetyState::Fault(why) if !why.needs_person() => Some(why),
            _ => None,
        };
        let waits = state == SafetyState::Disarmed || passing_fault.is_some();
        if self.authority.is_none() || !waits {
            let rest = request.filter(|request| *request != Request::Arm);
            return (rest, Readiness::NotTried);
        }
        // The attempt ends the trip that the cause describes.
        let cause = self.base.stop_cause();
        match self.base.arm() {
            Ok(true) => {
                self.refusal = None;
                (Some(Request::Arm), Readiness::Arming)
            }
            Ok(false) => {
                // A passing fault lasts until the base is armed again.
                self.refusal = passing_fault;
                (None, Readiness::Arming)
            }
            Err(error) => {
                let readiness = Readiness::of(error.kind());
                self.refusal = match readiness {
                    Readiness::NotYet => passing_fault,
                    _ => Some(refusal(cause, error.kind())),
                };
                (None, readiness)
            }
        }
    }

    fn disarm_after(&mut self, event: Option<SafetyEvent>) {
        let ends_authority = match event {
            Some(SafetyEvent::Faulted { why }) => why.needs_person(),
            Some(SafetyEvent::Disarmed) => true,
            _ => false,
        };
        if ends_authority {
            self.disarm();
        }
    }

    /// The reason why a request to arm that is still pending is cancelled in this step, if there is
    /// one.
    fn lapse(
        &self,
        now_ns: u64,
        forbidden: Option<FaultReason>,
        readiness: Readiness,
    ) -> Option<FaultReason> {
        let authority = self.authority?;
        let is_start = match forbidden {
            Some(FaultReason::SafetyBoardSilent) => !self.seen.board,
            // While a base is arming, its motors may be silent because they are being configured; it
            // then watches them itself.
            Some(FaultReason::BaseSilent) => !self.seen.motors || readiness == Readiness::Arming,
            Some(FaultReason::BaseFault) => !self.seen.motors && readiness == Readiness::Absent,
            _ => false,
        };
        if let Some(why) = forbidden.filter(|why| why.needs_person() && !is_start) {
            return Some(why);
        }
        let late = now_ns.saturating_sub(authority.since_ns) > ARM_WITHIN_NS;
        late.then(|| forbidden.unwrap_or(FaultReason::BaseSilent))
    }

    fn disarm(&mut self) {
        self.authority = None;
        self.refusal = None;
        self.base.disarm();
    }

    fn command(&mut self, now_ns: u64, output: &SafetyOutput, plan_age_ns: u64) -> SentCommand {
        let Some(twist) = output.command else {
            // A base that cannot be reached stops by its own watchdog.
            let _ = self.base.stop();
            return SentCommand::stop(now_ns);
        };
        self.counter = self.counter.wrapping_add(1);
        let counter = self.counter;
        // The age of the plan does not matter for a motion that the safety plane decides, nor for
        // standing still after a refused plan.
        let without_plan = output.in_charge || twist == hal::Twist2::ZERO;
        let plan_age_ns = if without_plan { 0 } else { plan_age_ns };
        if let Err(error) = self.base.drive(&DriveCommand { twist, counter, plan_age_ns }) {
            self.refusal = Some(refusal(self.base.stop_cause(), error.kind()));
            let _ = self.base.stop();
            return SentCommand::stop(now_ns);
        }
        SentCommand::drive(now_ns, counter, twist)
    }

    /// The safety plane's state machine.
    pub fn plane(&self) -> &SafetyPlane {
        &self.plane
    }

    /// Whether a request to arm is in force.
    #[must_use]
    pub fn has_authority(&self) -> bool {
        self.authority.is_some()
    }

    /// The base, to read its state.
    pub fn base(&self) -> &B {
        &self.base
    }

    /// The scanner, to read its state.
    pub fn lidar(&self) -> &L {
        &self.lidar
    }

    /// Brakes, disarms the base, and returns the devices.
    pub fn shut_down(mut self) -> (B, L) {
        let _ = self.base.stop();
        self.base.disarm();
        self.base.finish();
        (self.base, self.lidar)
    }
}

/// The reason for a stop when the base refused a command or refused to be armed. A loop that called
/// too late is no fault of the base.
fn refusal(cause: Option<StopCause>, kind: ErrorKind) -> FaultReason {
    match cause {
        Some(StopCause::EmergencyStop) => FaultReason::EmergencyStop,
        Some(StopCause::SafetyBoardSilent) => FaultReason::SafetyBoardSilent,
        Some(StopCause::LoopStalled) => FaultReason::LoopOverrun,
        _ => FaultReason::of_base(kind),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::event::FaultReason;
    use hal::{ErrorType, Pose2, PowerReport, Range, ScanGeometry, Twist2};

    const FORWARD: Twist2 = Twist2 { linear_mps: 0.3, angular_radps: 0.0 };
    const MS: u64 = 1_000_000;

    #[derive(Debug, Clone, Copy)]
    struct Broken(ErrorKind);

    impl std::fmt::Display for Broken {
        fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
            write!(f, "{:?}", self.0)
        }
    }

    impl Error for Broken {
        fn kind(&self) -> ErrorKind {
            self.0
        }
    }

    /// A base that powers its motors within three steps, or some more, and whose wheels follow commands exactly.
    #[derive(Default)]
    struct Motors {
        time_ns: u64,
        arming: u32,
        more_steps: u32,
        moved: Vec<Twist2>,
        pose: Pose2,
        broken: Option<ErrorKind>,
        counters: Vec<u32>,
        plan_age_ns: u64,
        /// The error that the feedback returns instead of a measurement.
        unheard: Option<ErrorKind>,
        power: PowerReport,
        demands: Option<StopCause>,
    }

    impl ErrorType for Motors {
        type Error = Broken;
    }

    impl Base for Motors {
        fn arm(&mut self) -> Result<bool, Broken> {
            self.broken.map_or(Ok(()), |kind| Err(Broken(kind)))?;
            self.arming += 1;
            Ok(self.arming > 3 + self.more_steps)
        }

        fn disarm(&mut self) {
            self.arming = 0;
        }

        fn drive(&mut self, command: &DriveCommand) -> Result<(), Broken> {
            if self.arming <= 3 + self.more_steps || self.broken.is_some() {
                return Err(Broken(self.broken.unwrap_or(ErrorKind::Rejected)));
            }
            self.counters.push(command.counter);
            self.plan_age_ns = command.plan_age_ns;
            self.moved.push(command.twist);
            Ok(())
        }

        fn power(&self) -> PowerReport {
            self.power
        }

        fn stop_cause(&self) -> Option<StopCause> {
            self.demands
        }

        fn stop(&mut self) -> Result<(), Broken> {
            self.moved.push(Twist2::ZERO);
            Ok(())
        }

        fn poll_feedback(&mut self) -> Result<Option<WheelFeedback>, Broken> {
            if let Some(kind @ (ErrorKind::Timeout | ErrorKind::Disconnected)) = self.broken {
                self.arming = 0;
                return Err(Broken(kind));
            }
            self.unheard.map_or(Ok(()), |kind| Err(Broken(kind)))?;
            Ok(Some(WheelFeedback {
                time_ns: self.time_ns,
                odom: self.pose,
                twist: Twist2::ZERO,
                contact: false,
                cliff: false,
            }))
        }
    }

    struct FreeFloor {
        time_ns: u64,
        error: Option<ErrorKind>,
        ahead_m: f32,
    }

    impl ErrorType for FreeFloor {
        type Error = Broken;
    }

    impl Lidar for FreeFloor {
        fn geometry(&self) -> ScanGeometry {
            ScanGeometry::UTM_30LX
        }

        fn poll_scan(&mut self, scan: &mut LaserScan) -> Result<bool, Broken> {
            self.error.map_or(Ok(()), |kind| Err(Broken(kind)))?;
            scan.time_ns = self.time_ns;
            scan.ranges.clear();
            scan.ranges.resize(1081, Range::Hit(3.0));
            scan.ranges[500..580].fill(Range::Hit(self.ahead_m));
            Ok(true)
        }
    }

    struct Robot {
        control: SafetyLoop<Motors, FreeFloor>,
        now_ns: u64,
    }

    impl Robot {
        fn new() -> Self {
            // Its odometry stands still, so it never knows the ground behind it.
            let blind_back_off_m = 0.05;
            let config = SafetyConfig {
                period_s: 0.01,
                good_scans: 3,
                blind_back_off_m,
                ..SafetyConfig::default()
            };
            let lidar = FreeFloor { time_ns: 0, error: None, ahead_m: 3.0 };
            Self { control: SafetyLoop::new(config, Motors::default(), lidar), now_ns: 0 }
        }

        fn step(&mut self, request: Option<Request>) -> SafetyOutput {
            self.now_ns += 10 * MS;
            (self.control.base.time_ns, self.control.lidar.time_ns) = (self.now_ns, self.now_ns);
            let plan = Some(Plan { twist: FORWARD, time_ns: self.now_ns });
            self.control.step(self.now_ns, &Orders { plan, request, ..Orders::default() }).output
        }

        /// Runs a step with a plan of this age; returns the plan age that the base received.
        fn step_with_plan_of_age(&mut self, age_ns: u64) -> u64 {
            self.now_ns += 10 * MS;
            (self.control.base.time_ns, self.control.lidar.time_ns) = (self.now_ns, self.now_ns);
            let plan = Some(Plan { twist: FORWARD, time_ns: self.now_ns - age_ns });
            self.control.step(self.now_ns, &Orders { plan, ..Orders::default() });
            self.control.base.plan_age_ns
        }

        fn drives(&self) -> bool {
            self.control.base.moved.last() == Some(&FORWARD)
        }

        fn drives_after(&mut self, steps: usize) -> bool {
            (0..steps).for_each(|_| _ = self.step(None));
            self.drives()
        }
    }

    #[test]
    fn one_order_to_arm_is_enough_and_nothing_moves_before_the_motors_are_ready() {
        let mut robot = Robot::new();
        assert!(!robot.drives_after(10), "no person has armed it");
        robot.step(Some(Request::Arm));
        assert!(!robot.drives() && robot.control.has_authority());
        assert!(robot.drives_after(10));
        assert_eq!(
            robot.control.base.moved.iter().position(|twist| *twist == FORWARD),
            Some(13),
            "three steps of arming"
        );
    }

    #[test]
    fn every_command_has_a_counter_of_its_own() {
        let mut robot = Robot::new();
        robot.step(Some(Request::Arm));
        robot.drives_after(20);
        let counters = &robot.control.base.counters;
        assert!(
            counters.len() > 10 && counters.windows(2).all(|pair| pair[1] == pair[0] + 1),
            "{counters:?}"
        );
    }

    #[test]
    fn wheels_that_fell_silent_move_again_only_after_a_person_has_asked_for_it() {
        let mut robot = Robot::new();
        robot.step(Some(Request::Arm));
        assert!(robot.drives_after(10));
        robot.control.base.broken = Some(ErrorKind::Timeout);
        assert_eq!(
            robot.step(None).event,
            Some(SafetyEvent::Faulted { why: FaultReason::BaseSilent })
        );
        robot.control.base.broken = None;
        assert!(!robot.drives_after(200), "power is back, and it drives without being armed");
        robot.step(Some(Request::ClearFault));
        assert!(!robot.drives_after(20));
        robot.step(Some(Request::Arm));
        assert!(robot.drives_after(10));
    }

    #[test]
    fn a_base_that_refuses_to_be_driven_stops_the_robot_until_a_person_has_looked() {
        let mut robot = Robot::new();
        robot.step(Some(Request::Arm));
        assert!(robot.drives_after(10));
        robot.control.base.broken = Some(ErrorKind::Fault);
        robot.step(None);
        assert!(!robot.drives());
        robot.step(None);
        assert_eq!(robot.control.plane.state(), SafetyState::Fault(FaultReason::BaseFault));
        robot.control.base.broken = None;
        robot.step(Some(Request::Arm));
        assert!(!robot.drives_after(20), "arming alone does not clear a fault");
        robot.step(Some(Request::ClearFault));
        robot.step(Some(Request::Arm));
        assert!(robot.drives_after(10));
    }

    #[test]
    fn a_silent_safety_board_is_a_fault_of_its_own_and_needs_a_person() {
        let mut robot = Robot::new();
        robot.step(Some(Request::Arm));
        assert!(robot.drives_after(10));
        robot.control.base.demands = Some(StopCause::SafetyBoardSilent);
        let faulted = SafetyEvent::Faulted { why: FaultReason::SafetyBoardSilent };
        assert_eq!(robot.step(None).event, Some(faulted));
        robot.control.base.demands = None;
        assert!(!robot.drives_after(200), "the board is back, and no person has asked");
        robot.step(Some(Request::ClearFault));
        robot.step(Some(Request::Arm));
        assert!(robot.drives_after(10));
    }

    #[test]
    fn a_safety_board_that_is_not_there_yet_is_waited_for() {
        let mut robot = Robot::new();
        robot.control.base.demands = Some(StopCause::SafetyBoardSilent);
        let first = robot.step(Some(Request::Arm)).event;
        assert!(!matches!(first, Some(SafetyEvent::ArmingLapsed { .. })), "{first:?}");
        assert!(!robot.drives_after(500), "for 5 s there is no board");
        robot.control.base.demands = None;
        assert!(robot.drives_after(10));
    }

    #[test]
    fn motors_that_switched_off_while_the_scanner_was_silent_are_armed_again_when_it_is_back() {
        let mut robot = Robot::new();
        robot.step(Some(Request::Arm));
        assert!(robot.drives_after(10));
        robot.control.lidar.error = Some(ErrorKind::Timeout);
        assert!(!robot.drives_after(40));
        assert_eq!(robot.control.plane.state(), SafetyState::Fault(FaultReason::LidarSilent));
        robot.control.base.disarm();
        robot.control.lidar.error = None;
        assert!(robot.drives_after(200));
    }

    #[test]
    fn a_refusal_is_named_by_its_cause_and_without_one_by_the_kind_of_its_error() {
        for (cause, why) in [
            (Some(StopCause::EmergencyStop), FaultReason::EmergencyStop),
            (Some(StopCause::SafetyBoardSilent), FaultReason::SafetyBoardSilent),
            (Some(StopCause::LoopStalled), FaultReason::LoopOverrun),
            (None, FaultReason::BaseFault),
        ] {
            assert_eq!(refusal(cause, ErrorKind::Rejected), why, "{cause:?}");
        }
    }

    #[test]
    fn a_low_battery_stops_the_robot_until_a_person_has_charged_it() {
        let mut robot = Robot::new();
        robot.control.power =
            PowerWatch::new(&SafetyConfig { low_battery_v: 21.0, ..SafetyConfig::default() });
        robot.control.base.power.voltage_v = Some(20.5);
        robot.step(Some(Request::Arm));
        assert!(robot.drives_after(400), "for 4 s that may be the motors' current");
        assert!(!robot.drives_after(110));
        assert_eq!(robot.control.plane.state(), SafetyState::Fault(FaultReason::LowBattery));
        robot.step(Some(Request::ClearFault));
        robot.step(Some(Request::Arm));
        assert!(!robot.drives_after(20), "it is still low");
        robot.control.base.power.voltage_v = Some(25.0);
        assert!(!robot.drives_after(200), "charged, and no person has asked");
        robot.step(Some(Request::ClearFault));
        robot.step(Some(Request::Arm));
        assert!(robot.drives_after(10));
    }

    #[test]
    fn hot_motors_drive_slower_and_cool_ones_as_fast_as_before() {
        let mut robot = Robot::new();
        robot.step(Some(Request::Arm));
        assert!(robot.drives_after(10));
        robot.control.base.power.temperature_c = Some(200.0);
        robot.drives_after(1);
        let slow_mps = robot.control.base.moved.last().map(|twist| twist.linear_mps);
        assert!(slow_mps.is_some_and(|mps| (0.05..0.11).contains(&mps)), "{slow_mps:?}");
        robot.control.base.power.temperature_c = Some(60.0);
        assert!(robot.drives_after(1));
    }

    #[test]
    fn an_order_to_arm_that_was_given_before_the_emergency_stop_does_not_move_the_robot_after_it() {
        let mut robot = Robot::new();
        robot.step(Some(Request::Arm));
        robot.now_ns += 10 * MS;
        let pressed = Orders { emergency_stop: true, ..Orders::default() };
        robot.control.step(robot.now_ns, &pressed);
        assert_eq!(robot.control.base.arming, 0, "and the motors are let go");
        assert!(!robot.drives_after(20), "released, and no person has asked again");
        robot.step(Some(Request::Arm));
        assert!(!robot.control.has_authority(), "the fault has to be cleared first");
        robot.step(Some(Request::ClearFault));
        assert!(!robot.drives_after(20), "cleared, and no person has asked since");
        robot.step(Some(Request::Arm));
        assert!(robot.drives_after(10));
    }

    #[test]
    fn an_order_to_disarm_lets_the_motors_go_also_before_the_robot_was_ready() {
        let mut robot = Robot::new();
        robot.control.lidar.error = Some(ErrorKind::Timeout);
        robot.step(Some(Request::Arm));
        robot.drives_after(5);
        assert!(robot.control.base.arming > 3, "powered, waiting for the scanner");
        robot.step(Some(Request::Disarm));
        assert_eq!(robot.control.base.arming, 0);
        robot.control.lidar.error = None;
        assert!(!robot.drives_after(20));
    }

    #[test]
    fn a_base_that_is_not_there_yet_is_asked_again_for_ten_seconds() {
        for kind in [ErrorKind::Rejected, ErrorKind::Disconnected, ErrorKind::Timeout] {
            for (steps, drives) in [(5, true), (990, true), (1001, false)] {
                let mut robot = Robot::new();
                robot.control.base.broken = Some(kind);
                robot.step(Some(Request::Arm));
                // No later step is exactly ten seconds after the request.
                robot.now_ns += 3 * MS;
                assert!(!robot.drives_after(steps));
                robot.control.base.broken = None;
                assert_eq!(robot.drives_after(10), drives, "{kind:?} after {steps} steps");
            }
        }
    }

    #[test]
    fn a_request_to_arm_a_faulty_base_is_void_at_once_and_says_why() {
        let mut robot = Robot::new();
        robot.control.base.broken = Some(ErrorKind::Fault);
        let output = robot.step(Some(Request::Arm));
        assert_eq!(output.event, Some(SafetyEvent::ArmingLapsed { why: FaultReason::BaseFault }));
        robot.control.base.broken = None;
        assert!(!robot.drives_after(20));
    }

    #[test]
    fn motors_whose_feedback_is_late_while_they_are_being_configured_do_not_end_the_request() {
        let mut robot = Robot::new();
        robot.step(None);
        robot.control.base.more_steps = 60;
        robot.control.base.unheard = Some(ErrorKind::Corrupt);
        robot.step(Some(Request::Arm));
        assert!(!robot.drives_after(40));
        robot.control.base.unheard = None;
        assert!(robot.drives_after(40));
    }

    #[test]
    fn a_base_that_is_faulty_from_the_beginning_is_not_waited_for() {
        let mut robot = Robot::new();
        robot.control.base.broken = Some(ErrorKind::Fault);
        robot.control.base.unheard = Some(ErrorKind::Fault);
        let output = robot.step(Some(Request::Arm));
        assert_eq!(output.event, Some(SafetyEvent::ArmingLapsed { why: FaultReason::BaseFault }));
    }

    #[test]
    fn motors_that_lose_power_while_the_robot_waits_for_its_scanner_end_the_request_to_arm() {
        let mut robot = Robot::new();
        robot.control.lidar.error = Some(ErrorKind::Timeout);
        robot.step(Some(Request::Arm));
        robot.drives_after(10);
        robot.control.base.broken = Some(ErrorKind::Timeout);
        robot.drives_after(10);
        robot.control.base.broken = None;
        robot.control.lidar.error = None;
        assert!(!robot.drives_after(20));
    }

    #[test]
    fn a_board_or_motors_that_are_lost_while_the_scanner_is_awaited_end_the_request_and_name_the_reason()
     {
        for (cause, why) in [
            (StopCause::SafetyBoardSilent, FaultReason::SafetyBoardSilent),
            (StopCause::MotorsLost, FaultReason::BaseSilent),
        ] {
            let mut robot = Robot::new();
            robot.control.lidar.error = Some(ErrorKind::Timeout);
            let first = robot.step(Some(Request::Arm)).event;
            assert!(!matches!(first, Some(SafetyEvent::ArmingLapsed { .. })), "{first:?}");
            robot.drives_after(10);
            robot.control.base.demands = Some(cause);
            assert_eq!(robot.step(None).event, Some(SafetyEvent::ArmingLapsed { why }));
            robot.control.base.demands = None;
            robot.control.lidar.error = None;
            assert!(!robot.drives_after(20), "{cause:?}");
        }
    }

    #[test]
    fn a_pause_of_half_a_second_ends_every_request_to_arm() {
        for (pause_ms, drives) in [(490, true), (510, false)] {
            let mut waiting = Robot::new();
            waiting.control.lidar.error = Some(ErrorKind::Timeout);
            waiting.step(Some(Request::Arm));
            waiting.drives_after(10);
            waiting.now_ns += (pause_ms - 10) * MS;
            waiting.step(None);
            waiting.control.lidar.error = None;
            assert_eq!(waiting.drives_after(20), drives, "waiting, {pause_ms} ms");
            let mut driving = Robot::new();
            driving.step(Some(Request::Arm));
            assert!(driving.drives_after(10));
            driving.now_ns += (pause_ms - 10) * MS;
            driving.step(None);
            assert_eq!(driving.drives_after(200), drives, "driving, {pause_ms} ms");
        }
    }

    #[test]
    fn a_suspended_computer_is_a_pause_that_the_monotonic_clock_does_not_show() {
        let mut robot = Robot::new();
        robot.step(Some(Request::Arm));
        assert!(robot.drives_after(10));
        let resumed = Orders { suspended: true, ..Orders::default() };
        let state = robot.control.step(robot.now_ns + 10 * MS, &resumed).state;
        assert_eq!(state, SafetyState::Fault(FaultReason::LoopStalled));
    }

    #[test]
    fn a_broken_frame_of_feedback_is_no_fault_and_silence_is() {
        let mut robot = Robot::new();
        robot.step(Some(Request::Arm));
        robot.drives_after(10);
        robot.control.base.unheard = Some(ErrorKind::Corrupt);
        assert!(robot.drives_after(20), "the last one is not 0.2 s old");
        assert!(!robot.drives_after(2));
        assert_eq!(robot.control.plane.state(), SafetyState::Fault(FaultReason::BaseSilent));
    }

    #[test]
    fn a_command_tells_the_age_of_its_plan_unless_the_robot_stands_or_drives_by_itself() {
        let mut robot = Robot::new();
        robot.step(Some(Request::Arm));
        robot.drives_after(50);
        assert_eq!(robot.step_with_plan_of_age(40 * MS), 40 * MS);
        assert_eq!(robot.step_with_plan_of_age(400 * MS), 0, "refused: it stands");
        // A wall: after one step at standstill the robot backs off without a plan, whatever the age
        // of the plan.
        robot.control.lidar.ahead_m = 0.2;
        let ages: Vec<u64> = (0..3).map(|_| robot.step_with_plan_of_age(40 * MS)).collect();
        assert!(robot.control.base.moved.last().is_some_and(|twist| twist.linear_mps < 0.0));
        assert_eq!(ages[2], 0);
    }

    #[test]
    fn shutting_down_brakes_lets_the_motors_go_and_gives_the_devices_back() {
        let mut robot = Robot::new();
        robot.step(Some(Request::Arm));
        assert!(robot.drives_after(10));
        assert_eq!(robot.control.lidar().error, None);
        assert!(
            robot.control.base().arming > 3 && robot.control.plane().state() == SafetyState::Clear
        );
        let (base, lidar) = robot.control.shut_down();
        assert_eq!(
            (base.moved.last(), base.arming, lidar.time_ns),
            (Some(&Twist2::ZERO), 0, robot.now_ns)
        );
    }

    #[test]
    fn a_scanner_that_is_gone_is_told_with_its_kind_and_stops_the_robot_in_time() {
        let mut robot = Robot::new();
        robot.step(Some(Request::Arm));
        assert!(robot.drives_after(10));
        robot.control.lidar.error = Some(ErrorKind::Disconnected);
        assert!(!robot.drives_after(24), "the default allows 0.2 s after the end of the last scan");
        let step = robot.control.step(robot.now_ns + 10 * MS, &Orders::default());
        assert_eq!(step.lidar_error, Some(ErrorKind::Disconnected));
        assert!(step.scan.is_none());
    }
}
