//! Kills programs (SIGKILL) at random moments, for tests of what they leave behind.

use std::path::{Path, PathBuf};
use std::process::Child;
use std::time::{Duration, Instant, SystemTime};

use hal::Clock;
use monotonic_clock::MonotonicClock;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// Number of kills per test when `KILLS` is not set: enough to detect frequent failures, in
/// seconds.
const DEFAULT_KILLS: u64 = 6;
/// Longest wait for a program to do something.
const TIMEOUT: Duration = Duration::from_secs(60);
/// Interval at which the program's files are checked.
const POLL_NS: u64 = 100_000;
/// Time after a change in which the next rename or sync is likely.
const RIGHT_AFTER: Duration = Duration::from_millis(4);

/// Number of kills per test: `KILLS`, or [`DEFAULT_KILLS`].
#[must_use]
pub fn kill_count() -> u64 {
    std::env::var("KILLS").ok().and_then(|kills| kills.parse().ok()).unwrap_or(DEFAULT_KILLS)
}

/// Chooses random moments at which to kill a program. The times are seeded; the state of the
/// program at these times is not.
pub struct KillSchedule {
    rng: Pcg64Mcg,
    clock: MonotonicClock,
    /// Run time of the program when it is not killed.
    whole: Duration,
}

impl KillSchedule {
    /// A schedule for a program with this approximate run time.
    #[must_use]
    pub fn new(seed: u64, whole: Duration) -> Self {
        Self { rng: Pcg64Mcg::seed_from_u64(seed), clock: MonotonicClock, whole }
    }

    /// Sleeps for a random time of at most `most`.
    pub fn pass(&mut self, most: Duration) {
        let ns = self.rng.random_range(0..=most.as_nanos() as u64);
        self.clock.sleep_until_ns(self.clock.now_ns() + ns);
    }

    /// Waits for a moment to kill `program`. Half of the moments are uniformly distributed over the
    /// run time. The others follow a change of the value that `changes` returns, when the program
    /// is most likely in the middle of an operation.
    ///
    /// # Errors
    /// Returns an error when the state of the program cannot be read, or when it neither ends nor
    /// does anything.
    pub fn wait<T: PartialEq>(
        &mut self,
        program: &mut Child,
        changes: impl Fn() -> T,
    ) -> std::io::Result<()> {
        if self.rng.random() {
            self.pass(self.whole);
            return Ok(());
        }
        let before = changes();
        self.until(program, || changes() != before)?;
        self.pass(RIGHT_AFTER);
        Ok(())
    }

    /// Waits until a condition holds or `program` has ended.
    ///
    /// # Errors
    /// Like [`wait`](Self::wait).
    pub fn until(&mut self, program: &mut Child, is_so: impl Fn() -> bool) -> std::io::Result<()> {
        let began = Instant::now();
        while !is_so() && program.try_wait()?.is_none() {
            if began.elapsed() > TIMEOUT {
                return Err(std::io::Error::other("the program to be killed shows no activity"));
            }
            self.clock.sleep_until_ns(self.clock.now_ns() + POLL_NS);
        }
        Ok(())
    }
}

/// Every file under `dir` with its size and modification time, which changes when a program writes
/// there.
#[must_use]
pub fn listing(dir: &Path) -> Vec<(PathBuf, u64, Option<SystemTime>)> {
    let mut all = Vec::new();
    for entry in std::fs::read_dir(dir).into_iter().flatten().flatten() {
        let path = entry.path();
        match entry.metadata() {
            Ok(data) if data.is_dir() => all.extend(listing(&path)),
            Ok(data) => all.push((path, data.len(), data.modified().ok())),
            Err(_) => {}
        }
    }
    all.sort();
    all
}
