//! The connected clients and what each of them wants.

use std::sync::atomic::{AtomicU32, AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::channels::Topic;

/// Most clients at a time. Viewers connect to `live-view`, which is one client.
pub const MOST_CLIENTS: usize = 16;
/// Frames that wait for a client.
const MOST_FRAMES: usize = 64;
/// Bytes that wait for a client: a second of everything.
const MOST_BYTES: usize = 8 << 20;

/// The connected clients and the topics that they want.
#[derive(Debug, Default)]
pub struct Hub {
    clients: Mutex<Vec<Arc<Client>>>,
    /// The topics that some client wants, one bit each. The exploration loop reads only this.
    wanted: AtomicU32,
    /// The topics that a client has subscribed since the last tick: their first message does not wait for its turn.
    fresh: AtomicU32,
}

/// The queue of one client.
#[derive(Debug)]
pub struct Client {
    queue: SyncSender<Arc<[u8]>>,
    wants: AtomicU32,
    waiting_bytes: Arc<AtomicUsize>,
    dropped: AtomicU64,
}

/// The frames that wait for a client.
pub struct Outgoing {
    frames: Receiver<Arc<[u8]>>,
    waiting_bytes: Arc<AtomicUsize>,
}

impl Hub {
    /// Adds a client that wants nothing yet; `None` if there are too many.
    pub fn join(&self) -> Option<(Arc<Client>, Outgoing)> {
        let mut clients = self.clients();
        if clients.len() >= MOST_CLIENTS {
            return None;
        }
        let (queue, frames) = sync_channel(MOST_FRAMES);
        let waiting_bytes = Arc::new(AtomicUsize::new(0));
        let client = Arc::new(Client {
            queue,
            wants: AtomicU32::new(0),
            waiting_bytes: Arc::clone(&waiting_bytes),
            dropped: AtomicU64::new(0),
        });
        clients.push(Arc::clone(&client));
        Some((client, Outgoing { frames, waiting_bytes }))
    }

    /// Removes a client.
    pub fn leave(&self, client: &Arc<Client>) {
        let mut clients = self.clients();
        clients.retain(|other| !Arc::ptr_eq(other, client));
        self.count(&clients);
    }

    /// Sets what a client wants. Numbers of channels that do not exist are ignored.
    pub fn subscribe(&self, client: &Client, channels: &[u16]) {
        let wants = Topic::ALL
            .iter()
            .filter(|topic| channels.contains(&topic.id()))
            .fold(0, |bits, topic| bits | topic.bit());
        let before = client.wants.swap(wants, Ordering::AcqRel);
        self.count(&self.clients());
        self.fresh.fetch_or(wants & !before, Ordering::AcqRel);
    }

    fn count(&self, clients: &[Arc<Client>]) {
        let wanted =
            clients.iter().fold(0, |bits, client| bits | client.wants.load(Ordering::Acquire));
        self.wanted.store(wanted, Ordering::Release);
    }

    /// Whether some client wants something.
    pub fn has_subscriptions(&self) -> bool {
        self.wanted.load(Ordering::Acquire) != 0
    }

    /// Whether some client wants messages of this topic.
    pub fn wants(&self, topic: Topic) -> bool {
        self.wanted.load(Ordering::Acquire) & topic.bit() != 0
    }

    /// Whether a client has subscribed this topic since the last call.
    pub fn is_fresh(&self, topic: Topic) -> bool {
        self.fresh.fetch_and(!topic.bit(), Ordering::AcqRel) & topic.bit() != 0
    }

    /// Passes a frame on to the clients that want it and keep up.
    pub fn send(&self, topic: Topic, frame: &Arc<[u8]>) {
        for client in self.clients().iter() {
            if client.wants.load(Ordering::Acquire) & topic.bit() != 0 {
                client.offer(frame);
            }
        }
    }

    fn clients(&self) -> MutexGuard<'_, Vec<Arc<Client>>> {
        self.clients.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Client {
    /// Queues a frame, or drops and counts it.
    fn offer(&self, frame: &Arc<[u8]>) {
        let waiting = self.waiting_bytes.fetch_add(frame.len(), Ordering::AcqRel);
        let fits = waiting == 0 || waiting + frame.len() <= MOST_BYTES;
        if !fits || self.queue.try_send(Arc::clone(frame)).is_err() {
            self.waiting_bytes.fetch_sub(frame.len(), Ordering::AcqRel);
            self.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Queues a frame that must not be dropped, such as an answer. Waits if the client is slow; `false` if it is gone.
    pub fn deliver(&self, frame: Vec<u8>) -> bool {
        self.waiting_bytes.fetch_add(frame.len(), Ordering::AcqRel);
        self.queue.send(frame.into()).is_ok()
    }

    /// Frames that the client did not get because it was too slow.
    pub fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }
}

impl Outgoing {
    /// The next frame; waits for one. `None` when the client has left.
    pub fn next(&self) -> Option<Arc<[u8]>> {
        let frame = self.frames.recv().ok()?;
        self.waiting_bytes.fetch_sub(frame.len(), Ordering::AcqRel);
        Some(frame)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(bytes: usize) -> Arc<[u8]> {
        vec![0; bytes].into()
    }

    #[test]
    fn a_client_gets_what_it_wants_and_nothing_else() {
        let hub = Hub::default();
        let (client, outgoing) = hub.join().unwrap();
        assert!(!hub.has_subscriptions());
        hub.subscribe(&client, &[Topic::Map.id(), 999]);
        assert!(hub.wants(Topic::Map) && !hub.wants(Topic::Scan));
        assert!(hub.is_fresh(Topic::Map) && !hub.is_fresh(Topic::Map));
        hub.send(Topic::Scan, &frame(3));
        hub.send(Topic::Map, &frame(5));
        assert_eq!(outgoing.next().unwrap().len(), 5);
        hub.leave(&client);
        assert!(!hub.has_subscriptions());
    }

    #[test]
    fn a_client_that_does_not_read_costs_bounded_memory_and_no_time() {
        let hub = Hub::default();
        let (slow, outgoing) = hub.join().unwrap();
        hub.subscribe(&slow, &[Topic::Map.id()]);
        for _ in 0..100 {
            hub.send(Topic::Map, &frame(1 << 20));
        }
        assert_eq!(slow.dropped(), 92);
        // After it has read, it gets new frames again.
        (0..8).for_each(|_| drop(outgoing.next()));
        hub.send(Topic::Map, &frame(9));
        assert_eq!(outgoing.next().unwrap().len(), 9);
        for _ in 0..100 {
            hub.send(Topic::Map, &frame(1));
        }
        assert_eq!(slow.dropped(), 92 + 100 - MOST_FRAMES as u64);
    }

    #[test]
    fn there_are_not_more_clients_than_threads_are_allowed() {
        let hub = Hub::default();
        let clients: Vec<_> = (0..MOST_CLIENTS).map(|_| hub.join().unwrap()).collect();
        assert!(hub.join().is_none());
        hub.leave(&clients[0].0);
        assert!(hub.join().is_some());
    }
}
