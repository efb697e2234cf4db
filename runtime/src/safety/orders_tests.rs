//! Exhaustive search over all sequences of eight events: the invariants hold after each of them,
//! and the robot can always drive again.

use std::collections::BTreeMap;

use super::*;
use crate::event::FaultReason;
use hal::{LaserScan, Pose2, Range, ScanGeometry, Twist2, WheelFeedback};

const DEPTH: u32 = 8;
const TICK_NS: u64 = 100_000_000;
const FORWARD: Twist2 = Twist2 { linear_mps: 0.3, angular_radps: 0.0 };

/// What happens in one tick. The planner asks for forward motion in each of them.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Happening {
    /// A scan of free ground, and a request to arm.
    Free,
    /// A scan with a wall in the stop zone.
    Wall,
    /// No scan and no wheel feedback for longer than allowed.
    Silence,
    /// A scan in which every beam is an error.
    BrokenScan,
    /// The base reports a fault.
    BaseFault,
    EmergencyStop,
    /// The operator clears the fault.
    Clear,
    /// The plan is NaN, the wheels are blocked and the bumper is pressed.
    Contact,
    /// The cliff sensors see no floor.
    Cliff,
}

const ALL: [Happening; 9] = [
    Happening::Free,
    Happening::Wall,
    Happening::Silence,
    Happening::BrokenScan,
    Happening::BaseFault,
    Happening::EmergencyStop,
    Happening::Clear,
    Happening::Contact,
    Happening::Cliff,
];

/// A coarse scanner, because the search takes millions of ticks.
const GEOMETRY: ScanGeometry = ScanGeometry {
    angle_min_rad: -2.0,
    angle_increment_rad: 0.25,
    beams: 17,
    range_min_m: 0.1,
    range_max_m: 30.0,
    period_ns: TICK_NS,
    clockwise: false,
};

struct Scans {
    free: LaserScan,
    wall: LaserScan,
    broken: LaserScan,
}

impl Scans {
    fn new() -> Self {
        let mut broken = Self::scan(Range::Error);
        broken.ranges.fill(Range::Error);
        Self { free: Self::scan(Range::Hit(3.0)), wall: Self::scan(Range::Hit(0.2)), broken }
    }

    /// A scan with this range in the five beams ahead and 3 m in all others.
    fn scan(ahead: Range) -> LaserScan {
        LaserScan {
            time_ns: 0,
            geometry: GEOMETRY,
            ranges: (0..17)
                .map(|beam| if (6..=10).contains(&beam) { ahead } else { Range::Hit(3.0) })
                .collect(),
        }
    }

    fn at(&mut self, happening: Happening, time_ns: u64) -> Option<&LaserScan> {
        let scan = match happening {
            Happening::Silence => return None,
            Happening::Wall => &mut self.wall,
            Happening::BrokenScan => &mut self.broken,
            _ => &mut self.free,
        };
        scan.time_ns = time_ns;
        // No two scans of a working scanner are the same.
        if happening != Happening::BrokenScan
            && let Some(range) = scan.ranges.first_mut()
        {
            *range = Range::Hit(3.0 + (time_ns / TICK_NS % 64) as f32 / 1024.0);
        }
        Some(scan)
    }
}

#[derive(Clone, PartialEq)]
struct Robot {
    plane: SafetyPlane,
    time_ns: u64,
    pose: Pose2,
    /// Time of the last good scan.
    observed_ns: u64,
    /// A fault that needs an operator has occurred and was not cleared since.
    needs_operator: bool,
}

impl Robot {
    fn new() -> Self {
        let plane = SafetyPlane::new(SafetyConfig::default());
        Self { plane, time_ns: 0, pose: Pose2::IDENTITY, observed_ns: 0, needs_operator: false }
    }

