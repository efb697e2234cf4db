//! The live view of a running robot: telemetry to, and orders from, the programs that connect to a Unix socket.
//!
//! The planes neither wait for it nor know of it. After a tick, the loop copies what some client has subscribed, as often as the
//! configuration allows, into a short queue; what does not fit is dropped and counted. A thread of low priority encodes it, and
//! every client has a reader and a writer of its own. Orders to stop and to arm go from the client's thread to the safety plane
//! directly ([`ControlPanel`]); tasks wait for the next tick. Every order
//! within the rate limit is noted in the input of a tick, and so recorded.

mod channels;
mod depth_color;
mod encode;
mod hand;
mod hub;
mod keep_out_scene;
mod order_handler;
mod rate;
mod socket;
#[cfg(test)]
mod tests;
mod tick_copy;
mod watchers;
mod words;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use hal::{CameraModel, Pose3};
use runtime::exploration::PolicyKind;
use runtime::operator::OperatorOrder;
use runtime::robot::Robot;
use runtime::session::{Devices, Session};
use runtime::task::{AreaChange, Task};
use runtime::tick::{Decision, TickInput};

use crate::areas;
use crate::config::Config;
use crate::control_panel::ControlPanel;
use crate::failure;
use crate::map::KeptMap;
use crate::run::status::Status;
use encode::{Encoder, Item};
use hand::DRIVE_WITHIN;
use hub::Hub;
pub use order_handler::Abilities;
use order_handler::{LoopOrder, OrderHandler};
use socket::Server;
use tick_copy::Copies;
use watchers::Watchers;
use words::StateTracker;

/// Ticks that wait for the thread that encodes them: the time that a large map takes.
const QUEUE: usize = 4;
/// Orders that wait for the next tick.
const ORDERS: usize = 32;

/// The live view, as the exploration loop sees it.
pub struct Live {
    hub: Arc<Hub>,
    queue: SyncSender<Item>,
    copies: Copies,
    state: StateTracker,
    orders: Receiver<LoopOrder>,
    notes: Receiver<OperatorOrder>,
    dropped: u64,
    watchers: Watchers,
    // Its `drop` ends the threads and removes the socket.
    _server: Server,
}

/// What the views of a run have in common.
#[derive(Debug, Clone)]
pub(crate) struct Mounts {
    pub camera: CameraModel,
    pub t_base_camera: Pose3,
    pub t_base_laser: Pose3,
}

/// The socket that the command line or the configuration names.
#[must_use]
pub fn socket_of(argument: Option<&Path>, config: &Config) -> Option<PathBuf> {
    let configured = Some(&config.live.socket).filter(|path| !path.is_empty());
    argument.map(Path::to_path_buf).or_else(|| configured.map(PathBuf::from))
}

/// What the orders of a run with this map and this policy can do.
///
/// # Errors
/// A policy that would enter the areas which were drawn on the map.
pub fn abilities(map: Option<&KeptMap>, policy: PolicyKind, config: &Config) -> Result<Abilities> {
    let can_keep_out = areas::can_keep_out(policy, config);
    let plans_paths = can_keep_out.is_ok();
    let drawn = map.map_or(0, |map| map.area_changes().count());
    if drawn > 0 {
        can_keep_out.context("areas are drawn on the map")?;
    }
    let planning = &config.planning;
    let keeps_out = !planning.keep_out_m.is_empty() || !planning.keep_in_m.is_empty();
    Ok(Abilities { keeps_map: map.is_some(), plans_paths, keeps_out, drawn })
}

