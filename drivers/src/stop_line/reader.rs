//! The thread that reads the line, and what the safety loop and other threads see of it.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use hal::Clock;
use monotonic_clock::MonotonicClock;

use super::{Debounce, Line, StopLineConfig, StopLineError, open_line};

/// Time between two samples. With the default debounce time a press counts within 15 ms.
const SAMPLE_NS: u64 = 5_000_000;
/// Without a sample for this long the stop counts as pressed: the same limit as for a safety board.
const STALE_NS: u64 = 100_000_000;
/// Time between two attempts to open a line that is gone.
const RETRY_NS: u64 = 1_000_000_000;
/// The start waits this long for the first decision.
const FIRST_DECISION: Duration = Duration::from_secs(1);

/// What the thread publishes.
#[derive(Debug)]
struct Shared {
    pressed: AtomicBool,
    sampled_ns: AtomicU64,
    ends: AtomicBool,
    /// Why the line cannot be read, for other threads than the safety loop.
    problem: Mutex<Option<String>>,
}

/// The emergency stop's line. Dropping it ends its thread.
#[derive(Debug)]
pub struct StopLine {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

/// Shows the line's state to other threads.
#[derive(Debug, Clone)]
pub struct StopLineMonitor {
    shared: Arc<Shared>,
}

impl StopLine {
    /// Starts reading the line of the configuration; `None` if it names none. A line that is absent is
    /// pressed until it is found. Waits for the first decision, so that a released stop is not taken
    /// for a pressed one at the start.
    ///
    /// # Errors
    /// The configuration is not allowed, or the thread cannot be started.
    pub fn start(config: &StopLineConfig) -> Result<Option<Self>, StopLineError> {
        config.validate()?;
        if !config.is_used() {
            return Ok(None);
        }
        let shared = Arc::new(Shared {
            pressed: AtomicBool::new(true),
            sampled_ns: AtomicU64::new(0),
            ends: AtomicBool::new(false),
            problem: Mutex::new(None),
        });
        let (decided, first_decision) = sync_channel(1);
        let reader = Reader {
            config: config.clone(),
            shared: Arc::clone(&shared),
            line: None,
            retry_ns: 0,
            debounce: Debounce::new(config),
        };
        let thread = std::thread::Builder::new()
            .name("emergency stop".to_owned())
            .spawn(move || reader.run(&decided))
            .map_err(|source| StopLineError::Thread { source })?;
        // Without a decision the stop is pressed.
        let _ = first_decision.recv_timeout(FIRST_DECISION);
        Ok(Some(Self { shared, thread: Some(thread) }))
    }

    /// Whether the stop is pressed, or its line could not be read, or was not read for too long. Takes
    /// no lock.
    #[must_use]
    pub fn is_pressed(&self, now_ns: u64) -> bool {
        let sampled_ns = self.shared.sampled_ns.load(Ordering::Acquire);
        self.shared.pressed.load(Ordering::Acquire) || now_ns.saturating_sub(sampled_ns) > STALE_NS
    }

