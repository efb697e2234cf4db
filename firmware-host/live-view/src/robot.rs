//! The connection to the robot: one for all clients, opened again whenever it ends.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use anyhow::{Context, Result};
use live_link::{Answer, Channel, Frame, FrameReader, Line, Order, OrderLine};
use runtime::operator::Role;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::UnixStream;
use tokio::sync::{mpsc, oneshot, watch};

use crate::protocol;

/// Time until the next attempt to connect.
const RETRY: Duration = Duration::from_millis(300);
/// The robot answers an order in this time, or not at all.
const ANSWERS_WITHIN: Duration = Duration::from_secs(2);
/// Lines that wait to be written to the robot.
const LINES: usize = 64;
/// Messages, and bytes of them, that wait for a client.
const MESSAGES: usize = 64;
const MOST_BYTES: usize = 8 << 20;
/// Bytes that are read at once.
const PIECE: usize = 64 << 10;

/// A handle to the connection, which all clients share.
#[derive(Clone)]
pub struct Robot {
    shared: Arc<Shared>,
}

/// What is known of the robot.
#[derive(Debug, Clone, Default)]
pub struct Link {
    /// The channels of the newest connection.
    pub channels: Arc<Vec<Channel>>,
    /// Why there is no connection.
    pub lost: Option<Arc<str>>,
}

struct Shared {
    link: watch::Sender<Link>,
    lines: mpsc::Sender<Line>,
    listeners: Mutex<Vec<Arc<Listener>>>,
    answers: Mutex<HashMap<u64, oneshot::Sender<Answer>>>,
    next_id: AtomicU64,
}

/// A client, as the connection sees it.
pub struct Listener {
    /// Channels of the robot with the subscriptions of the client.
    subscriptions: Mutex<Vec<(u16, u32)>>,
    queue: mpsc::Sender<Vec<u8>>,
    waiting_bytes: AtomicUsize,
    dropped: AtomicU64,
}

impl Robot {
    /// Connects to the socket at this path now, or as soon as there is one. Must be called in a tokio runtime.
    #[must_use]
    pub fn connect(path: &Path) -> Self {
        let (lines, receiver) = mpsc::channel(LINES);
        let lost = Some(format!("there is no robot at {} yet", path.display()).into());
        let shared = Arc::new(Shared {
            link: watch::Sender::new(Link { lost, ..Link::default() }),
            lines,
            listeners: Mutex::default(),
            answers: Mutex::default(),
            next_id: AtomicU64::new(1),
        });
        tokio::spawn(stay_connected(path.to_owned(), Arc::clone(&shared), receiver));
        Self { shared }
    }

    /// What is known of the robot, and every change of it.
    #[must_use]
    pub fn link(&self) -> watch::Receiver<Link> {
        self.shared.link.subscribe()
    }

    /// Adds a client that subscribes nothing yet, with the messages for it.
    #[must_use]
    pub fn join(&self) -> (Arc<Listener>, mpsc::Receiver<Vec<u8>>) {
        let (queue, messages) = mpsc::channel(MESSAGES);
        let listener = Arc::new(Listener {
            subscriptions: Mutex::default(),
            queue,
            waiting_bytes: AtomicUsize::new(0),
            dropped: AtomicU64::new(0),
        });
        self.shared.listeners().push(Arc::clone(&listener));
        (listener, messages)
    }

    /// Number of clients.
    #[must_use]
    pub fn listeners(&self) -> usize {
        self.shared.listeners().len()
    }

    /// Removes a client.
    pub fn leave(&self, listener: &Arc<Listener>) {
        self.shared.listeners().retain(|other| !Arc::ptr_eq(other, listener));
        self.shared.subscribe();
    }

    /// Changes the subscriptions of a client.
    pub fn subscribe(&self, listener: &Listener, change: impl FnOnce(&mut Vec<(u16, u32)>)) {
        change(&mut lock(&listener.subscriptions));
        self.shared.subscribe();
    }

    /// Gives the robot an order, and waits for its answer.
    ///
    /// # Errors
    /// Why the order did not reach the robot.
    pub async fn order(&self, who: &str, role: Role, order: Order) -> Result<Answer, String> {
        if let Some(lost) = &self.shared.link.borrow().lost {
            return Err(format!("the order did not reach the robot: {lost}"));
        }
        let id = self.shared.next_id.fetch_add(1, Ordering::Relaxed);
        let (sender, answer) = oneshot::channel();
        lock(&self.shared.answers).insert(id, sender);
        let line = Line::Order(OrderLine { id, who: who.to_owned(), role, order });
        if self.shared.lines.try_send(line).is_err() {
            lock(&self.shared.answers).remove(&id);
            return Err(
                "the order did not reach the robot: it takes nothing at the moment".to_owned()
            );
        }
        let answered = tokio::time::timeout(ANSWERS_WITHIN, answer).await;
        lock(&self.shared.answers).remove(&id);
        match answered {
            Ok(Ok(answer)) => Ok(answer),
            Ok(Err(_)) => Err("the connection to the robot ended before its answer".to_owned()),
            Err(_) => Err("the robot has not answered within 2 s".to_owned()),
        }
    }
}

