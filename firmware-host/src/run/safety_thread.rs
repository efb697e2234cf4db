//! The safety plane's own thread: it owns scanner and base, and nothing that it does waits for anybody.
//!
//! What it needs of others comes through buffers that hold the newest value; what it tells goes into rings of fixed size that
//! drop and count. No lock, no allocation, no log call.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, Ordering};
use std::thread::JoinHandle;

use anyhow::{Context, Result};
use drivers::DeviceStatus;
use hal::{Base, Clock, ErrorKind, Lidar, WheelFeedback};
use monotonic_clock::MonotonicClock;
use runtime::event::SafetyEvent;
use runtime::latency::LatencyHistogram;
use runtime::safety::{Orders, Plan, Request, SafetyLoop, SafetyState};
use thread_priority::{
    RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id,
};
use triple_buffer::{Input, Output, triple_buffer};

use super::scan_history::{ScanHistory, ScanWriter, scan_history};

/// Half a second of wheels at 100 Hz, and more events than a tick can have.
const WHEELS: usize = 64;
const NEWS: usize = 64;

/// A device that tells how it is, without a lock and without an allocation.
pub trait Watched {
    /// State and counts.
    fn status(&self) -> DeviceStatus;
}

/// A base that tells why it does not move.
pub trait WatchedBase: Watched {
    /// In words of its own that are made elsewhere: a plain value.
    fn phase(&self) -> drivers::can::Phase;
}

/// Something that happened.
#[derive(Debug, Clone, Copy)]
pub struct News {
    /// What, with its reason.
    pub event: Option<SafetyEvent>,
    /// A place that could not be passed, in `odom`, metres.
    pub blocked_m: Option<[f64; 2]>,
}

/// How the safety plane is at the moment.
#[derive(Debug, Clone, Copy)]
pub struct Glance {
    /// When this was, monotonic.
    pub time_ns: u64,
    /// What it does.
    pub state: SafetyState,
    /// Since when, monotonic.
    pub since_ns: u64,
    /// What it stopped for.
    pub trips: u64,
    /// The scanner.
    pub lidar: DeviceStatus,
    /// What is wrong with it now.
    pub lidar_error: Option<ErrorKind>,
    /// The base.
    pub base: DeviceStatus,
    /// Where the base is between powerless and moving.
    pub phase: drivers::can::Phase,
    /// Turns of the loop, turns that were skipped because one came late, and the worst lateness, nanoseconds.
    pub turns: u64,
    /// Turns that were skipped because one before came late.
    pub skipped: u64,
    /// The worst lateness, nanoseconds.
    pub worst_late_ns: u64,
}

/// The other end of the thread's buffers.
pub struct SafetyThread {
    /// The newest plan goes in here.
    pub plan: Input<Option<Plan>>,
    /// The scanner's recent past.
    pub scans: ScanHistory,
    /// Every measurement of the wheels.
    pub wheels: rtrb::Consumer<WheelFeedback>,
    /// Everything that happened.
    pub news: rtrb::Consumer<News>,
    /// How it is.
    pub glance: Output<Glance>,
    /// Turns so far: whoever feeds a watchdog looks at this.
    pub turns: Arc<AtomicU64>,
    /// Whether it runs with real-time priority.
    pub realtime: bool,
    request: Arc<AtomicU8>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<LatencyHistogram>>,
}

/// How the loop is run.
#[derive(Debug, Clone, Copy)]
pub struct Pace {
    /// Time from turn to turn, nanoseconds.
    pub period_ns: u64,
    /// SCHED_FIFO priority; 0: an ordinary thread.
    pub priority: u8,
}

impl SafetyThread {
    /// Starts the thread, opens the devices in it, and starts the loop. Threads that drivers start then have the same priority.
    /// Also hands out whatever else `open` made. Nothing moves before [`request`](Self::request) has asked for it.
    ///
    /// # Errors
    /// What `open` refuses; when the system has no thread left.
    pub fn start<B, L, T>(
        pace: Pace,
        open: impl FnOnce() -> Result<(SafetyLoop<B, L>, T)> + Send + 'static,
    ) -> Result<(Self, T)>
    where
        B: Base + WatchedBase,
        L: Lidar + Watched,
        T: Send + 'static,
    {
        let (told, hears) = std::sync::mpsc::sync_channel(1);
        let work = move || {
            let realtime = become_realtime(pace.priority);
            match open() {
                Ok((control, rest)) => {
                    let (turning, ends) = wire(control, realtime);
                    let _ = told.send(Ok((ends, rest)));
                    turning.run(pace.period_ns)
                }
                Err(error) => {
                    let _ = told.send(Err(error));
                    LatencyHistogram::default()
                }
            }
        };
        let thread = std::thread::Builder::new().name("safety".to_owned()).spawn(work)?;
        let (mut ends, rest) =
            hears.recv().context("the safety thread has panicked; please report this")??;
        ends.thread = Some(thread);
        Ok((ends, rest))
    }

    /// Asks for something. Of several between two turns the last counts.
    pub fn request(&self, request: Request) {
        self.request.store(number_of(Some(request)), Ordering::Release);
    }