    /// A view of the line for other threads.
    #[must_use]
    pub fn monitor(&self) -> StopLineMonitor {
        StopLineMonitor { shared: Arc::clone(&self.shared) }
    }
}

impl StopLineMonitor {
    /// Why the line cannot be read, with the remedy; `None` while it is read.
    #[must_use]
    pub fn problem(&self) -> Option<String> {
        self.shared.problem.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Whether the stop was pressed at the newest sample.
    #[must_use]
    pub fn is_pressed(&self) -> bool {
        self.shared.pressed.load(Ordering::Acquire)
    }
}

impl Drop for StopLine {
    fn drop(&mut self) {
        self.shared.ends.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// What the thread owns.
struct Reader {
    config: StopLineConfig,
    shared: Arc<Shared>,
    line: Option<Box<dyn Line>>,
    /// Earliest time of the next attempt to open the line.
    retry_ns: u64,
    debounce: Debounce,
}

impl Reader {
    fn run(mut self, decided: &SyncSender<()>) {
        let mut clock = MonotonicClock;
        while !self.shared.ends.load(Ordering::Acquire) {
            let now_ns = clock.now_ns();
            self.sample(now_ns);
            if self.debounce.is_settled() {
                let _ = decided.try_send(());
            }
            clock.sleep_until_ns(now_ns + SAMPLE_NS);
        }
    }

    fn sample(&mut self, now_ns: u64) {
        if self.line.is_none() && now_ns >= self.retry_ns {
            self.retry_ns = now_ns + RETRY_NS;
            match open_line(&self.config) {
                Ok(line) => self.line = Some(line),
                Err(error) => self.set_problem(Some(error.to_string())),
            }
        }
        let level = match self.line.as_ref().map(|line| line.read()) {
            Some(Ok(level)) => {
                self.set_problem(None);
                Some(level)
            }
            Some(Err(error)) => {
                self.line = None;
                self.set_problem(Some(error.to_string()));
                None
            }
            None => None,
        };
        let is_pressed = self.debounce.sample(now_ns, level);
        self.shared.pressed.store(is_pressed, Ordering::Release);
        self.shared.sampled_ns.store(now_ns, Ordering::Release);
    }

    fn set_problem(&self, problem: Option<String>) {
        *self.shared.problem.lock().unwrap_or_else(PoisonError::into_inner) = problem;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use monotonic_clock::monotonic_ns;

    fn simulated(name: &str, level: Option<&str>) -> (std::path::PathBuf, StopLineConfig) {
        let path = std::env::temp_dir().join(format!("stop_line_{}_{name}", std::process::id()));
        let _ = std::fs::remove_file(&path);
        level.map_or(Ok(()), |level| std::fs::write(&path, level)).unwrap();
        let chip = format!("file:{}", path.display());
        (path, StopLineConfig { chip, debounce_ms: 0, ..StopLineConfig::default() })
    }

    fn reader(config: &StopLineConfig) -> Reader {
        let shared = Arc::new(Shared {
            pressed: AtomicBool::new(true),
            sampled_ns: AtomicU64::new(0),
            ends: AtomicBool::new(false),
            problem: Mutex::new(None),
        });
        let debounce = Debounce::new(config);
        Reader { config: config.clone(), shared, line: None, retry_ns: 0, debounce }
    }

    #[test]
    fn a_robot_without_such_a_line_reads_none() {
        assert!(StopLine::start(&StopLineConfig::default()).unwrap().is_none());
    }

    #[test]
    fn a_released_stop_is_released_from_the_start_and_an_absent_one_is_pressed() {
        let (released, config) = simulated("released", Some("0"));
        let line = StopLine::start(&config).unwrap().unwrap();
        assert!(!line.monitor().is_pressed());
        std::fs::remove_file(released).unwrap();
        let (_, absent) = simulated("absent", None);
        let line = StopLine::start(&absent).unwrap().unwrap();
        assert!(line.is_pressed(monotonic_ns()));
        let problem = line.monitor().problem().unwrap();
        assert!(problem.contains("must contain 0 or 1"), "{problem}");
    }

    #[test]
    fn a_line_that_is_lost_is_pressed_and_is_found_again() {
        let (path, config) = simulated("lost", Some("0"));
        let mut reader = reader(&config);
        let line = StopLine { shared: Arc::clone(&reader.shared), thread: None };
        reader.sample(1);
        assert!(!line.is_pressed(1));
        std::fs::remove_file(&path).unwrap();
        reader.sample(2);
        assert!(line.is_pressed(2) && line.monitor().problem().is_some());
        std::fs::write(&path, "0").unwrap();
        reader.sample(RETRY_NS);
        assert!(line.is_pressed(RETRY_NS), "the next attempt is due a second after the first");
        reader.sample(RETRY_NS + 1);
        assert!(!line.is_pressed(RETRY_NS + 1) && line.monitor().problem().is_none());
        std::fs::write(&path, "1").unwrap();
        reader.sample(RETRY_NS + 2);
        assert!(line.is_pressed(RETRY_NS + 2));
        std::fs::remove_file(&path).unwrap();
    }

    #[test]
    fn a_thread_that_hangs_in_a_slow_bus_is_a_press() {
        let (path, config) = simulated("slow", Some("0"));
        let mut reader = reader(&config);
        let line = StopLine { shared: Arc::clone(&reader.shared), thread: None };
        reader.sample(1);
        assert!(!line.is_pressed(1 + STALE_NS));
        assert!(line.is_pressed(2 + STALE_NS));
        std::fs::remove_file(&path).unwrap();
    }
}
