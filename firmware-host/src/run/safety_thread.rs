//! The safety loop's own thread. It owns scanner and base, and waits for no other thread: plans and requests reach it through
//! queues of fixed size ([`safety_link`]), without lock, allocation or log call.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;

use anyhow::{Context, Result};
use drivers::DeviceStatus;
use drivers::stop_line::StopLine;
use hal::{Base, Clock, ErrorKind, Lidar, PowerReport};
use monotonic_clock::MonotonicClock;
use runtime::event::{FaultReason, SafetyEvent};
use runtime::latency::LatencyHistogram;
use runtime::safety::{Orders, SafetyLoop, SafetyState, WheelError};
use runtime::session::{SafetyPort, SafetyTask, safety_link};
use thread_priority::{
    RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id,
};
use triple_buffer::{Input, Output, triple_buffer};

use crate::control_panel::{ControlPanel, PanelReader};

/// A device whose state can be read without a lock and without an allocation.
pub trait Watched {
    /// State and counts of the device.
    fn status(&self) -> DeviceStatus;
}

/// A base that reports why it does not move.
pub trait WatchedBase: Watched {
    /// The state of the base between powerless and moving.
    fn phase(&self) -> drivers::can::Phase;
}

/// The computer counts as suspended when it slept for longer than this.
const SUSPENDED_NS: u64 = 500_000_000;
/// The base brakes for 0.5 s before it removes power from the motors.
const DISARMING_NS: u64 = 1_000_000_000;

/// The safety loop's current status, for `health`.
#[derive(Debug, Clone, Copy)]
pub struct LoopStatus {
    pub time_ns: u64,
    pub state: SafetyState,
    /// Time of the last change of `state`, monotonic.
    pub since_ns: u64,
    /// Why the last request to arm was cancelled, until a later one is followed.
    pub lapsed: Option<FaultReason>,
    /// Number of obstacles for which the robot has stopped.
    pub trips: u64,
    pub lidar: DeviceStatus,
    pub lidar_error: Option<ErrorKind>,
    pub base: DeviceStatus,
    pub phase: drivers::can::Phase,
    pub power: PowerReport,
    /// How far wheels and scanner disagree.
    pub wheel_error: WheelError,
    /// Number of steps so far.
    pub steps: u64,
    /// Number of steps that were skipped because an earlier one took too long.
    pub skipped: u64,
    /// Largest delay of the start of a step, also of one that was skipped.
    pub worst_late_ns: u64,
}

/// The safety thread, as the rest of the program sees it.
pub struct SafetyThread {
    /// The newest status of the loop.
    pub status: Output<LoopStatus>,
    /// Number of steps so far; systemd's watchdog is fed while it increases.
    pub steps: Arc<AtomicU64>,
    /// Whether the thread runs with real-time priority.
    pub realtime: bool,
    /// The operator's orders to the loop.
    pub panel: ControlPanel,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<LatencyHistogram>>,
}

/// What the thread opens before the loop starts.
pub struct Opened<B, L, T> {
    /// The safety loop with scanner and base.
    pub control: SafetyLoop<B, L>,
    /// The emergency stop on an input line of the computer, if there is one.
    pub stop_line: Option<StopLine>,
    /// What the rest of the program gets.
    pub rest: T,
}

/// Rate and priority of the loop.
#[derive(Debug, Clone, Copy)]
pub struct Pace {
    /// Time from step to step, nanoseconds.
    pub period_ns: u64,
    /// SCHED_FIFO priority; 0: an ordinary thread.
    pub priority: u8,
}

impl SafetyThread {
    /// Starts the thread, opens the devices in it, and starts the loop. Threads that drivers start then inherit its priority.
    /// Returns the exploration loop's port, and the other results of `open`. Nothing moves before
    /// [`ControlPanel::arm`].
    ///
    /// # Errors
    /// The errors of `open`, and an error if the system cannot create a thread.
    pub fn start<B, L, T>(
        pace: Pace,
        open: impl FnOnce() -> Result<Opened<B, L, T>> + Send + 'static,
    ) -> Result<(Self, SafetyPort, T)>
    where
        B: Base + WatchedBase,
        L: Lidar + Watched,
        T: Send + 'static,
    {
        let (sender, receiver) = std::sync::mpsc::sync_channel(1);
        let thread = std::thread::Builder::new().name("safety".to_owned()).spawn(move || {
            let realtime = become_realtime(pace.priority);
            match open() {
                Ok(Opened { control, stop_line, rest }) => {
                    let (looping, thread, port) = connect(control, stop_line, realtime);
                    let _ = sender.send(Ok((thread, port, rest)));
                    looping.run(pace.period_ns)
                }
                Err(error) => {
                    let _ = sender.send(Err(error));
                    LatencyHistogram::default()
                }
            }
        })?;
        let opened = receiver.recv();
        let (mut safety, port, rest) =
            opened.context("the safety thread has panicked; please report this")??;
        safety.thread = Some(thread);
        Ok((safety, port, rest))
    }

