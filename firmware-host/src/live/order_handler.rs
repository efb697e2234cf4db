//! Takes the orders of all clients: judges them, does what cannot wait, passes the rest on to the loop, and notes every one.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{SyncSender, TrySendError};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use live_link::{Answer, LineError, Order, OrderLine};
use runtime::exploration::PolicyKind;
use runtime::operator::OperatorOrder;
use runtime::task::{AreaChange, Task};

use super::hand::Hand;
use super::rate::{Bucket, pause};
use crate::control_panel::{ControlPanel, Plane};

/// Orders a second, and in a burst. A person gives fewer.
const ORDERS_PER_S: f64 = 5.0;
const BURST: f64 = 20.0;
/// The safety plane answers a stop within two steps. This is waited for its answer.
const STOP_ANSWERS_WITHIN: Duration = Duration::from_millis(250);
const LOOK_EVERY: Duration = Duration::from_millis(1);
/// A person draws fewer areas in a run. The planner reads all of them for each path.
const MOST_AREAS: usize = 100;

/// An order that the exploration loop carries out between two ticks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LoopOrder {
    Task(Task),
    /// A drive by hand, and when it was ordered.
    Drive(Task, Instant),
    Area(AreaChange),
    SaveMap,
}

/// What the run can do.
#[derive(Debug, Clone, Copy)]
pub struct Abilities {
    /// It keeps a map in a file.
    pub keeps_map: bool,
    /// Its policy drives along planned paths only.
    pub plans_paths: bool,
    /// The configuration closes areas, which stay closed.
    pub keeps_out: bool,
    /// Number of areas that were drawn on the map in earlier runs.
    pub drawn: usize,
}

/// Checks the orders of clients and passes them to the safety plane or to the exploration loop.
pub struct OrderHandler {
    panel: ControlPanel,
    to_loop: SyncSender<LoopOrder>,
    notes: SyncSender<OperatorOrder>,
    can: Abilities,
    rate: Mutex<Bucket>,
    hand: Mutex<Hand>,
    /// Number of areas that were drawn.
    areas: AtomicUsize,
    plans_paths: AtomicBool,
}

impl OrderHandler {
    /// A handler whose tasks go to the loop by `to_loop`, and whose notes by `notes`.
    pub fn new(
        panel: ControlPanel,
        to_loop: SyncSender<LoopOrder>,
        notes: SyncSender<OperatorOrder>,
        can: Abilities,
    ) -> Self {
        let rate = Mutex::new(Bucket::new(ORDERS_PER_S, BURST));
        let hand = Mutex::default();
        let areas = AtomicUsize::new(can.drawn);
        let plans_paths = AtomicBool::new(can.plans_paths);
        Self { panel, to_loop, notes, can, rate, hand, areas, plans_paths }
    }

    /// Carries an order out or refuses it.
    pub fn take(&self, line: &OrderLine) -> Answer {
        if let (Order::Drive { .. }, Some(task)) = (line.order, line.order.task()) {
            return self.take_drive(line, task);
        }
        let within_rate = self.is_within_rate();
        let outcome = self.judge(line, within_rate).and_then(|()| self.carry_out(line.order));
        // What is over the rate is not noted either, otherwise a flood of orders fills the recording.
        self.answer(line, outcome, within_rate)
    }

    /// Orders of a drive by hand come ten times a second, and only the first one is noted.
    fn take_drive(&self, line: &OrderLine, task: Task) -> Answer {
        let drives = self.drive(line, task);
        let is_noted = drives.clone().unwrap_or_else(|_| self.is_within_rate());
        let outcome = drives.map(|_| "the robot drives as far as it is safe".to_owned());
        self.answer(line, outcome, is_noted)
    }

    fn drive(&self, line: &OrderLine, task: Task) -> Result<bool, String> {
        self.judge(line, true)?;
        let now = Instant::now();
        let begins = lock(&self.hand).take(&line.who, now)?;
        self.pass(LoopOrder::Drive(task, now), "").map(|_| begins)
    }

    fn answer(&self, line: &OrderLine, outcome: Result<String, String>, is_noted: bool) -> Answer {
        if is_noted {
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
            Order::SaveMap if !self.can.keeps_map => {
                Err("this run keeps no map: start it with --map FILE".to_owned())
            }
            Order::SaveMap => self.pass(LoopOrder::SaveMap, "the map is written to its file"),
            Order::KeepOut { .. } | Order::OpenAreas => {
                let Some(change) = order.area() else { return Err("not an area".to_owned()) };
                self.change_areas(change)
            }
            Order::ExploreBy { policy } => self.explore_by(policy),
            Order::Pause
            | Order::Resume
            | Order::GoTo { .. }
            | Order::Return
            | Order::Drive { .. } => {
                let Some(task) = order.task() else { return Err("not a task".to_owned()) };
                self.pass(LoopOrder::Task(task), "the robot takes it with its next tick")
            }
        }
    }

    fn explore_by(&self, policy: PolicyKind) -> Result<String, String> {
        let keeps_out = self.can.keeps_out || self.areas.load(Ordering::Relaxed) > 0;
        if keeps_out && !policy.plans_paths() {
            return Err(format!(
                "the policy `{}` plans no paths and would enter the closed areas",
                policy.name()
            ));
        }
        let task = LoopOrder::Task(Task::ExploreBy { policy });
        let done = self.pass(task, "the robot explores by it from its next tick on")?;
        self.plans_paths.store(policy.plans_paths(), Ordering::Relaxed);
        Ok(done)
    }

