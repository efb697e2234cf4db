//! The simulated robot in its home: advances by the velocities of its simulated wheels.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use drivers::can::{BaseConfig, Kinematics};
use hal::{Base, Clock, DriveCommand, Pose2, Twist2};
use simulator::robot::{SimBase, SimClock, SimImu, SimLidar, Truth};
use simulator::{RobotOptions, SceneError, SimulatedRobot, World};

use super::hands::{Handled, Push};
use super::wheels::Wheels;
use crate::motor::MotorNode;

/// Contacts within this time count as one touch: blocked wheels push repeatedly.
const SAME_TOUCH_NS: u64 = 1_000_000_000;

/// The robot in its home, shared between its devices.
#[derive(Clone)]
pub struct Home {
    world: Arc<World>,
    state: Arc<Mutex<State>>,
}

struct State {
    robot: SimulatedRobot,
    base: SimBase,
    clock: SimClock,
    truth: Truth,
    kinematics: Kinematics,
    wheel_radius_m: f64,
    wheels: Wheels,
    counter: u32,
    /// Time of the last contact.
    touched_ns: Option<u64>,
    touches: u64,
    path_m: f64,
    /// A push that is not over.
    push: Option<Push>,
    /// Until then the wheels have no grip on the floor.
    spins_until_ns: u64,
}

impl Home {
    /// Places a robot with these wheels in the home. Its time begins at 0. The options contain the
    /// errors of the wheels.
    ///
    /// # Errors
    /// Returns an error when the robot does not fit at its start pose.
    pub fn new(
        world: Arc<World>,
        options: RobotOptions,
        base: &BaseConfig,
    ) -> Result<Self, SceneError> {
        let wheels = Wheels::new(options.odometry, options.seed);
        let robot = SimulatedRobot::new(Arc::clone(&world), options)?;
        let devices = robot.devices();
        let state = State {
            robot,
            base: devices.base,
            clock: devices.clock,
            truth: devices.truth,
            kinematics: Kinematics { track_m: base.track_m },
            wheel_radius_m: base.wheel_radius_m,
            wheels,
            counter: 0,
            touched_ns: None,
            touches: 0,
            path_m: 0.0,
            push: None,
            spins_until_ns: 0,
        };
        Ok(Self { world, state: Arc::new(Mutex::new(state)) })
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The home, for rendering.
    #[must_use]
    pub fn world(&self) -> &World {
        &self.world
    }

    /// Advances to `time_ns` at the current velocities of the wheels. Wheels are blocked while the
    /// robot touches an obstacle.
    pub fn advance(&self, time_ns: u64, wheels: &mut [Box<dyn MotorNode>; 2]) {
        let mut state = self.state();
        let rims =
            wheels.each_ref().map(|node| node.wheel().velocity_radps() * state.wheel_radius_m);
        let measured = state.kinematics.twist(rims);
        let seconds = time_ns.saturating_sub(state.clock.now_ns()) as f64 * 1e-9;
        let on_floor = state.wheels.on_floor(&measured, seconds);
        let twist = if time_ns < state.spins_until_ns { Twist2::ZERO } else { on_floor };
        state.counter = state.counter.wrapping_add(1);
        let command = DriveCommand { twist, counter: state.counter, plan_age_ns: 0 };
        // Wheel velocities are finite, so the command is not refused.
        let _ = state.base.drive(&command);
        let before = state.truth.pose();
        state.clock.sleep_until_ns(time_ns);
        state.path_m += before.distance_m(&state.truth.pose());
        state.go_on_pushing(seconds);
        let touching = state.truth.contact();
        if touching {
            let before_ns = state.touched_ns.replace(time_ns);
            state.touches +=
                u64::from(before_ns.is_none_or(|before_ns| time_ns - before_ns > SAME_TOUCH_NS));
        }
        for node in wheels {
            node.wheel_mut().blocked = touching;
        }
    }

    /// The robot's scanner. Its times are those of the home.
    #[must_use]
    pub fn lidar(&self) -> SimLidar {
        self.state().robot.devices().lidar
    }

    /// The robot's inertial measurement unit. Its times are those of the home.
    #[must_use]
    pub fn imu(&self) -> SimImu {
        self.state().robot.devices().imu
    }

    /// Does to the robot what a person would do. Its wheels do not notice.
    ///
    /// # Errors
    /// A place where the robot does not fit, with the nearest one where it does.
    pub fn handle(&self, what: &Handled) -> Result<(), String> {
        let mut state = self.state();
        match *what {
            Handled::Carried(pose) => {
                self.check_fit(&pose)?;
                state.push = None;
                state.robot.carry_to(pose);
            }
            Handled::Pushed { forward_m, left_m } => {
                let end = state.truth.pose().compose(&Pose2::new(forward_m, left_m, 0.0));
                self.check_fit(&end)?;
                state.push = Some(Push::new(forward_m, left_m));
            }
            Handled::WithoutGrip { seconds } => {
                let now_ns = state.clock.now_ns();
                state.spins_until_ns = now_ns + (seconds * 1e9) as u64;
            }
        }
        Ok(())
    }

    fn check_fit(&self, pose: &Pose2) -> Result<(), String> {
        let Pose2 { x_m, y_m, .. } = *pose;
        let plan = self.world.floor_plan();
        if plan.fits(x_m, y_m, &[]) {
            return Ok(());
        }
        let [near_x_m, near_y_m] = plan.nearest_free(x_m, y_m);
        Err(format!(
            "the robot does not fit at ({x_m:.2}, {y_m:.2}) m; it does at ({near_x_m:.2}, {near_y_m:.2}) m"
        ))
    }

    /// Whether the wheels have no grip on the floor now.
    #[must_use]
    pub fn is_without_grip(&self) -> bool {
        let state = self.state();
        state.clock.now_ns() < state.spins_until_ns
    }

    /// True pose of the robot.
    #[must_use]
    pub fn pose(&self) -> Pose2 {
        self.state().truth.pose()
    }

    /// True pose of the robot `ago_ns` earlier, at most a second.
    #[must_use]
    pub fn pose_ago(&self, ago_ns: u64) -> Pose2 {
        let state = self.state();
        state.truth.pose_at(state.clock.now_ns().saturating_sub(ago_ns))
    }

    /// Number of touches, and driven distance in metres.
    #[must_use]
    pub fn score(&self) -> (u64, f64) {
        let state = self.state();
        (state.touches, state.path_m)
    }
}

impl State {
    fn go_on_pushing(&mut self, seconds: f64) {
        let Some(push) = &mut self.push else { return };
        let Some(motion) = push.step(seconds) else {
            self.push = None;
            return;
        };
        // What stands in the way ends a push.
        if !self.robot.push_by(&motion) {
            self.push = None;
        }
    }
}
