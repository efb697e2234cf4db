//! The one loop of the project: sense, perceive, map, decide, hand the plan to the safety loop, record.
//!
//! `explore`, `run`, the hardware-in-the-loop scenarios and the accuracy tool are [`Session`]s that differ in their [`Devices`]
//! and their clock only. `Robot::tick` is visible in this crate alone, and its two callers are [`Session::tick`] and
//! [`recompute`], which takes a recorded tick. A loop in another crate cannot call it.
//!
//! The safety loop stands outside. On a robot a thread of its own steps it; in simulation [`VirtualTime`] steps it, at the same
//! rate and through the same queues ([`safety_link`]).

mod safety_link;
mod scan_history;
#[cfg(test)]
mod tests;
mod virtual_time;
mod wheel_history;

use hal::{Clock, DepthMap, ImageView, ImuSample, LaserScan};

pub use safety_link::{SafetyPort, SafetyTask, safety_link};
pub use virtual_time::{VirtualDevices, VirtualTime};

use crate::imu::ImuHistory;
use crate::operator::OperatorOrder;
use crate::outside_pose::{OutsideInput, OutsidePose};
use crate::recording::{RecordedTick, RecordingError};
use crate::robot::{Robot, StageTimer};
use crate::safety::Plan;
use crate::task::{AreaChange, AreaTooFar, NotFinite, Task};
use crate::tick::{Decision, SafetyReport, TickInput};
use wheel_history::WheelHistory;

/// Samples of the inertial unit that one tick takes: two seconds of a fast unit. The others wait.
const MOST_SAMPLES: usize = 2000;
/// Orders that wait for one tick. More than a second's worth comes only while there are no ticks.
const MOST_ORDERS: usize = 64;

/// The exploration loop's devices: a clock, a camera, and an inertial measurement unit if there is one. Wheels and scans come
/// through the [`SafetyPort`].
pub trait Devices: Clock {
    /// Fetches the newest frame, if there is a new one. Returns the time at which it was taken, monotonic nanoseconds.
    fn poll_frame(&mut self) -> Option<u64>;

    /// The frame that was fetched last: RGB8, of the size that perception works on.
    fn frame(&self) -> Option<ImageView<'_>>;

    /// The oldest sample of the inertial measurement unit that was not returned before, in the axes of `base_link`. `None` when
    /// there is none.
    fn poll_imu(&mut self) -> Option<ImuSample> {
        None
    }

    /// Ground-truth depth of that frame. Only simulated devices have it, and only for the depth source `truth`.
    fn truth(&self) -> Option<&DepthMap> {
        None
    }
}

/// What a program adds to the loop: recording, reports, new models. Only a new model changes
/// decisions, and it is recorded as an event.
pub trait Observer: StageTimer {
    /// The error that ends the session.
    type Error;

    /// Called when a tick begins.
    fn started(&mut self) {}

    /// Called when the tick's input is complete, before the robot processes it.
    ///
    /// # Errors
    /// An error ends the session.
    fn before(&mut self, robot: &mut Robot, input: &TickInput<'_>) -> Result<(), Self::Error>;

    /// Called when the robot has decided and the plan is with the safety loop.
    ///
    /// # Errors
    /// An error ends the session.
    fn after(
        &mut self,
        robot: &mut Robot,
        input: &TickInput<'_>,
        decision: &Decision,
    ) -> Result<(), Self::Error>;
}

/// The exploration loop over some devices.
pub struct Session<D> {
    devices: D,
    robot: Robot,
    port: SafetyPort,
    wheels: WheelHistory,
    imu: ImuHistory,
    report: SafetyReport,
    task: Option<Task>,
    areas: Vec<AreaChange>,
    outside: Option<OutsidePose>,
    orders: Vec<OperatorOrder>,
    period_ns: u64,
    due_ns: u64,
    tick: u64,
    skipped: u64,
}

impl<D: Devices> Session<D> {
    /// A session whose first tick is one period from now.
    pub fn new(devices: D, robot: Robot, port: SafetyPort, period_ns: u64) -> Self {
        let due_ns = devices.now_ns();
        Self {
            devices,
            robot,
            port,
            wheels: WheelHistory::default(),
            imu: ImuHistory::default(),
            report: SafetyReport::default(),
            task: None,
            areas: Vec::new(),
            outside: None,
            orders: Vec::new(),
            period_ns,
            due_ns,
            tick: 0,
            skipped: 0,
        }
    }

    /// Sleeps until the next tick is due. Ticks that are already over are skipped and counted, not made up for.
    pub fn wait(&mut self) {
        let now_ns = self.devices.now_ns();
        self.due_ns += self.period_ns;
        if now_ns > self.due_ns {
            let missed = (now_ns - self.due_ns) / self.period_ns + 1;
            self.skipped += missed;
            self.due_ns += missed * self.period_ns;
        }
        self.devices.sleep_until_ns(self.due_ns);
    }

