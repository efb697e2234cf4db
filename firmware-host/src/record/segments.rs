//! Divides a run into segments.

use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::time::SystemTime;

use monotonic_clock::monotonic_ns;
use runtime::recording::{
    RecordedTick, RecordingError, RecordingWriter, RunDigest, RunHeader, SegmentHeader, Views,
};
use segment_store::signature::SIGNATURE;

use super::age::remove_expired;
use super::disk::{Disk, SegmentFile, Sink, Written};
use super::error::RecordError;
use super::free_space::free_space;
use super::kept::EventKeeper;
use super::recorder::{RecorderOptions, RecordingSummary};
use super::signer::Signer;

/// `recording_0000.mcap` for segment 0. The names of up to 10,000 segments of a minute each, a week, sort in order.
#[must_use]
pub fn segment_name(segment: u32) -> String {
    format!("recording_{segment:04}.mcap")
}

/// Unix time at which the computer's monotonic clock was zero, by its present date; `None` if that is not set.
fn zero_unix_ns() -> Option<u64> {
    let date = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).ok()?;
    u64::try_from(date.as_nanos()).ok()?.checked_sub(monotonic_ns())
}

/// Writes ticks into segments, on the recording thread.
pub(super) struct Segments {
    options: RecorderOptions,
    disk: Box<dyn Disk>,
    run: RunHeader,
    /// File of the first segment. It was created before the thread started, so that a bad directory is reported at once.
    first_file: Option<Box<dyn SegmentFile>>,
    open: Option<Open>,
    /// `None` without a quota: nothing deletes the segments.
    keeper: Option<EventKeeper>,
    /// `None` when the robot has no key.
    signer: Option<Signer>,
    digest: RunDigest,
    summary: RecordingSummary,
}

struct Open {
    number: u32,
    writer: RecordingWriter<Sink>,
    path: PathBuf,
    start_ns: u64,
    written: Rc<Written>,
}

impl Segments {
    pub(super) fn new(
        options: RecorderOptions,
        disk: Box<dyn Disk>,
        run: RunHeader,
        first_file: Box<dyn SegmentFile>,
    ) -> Self {
        let summary = RecordingSummary::default();
        let keeper = options.quota.as_ref().map(|_| EventKeeper::new(&options.dir));
        let run_id = run.identity.as_ref().map(|identity| identity.run.as_str());
        let signer = options.key.clone().zip(run_id).map(|(key, run)| Signer::new(key, run));
        Self {
            options,
            disk,
            run,
            first_file: Some(first_file),
            open: None,
            keeper,
            signer,
            digest: RunDigest::new(),
            summary,
        }
    }

    /// Writes a tick. An error closes the segment at its last complete chunk; the next tick begins another one.
    pub(super) fn write(&mut self, tick: &RecordedTick, views: &Views) -> Result<(), RecordError> {
        if self.open.as_ref().is_some_and(|open| self.is_full(open, tick.time_ns)) {
            self.close()?;
        }
        let mut open = match self.open.take() {
            Some(open) => open,
            None => self.start(tick.tick, tick.time_ns)?,
        };
        let input = tick.input().map_err(|error| RecordError::writing(open.path.clone(), error))?;
        if let Err(error) = open.writer.write(tick, views) {
            self.salvage(open.writer.abandon(), &open.path);
            return Err(RecordError::writing(open.path, error));
        }
        if let Some(keeper) = &mut self.keeper {
            keeper.wrote(open.number, &tick.safety.events);
        }
        self.open = Some(open);
        self.digest.add_input(&input);
        if let Some(decision) = &tick.decision {
            self.digest.add_decision(decision);
        }
        self.summary.ticks += 1;
        Ok(())
    }

    /// Closes the current segment. Returns the number of segments.
    pub(super) fn cut(&mut self) -> Result<u32, RecordError> {
        self.close()?;
        Ok(self.summary.segments)
    }

    /// Closes the last segment. A run without ticks leaves a segment with its header.
    pub(super) fn finish(mut self) -> Result<RecordingSummary, RecordError> {
        if self.first_file.is_some() {
            self.open = Some(self.start(0, 0)?);
        }
        self.close()?;
        self.summary.inputs_digest = self.digest.inputs();
        self.summary.decisions_digest = self.digest.decisions();
        Ok(self.summary)
    }