    /// Brakes, disarms the base, and ends the thread. The first call returns the delays of the steps.
    pub fn shut_down(&mut self) -> Option<LatencyHistogram> {
        self.stop.store(true, Ordering::Release);
        let joined = self.thread.take()?.join();
        joined
            .inspect_err(|_| tracing::error!("the safety thread has panicked; please report this"))
            .ok()
    }

    /// Whether the thread still runs.
    #[must_use]
    pub fn is_alive(&self) -> bool {
        self.thread.as_ref().is_some_and(|thread| !thread.is_finished())
    }
}

fn connect<B, L>(
    control: SafetyLoop<B, L>,
    stop_line: Option<StopLine>,
    realtime: bool,
) -> (Looping<B, L>, SafetyThread, SafetyPort)
where
    B: Base + WatchedBase,
    L: Lidar + Watched,
{
    let (task, port) = safety_link(control);
    let (status_input, status) = triple_buffer(&first_status(&task));
    let panel = ControlPanel::default();
    let stop = Arc::new(AtomicBool::new(false));
    let steps = Arc::new(AtomicU64::new(0));
    let looping = Looping {
        task,
        status: status_input,
        panel: PanelReader::new(panel.clone()),
        stop_line,
        suspended_ns: suspended_ns(),
        stop: Arc::clone(&stop),
        steps: Arc::clone(&steps),
    };
    let thread = SafetyThread { status, steps, realtime, panel, stop, thread: None };
    (looping, thread, port)
}

impl Drop for SafetyThread {
    fn drop(&mut self) {
        let _ = self.shut_down();
    }
}

/// The data that the thread owns.
struct Looping<B, L> {
    task: SafetyTask<B, L>,
    status: Input<LoopStatus>,
    panel: PanelReader,
    stop_line: Option<StopLine>,
    /// Time that the computer has been suspended since it was started.
    suspended_ns: u64,
    stop: Arc<AtomicBool>,
    steps: Arc<AtomicU64>,
}

impl<B, L> Looping<B, L>
where
    B: Base + WatchedBase,
    L: Lidar + Watched,
{
    fn run(mut self, period_ns: u64) -> LatencyHistogram {
        let mut clock = MonotonicClock;
        let mut due_ns = clock.now_ns() + period_ns;
        let mut status = first_status(&self.task);
        let mut late = LatencyHistogram::default();
        let mut ends_ns = None;
        loop {
            clock.sleep_until_ns(due_ns);
            let now_ns = clock.now_ns();
            late.record(now_ns - due_ns);
            status.worst_late_ns = status.worst_late_ns.max(now_ns - due_ns);
            if self.stop.load(Ordering::Acquire) {
                let ends_ns = *ends_ns.get_or_insert(now_ns + DISARMING_NS);
                let released = self.task.control().base().phase() == drivers::can::Phase::Disarmed;
                if released || now_ns >= ends_ns {
                    break;
                }
                self.panel.panel().disarm();
            }
            self.step(now_ns, &mut status);
            self.steps.fetch_add(1, Ordering::Release);
            due_ns += period_ns;
            due_ns += leave_out(due_ns, clock.now_ns(), period_ns, &mut status, &mut late);
        }
        self.task.shut_down();
        late
    }

    /// The orders of this step. `suspended_ns` is the time that the computer has been suspended until now.
    fn orders(&mut self, now_ns: u64, suspended_ns: u64) -> Orders {
        let before_ns = std::mem::replace(&mut self.suspended_ns, suspended_ns);
        let suspended = self.suspended_ns.saturating_sub(before_ns) > SUSPENDED_NS;
        let orders = self.panel.orders();
        let is_pressed = self.stop_line.as_ref().is_some_and(|line| line.is_pressed(now_ns));
        Orders { suspended, emergency_stop: orders.emergency_stop || is_pressed, ..orders }
    }

    fn step(&mut self, now_ns: u64, status: &mut LoopStatus) {
        let orders = self.orders(now_ns, suspended_ns());
        let step = self.task.step(now_ns, &orders);
        let state = step.state;
        status.lidar_error = step.lidar_error;
        status.lapsed = lapsed_after(step.output.event, status.lapsed);
        let is_new_fault = matches!(state, SafetyState::Fault(_)) && state != status.state;
        if state.name() != status.state.name() || is_new_fault {
            status.since_ns = now_ns;
        }
        self.panel.publish(state);
        let control = self.task.control();
        status.time_ns = now_ns;
        status.state = state;
        status.trips = control.plane().trip_count();
        status.lidar = control.lidar().status();
        status.base = control.base().status();
        status.phase = control.base().phase();
        status.power = control.base().power();
        status.wheel_error = control.plane().wheel_error();
        status.steps += 1;
        *self.status.input_buffer_mut() = *status;
        self.status.publish();
    }
}

