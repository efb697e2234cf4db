//! Takes the orders of all clients: judges them, does what cannot wait, passes the rest on to the loop, and notes every one.

use std::sync::mpsc::{SyncSender, TrySendError};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use live_link::{Answer, LineError, Order, OrderLine};
use runtime::operator::OperatorOrder;
use runtime::task::Task;

use super::rate::{Bucket, pause};
use crate::control_panel::{ControlPanel, Plane};

/// Orders a second, and in a burst. A person gives fewer.
const ORDERS_PER_S: f64 = 5.0;
const BURST: f64 = 20.0;
/// The safety plane answers a stop within two steps. This is waited for its answer.
const STOP_ANSWERS_WITHIN: Duration = Duration::from_millis(250);
const LOOK_EVERY: Duration = Duration::from_millis(1);

/// An order that the exploration loop carries out between two ticks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LoopOrder {
    Task(Task),
    SaveMap,
}

/// Takes orders.
pub struct OrderHandler {
    panel: ControlPanel,
    to_loop: SyncSender<LoopOrder>,
    notes: SyncSender<OperatorOrder>,
    keeps_map: bool,
    rate: Mutex<Bucket>,
}

impl OrderHandler {
    /// A handler whose tasks go to the loop by `to_loop`, and whose notes by `notes`.
    pub fn new(
        panel: ControlPanel,
        to_loop: SyncSender<LoopOrder>,
        notes: SyncSender<OperatorOrder>,
        keeps_map: bool,
    ) -> Self {
        let rate = Mutex::new(Bucket::new(ORDERS_PER_S, BURST));
        Self { panel, to_loop, notes, keeps_map, rate }
    }

    /// Carries an order out or refuses it.
    pub fn take(&self, line: &OrderLine) -> Answer {
        let within_rate = self.is_within_rate();
        let outcome = self.judge(line, within_rate).and_then(|()| self.carry_out(line.order));
        // What is over the rate is not noted either, otherwise a flood of orders fills the recording.
        if within_rate {
            self.note(OperatorOrder {
                who: line.who.clone(),
                role: Some(line.role),
                what: line.order.words(),
                refused: outcome.as_ref().err().cloned(),
            });
        }
        let accepted = outcome.is_ok();
        let (Ok(text) | Err(text)) = outcome;
        Answer { id: line.id, accepted, text }
    }

    /// Notes bytes that are no order.
    pub fn refuse(&self, error: &LineError) -> Answer {
        if self.is_within_rate() {
            self.note(OperatorOrder {
                who: "a client of the socket".to_owned(),
                role: None,
                what: "something that is not an order".to_owned(),
                refused: Some(error.to_string().chars().take(200).collect()),
            });
        }
        Answer { id: 0, accepted: false, text: error.to_string() }
    }

    fn judge(&self, line: &OrderLine, within_rate: bool) -> Result<(), String> {
        if !line.order.is_allowed_to(line.role) {
            return Err("this client may watch and stop only".to_owned());
        }
        // A stop is never refused for being the last of many.
        if !within_rate && line.order != Order::Stop {
            return Err(format!("more than {ORDERS_PER_S} orders a second: wait a moment"));
        }
        Ok(())
    }

    fn carry_out(&self, order: Order) -> Result<String, String> {
        match order {
            Order::Stop => {
                self.panel.stop();
                self.wait_until(|plane| matches!(plane, Plane::Fault(_) | Plane::Disarmed))
            }
            Order::Disarm => {
                self.panel.disarm();
                self.wait_until(|plane| plane == Plane::Disarmed)
            }
            Order::Arm => {
                self.panel.arm();
                Ok("the safety plane arms the robot when scanner and wheels are well".to_owned())
            }
            Order::SaveMap if !self.keeps_map => {
                Err("this run keeps no map: start it with --map FILE".to_owned())
            }
            Order::SaveMap => self.pass(LoopOrder::SaveMap, "the map is written to its file"),
            Order::Pause | Order::Resume | Order::GoTo { .. } | Order::Return => {
                let Some(task) = order.task() else { return Err("not a task".to_owned()) };
                self.pass(LoopOrder::Task(task), "the robot takes it with its next tick")
            }
        }
    }

    /// Says only then that the robot is stopped when the safety plane has.
    fn wait_until(&self, is_so: impl Fn(Plane) -> bool) -> Result<String, String> {
        let began = Instant::now();
        while began.elapsed() < STOP_ANSWERS_WITHIN {
            if is_so(self.panel.plane()) {
                return Ok("the safety plane has stopped the robot".to_owned());
            }
            pause(LOOK_EVERY);
        }
        Ok("the safety plane has the order and has not confirmed it yet".to_owned())
    }