impl Live {
    /// Opens the socket and starts the threads.
    ///
    /// # Errors
    /// A socket that cannot be opened, for example because another robot serves it.
    pub fn start(
        path: &Path,
        config: &Config,
        panel: ControlPanel,
        can: Abilities,
    ) -> Result<Self> {
        let hub = Arc::new(Hub::default());
        let (queue, items) = sync_channel(QUEUE);
        let (order_sender, orders) = sync_channel(ORDERS);
        let (note_sender, notes) = sync_channel(ORDERS);
        let handler = OrderHandler::new(panel.clone(), order_sender, note_sender, can);
        let server = Server::start(path, Arc::clone(&hub), Arc::new(handler))?;
        let mounts = Mounts {
            camera: config.camera.model(),
            t_base_camera: config.camera.t_base_camera(),
            t_base_laser: config.lidar.t_base_laser_3d(),
        };
        Encoder::start(Arc::clone(&hub), config.live.clone(), mounts, items)?;
        let copies = Copies::new(&config.live, Arc::clone(&hub));
        let state = StateTracker::new(panel);
        let watchers = Watchers::new(config.live.pause_when_unwatched_s);
        Ok(Self { hub, queue, copies, state, orders, notes, dropped: 0, watchers, _server: server })
    }

    /// Gives the orders that have come to the session before its next tick.
    pub fn serve<D: Devices>(&mut self, session: &mut Session<D>, map: Option<&mut KeptMap>) {
        while let Ok(note) = self.notes.try_recv() {
            tracing::warn!("{}", note.sentence());
            session.note(note);
        }
        if self.watchers.are_gone(self.hub.has_subscriptions(), Instant::now()) {
            pause(session);
        }
        let mut map = map;
        while let Ok(order) = self.orders.try_recv() {
            match order {
                LoopOrder::Drive(_, when) if when.elapsed() > DRIVE_WITHIN => {
                    tracing::warn!("an order to drive came too late and is not carried out");
                }
                LoopOrder::Task(task) | LoopOrder::Drive(task, _) => {
                    // The place was checked when the order was read.
                    if let Err(error) = session.give(task) {
                        tracing::error!("{error}");
                    }
                }
                LoopOrder::Area(change) => change_areas(change, session, map.as_deref_mut()),
                LoopOrder::SaveMap => {
                    let saved = map.as_mut().map(|map| map.save_aside(session.robot()));
                    if let Some(Err(error)) = saved {
                        tracing::error!("{}", failure::sentence(&error));
                    }
                }
            }
        }
    }

    /// Shows a tick to the clients, as far as some have subscribed and the thread that encodes keeps up. Never waits.
    pub fn offer(
        &mut self,
        robot: &Robot,
        input: &TickInput<'_>,
        decision: &Decision,
        took: Duration,
    ) {
        self.state.note(input, decision);
        if !self.hub.has_subscriptions() {
            return;
        }
        let now = self.state.now(robot, input, decision, took, self.dropped);
        let copy = self.copies.of(robot, input, decision, now);
        if self.queue.try_send(Item::Tick(Box::new(copy))).is_err() {
            self.dropped += 1;
        }
    }

    /// Shows the robot's health.
    pub fn show_health(&mut self, status: &Status) {
        if self.hub.has_subscriptions()
            && self.queue.try_send(Item::Health(Box::new(status.clone()))).is_err()
        {
            self.dropped += 1;
        }
    }
}

/// Pauses a robot that is not watched any more, and notes it as an order.
fn pause<D: Devices>(session: &mut Session<D>) {
    let order = OperatorOrder {
        who: "live.pause_when_unwatched_s".to_owned(),
        role: None,
        what: "pause, because no client watches any more".to_owned(),
        refused: None,
    };
    tracing::warn!("{}", order.sentence());
    session.note(order);
    // A pause has no number that could be refused.
    if let Err(error) = session.give(Task::Pause) {
        tracing::error!("{error}");
    }
}

/// Closes or opens areas, and keeps them with the map.
fn change_areas<D: Devices>(
    change: AreaChange,
    session: &mut Session<D>,
    map: Option<&mut KeptMap>,
) {
    // The corners were checked when the order was read.
    if let Err(error) = session.change_areas(change) {
        tracing::error!("{error}");
        return;
    }
    if let Some(Err(error)) = map.map(|map| map.change_areas(change, session.robot())) {
        tracing::error!("the closed areas are not kept: {}", failure::sentence(&error));
    }
}