/// Why the last request to arm was cancelled, after a step with this event.
fn lapsed_after(event: Option<SafetyEvent>, before: Option<FaultReason>) -> Option<FaultReason> {
    match event {
        Some(SafetyEvent::ArmingLapsed { why }) => Some(why),
        Some(SafetyEvent::Armed) => None,
        _ => before,
    }
}

/// Counts the steps that are left out at `now_ns`, because one before them took too long, and how late the first of them would have
/// started: the step after them starts in time. Returns by how much the next step is later than `due_ns`.
fn leave_out(
    due_ns: u64,
    now_ns: u64,
    period_ns: u64,
    status: &mut LoopStatus,
    late: &mut LatencyHistogram,
) -> u64 {
    let missed = missed_steps(due_ns, now_ns, period_ns);
    if missed > 0 {
        late.record(now_ns - due_ns);
        status.worst_late_ns = status.worst_late_ns.max(now_ns - due_ns);
        status.skipped += missed;
    }
    missed * period_ns
}

/// Number of steps that are left out because the loop is late at `now_ns`. They are not made up for: a burst of late steps
/// protects nothing.
fn missed_steps(due_ns: u64, now_ns: u64, period_ns: u64) -> u64 {
    if now_ns > due_ns { (now_ns - due_ns) / period_ns + 1 } else { 0 }
}

/// Time that the computer has been suspended since it was started: the monotonic clock stands still
/// during that time, and the boot-time clock does not.
fn suspended_ns() -> u64 {
    let boot_ns = nanoseconds(rustix::time::clock_gettime(rustix::time::ClockId::Boottime));
    boot_ns.saturating_sub(MonotonicClock.now_ns())
}

fn nanoseconds(time: rustix::time::Timespec) -> u64 {
    time.tv_sec.unsigned_abs() * 1_000_000_000 + time.tv_nsec.unsigned_abs()
}

fn first_status<B, L>(task: &SafetyTask<B, L>) -> LoopStatus
where
    B: Base + WatchedBase,
    L: Lidar + Watched,
{
    let control = task.control();
    LoopStatus {
        time_ns: 0,
        state: control.plane().state(),
        since_ns: 0,
        lapsed: None,
        trips: 0,
        lidar: control.lidar().status(),
        lidar_error: None,
        base: control.base().status(),
        phase: control.base().phase(),
        power: control.base().power(),
        wheel_error: control.plane().wheel_error(),
        steps: 0,
        skipped: 0,
        worst_late_ns: 0,
    }
}

