//! The operator's signals, and the memory of the last stop, in a thread of their own: a stop must
//! not wait for the exploration loop, which may be busy or hang.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;

use anyhow::{Context, Result};
use hal::Clock;
use monotonic_clock::MonotonicClock;
use runtime::event::FaultReason;
use runtime::recording::fault_reason;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM, SIGUSR1, SIGUSR2};

use super::last_stop::{LastStop, StopFile};
use crate::control_panel::{ControlPanel, Motion};
use crate::failure::sentence;

/// Period of the thread: the longest delay of a signal, and of writing a stop to the file.
const EVERY_NS: u64 = 10_000_000;

/// The operator's thread, as the rest of the program sees it.
pub struct Operator {
    /// A signal has requested the end of the program.
    pub ends: Arc<AtomicBool>,
    /// A stop that needs a person is in the file, even if the robot is merely disarmed now.
    pub held: Arc<AtomicBool>,
    /// The stop of an earlier run after which the robot does not arm on its own.
    pub last_stop: Option<LastStop>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Operator {
    /// Registers the signals and starts the thread.
    ///
    /// # Errors
    /// When the system refuses a signal handler or a thread.
    pub fn start(panel: ControlPanel, file: (StopFile, Option<LastStop>)) -> Result<Self> {
        let (file, last_stop) = file;
        let signals = Signals::register()?;
        let ends = Arc::clone(&signals.ends);
        let held = Arc::new(AtomicBool::new(last_stop.is_some()));
        let stop = Arc::new(AtomicBool::new(false));
        let mut watch =
            Watch { signals, panel, file, held: Arc::clone(&held), written: last_stop.is_some() };
        let stopped = Arc::clone(&stop);
        let thread = std::thread::Builder::new().name("operator".to_owned()).spawn(move || {
            let mut clock = MonotonicClock;
            while !stopped.load(Ordering::Acquire) {
                watch.update();
                clock.sleep_until_ns(clock.now_ns() + EVERY_NS);
            }
            // A stop in the last moments of the program is remembered too.
            watch.remember();
        })?;
        Ok(Self { ends, held, last_stop, stop, thread: Some(thread) })
    }
}

impl Drop for Operator {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// What the thread owns.
struct Watch {
    signals: Signals,
    panel: ControlPanel,
    file: StopFile,
    held: Arc<AtomicBool>,
    /// The file contains a stop.
    written: bool,
}

impl Watch {
    fn update(&mut self) {
        // The order matters: of several signals at once, the one that stops the robot takes effect
        // last.
        if self.signals.arms.swap(false, Ordering::Relaxed) {
            self.panel.arm();
        }
        if self.signals.ends.load(Ordering::Relaxed) {
            self.panel.disarm();
        }
        if self.signals.stops.swap(false, Ordering::Relaxed) {
            self.panel.stop();
        }
        self.remember();
    }

    /// Writes a stop that needs a person to the file, and removes it once the robot is armed again.
    fn remember(&mut self) {
        let outcome = match self.panel.motion() {
            Motion::NeedsPerson(why) if !self.written => self.write(why),
            Motion::Armed if self.written => self.file.forget().map(|()| self.written = false),
            _ => Ok(()),
        };
        if let Err(error) = outcome {
            tracing::error!("{}", sentence(&error));
            // The attempt and its log message are not repeated in every period.
            self.written = !self.written;
        }
        self.held.store(self.written, Ordering::Release);
    }

    fn write(&mut self, why: FaultReason) -> Result<()> {
        self.file.remember(fault_reason(why))?;
        self.written = true;
        Ok(())
    }
}

/// The signals that operators send.
struct Signals {
    ends: Arc<AtomicBool>,
    arms: Arc<AtomicBool>,
    stops: Arc<AtomicBool>,
}

impl Signals {
    fn register() -> Result<Self> {
        let signals = Self { ends: Arc::default(), arms: Arc::default(), stops: Arc::default() };
        let flags = [
            (SIGINT, &signals.ends),
            (SIGTERM, &signals.ends),
            (SIGHUP, &signals.ends),
            (SIGUSR1, &signals.arms),
            (SIGUSR2, &signals.stops),
        ];
        for (signal, flag) in flags {
            // `nohup` ignores SIGHUP: the robot is to go on without its terminal.
            if signal == SIGHUP && is_ignored(signal) {
                continue;
            }
            signal_hook::flag::register(signal, Arc::clone(flag))
                .context("cannot listen for signals")?;
        }
        Ok(signals)
    }
}

/// Whether this process was started with the signal ignored. `proc(5)` describes the mask.
fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0);
    mask >> (signal - 1) & 1 == 1
}
