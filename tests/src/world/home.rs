//! The robot in its home: wheels in, pose out.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use drivers::can::{BaseConfig, Kinematics};
use hal::{Base, Clock, DriveCommand, LaserScan, Lidar, Pose2};
use simulator::robot::{SimBase, SimClock, SimLidar, Truth};
use simulator::{RobotOptions, SceneError, SimulatedRobot, World};

use crate::motor::MotorNode;

/// Wheels that stop against something and push again touch it once.
const SAME_TOUCH_NS: u64 = 1_000_000_000;
/// How long it is known where it was: cameras are late by no more.
const PAST_NS: u64 = 500_000_000;

/// The robot in its home, shared between its devices.
#[derive(Clone)]
pub struct Home {
    world: Arc<World>,
    inside: Arc<Mutex<Inside>>,
}

struct Inside {
    base: SimBase,
    clock: SimClock,
    lidar: SimLidar,
    scan: LaserScan,
    truth: Truth,
    kinematics: Kinematics,
    wheel_radius_m: f64,
    counter: u32,
    /// When it touched something last.
    touched_ns: Option<u64>,
    touches: u64,
    path_m: f64,
    /// Where it was, and when.
    past: VecDeque<(u64, Pose2)>,
}

impl Home {
    /// Puts a robot with these wheels into the home. Its time begins at 0.
    ///
    /// # Errors
    /// When it does not fit there.
    pub fn new(
        world: Arc<World>,
        options: RobotOptions,
        base: &BaseConfig,
    ) -> Result<Self, SceneError> {
        let devices = SimulatedRobot::new(Arc::clone(&world), options)?.devices();
        let scan = LaserScan::empty(devices.lidar.geometry());
        let inside = Inside {
            base: devices.base,
            clock: devices.clock,
            lidar: devices.lidar,
            scan,
            truth: devices.truth,
            kinematics: Kinematics { track_m: base.track_m },
            wheel_radius_m: base.wheel_radius_m,
            counter: 0,
            touched_ns: None,
            touches: 0,
            path_m: 0.0,
            past: VecDeque::new(),
        };
        Ok(Self { world, inside: Arc::new(Mutex::new(inside)) })
    }

    fn inside(&self) -> MutexGuard<'_, Inside> {
        self.inside.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The home itself, to look at.
    #[must_use]
    pub fn world(&self) -> &World {
        &self.world
    }

    /// Time passes up to `time_ns` while the wheels turn as they do. A wheel whose robot stands against something does not turn.
    pub fn pass(&self, time_ns: u64, wheels: &mut [Box<dyn MotorNode>; 2]) {
        let mut inside = self.inside();
        let rims =
            wheels.each_ref().map(|node| node.wheel().velocity_radps() * inside.wheel_radius_m);
        let twist = inside.kinematics.twist(rims);
        inside.counter = inside.counter.wrapping_add(1);
        let command = DriveCommand { twist, counter: inside.counter, plan_age_ns: 0 };
        // Wheels are finite, so nothing is refused.
        let _ = inside.base.drive(&command);
        let before = inside.truth.pose();
        inside.clock.sleep_until_ns(time_ns);
        let pose = inside.truth.pose();
        inside.path_m += before.distance_m(&pose);
        inside.past.push_back((time_ns, pose));
        while inside.past.front().is_some_and(|(then_ns, _)| then_ns + PAST_NS < time_ns) {
            inside.past.pop_front();
        }
        let touching = inside.truth.contact();
        if touching {
            let before_ns = inside.touched_ns.replace(time_ns);
            inside.touches +=
                u64::from(before_ns.is_none_or(|before_ns| time_ns - before_ns > SAME_TOUCH_NS));
        }
        for node in wheels {
            node.wheel_mut().blocked = touching;
        }
    }

    /// The newest scan. Not the same as a scanner's own: its noise is drawn anew once in a period.
    pub fn scan(&self, read: impl FnOnce(&LaserScan)) {
        let mut inside = self.inside();
        let Inside { lidar, scan, .. } = &mut *inside;
        // A simulated scanner never fails.
        let _ = lidar.poll_scan(scan);
        read(scan);
    }

    /// Where it really is.
    #[must_use]
    pub fn pose(&self) -> Pose2 {
        self.inside().truth.pose()
    }

    /// Where it was so long ago, half a second at most.
    #[must_use]
    pub fn pose_ago(&self, ago_ns: u64) -> Pose2 {
        let inside = self.inside();
        let then_ns = inside.past.back().map_or(0, |(now_ns, _)| now_ns.saturating_sub(ago_ns));
        let then = inside.past.iter().find(|(time_ns, _)| *time_ns >= then_ns);
        then.map_or_else(|| inside.truth.pose(), |(_, pose)| *pose)
    }

    /// How often it has touched something, and its way in metres.
    #[must_use]
    pub fn score(&self) -> (u64, f64) {
        let inside = self.inside();
        (inside.touches, inside.path_m)
    }
}