/// Requests SCHED_FIFO and memory that stays resident. Returns whether both were allowed.
fn become_realtime(priority: u8) -> bool {
    if priority == 0 {
        return false;
    }
    let Ok(value) = ThreadPriorityValue::try_from(priority) else { return false };
    let fifo = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
    let locked = rustix::mm::mlockall(
        rustix::mm::MlockAllFlags::CURRENT | rustix::mm::MlockAllFlags::FUTURE,
    )
    .is_ok();
    set_thread_priority_and_policy(thread_native_id(), ThreadPriority::Crossplatform(value), fifo)
        .is_ok()
        && locked
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use crate::run::devices::{AnyBase, open_scanner_and_base};
    use drivers::fault::{Faults, FaultyBase, FaultyLidar};
    use drivers::lidar::AnyLidar;

    /// The safety loop of a robot whose devices are absent.
    fn control() -> SafetyLoop<FaultyBase<AnyBase>, FaultyLidar<AnyLidar>> {
        let mut config = Config::default();
        config.devices.lidar.port = "/nonexistent/lidar".parse().unwrap();
        config.devices.base.bus = "unix:/nonexistent/can".to_owned();
        config.devices.base.protocol = drivers::can::Protocol::Vesc;
        let faults = Faults::new(Vec::new(), 1, Arc::new(|| 0));
        open_scanner_and_base(&config, &faults).unwrap().0
    }

    fn looping() -> (Looping<FaultyBase<AnyBase>, FaultyLidar<AnyLidar>>, SafetyThread) {
        let (looping, thread, _) = connect(control(), None, false);
        (looping, thread)
    }

    #[test]
    fn a_computer_that_was_suspended_is_reported_once_to_the_safety_loop() {
        let (mut looping, _thread) = looping();
        let begin_ns = looping.suspended_ns;
        assert!(!looping.orders(0, begin_ns).suspended);
        // The two clocks are not read at the same moment.
        assert!(!looping.orders(0, begin_ns + 400_000_000).suspended);
        assert!(looping.orders(0, begin_ns + 8_000_000_000).suspended);
        assert!(!looping.orders(0, begin_ns + 8_000_000_000).suspended);
    }

    #[test]
    fn a_loop_that_is_late_leaves_out_the_steps_that_it_missed() {
        let missed = [99, 100, 101, 109, 110, 3099].map(|now_ns| missed_steps(100, now_ns, 10));
        assert_eq!(missed, [0, 0, 1, 1, 2, 300]);
    }

    #[test]
    fn a_step_that_took_too_long_makes_the_next_one_late_although_that_is_left_out() {
        let (looping, _thread) = looping();
        let mut status = first_status(&looping.task);
        let mut late = LatencyHistogram::default();
        assert_eq!(leave_out(100, 99, 10, &mut status, &mut late), 0);
        assert_eq!((status.skipped, status.worst_late_ns), (0, 0));
        assert_eq!(late.quantile_ns(1.0), None);
        assert_eq!(leave_out(100, 112, 10, &mut status, &mut late), 20);
        assert_eq!((status.skipped, status.worst_late_ns), (2, 12));
        assert!(late.quantile_ns(1.0).is_some());
    }

    #[test]
    fn an_order_to_stop_reaches_the_safety_loop_in_the_next_step_and_its_answer_the_panel() {
        let (mut looping, thread) = looping();
        let mut status = first_status(&looping.task);
        thread.panel.stop();
        looping.step(MonotonicClock.now_ns(), &mut status);
        assert_eq!(status.state, SafetyState::Fault(FaultReason::EmergencyStop));
        assert_eq!(thread.panel.plane().words(), "fault: the emergency stop is pressed");
    }

    #[test]
    fn a_request_to_arm_that_lapsed_is_reported_until_a_later_one_is_followed() {
        let why = FaultReason::LidarSilent;
        let lapsed = lapsed_after(Some(SafetyEvent::ArmingLapsed { why }), None);
        assert_eq!(lapsed, Some(why));
        assert_eq!(lapsed_after(None, lapsed), Some(why));
        assert_eq!(lapsed_after(Some(SafetyEvent::Cleared), lapsed), Some(why));
        assert_eq!(lapsed_after(Some(SafetyEvent::Armed), lapsed), None);
    }

    #[test]
    fn a_thread_that_has_ended_is_not_alive_and_an_ordinary_one_has_no_real_time_priority() {
        let pace = Pace { period_ns: 1_000_000, priority: 0 };
        let (mut thread, _port, ()) = SafetyThread::start(pace, || {
            Ok(Opened { control: control(), stop_line: None, rest: () })
        })
        .unwrap();
        assert!(thread.is_alive() && !thread.realtime);
        assert!(thread.shut_down().is_some());
        assert!(!thread.is_alive());
    }

    #[test]
    fn a_priority_that_the_system_refuses_is_not_reported_as_granted() {
        use rustix::process::{Resource, Rlimit, setrlimit};
        use rustix::thread::{CapabilitySet, capabilities, set_capabilities};

        // Linux grants it to those who may set priorities, and up to the process's limit.
        setrlimit(Resource::Rtprio, Rlimit { current: Some(0), maximum: Some(0) }).unwrap();
        let mut sets = capabilities(None).unwrap();
        sets.effective.remove(CapabilitySet::SYS_NICE);
        set_capabilities(None, sets).unwrap();
        assert!(!become_realtime(40));
        let policy = thread_priority::thread_schedule_policy_param(thread_native_id()).unwrap().0;
        assert!(!matches!(policy, ThreadSchedulePolicy::Realtime(_)), "{policy:?}");
    }
}
