//! The safety loop's own thread. It owns scanner and base, and waits for no other thread: plans and requests reach it through
//! queues of fixed size ([`safety_link`]), without lock, allocation or log call.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, Ordering};
use std::thread::JoinHandle;

use anyhow::{Context, Result};
use drivers::DeviceStatus;
use hal::{Base, Clock, ErrorKind, Lidar};
use monotonic_clock::MonotonicClock;
use runtime::latency::LatencyHistogram;
use runtime::safety::{Request, SafetyLoop, SafetyState};
use runtime::session::{SafetyPort, SafetyTask, safety_link};
use thread_priority::{
    RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id,
};
use triple_buffer::{Input, Output, triple_buffer};

/// A device whose state can be read without a lock and without an allocation.
pub trait Watched {
    /// State and counts.
    fn status(&self) -> DeviceStatus;
}

/// A base that reports why it does not move.
pub trait WatchedBase: Watched {
    /// Where the base is between powerless and moving.
    fn phase(&self) -> drivers::can::Phase;
}

/// The safety loop's current status, for `health`.
#[derive(Debug, Clone, Copy)]
pub struct LoopStatus {
    pub time_ns: u64,
    pub state: SafetyState,
    /// Time of the last change of `state`, monotonic.
    pub since_ns: u64,
    /// Obstacles that it has stopped for.
    pub trips: u64,
    pub lidar: DeviceStatus,
    pub lidar_error: Option<ErrorKind>,
    pub base: DeviceStatus,
    pub phase: drivers::can::Phase,
    /// Steps so far.
    pub steps: u64,
    /// Steps that were skipped because one before took too long.
    pub skipped: u64,
    /// Largest delay of a step's start.
    pub worst_late_ns: u64,
}

/// The thread, as the rest of the program sees it.
pub struct SafetyThread {
    /// The newest status.
    pub status: Output<LoopStatus>,
    /// Steps so far; systemd's watchdog is fed while it grows.
    pub steps: Arc<AtomicU64>,
    /// Whether the thread runs with real-time priority.
    pub realtime: bool,
    request: Arc<AtomicU8>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<LatencyHistogram>>,
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
    /// Returns the exploration loop's port, and whatever else `open` made. Nothing moves before [`request`](Self::request) has
    /// asked for arming.
    ///
    /// # Errors
    /// The errors of `open`; when the system has no thread left.
    pub fn start<B, L, T>(
        pace: Pace,
        open: impl FnOnce() -> Result<(SafetyLoop<B, L>, T)> + Send + 'static,
    ) -> Result<(Self, SafetyPort, T)>
    where
        B: Base + WatchedBase,
        L: Lidar + Watched,
        T: Send + 'static,
    {
        let (sender, receiver) = std::sync::mpsc::sync_channel(1);
        let work = move || {
            let realtime = become_realtime(pace.priority);
            match open() {
                Ok((control, rest)) => {
                    let (looping, thread, port) = connect(control, realtime);
                    let _ = sender.send(Ok((thread, port, rest)));
                    looping.run(pace.period_ns)
                }
                Err(error) => {
                    let _ = sender.send(Err(error));
                    LatencyHistogram::default()
                }
            }
        };
        let thread = std::thread::Builder::new().name("safety".to_owned()).spawn(work)?;
        let opened = receiver.recv();
        let (mut safety, port, rest) =
            opened.context("the safety thread has panicked; please report this")??;
        safety.thread = Some(thread);
        Ok((safety, port, rest))
    }

    /// Passes an operator's request to the next step. Of several between two steps the last counts.
    pub fn request(&self, request: Request) {
        self.request.store(number_of(Some(request)), Ordering::Release);
    }

    /// Brakes, disarms the base, and ends the thread. The first call returns how late the steps began.
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
    realtime: bool,
) -> (Looping<B, L>, SafetyThread, SafetyPort)
where
    B: Base + WatchedBase,
    L: Lidar + Watched,
{
    let (task, port) = safety_link(control);
    let (status_input, status) = triple_buffer(&first_status(&task));
    let request = Arc::new(AtomicU8::new(0));
    let stop = Arc::new(AtomicBool::new(false));
    let steps = Arc::new(AtomicU64::new(0));
    let looping = Looping {
        task,
        status: status_input,
        request: Arc::clone(&request),
        stop: Arc::clone(&stop),
        steps: Arc::clone(&steps),
    };
    let thread = SafetyThread { status, steps, realtime, request, stop, thread: None };
    (looping, thread, port)
}

impl Drop for SafetyThread {
    fn drop(&mut self) {
        let _ = self.shut_down();
    }
}

/// What the thread owns.
struct Looping<B, L> {
    task: SafetyTask<B, L>,
    status: Input<LoopStatus>,
    request: Arc<AtomicU8>,
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
        while !self.stop.load(Ordering::Acquire) {
            clock.sleep_until_ns(due_ns);
            let now_ns = clock.now_ns();
            late.record(now_ns - due_ns);
            status.worst_late_ns = status.worst_late_ns.max(now_ns - due_ns);
            self.step(now_ns, &mut status);
            self.steps.fetch_add(1, Ordering::Release);
            due_ns += period_ns;
            // Missed steps are not made up for: a burst of late steps protects nothing.
            let after_ns = clock.now_ns();
            if after_ns > due_ns {
                let missed = (after_ns - due_ns) / period_ns + 1;
                status.skipped += missed;
                due_ns += missed * period_ns;
            }
        }
        self.task.shut_down();
        late
    }

    fn step(&mut self, now_ns: u64, status: &mut LoopStatus) {
        let request = request_of(self.request.swap(0, Ordering::AcqRel));
        let step = self.task.step(now_ns, request, false);
        let state = step.state;
        status.lidar_error = step.lidar_error;
        let is_new_fault = matches!(state, SafetyState::Fault(_)) && state != status.state;
        if state.name() != status.state.name() || is_new_fault {
            status.since_ns = now_ns;
        }
        let control = self.task.control();
        status.time_ns = now_ns;
        status.state = state;
        status.trips = control.plane().trip_count();
        status.lidar = control.lidar().status();
        status.base = control.base().status();
        status.phase = control.base().phase();
        status.steps += 1;
        *self.status.input_buffer_mut() = *status;
        self.status.publish();
    }
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
        trips: 0,
        lidar: control.lidar().status(),
        lidar_error: None,
        base: control.base().status(),
        phase: control.base().phase(),
        steps: 0,
        skipped: 0,
        worst_late_ns: 0,
    }
}

/// Asks for SCHED_FIFO and for memory that stays resident. Returns whether both were allowed.
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

fn number_of(request: Option<Request>) -> u8 {
    match request {
        None => 0,
        Some(Request::Arm) => 1,
        Some(Request::Disarm) => 2,
        Some(Request::ClearFault) => 3,
    }
}

fn request_of(number: u8) -> Option<Request> {
    [Request::Arm, Request::Disarm, Request::ClearFault]
        .into_iter()
        .find(|request| number_of(Some(*request)) == number)
}