    fn step(&mut self, happening: Happening, scans: &mut Scans) -> SafetyOutput {
        let silent = happening == Happening::Silence;
        self.time_ns += TICK_NS * if silent { 3 } else { 1 };
        if !matches!(happening, Happening::Silence | Happening::BrokenScan) {
            self.observed_ns = self.time_ns;
        }
        let contact = happening == Happening::Contact;
        let plan =
            if contact { Twist2 { linear_mps: f64::NAN, angular_radps: 0.0 } } else { FORWARD };
        let wheel = WheelFeedback {
            time_ns: self.time_ns,
            odom: self.pose,
            twist: Twist2::ZERO,
            contact,
            cliff: happening == Happening::Cliff,
        };
        let output = self.plane.step(&SafetyInput {
            time_ns: self.time_ns,
            scan: scans.at(happening, self.time_ns),
            wheel: (!silent).then_some(wheel),
            base_error: (happening == Happening::BaseFault).then_some(FaultReason::BaseFault),
            emergency_stop: happening == Happening::EmergencyStop,
            suspended: false,
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

    /// Asserts the invariants that hold after every tick.
    fn check(&mut self, happening: Happening, before: SafetyState, output: &SafetyOutput) {
        let twist = output.twist();
        assert!(twist.is_finite());
        let blind = [
            Happening::Silence,
            Happening::BrokenScan,
            Happening::BaseFault,
            Happening::EmergencyStop,
        ];
        if blind.contains(&happening) {
            assert_eq!(output.command, None, "must stop on {happening:?}");
        }
        if matches!(happening, Happening::Wall | Happening::Contact | Happening::Cliff) {
            assert!(twist.linear_mps <= 0.0, "never forward into {happening:?}");
        }
        let state = self.plane.state();
        if matches!(state, SafetyState::Disarmed | SafetyState::Fault(_)) {
            assert_eq!(output.command, None);
        }
        let armed = before != SafetyState::Disarmed;
        if happening == Happening::EmergencyStop || armed && happening == Happening::BaseFault {
            self.needs_operator = true;
        }
        if self.needs_operator {
            assert_eq!(output.command, None, "nothing moves before an operator has cleared it");
            self.needs_operator = state != SafetyState::Disarmed;
            assert!(self.needs_operator || happening == Happening::Clear);
        }
        let changed = std::mem::discriminant(&before) != std::mem::discriminant(&state);
        let rolls =
            matches!((before, state), (SafetyState::Tripped { .. }, SafetyState::BackingOff(_)));
        assert!(
            !changed || rolls || output.event.is_some(),
            "{before:?} -> {state:?} without an event"
        );
        assert!(
            !changed || state != SafetyState::Fault(FaultReason::LoopOverrun),
            "silence must be reported with its own reason"
        );
    }

    /// Whether the robot drives forward again when all inputs are good and an operator clears the
    /// fault.
    fn can_go_on(mut self, scans: &mut Scans) -> bool {
        self.step(Happening::Clear, scans);
        (0..300).any(|_| self.step(Happening::Free, scans).twist() == FORWARD)
    }
}

/// Robots, each with the number of event sequences that have led to it. Sequences that end in the
/// same complete state behave the same from there on, so they are continued together.
#[derive(Default)]
struct Robots(BTreeMap<String, Vec<(Robot, u64)>>);

impl Robots {
    fn add(&mut self, robot: Robot, sequences: u64) {
        // The key only finds candidates for equality quickly.
        let candidates = self
            .0
            .entry(format!(
                "{:?} {:?} {} {}",
                robot.plane.state(),
                robot.pose,
                robot.time_ns,
                robot.observed_ns
            ))
            .or_default();
        match candidates.iter_mut().find(|(known, _)| *known == robot) {
            Some((_, count)) => *count += sequences,
            None => candidates.push((robot, sequences)),
        }
    }

    fn each(&self) -> impl Iterator<Item = &(Robot, u64)> {
        self.0.values().flatten()
    }
}

#[test]
fn after_every_sequence_of_eight_events_the_invariants_hold_and_the_robot_can_drive_again() {
    let mut scans = Scans::new();
    // The robot begins disarmed; the first `Free` event arms it.
    let mut robots = Robots::default();
    robots.add(Robot::new(), 1);
    for depth in 1..=DEPTH {
        let mut next = Robots::default();
        let mut walked = 0;
        for ((robot, sequences), happening) in
            robots.each().flat_map(|robot| ALL.map(|happening| (robot, happening)))
        {
            let mut robot = robot.clone();
            let before = robot.plane.state();
            let output = robot.step(happening, &mut scans);
            robot.check(happening, before, &output);
            walked += sequences;
            if depth < DEPTH {
                next.add(robot, *sequences);
            }
        }
        assert_eq!(walked, (ALL.len() as u64).pow(depth), "no sequence was left out");
        robots = next;
        // Driving again takes many ticks, so it is tried from every state up to depth five only.
        if depth <= 5 {
            for (robot, _) in robots.each() {
                assert!(robot.clone().can_go_on(&mut scans), "stuck in {:?}", robot.plane.state());
            }
        }
    }
}
