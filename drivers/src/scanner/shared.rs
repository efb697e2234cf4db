//! The state that the reader thread shares with other threads.

use std::sync::atomic::{AtomicU8, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use crate::{DeviceState, DeviceStatus};

/// The scanner's identification.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Identity {
    /// The model as reported by the scanner.
    pub model: String,
    /// The serial number; empty when its line was unreadable.
    pub serial: String,
    /// The firmware version; empty when its line was unreadable.
    pub firmware: String,
}

/// The numbers are atomic, so that the safety thread takes no lock. The texts are locked and are
/// for other threads.
#[derive(Debug, Default)]
pub(crate) struct Shared {
    state: AtomicU8,
    pub(crate) good: AtomicU64,
    pub(crate) bad: AtomicU64,
    pub(crate) lost: AtomicU64,
    pub(crate) reopened: AtomicU64,
    pub(crate) last_good_ns: AtomicU64,
    texts: Mutex<Texts>,
}

#[derive(Debug, Default, Clone)]
struct Texts {
    identity: Option<Identity>,
    problem: Option<String>,
}

const STATES: [DeviceState; 5] = [
    DeviceState::Starting,
    DeviceState::Working,
    DeviceState::Silent,
    DeviceState::Disconnected,
    DeviceState::Faulty,
];

impl Shared {
    pub(crate) fn state(&self) -> DeviceState {
        STATES.get(usize::from(self.state.load(Ordering::Acquire))).copied().unwrap_or_default()
    }

    pub(crate) fn set_state(&self, state: DeviceState) {
        let index = STATES.iter().position(|known| *known == state).unwrap_or_default();
        self.state.store(index as u8, Ordering::Release);
    }

    fn with_texts<T>(&self, access: impl FnOnce(&mut Texts) -> T) -> T {
        access(&mut self.texts.lock().unwrap_or_else(PoisonError::into_inner))
    }

    pub(crate) fn set_identity(&self, identity: Identity) {
        self.with_texts(|texts| texts.identity = Some(identity));
    }

    pub(crate) fn set_problem(&self, problem: String) {
        self.with_texts(|texts| texts.problem = Some(problem));
    }

    pub(crate) fn problem(&self) -> Option<String> {
        self.with_texts(|texts| texts.problem.clone())
    }

    pub(crate) fn status(&self) -> DeviceStatus {
        DeviceStatus {
            state: self.state(),
            good: self.good.load(Ordering::Relaxed),
            bad: self.bad.load(Ordering::Relaxed),
            lost: self.lost.load(Ordering::Relaxed),
            reopened: self.reopened.load(Ordering::Relaxed),
            last_good_ns: self.last_good_ns.load(Ordering::Acquire),
        }
    }
}

/// Reads a scanner's state from another thread than the one that polls it.
#[derive(Debug, Clone)]
pub struct LidarMonitor {
    pub(crate) shared: Arc<Shared>,
}

impl LidarMonitor {
    /// The scanner's state and counts. Takes no lock.
    #[must_use]
    pub fn status(&self) -> DeviceStatus {
        self.shared.status()
    }

    /// The scanner's identification; `None` before its first answer.
    #[must_use]
    pub fn identity(&self) -> Option<Identity> {
        self.shared.with_texts(|texts| texts.identity.clone())
    }

    /// The last problem with its remedy, as a text for the operator. It remains after the problem
    /// is solved, which the state shows.
    #[must_use]
    pub fn problem(&self) -> Option<String> {
        self.shared.problem()
    }
}
