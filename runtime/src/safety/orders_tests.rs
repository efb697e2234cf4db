//! Every order of events, eight deep: what must never happen does not, and the robot can always go on.

use std::collections::BTreeMap;

use super::*;
use crate::event::FaultReason;
use hal::{ErrorKind, LaserScan, Pose2, Range, ScanGeometry, Twist2, WheelFeedback};

const DEPTH: u32 = 8;
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
            ranges: (0..17)
                .map(|beam| if (6..=10).contains(&beam) { ahead } else { Range::Hit(3.0) })
                .collect(),
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

#[derive(Clone, PartialEq)]
struct Robot {
    plane: SafetyPlane,
    time_ns: u64,
    pose: Pose2,
    /// When it looked around last.
    looked_ns: u64,
    /// What the plane was told and not told again since: a person is needed.
    needs_person: bool,
}

impl Robot {
    fn new() -> Self {
        let plane = SafetyPlane::new(SafetyConfig::default());
        Self { plane, time_ns: 0, pose: Pose2::IDENTITY, looked_ns: 0, needs_person: false }
    }

    fn turn(&mut self, happening: Happening, scans: &mut Scans) -> SafetyOutput {
        let silent = happening == Happening::Silence;
        self.time_ns += TICK_NS * if silent { 3 } else { 1 };
        if !matches!(happening, Happening::Silence | Happening::BrokenScan) {
            self.looked_ns = self.time_ns;
        }
        let contact = happening == Happening::Contact;
        let plan =
            if contact { Twist2 { linear_mps: f64::NAN, angular_radps: 0.0 } } else { FORWARD };
        let wheel =
            WheelFeedback { time_ns: self.time_ns, odom: self.pose, twist: Twist2::ZERO, contact };
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
        let blind = [
            Happening::Silence,
            Happening::BrokenScan,
            Happening::BaseFault,
            Happening::EmergencyStop,
        ];
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
        if happening == Happening::EmergencyStop || armed && happening == Happening::BaseFault {
            self.needs_person = true;
        }
        if self.needs_person {
            assert_eq!(output.command, None, "nothing moves before a person has cleared it");
            self.needs_person = state != SafetyState::Disarmed;
            assert!(self.needs_person || happening == Happening::Clear);
        }
        let changed = std::mem::discriminant(&before) != std::mem::discriminant(&state);
        let rolls =
            matches!((before, state), (SafetyState::Tripped { .. }, SafetyState::BackingOff(_)));
        assert!(
            !changed || rolls || output.event.is_some(),
            "{before:?} -> {state:?} without a word"
        );
        assert!(
            !changed || state != SafetyState::Fault(FaultReason::LoopOverrun),
            "silence has a better reason"
        );
    }

    /// With everything well and a person to help, it drives forward again.
    fn can_go_on(mut self, scans: &mut Scans) -> bool {
        self.turn(Happening::Clear, scans);
        (0..300).any(|_| self.turn(Happening::Free, scans).twist() == FORWARD)
    }
}

/// Robots, each with the number of orders of events that have led to it. Orders that end in the same state of everything
/// cannot differ from there on: they are walked on together.
#[derive(Default)]
struct Robots(BTreeMap<String, Vec<(Robot, u64)>>);

impl Robots {
    fn add(&mut self, robot: Robot, orders: u64) {
        // Only to find equals quickly.
        let like_it = self
            .0
            .entry(format!(
                "{:?} {:?} {} {}",
                robot.plane.state(),
                robot.pose,
                robot.time_ns,
                robot.looked_ns
            ))
            .or_default();
        match like_it.iter_mut().find(|(known, _)| *known == robot) {
            Some((_, count)) => *count += orders,
            None => like_it.push((robot, orders)),
        }
    }

    fn each(&self) -> impl Iterator<Item = &(Robot, u64)> {
        self.0.values().flatten()
    }
}

#[test]
fn in_every_order_of_eight_events_it_stands_when_it_must_says_why_and_can_go_on() {
    let mut scans = Scans::new();
    // Armed and driving, and not yet armed: the first turn of `Free` is what arms.
    let mut robots = Robots::default();
    robots.add(Robot::new(), 1);
    for depth in 1..=DEPTH {
        let (mut next, mut walked) = (Robots::default(), 0);
        for ((robot, orders), happening) in
            robots.each().flat_map(|robot| ALL.map(|happening| (robot, happening)))
        {
            let mut robot = robot.clone();
            let before = robot.plane.state();
            let output = robot.turn(happening, &mut scans);
            robot.check(happening, before, &output);
            walked += orders;
            if depth < DEPTH {
                next.add(robot, *orders);
            }
        }
        assert_eq!(walked, 8_u64.pow(depth), "no order was left out");
        robots = next;
        // The way back to driving is long; it is walked from every state five deep.
        if depth <= 5 {
            for (robot, _) in robots.each() {
                assert!(robot.clone().can_go_on(&mut scans), "stuck in {:?}", robot.plane.state());
            }
        }
    }
}