    /// Brakes, lets the motors go, and ends. How late its turns began, the first time that it is called.
    pub fn shut_down(&mut self) -> Option<LatencyHistogram> {
        self.stop.store(true, Ordering::Release);
        let joined = self.thread.take()?.join();
        joined
            .inspect_err(|_| tracing::error!("the safety thread has panicked; please report this"))
            .ok()
    }

    /// Whether the thread is there.
    #[must_use]
    pub fn is_alive(&self) -> bool {
        self.thread.as_ref().is_some_and(|thread| !thread.is_finished())
    }
}

/// Both ends of the buffers.
fn wire<B, L>(control: SafetyLoop<B, L>, realtime: bool) -> (Turning<B, L>, SafetyThread)
where
    B: Base + WatchedBase,
    L: Lidar + Watched,
{
    let (plan, plans) = triple_buffer(&None);
    let (scan_writer, scans) = scan_history(control.lidar().geometry());
    let (wheel_producer, wheels) = rtrb::RingBuffer::new(WHEELS);
    let (news_producer, news) = rtrb::RingBuffer::new(NEWS);
    let (glance_input, glance) = triple_buffer(&first_glance(&control));
    let (request, stop, turns) = (Arc::default(), Arc::default(), Arc::default());
    let turning = Turning {
        control,
        plans,
        scans: scan_writer,
        wheels: wheel_producer,
        news: news_producer,
        glance: glance_input,
        request: Arc::clone(&request),
        stop: Arc::clone(&stop),
        turns: Arc::clone(&turns),
    };
    (
        turning,
        SafetyThread {
            plan,
            scans,
            wheels,
            news,
            glance,
            turns,
            realtime,
            request,
            stop,
            thread: None,
        },
    )
}

impl Drop for SafetyThread {
    fn drop(&mut self) {
        let _ = self.shut_down();
    }
}

/// What the thread owns.
struct Turning<B, L> {
    control: SafetyLoop<B, L>,
    plans: Output<Option<Plan>>,
    scans: ScanWriter,
    wheels: rtrb::Producer<WheelFeedback>,
    news: rtrb::Producer<News>,
    glance: Input<Glance>,
    request: Arc<AtomicU8>,
    stop: Arc<AtomicBool>,
    turns: Arc<AtomicU64>,
}

impl<B, L> Turning<B, L>
where
    B: Base + WatchedBase,
    L: Lidar + Watched,
{
    fn run(mut self, period_ns: u64) -> LatencyHistogram {
        let mut clock = MonotonicClock;
        let mut due_ns = clock.now_ns() + period_ns;
        let mut glance = first_glance(&self.control);
        let mut late = LatencyHistogram::default();
        while !self.stop.load(Ordering::Acquire) {
            clock.sleep_until_ns(due_ns);
            let now_ns = clock.now_ns();
            late.record(now_ns - due_ns);
            glance.worst_late_ns = glance.worst_late_ns.max(now_ns - due_ns);
            self.turn(now_ns, &mut glance);
            self.turns.fetch_add(1, Ordering::Release);
            due_ns += period_ns;
            // Turns that were missed are not made up for: a burst of old turns helps nobody.
            let after_ns = clock.now_ns();
            if after_ns > due_ns {
                let missed = (after_ns - due_ns) / period_ns + 1;
                glance.skipped += missed;
                due_ns += missed * period_ns;
            }
        }
        self.control.shut_down();
        late
    }

    fn turn(&mut self, now_ns: u64, glance: &mut Glance) {
        let request = request_of(self.request.swap(0, Ordering::AcqRel));
        let orders = Orders { plan: *self.plans.read(), request, emergency_stop: false };
        let turn = self.control.turn(now_ns, &orders);
        let lidar_error = turn.lidar_error;
        if let Some(scan) = turn.scan {
            self.scans.push(scan);
        }
        if let Some(wheel) = turn.wheel {
            let _ = self.wheels.push(wheel);
        }
        if turn.output.event.is_some() || turn.output.blocked_m.is_some() {
            let _ =
                self.news.push(News { event: turn.output.event, blocked_m: turn.output.blocked_m });
        }
        let state = self.control.plane().state();
        if state.name() != glance.state.name()
            || matches!(state, SafetyState::Fault(_)) && state != glance.state
        {
            glance.since_ns = now_ns;
        }
        glance.time_ns = now_ns;
        glance.state = state;
        glance.trips = self.control.plane().trip_count();
        (glance.lidar, glance.lidar_error) = (self.control.lidar().status(), lidar_error);
        (glance.base, glance.phase) = (self.control.base().status(), self.control.base().phase());
        glance.turns += 1;
        *self.glance.input_buffer_mut() = *glance;
        self.glance.publish();
    }
}

fn first_glance<B: Base + WatchedBase, L: Lidar + Watched>(control: &SafetyLoop<B, L>) -> Glance {
    Glance {
        time_ns: 0,
        state: control.plane().state(),
        since_ns: 0,
        trips: 0,
        lidar: control.lidar().status(),
        lidar_error: None,
        base: control.base().status(),
        phase: control.base().phase(),
        turns: 0,
        skipped: 0,
        worst_late_ns: 0,
    }
}

/// SCHED_FIFO and memory that stays resident. Whether both were allowed.
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
