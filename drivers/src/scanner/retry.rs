//! The life of a reader thread: a session with the scanner, then a pause, then the next session.

use std::sync::atomic::Ordering::Relaxed;

use super::link::{Stop, wait_for_stop};
use super::shared::Shared;
use crate::DeviceState;
use monotonic_clock::monotonic_ns;

/// Delay between two attempts to open the port, doubled after each failure.
pub(crate) const FIRST_WAIT_NS: u64 = 50_000_000;
const LONGEST_WAIT_NS: u64 = 1_000_000_000;

/// Why a session ended or could not be started.
pub(crate) enum End<E> {
    /// The driver is being dropped.
    Stopped,
    /// An error. The reader tries again later.
    Failed(E),
}

impl<E> From<E> for End<E> {
    fn from(error: E) -> Self {
        Self::Failed(error)
    }
}

/// Runs sessions until the driver is dropped. `session` receives whether an earlier
/// one had good scans.
pub(crate) fn keep_trying<E: hal::Error>(
    shared: &Shared,
    stop: &Stop,
    mut session: impl FnMut(bool) -> End<E>,
) {
    let mut wait_ns = FIRST_WAIT_NS;
    let mut was_alive = false;
    loop {
        let good_before = shared.good.load(Relaxed);
        let End::Failed(error) = session(was_alive) else { return };
        report(shared, &error);
        if shared.good.load(Relaxed) > good_before {
            was_alive = true;
            wait_ns = FIRST_WAIT_NS;
        }
        if wait_for_stop(stop, monotonic_ns() + wait_ns) {
            return;
        }
        wait_ns = (wait_ns * 2).min(LONGEST_WAIT_NS);
    }
}

fn report<E: hal::Error>(shared: &Shared, error: &E) {
    shared.set_state(match error.kind() {
        hal::ErrorKind::Timeout => DeviceState::Silent,
        hal::ErrorKind::Fault | hal::ErrorKind::Unsupported => DeviceState::Faulty,
        _ => DeviceState::Disconnected,
    });
    shared.set_problem(error.to_string());
}