    fn pass(&self, order: LoopOrder, says: &str) -> Result<String, String> {
        self.to_loop.try_send(order).map(|()| says.to_owned()).map_err(|error| {
            match error {
                TrySendError::Full(_) => {
                    "the robot has not taken the orders before: it hangs or is busy"
                }
                TrySendError::Disconnected(_) => "the robot is ending its run",
            }
            .to_owned()
        })
    }

    fn note(&self, order: OperatorOrder) {
        if let Err(error) = self.notes.try_send(order) {
            tracing::warn!("an order is missing in the recording: {error}");
        }
    }

    fn is_within_rate(&self) -> bool {
        let mut rate = self.rate.lock().unwrap_or_else(PoisonError::into_inner);
        rate.take(Instant::now())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use runtime::operator::Role;
    use runtime::safety::SafetyState;
    use std::sync::mpsc::{Receiver, sync_channel};

    use crate::control_panel::PanelReader;

    struct Fixture {
        handler: OrderHandler,
        safety: PanelReader,
        to_loop: Receiver<LoopOrder>,
        notes: Receiver<OperatorOrder>,
    }

    fn fixture(keeps_map: bool) -> Fixture {
        let panel = ControlPanel::default();
        let safety = PanelReader::new(panel.clone());
        let (loop_sender, to_loop) = sync_channel(2);
        let (note_sender, notes) = sync_channel(100);
        Fixture {
            handler: OrderHandler::new(panel, loop_sender, note_sender, keeps_map),
            safety,
            to_loop,
            notes,
        }
    }

    fn line(role: Role, order: Order) -> OrderLine {
        OrderLine { id: 3, who: "tester".to_owned(), role, order }
    }

    #[test]
    fn a_task_goes_to_the_loop_and_is_noted() {
        let fixture = fixture(false);
        let answer = fixture.handler.take(&line(Role::Steer, Order::Pause));
        assert!(answer.accepted && answer.id == 3);
        assert_eq!(fixture.to_loop.try_recv(), Ok(LoopOrder::Task(Task::Pause)));
        let note = fixture.notes.recv().unwrap();
        assert_eq!(
            (note.who.as_str(), note.what.as_str(), note.refused),
            ("tester", "pause", None)
        );
    }

    #[test]
    fn a_stop_reaches_the_safety_plane_without_the_loop() {
        let mut fixture = fixture(false);
        fixture.safety.publish(SafetyState::Disarmed);
        let answer = fixture.handler.take(&line(Role::Watch, Order::Stop));
        assert_eq!(answer.text, "the safety plane has stopped the robot");
        assert!(fixture.safety.orders().emergency_stop);
        assert!(fixture.to_loop.try_recv().is_err());
    }

    #[test]
    fn a_stop_that_the_safety_plane_does_not_confirm_is_not_reported_as_done() {
        let fixture = fixture(false);
        fixture.safety.publish(SafetyState::Clear);
        let answer = fixture.handler.take(&line(Role::Steer, Order::Stop));
        assert!(answer.text.contains("not confirmed"), "{answer:?}");
    }

    #[test]
    fn a_watcher_steers_nothing_and_the_attempt_is_noted() {
        let mut fixture = fixture(true);
        for order in Order::ALL.into_iter().filter(|order| *order != Order::Stop) {
            let answer = fixture.handler.take(&line(Role::Watch, order));
            assert!(!answer.accepted && answer.text.contains("watch"), "{answer:?}");
            assert!(fixture.notes.recv().unwrap().refused.is_some());
        }
        assert!(fixture.to_loop.try_recv().is_err());
        let orders = fixture.safety.orders();
        assert!(orders.request.is_none() && !orders.emergency_stop);
    }

    #[test]
    fn a_flood_of_orders_is_refused_but_its_stop_is_not() {
        let mut fixture = fixture(false);
        fixture.safety.publish(SafetyState::Disarmed);
        let refused =
            (0..100).filter(|_| !fixture.handler.take(&line(Role::Steer, Order::Arm)).accepted);
        assert!(refused.count() >= 70);
        fixture.safety.orders();
        assert!(fixture.handler.take(&line(Role::Steer, Order::Stop)).accepted);
        assert!(fixture.safety.orders().emergency_stop);
    }

    #[test]
    fn orders_that_the_loop_does_not_take_are_refused_and_never_wait() {
        let fixture = fixture(true);
        let answers = [Order::Pause, Order::SaveMap, Order::Resume]
            .map(|order| fixture.handler.take(&line(Role::Steer, order)).accepted);
        assert_eq!(answers, [true, true, false]);
        let other = self::fixture(false);
        let answer = other.handler.take(&line(Role::Steer, Order::SaveMap));
        assert!(!answer.accepted && answer.text.contains("--map FILE"), "{answer:?}");
    }
}