    /// Runs one tick with the newest frame and with the wheels and the scan at the time of that
    /// frame. Returns `None`, and counts no tick, before the first wheel feedback.
    ///
    /// # Errors
    /// The error of the observer.
    pub fn tick<O: Observer>(&mut self, observer: &mut O) -> Result<Option<Decision>, O::Error> {
        observer.started();
        let frame_ns = self.devices.poll_frame();
        self.port.update(&mut self.wheels, &mut self.report);
        for _ in 0..MOST_SAMPLES {
            let Some(sample) = self.devices.poll_imu() else { break };
            self.imu.push(&sample);
        }
        let time_ns = self.devices.now_ns();
        let wheel = match frame_ns {
            Some(frame_ns) => self.wheels.at(frame_ns),
            None => self.wheels.newest().copied(),
        };
        let Some(wheel) = wheel else { return Ok(None) };
        let outside = self.take_outside_pose();
        let scan = self.port.scans.nearest(wheel.time_ns);
        let scan_ns = scan.map(LaserScan::middle_ns);
        let scan_wheel = scan_ns.and_then(|scan_ns| self.wheels.at(scan_ns));
        let input = TickInput {
            tick: self.tick,
            time_ns,
            wheel,
            scan,
            scan_odom: scan_wheel.unwrap_or(wheel).odom,
            imu: self.imu.at(wheel.time_ns, scan_ns),
            outside,
            frame: frame_ns.and_then(|_| self.devices.frame()),
            truth: frame_ns.and_then(|_| self.devices.truth()),
            task: self.task.take(),
            areas: &self.areas,
            orders: &self.orders,
            safety: &self.report,
        };
        observer.before(&mut self.robot, &input)?;
        let decision = self.robot.tick(&input, observer);
        // The plan is as old as the observation that it is based on, and never newer than now.
        let plan_ns = wheel.time_ns.min(time_ns);
        self.port.plan.write(Some(Plan { twist: decision.desired.into(), time_ns: plan_ns }));
        self.tick += 1;
        observer.after(&mut self.robot, &input, &decision)?;
        self.areas.clear();
        self.orders.clear();
        Ok(Some(decision))
    }

    /// Gives the robot a task, which becomes part of the next tick's input. It replaces one that no tick has taken.
    ///
    /// # Errors
    /// A place or a velocity that is not finite.
    pub fn give(&mut self, task: Task) -> Result<(), NotFinite> {
        self.task = Some(task.check()?);
        Ok(())
    }

    /// Closes or opens areas with the next tick.
    ///
    /// # Errors
    /// A corner that is too far away or not a number.
    pub fn change_areas(&mut self, change: AreaChange) -> Result<(), AreaTooFar> {
        self.areas.push(change.check()?);
        Ok(())
    }

    /// Gives the robot a pose that another program has sent. The next tick takes the newest one.
    pub fn give_pose(&mut self, outside: OutsidePose) {
        self.outside = Some(outside);
    }

    fn take_outside_pose(&mut self) -> Option<OutsideInput> {
        let outside = self.outside.take()?;
        let wheel = self.wheels.at(outside.time_ns)?;
        Some(OutsideInput { outside, wheel_odom: wheel.odom })
    }

    /// Notes an order of the operator in the input of the next tick, and so in the recording.
    pub fn note(&mut self, order: OperatorOrder) {
        // There is no tick, and no recording, before the first wheel feedback.
        if self.orders.len() < MOST_ORDERS {
            self.orders.push(order);
        }
    }

    /// Number of ticks so far.
    pub fn ticks(&self) -> u64 {
        self.tick
    }

    /// Number of ticks that were skipped because the one before took longer than its period.
    pub fn skipped(&self) -> u64 {
        self.skipped
    }

    /// The robot, for reading its state.
    pub fn robot(&self) -> &Robot {
        &self.robot
    }

    /// The robot, for a new model between two ticks.
    pub fn robot_mut(&mut self) -> &mut Robot {
        &mut self.robot
    }

    /// The devices, for example to read their counts.
    pub fn devices(&self) -> &D {
        &self.devices
    }

    /// The devices, for writing.
    pub fn devices_mut(&mut self) -> &mut D {
        &mut self.devices
    }

    /// Ends the session, and returns the devices and the robot.
    pub fn into_parts(self) -> (D, Robot) {
        (self.devices, self.robot)
    }
}

/// Decides a recorded tick again.
///
/// # Errors
/// The bytes of the recorded frame do not fit its size.
pub fn recompute(robot: &mut Robot, tick: &RecordedTick) -> Result<Decision, RecordingError> {
    Ok(robot.tick(&tick.input()?, &mut ()))
}