    fn is_full(&self, open: &Open, time_ns: u64) -> bool {
        time_ns.saturating_sub(open.start_ns) >= self.options.segment_ns
            || open.written.bytes() >= self.options.segment_bytes
    }

    fn start(&mut self, tick: u64, time_ns: u64) -> Result<Open, RecordError> {
        let segment = self.summary.segments;
        let path = self.options.dir.join(segment_name(segment));
        if let Some(quota) = &self.options.quota {
            let disk = self.disk.as_mut();
            self.summary.removed += remove_expired(disk, quota, &path, SystemTime::now());
            self.summary.removed += free_space(disk, quota, &path);
        }
        let file = match self.first_file.take() {
            Some(file) => file,
            None => self.create(&path)?,
        };
        let written = Written::new(self.signer.is_some());
        let sink = Sink::new(file, Rc::clone(&written), self.options.sync);
        let zero_unix_ns = self.options.dated.then(zero_unix_ns).flatten();
        let header = SegmentHeader {
            zero_unix_ns,
            ..SegmentHeader::new(self.run.clone(), segment, tick, time_ns)
        };
        match RecordingWriter::begin(sink, header) {
            Ok(writer) => {
                self.summary.segments += 1;
                if let Some(keeper) = &mut self.keeper {
                    keeper.began(segment);
                }
                Ok(Open { number: segment, writer, path, start_ns: time_ns, written })
            }
            Err(error) => {
                // A segment without its header cannot be read.
                if let Err(error) = self.disk.remove(&path) {
                    tracing::warn!("cannot remove {}: {error}", path.display());
                }
                Err(RecordError::writing(path, error))
            }
        }
    }

    fn create(&mut self, path: &Path) -> Result<Box<dyn SegmentFile>, RecordError> {
        self.disk.create(path).map_err(|source| {
            if source.kind() == ErrorKind::AlreadyExists {
                // The file is left from an attempt that failed and could not be removed. The next attempt takes the next
                // number.
                self.summary.segments += 1;
            }
            RecordError::Create { path: path.to_owned(), source }
        })
    }

    /// The result so far.
    pub(super) fn summary(&self) -> &RecordingSummary {
        &self.summary
    }

    /// Ends a segment that cannot be written any more at its last complete chunk.
    fn salvage(&mut self, sink: Sink, path: &Path) {
        let holds_ticks = sink.holds_ticks();
        match sink.salvage() {
            Ok(()) => tracing::warn!("{} was truncated to its last complete chunk", path.display()),
            Err(error) if holds_ticks => {
                tracing::warn!(
                    "{} could not be closed and lacks its footer: {error}",
                    path.display()
                );
            }
            Err(error) => {
                tracing::warn!("{} holds no tick and is removed: {error}", path.display());
                if let Err(error) = self.disk.remove(path) {
                    tracing::warn!("cannot remove {}: {error}", path.display());
                }
            }
        }
    }

    fn close(&mut self) -> Result<(), RecordError> {
        let Some(mut open) = self.open.take() else { return Ok(()) };
        if let Some(signer) = &mut self.signer
            && let Err(error) = sign(signer, &mut open)
        {
            self.salvage(open.writer.abandon(), &open.path);
            return Err(RecordError::writing(open.path, error));
        }
        match open.writer.finish() {
            Ok(_) => {
                self.summary.bytes += open.written.bytes();
                Ok(())
            }
            Err((sink, error)) => {
                self.salvage(sink, &open.path);
                Err(RecordError::writing(open.path, error))
            }
        }
    }
}

/// Signs everything that is in the segment.
fn sign(signer: &mut Signer, open: &mut Open) -> Result<(), RecordingError> {
    open.writer.flush()?;
    let Some(digest) = open.written.digest() else { return Ok(()) };
    open.writer.write_metadata(SIGNATURE, signer.sign(open.number, digest))
}

#[cfg(test)]
mod tests {
    use segment_store::is_segment_name;

    use super::*;

    #[test]
    fn segment_names_are_recognised_and_sort_in_order() {
        for segment in [0, 9, 10, 999, 9_999, 12_345] {
            assert!(is_segment_name(&segment_name(segment)));
        }
        assert!(segment_name(9) < segment_name(10));
        for other in [
            "recording_.mcap",
            "recording_1.mcap",
            "recording_0000.mcap.part",
            "map.png",
            "recording_00a0.mcap",
        ] {
            assert!(!is_segment_name(other), "{other}");
        }
    }
}