    fn change_areas(&self, change: AreaChange) -> Result<String, String> {
        let (count, says) = match change {
            AreaChange::OpenAll => (0, "all areas that were drawn are open with the next tick"),
            AreaChange::Close { .. } => (self.count_with_another_area()?, self.kept_words()),
        };
        let done = self.pass(LoopOrder::Area(change), says)?;
        self.areas.store(count, Ordering::Relaxed);
        Ok(done)
    }

    fn count_with_another_area(&self) -> Result<usize, String> {
        if !self.plans_paths.load(Ordering::Relaxed) {
            return Err("this run's policy plans no paths and would enter closed areas".to_owned());
        }
        let count = self.areas.load(Ordering::Relaxed) + 1;
        if count > MOST_AREAS {
            return Err(format!("{MOST_AREAS} areas are closed already: open them first"));
        }
        Ok(count)
    }

    /// How long an area stays closed.
    fn kept_words(&self) -> &'static str {
        if self.can.keeps_map {
            "the robot plans around it from its next tick on; it is kept with the map"
        } else {
            "the robot plans around it until this run ends; with --map FILE it is kept"
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
                    "earlier orders are still queued; the exploration loop is busy or has stopped responding"
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
        lock(&self.rate).take(Instant::now())
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
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

    const PLANS: Abilities =
        Abilities { keeps_map: false, plans_paths: true, keeps_out: false, drawn: 0 };

    fn fixture(keeps_map: bool) -> Fixture {
        able(Abilities { keeps_map, ..PLANS })
    }

    fn able(can: Abilities) -> Fixture {
        let panel = ControlPanel::default();
        let safety = PanelReader::new(panel.clone());
        let (loop_sender, to_loop) = sync_channel(2);
        let (note_sender, notes) = sync_channel(100);
        Fixture {
            handler: OrderHandler::new(panel, loop_sender, note_sender, can),
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
    fn a_drive_by_hand_goes_to_the_loop_each_time_and_is_noted_once() {
        let fixture = fixture(false);
        let order = Order::Drive { linear_mps: 0.2, angular_radps: 0.1 };
        for _ in 0..5 {
            let answer = fixture.handler.take(&line(Role::Steer, order));
            assert!(answer.accepted, "{answer:?}");
            let Ok(LoopOrder::Drive(task, _)) = fixture.to_loop.try_recv() else { panic!() };
            assert_eq!(Some(task), order.task());
        }
        assert_eq!(fixture.notes.try_iter().count(), 1);
        let other = OrderLine { who: "another".to_owned(), ..line(Role::Steer, order) };
        assert!(fixture.handler.take(&other).text.contains("tester drives"));
        assert!(fixture.notes.recv().unwrap().refused.is_some());
    }

    #[test]
    fn areas_are_passed_on_up_to_a_number_and_refused_without_a_planner() {
        let close = Order::KeepOut { corners_m: [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]] };
        let fixture = fixture(false);
        // The rate of orders is not what is tested here.
        for _ in 0..MOST_AREAS {
            assert!(change_areas(&fixture, close).unwrap().contains("until this run ends"));
            assert!(matches!(fixture.to_loop.try_recv(), Ok(LoopOrder::Area(_))));
        }
        assert!(change_areas(&fixture, close).unwrap_err().contains("open them first"));
        change_areas(&fixture, Order::OpenAreas).unwrap();
        change_areas(&fixture, close).unwrap();
        let random = able(Abilities { keeps_map: true, plans_paths: false, ..PLANS });
        let answer = random.handler.take(&line(Role::Steer, close));
        assert!(!answer.accepted && answer.text.contains("plans no paths"), "{answer:?}");
    }

    #[test]
    fn a_policy_without_paths_is_refused_while_areas_are_closed_and_no_area_is_closed_after_it() {
        let close = Order::KeepOut { corners_m: [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]] };
        let fixture = fixture(false);
        assert!(accepts(&fixture, close) && accepts(&fixture, by(PolicyKind::Frontier)));
        assert!(!accepts(&fixture, by(PolicyKind::Random)));
        assert!(accepts(&fixture, Order::OpenAreas) && accepts(&fixture, by(PolicyKind::Random)));
        assert!(!accepts(&fixture, close));
        assert!(accepts(&fixture, by(PolicyKind::Active)) && accepts(&fixture, close));
        let fenced = able(Abilities { keeps_out: true, ..PLANS });
        let answer = fenced.handler.take(&line(Role::Steer, by(PolicyKind::Forward)));
        assert!(!answer.accepted && answer.text.contains("`forward` plans no paths"), "{answer:?}");
        // Areas of earlier runs can be opened; those of the configuration cannot.
        for (can, is_free) in [
            (Abilities { drawn: 3, ..PLANS }, true),
            (Abilities { keeps_out: true, drawn: 3, ..PLANS }, false),
        ] {
            let drawn = able(can);
            assert!(!accepts(&drawn, by(PolicyKind::Random)) && accepts(&drawn, Order::OpenAreas));
            assert_eq!(accepts(&drawn, by(PolicyKind::Random)), is_free);
        }
    }

    fn change_areas(fixture: &Fixture, order: Order) -> Result<String, String> {
        fixture.handler.change_areas(order.area().unwrap())
    }

    fn by(policy: PolicyKind) -> Order {
        Order::ExploreBy { policy }
    }

    fn accepts(fixture: &Fixture, order: Order) -> bool {
        let answer = fixture.handler.take(&line(Role::Steer, order));
        let _ = fixture.to_loop.try_recv();
        answer.accepted
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