impl Listener {
    /// Must be called for every message that was taken from the queue.
    pub fn taken(&self, message: &[u8]) {
        self.waiting_bytes.fetch_sub(message.len(), Ordering::AcqRel);
    }

    /// Messages that this client did not get because it was too slow.
    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    fn offer(&self, message: Vec<u8>) {
        let bytes = message.len();
        let waiting = self.waiting_bytes.fetch_add(bytes, Ordering::AcqRel);
        let fits = waiting == 0 || waiting + bytes <= MOST_BYTES;
        if !fits || self.queue.try_send(message).is_err() {
            self.waiting_bytes.fetch_sub(bytes, Ordering::AcqRel);
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }
}

impl Shared {
    fn listeners(&self) -> MutexGuard<'_, Vec<Arc<Listener>>> {
        lock(&self.listeners)
    }

    /// What some client has subscribed.
    fn wanted(&self) -> Vec<u16> {
        let mut wanted: Vec<u16> = Vec::new();
        for listener in self.listeners().iter() {
            wanted.extend(lock(&listener.subscriptions).iter().map(|(channel, _)| channel));
        }
        wanted.sort_unstable();
        wanted.dedup();
        wanted
    }

    /// Asks the robot for what is wanted now. A connection asks again when it begins.
    fn subscribe(&self) {
        if self.lines.try_send(Line::Subscribe(self.wanted())).is_err() {
            tracing::warn!("the robot takes no subscriptions at the moment");
        }
    }

    fn frame(&self, frame: Frame) {
        match frame {
            Frame::Channels(channels) => {
                self.link.send_replace(Link { channels: Arc::new(channels), lost: None });
                self.subscribe();
            }
            Frame::Answer(answer) => {
                if let Some(waits) = lock(&self.answers).remove(&answer.id) {
                    let _ = waits.send(answer);
                }
            }
            Frame::Message { channel, time_ns, payload } => {
                for listener in self.listeners().iter() {
                    for (wanted, id) in lock(&listener.subscriptions).iter() {
                        if *wanted == channel {
                            listener.offer(protocol::message_data(*id, time_ns, &payload));
                        }
                    }
                }
            }
        }
    }

    fn lost(&self, why: &str) {
        lock(&self.answers).clear();
        let is_news = self.link.borrow().lost.as_deref() != Some(why);
        if is_news {
            self.link.send_modify(|link| link.lost = Some(why.into()));
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

async fn stay_connected(path: PathBuf, shared: Arc<Shared>, mut lines: mpsc::Receiver<Line>) {
    loop {
        match UnixStream::connect(&path).await {
            Ok(stream) => {
                // An order for an earlier run is not for this one.
                while lines.try_recv().is_ok() {}
                let ended = converse(stream, &shared, &mut lines).await;
                let why = ended.err().map_or_else(String::new, |error| format!(": {error:#}"));
                tracing::warn!("the connection to the robot has ended{why}");
                shared.lost("the robot's program has ended, or does not answer");
            }
            Err(error) => {
                tracing::debug!("{}: {error}", path.display());
            }
        }
        tokio::time::sleep(RETRY).await;
    }
}

/// Passes frames and lines on until the connection ends.
async fn converse(
    stream: UnixStream,
    shared: &Shared,
    lines: &mut mpsc::Receiver<Line>,
) -> Result<()> {
    let (mut from_robot, mut to_robot) = stream.into_split();
    let mut reader = FrameReader::default();
    let mut piece = vec![0; PIECE];
    loop {
        tokio::select! {
            count = from_robot.read(&mut piece) => {
                let count = count?;
                if count == 0 {
                    return Ok(());
                }
                reader.push(piece.get(..count).unwrap_or_default());
                while let Some(frame) = reader.next_frame()? {
                    shared.frame(frame);
                }
            }
            line = lines.recv() => {
                let line = line.context("the program ends")?;
                to_robot.write_all(&line.to_bytes()?).await?;
            }
        }
    }
}
