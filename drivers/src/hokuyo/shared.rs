//! What the reader's thread tells the others.

use std::sync::atomic::{AtomicU8, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use crate::{DeviceState, DeviceStatus};

/// Who the scanner says it is.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Identity {
    /// Model, in its own words.
    pub model: String,
    /// Serial number; empty when its line was unreadable.
    pub serial: String,
    /// Firmware; empty when its line was unreadable.
    pub firmware: String,
}

/// Numbers are atomic, so that the safety thread takes no lock; texts are for the others.
#[derive(Debug, Default)]
pub(super) struct Shared {
    state: AtomicU8,
    pub(super) good: AtomicU64,
    pub(super) bad: AtomicU64,
    pub(super) lost: AtomicU64,
    pub(super) reopened: AtomicU64,
    pub(super) last_good_ns: AtomicU64,
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
    pub(super) fn state(&self) -> DeviceState {
        STATES.get(usize::from(self.state.load(Ordering::Acquire))).copied().unwrap_or_default()
    }

    pub(super) fn set_state(&self, state: DeviceState) {
        let index = STATES.iter().position(|one| *one == state).unwrap_or_default();
        self.state.store(index as u8, Ordering::Release);
    }

    fn with_texts<T>(&self, f: impl FnOnce(&mut Texts) -> T) -> T {
        f(&mut self.texts.lock().unwrap_or_else(PoisonError::into_inner))
    }

    pub(super) fn set_identity(&self, identity: Identity) {
        self.with_texts(|texts| texts.identity = Some(identity));
    }

    pub(super) fn set_problem(&self, problem: String) {
        self.with_texts(|texts| texts.problem = Some(problem));
    }
}

/// Looks at a scanner from another thread than the one that polls it.
#[derive(Debug, Clone)]
pub struct HokuyoMonitor {
    pub(super) shared: Arc<Shared>,
}

impl HokuyoMonitor {
    /// State and counts. Takes no lock.
    #[must_use]
    pub fn status(&self) -> DeviceStatus {
        let shared = &self.shared;
        DeviceStatus {
            state: shared.state(),
            good: shared.good.load(Ordering::Relaxed),
            bad: shared.bad.load(Ordering::Relaxed),
            lost: shared.lost.load(Ordering::Relaxed),
            reopened: shared.reopened.load(Ordering::Relaxed),
            last_good_ns: shared.last_good_ns.load(Ordering::Acquire),
        }
    }

    /// Who it is; `None` before it answered for the first time.
    #[must_use]
    pub fn identity(&self) -> Option<Identity> {
        self.shared.with_texts(|texts| texts.identity.clone())
    }

    /// The last thing that went wrong and the way out, for people. Stays after it has been overcome: the state says whether.
    #[must_use]
    pub fn problem(&self) -> Option<String> {
        self.shared.with_texts(|texts| texts.problem.clone())
    }
}
