//! Programs that are killed (SIGKILL) at random moments: what they leave behind must be good.

use std::path::{Path, PathBuf};
use std::process::Child;
use std::time::{Duration, Instant, SystemTime};

use hal::Clock;
use monotonic_clock::MonotonicClock;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// Kills of a test where `KILLS` does not say how many: enough to notice what breaks often, in seconds.
const FEW: u64 = 6;
/// Longest wait for a program that should do something.
const PATIENCE: Duration = Duration::from_secs(60);
/// Between two looks at what a program has done.
const LOOK_NS: u64 = 100_000;
/// What follows a change: the next rename, the next sync.
const RIGHT_AFTER: Duration = Duration::from_millis(4);

/// How often a test kills: `KILLS`, or a few times.
#[must_use]
pub fn wanted() -> u64 {
    std::env::var("KILLS").ok().and_then(|kills| kills.parse().ok()).unwrap_or(FEW)
}

/// Moments: the times are by dice, what a program does at them is the computer's affair.
pub struct Moments {
    dice: Pcg64Mcg,
    clock: MonotonicClock,
    /// How long the program takes when nobody kills it.
    whole: Duration,
}

impl Moments {
    /// For a program that takes about so long.
    #[must_use]
    pub fn new(seed: u64, whole: Duration) -> Self {
        Self { dice: Pcg64Mcg::seed_from_u64(seed), clock: MonotonicClock, whole }
    }

    /// Lets a random share of `most` pass.
    pub fn pass(&mut self, most: Duration) {
        let ns = self.dice.random_range(0..=most.as_nanos() as u64);
        self.clock.sleep_until_ns(self.clock.now_ns() + ns);
    }

    /// Waits for a moment to kill `program` in. Every other one is anywhere in its life, else it is right after what `changes`
    /// gives has become something else: there the program is most likely in the middle of something.
    ///
    /// # Errors
    /// When the program cannot be looked at, or neither ends nor does anything.
    pub fn wait<T: PartialEq>(
        &mut self,
        program: &mut Child,
        changes: impl Fn() -> T,
    ) -> std::io::Result<()> {
        if self.dice.random() {
            self.pass(self.whole);
            return Ok(());
        }
        let before = changes();
        self.until(program, || changes() != before)?;
        self.pass(RIGHT_AFTER);
        Ok(())
    }

    /// Waits until something is so, or `program` has ended.
    ///
    /// # Errors
    /// As [`wait`](Self::wait).
    pub fn until(&mut self, program: &mut Child, is_so: impl Fn() -> bool) -> std::io::Result<()> {
        let began = Instant::now();
        while !is_so() && program.try_wait()?.is_none() {
            if began.elapsed() > PATIENCE {
                return Err(std::io::Error::other("the program to be killed does nothing"));
            }
            self.clock.sleep_until_ns(self.clock.now_ns() + LOOK_NS);
        }
        Ok(())
    }
}

/// Every file under `dir` with its size and time: changes when a program does something there.
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
