//! The queues between the safety loop and the exploration loop. They have a fixed size, take no
//! lock and allocate nothing. An item that does not fit is dropped and counted.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use hal::{Base, Lidar, WheelFeedback};
use triple_buffer::{Input, Output, triple_buffer};

use super::scan_history::{ScanHistory, ScanWriter, scan_history};
use super::wheel_history::WheelHistory;
use crate::event::SafetyEvent;
use crate::safety::SentCommand;
use crate::safety::{Orders, Plan, SafetyLoop, SafetyStep};
use crate::tick::SafetyReport;

/// Wheel feedback of 0.6 s at 100 Hz: six ticks of 0.1 s.
const WHEELS: usize = 64;
/// Changes of state; one tick brings fewer.
const CHANGES: usize = 64;
/// Commands of 20 s at 100 Hz. A longer tick is a defect; the report then contains the number of
/// missing commands.
const SENT: usize = 2048;

/// A change of the safety plane's state.
#[derive(Debug, Clone, Copy)]
struct Change {
    event: Option<SafetyEvent>,
    blocked_m: Option<[f64; 2]>,
    unseen_m: Option<[f64; 2]>,
}

/// The safety loop with its ends of the queues to exploration.
pub struct SafetyTask<B, L> {
    control: SafetyLoop<B, L>,
    plans: Output<Option<Plan>>,
    scans: ScanWriter,
    wheels: rtrb::Producer<WheelFeedback>,
    changes: rtrb::Producer<Change>,
    sent: rtrb::Producer<SentCommand>,
    sent_dropped: Arc<AtomicU64>,
    in_charge: Arc<AtomicBool>,
}

/// The exploration loop's ends of the queues.
pub struct SafetyPort {
    /// The newest plan goes in here.
    pub plan: Input<Option<Plan>>,
    /// The recent scans, with the exploration loop's end of their circulation.
    pub(super) scans: ScanHistory,
    wheels: rtrb::Consumer<WheelFeedback>,
    changes: rtrb::Consumer<Change>,
    sent: rtrb::Consumer<SentCommand>,
    sent_dropped: Arc<AtomicU64>,
    in_charge: Arc<AtomicBool>,
}

/// Connects a safety loop with the exploration loop that it watches over.
#[must_use]
pub fn safety_link<B: Base, L: Lidar>(control: SafetyLoop<B, L>) -> (SafetyTask<B, L>, SafetyPort) {
    let (plan, plans) = triple_buffer(&None);
    let late_ns = (1e9 * control.plane().config().scan_late_s) as u64;
    let (scan_writer, scans) = scan_history(control.lidar().geometry(), late_ns);
    let (wheel_producer, wheels) = rtrb::RingBuffer::new(WHEELS);
    let (change_producer, changes) = rtrb::RingBuffer::new(CHANGES);
    let (sent_producer, sent) = rtrb::RingBuffer::new(SENT);
    let sent_dropped = Arc::new(AtomicU64::new(0));
    let in_charge = Arc::new(AtomicBool::new(control.plane().state().is_in_charge()));
    let task = SafetyTask {
        control,
        plans,
        scans: scan_writer,
        wheels: wheel_producer,
        changes: change_producer,
        sent: sent_producer,
        sent_dropped: Arc::clone(&sent_dropped),
        in_charge: Arc::clone(&in_charge),
    };
    let port = SafetyPort { plan, scans, wheels, changes, sent, sent_dropped, in_charge };
    (task, port)
}

impl<B: Base, L: Lidar> SafetyTask<B, L> {
    /// One step of the safety loop at `now_ns`, monotonic, with the operator's orders and the newest
    /// plan of the queue. Its results go into the queues.
    pub fn step(&mut self, now_ns: u64, orders: &Orders) -> SafetyStep<'_> {
        let orders = Orders { plan: *self.plans.read(), ..*orders };
        let step = self.control.step(now_ns, &orders);
        if let Some(scan) = step.scan {
            self.scans.push(scan);
        }
        if let Some(wheel) = step.wheel {
            // The queue is full only while exploration is late; exploration then uses the newest
            // feedback that it finds.
            let _ = self.wheels.push(wheel);
        }
        let SafetyStep { output, sent, .. } = step;
        if output.event.is_some() || output.blocked_m.is_some() || output.unseen_m.is_some() {
            let _ = self.changes.push(Change {
                event: output.event,
                blocked_m: output.blocked_m,
                unseen_m: output.unseen_m,
            });
        }
        if self.sent.push(sent).is_err() {
            self.sent_dropped.fetch_add(1, Ordering::Relaxed);
        }
        // `output.in_charge` is not used here: the step that changes the state still reports the
        // state before it.
        self.in_charge.store(step.state.is_in_charge(), Ordering::Release);
        step
    }

    /// The safety loop, for reading its state.
    pub fn control(&self) -> &SafetyLoop<B, L> {
        &self.control
    }

    /// Brakes, disarms the base, and returns the devices.
    pub fn shut_down(self) -> (B, L) {
        self.control.shut_down()
    }
}

impl SafetyPort {
    /// Fetches everything that the safety loop has sent since the last call.
    pub(super) fn update(&mut self, wheels: &mut WheelHistory, report: &mut SafetyReport) {
        while let Ok(wheel) = self.wheels.pop() {
            wheels.push(wheel);
        }
        self.scans.update();
        report.clear();
        while let Ok(Change { event, blocked_m, unseen_m }) = self.changes.pop() {
            report.events.extend(event);
            report.blocked_m = blocked_m.or(report.blocked_m);
            report.unseen_m = unseen_m.or(report.unseen_m);
        }
        while let Ok(sent) = self.sent.pop() {
            report.sent.push(sent);
        }
        report.sent_dropped = self.sent_dropped.swap(0, Ordering::Relaxed);
        report.in_charge = self.in_charge.load(Ordering::Acquire);
    }
}
