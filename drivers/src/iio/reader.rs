//! The thread that reads the unit, and opens it again when it was lost.

use std::io;
use std::sync::atomic::Ordering::{Relaxed, Release};
use std::sync::{Arc, Mutex, PoisonError};

use hal::ImuSample;
use monotonic_clock::monotonic_ns;

use super::kernel::KernelDevice;
use super::source::Source;
use super::{ImuConfig, ImuError, ImuSetup, Refusal, Roots, SampleCheck};
use crate::DeviceState;
use crate::scanner::{End, Link, LinkError, Received, Shared, Stop, keep_trying};

/// Time-out of the first sample, because a sensor that slept has to start.
const FIRST_SAMPLE_NS: u64 = 1_000_000_000;
/// After a silence of this length the unit is set up again.
const GIVE_UP_NS: u64 = 10_000_000_000;

pub(super) struct Reader {
    pub(super) config: ImuConfig,
    pub(super) device: Arc<str>,
    pub(super) roots: Roots,
    pub(super) shared: Arc<Shared>,
    pub(super) setup: Arc<Mutex<Option<ImuSetup>>>,
    pub(super) samples: rtrb::Producer<ImuSample>,
    pub(super) stop: Stop,
    /// Lives longer than a session, so that times do not go back when the unit is opened again.
    pub(super) check: SampleCheck,
}

impl Reader {
    /// Runs until the driver is dropped.
    pub(super) fn run(mut self) {
        let shared = Arc::clone(&self.shared);
        let stop = Arc::clone(&self.stop);
        keep_trying(&shared, &stop, |was_alive| self.session(was_alive));
    }

    fn session(&mut self, was_alive: bool) -> End<ImuError> {
        let (source, file) = match Source::open(&self.config, &self.device, &self.roots) {
            Ok(opened) => opened,
            Err(error) => return error.into(),
        };
        *self.setup.lock().unwrap_or_else(PoisonError::into_inner) = Some(source.setup.clone());
        // A unit that was silent stays so until it sends again.
        if self.shared.state() != DeviceState::Silent {
            self.shared.set_state(DeviceState::Starting);
        }
        let link = Link::of(file, &self.device, &self.stop);
        Session { reader: self, source, link, is_reopened: was_alive, refusal: None }.run()
    }
}

/// One opened unit.
struct Session<'a> {
    reader: &'a mut Reader,
    source: Source,
    link: Link,
    is_reopened: bool,
    /// Why the last sample was refused, if it was.
    refusal: Option<Refusal>,
}

impl Session<'_> {
    fn run(mut self) -> End<ImuError> {
        let limit_ns = u64::from(self.reader.config.timeout_ms) * 1_000_000;
        // Time of the last good sample, and for how long after it the next one may take.
        let mut good_ns = monotonic_ns();
        let mut allowed_ns = limit_ns.max(FIRST_SAMPLE_NS);
        loop {
            let received =
                match self.link.read(self.source.records.free_space(), good_ns + allowed_ns) {
                    Ok(received) => received,
                    Err(error) => return self.gone(error).into(),
                };
            let now_ns = monotonic_ns();
            let has_good = match received {
                Received::Stopped => return End::Stopped,
                Received::Nothing => false,
                Received::Bytes(count) => self.take(count, now_ns),
            };
            if has_good {
                good_ns = now_ns;
                allowed_ns = limit_ns;
            } else if now_ns >= good_ns + allowed_ns {
                let is_hopeless = allowed_ns == GIVE_UP_NS;
                if is_hopeless || self.is_gone() {
                    return self.silence().into();
                }
                self.report_silence();
                allowed_ns = GIVE_UP_NS;
            }
        }
    }

    /// Takes bytes that were read. Returns whether there was a good sample among them.
    fn take(&mut self, count: usize, now_ns: u64) -> bool {
        let Self { reader, source, refusal, .. } = self;
        let good_before = reader.shared.good.load(Relaxed);
        source.records.received(count, |record| {
            let sample = source.decode.sample(record, now_ns).ok_or(Refusal::Record);
            match sample.and_then(|sample| reader.check.check(&sample, now_ns).map(|()| sample)) {
                Ok(sample) => reader.accept(sample),
                Err(why) => {
                    *refusal = Some(why);
                    reader.shared.bad.fetch_add(1, Relaxed);
                }
            }
        });
        if reader.shared.good.load(Relaxed) == good_before {
            return false;
        }
        if std::mem::take(&mut self.is_reopened) {
            self.reader.shared.reopened.fetch_add(1, Relaxed);
        }
        self.refusal = None;
        self.reader.shared.last_good_ns.store(now_ns, Release);
        self.reader.shared.set_state(DeviceState::Working);
        true
    }

    fn is_gone(&self) -> bool {
        self.source.device.as_ref().is_some_and(KernelDevice::is_gone)
    }

    fn silence(&self) -> ImuError {
        let device = Arc::clone(&self.reader.device);
        let limit_ms = self.reader.config.timeout_ms;
        if self.is_gone() {
            return ImuError::Gone { device, source: io::ErrorKind::NotFound.into() };
        }
        match self.refusal {
            Some(refusal) => ImuError::Refused { device, limit_ms, refusal },
            None => ImuError::Silent { device, limit_ms },
        }
    }

    fn report_silence(&self) {
        self.reader.shared.set_state(DeviceState::Silent);
        self.reader.shared.set_problem(self.silence().to_string());
    }

    fn gone(&self, error: LinkError) -> ImuError {
        let (LinkError::Open { source, .. } | LinkError::Gone { source, .. }) = error;
        ImuError::Gone { device: Arc::clone(&self.reader.device), source }
    }
}

impl Reader {
    fn accept(&mut self, sample: ImuSample) {
        self.shared.good.fetch_add(1, Relaxed);
        if self.samples.push(sample).is_err() {
            self.shared.lost.fetch_add(1, Relaxed);
        }
    }
}
