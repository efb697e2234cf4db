//! Every order of events, eight deep: what must never happen does not, and the robot can always go on.

use super::*;
use crate::event::FaultReason;
use hal::{ErrorKind, LaserScan, Pose2, Range, ScanGeometry, Twist2, WheelFeedback};

const DEPTH: usize = 8;
const TICK_NS: u64 = 100_000_000;
const FORWARD: Twist2 = Twist2 { linear_mps: 0.3, angular_radps: 0.0 };

/// What may happen in one turn. In every one the planner wants to drive on.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Happening {
    /// A scan of free ground; whoever may arm, arms.
    Free,
    /// A scan with a wall in the stop zone.
    Wall,
    /// No scan and no wheels for longer than allowed.
    Silence,
    /// A scan of errors.
    BrokenScan,
    /// The base says that it has a fault.
    BaseFault,
    /// The emergency stop is pressed.
    EmergencyStop,
    /// An operator clears the fault.
    Clear,
    /// The plan is NaN, the wheels are blocked and feel it.
    Contact,
}

const ALL: [Happening; 8] = [
    Happening::Free,
    Happening::Wall,
    Happening::Silence,
    Happening::BrokenScan,
    Happening::BaseFault,
    Happening::EmergencyStop,
    Happening::Clear,
    Happening::Contact,
];

/// A coarse scanner: the search takes millions of turns.
const GEOMETRY: ScanGeometry = ScanGeometry {
    angle_min_rad: -2.0,
    angle_increment_rad: 0.25,
    beams: 17,
    range_min_m: 0.1,
    range_max_m: 30.0,
    period_ns: TICK_NS,
};

struct Scans {
    free: LaserScan,
    wall: LaserScan,
    broken: LaserScan,
}

impl Scans {
    fn new() -> Self {
        let scan = |ahead| LaserScan {
            time_ns: 0,
            geometry: GEOMETRY,
            ranges: (0..17).map(|beam| if (6..=10).contains(&beam) { ahead } else { Range::Hit(3.0) }).collect(),
        };
        let mut broken = scan(Range::Error);
        broken.ranges.fill(Range::Error);
        Self { free: scan(Range::Hit(3.0)), wall: scan(Range::Hit(0.2)), broken }
    }

    fn at(&mut self, happening: Happening, time_ns: u64) -> Option<&LaserScan> {
        let scan = match happening {
            Happening::Silence => return None,
            Happening::Wall => &mut self.wall,
            Happening::BrokenScan => &mut self.broken,
            _ => &mut self.free,
        };
        scan.time_ns = time_ns;
        Some(scan)
    }
}

#[derive(Clone)]
struct Robot {
    plane: SafetyPlane,
    time_ns: u64,
    pose: Pose2,
    /// What the plane was told and not told again since: a person is needed.
    needs_person: bool,
}

impl Robot {
    fn new() -> Self {
        let plane = SafetyPlane::new(SafetyConfig::default());
        Self { plane, time_ns: 0, pose: Pose2::IDENTITY, needs_person: false }
    }

    fn turn(&mut self, happening: Happening, scans: &mut Scans) -> SafetyOutput {
        let silent = happening == Happening::Silence;
        self.time_ns += TICK_NS * if silent { 3 } else { 1 };
        let contact = happening == Happening::Contact;
        let plan = if contact { Twist2 { linear_mps: f64::NAN, angular_radps: 0.0 } } else { FORWARD };
        let wheel = WheelFeedback { time_ns: self.time_ns, odom: self.pose, twist: Twist2::ZERO, contact };
        let output = self.plane.step(&SafetyInput {
            time_ns: self.time_ns,
            scan: scans.at(happening, self.time_ns),
            wheel: (!silent).then_some(wheel),
            base_error: (happening == Happening::BaseFault).then_some(ErrorKind::Fault),
            emergency_stop: happening == Happening::EmergencyStop,
            plan: Some(Plan { twist: plan, time_ns: self.time_ns }),
            request: match happening {
                Happening::Clear => Some(Request::ClearFault),
                Happening::Free => Some(Request::Arm),
                _ => None,
            },
        });
        if !contact {
            self.pose = self.pose.compose(&output.twist().integrate(0.1));
        }
        output
    }

    /// What must hold after every turn.
    fn check(&mut self, happening: Happening, before: SafetyState, output: &SafetyOutput) {
        let twist = output.twist();
        assert!(twist.is_finite());
        let blind = [Happening::Silence, Happening::BrokenScan, Happening::BaseFault, Happening::EmergencyStop];
        if blind.contains(&happening) {
            assert_eq!(output.command, None, "stands on {happening:?}");
        }
        if happening == Happening::Wall || happening == Happening::Contact {
            assert!(twist.linear_mps <= 0.0, "never forward into {happening:?}");
        }
        let state = self.plane.state();
        if matches!(state, SafetyState::Disarmed | SafetyState::Fault(_)) {
            assert_eq!(output.command, None);
        }
        let armed = before != SafetyState::Disarmed;
        if armed && matches!(happening, Happening::BaseFault | Happening::EmergencyStop) {
            self.needs_person = true;
        }
        if self.needs_person {
            assert_eq!(output.command, None, "nothing moves before a person has cleared it");
            self.needs_person = state != SafetyState::Disarmed;
            assert!(self.needs_person || happening == Happening::Clear);
        }
        let changed = std::mem::discriminant(&before) != std::mem::discriminant(&state);
        let rolls = matches!((before, state), (SafetyState::Tripped { .. }, SafetyState::BackingOff { .. }));
        assert!(!changed || rolls || output.event.is_some(), "{before:?} -> {state:?} without a word");
        assert!(!changed || state != SafetyState::Fault(FaultReason::LoopOverrun), "silence has a better reason");
    }

    /// With everything well and a person to help, it drives forward again.
    fn can_go_on(mut self, scans: &mut Scans) -> bool {
        self.turn(Happening::Clear, scans);
        (0..300).any(|_| self.turn(Happening::Free, scans).twist() == FORWARD)
    }
}

fn every_order(robot: &Robot, depth: usize, scans: &mut Scans, turns: &mut u64) {
    for happening in ALL {
        let mut next = robot.clone();
        let before = next.plane.state();
        let output = next.turn(happening, scans);
        next.check(happening, before, &output);
        *turns += 1;
        if depth > 1 {
            every_order(&next, depth - 1, scans, turns);
        }
        // The way back to driving is long; it is walked from every state five deep.
        if depth + 5 == DEPTH + 1 {
            assert!(next.clone().can_go_on(scans), "stuck in {:?}", next.plane.state());
        }
    }
}

#[test]
fn in_every_order_of_eight_events_it_stands_when_it_must_says_why_and_can_go_on() {
    let mut turns = 0;
    let mut scans = Scans::new();
    // Armed and driving, and not yet armed: the first turn of `Free` is what arms.
    every_order(&Robot::new(), DEPTH, &mut scans, &mut turns);
    assert_eq!(turns, (1..=8).map(|depth| 8_u64.pow(depth)).sum::<u64>());
}
