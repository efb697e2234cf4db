//! One run as a row of files.

use std::cell::Cell;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use runtime::recording::{
    RecordedTick, RecordingWriter, RunDigest, RunHeader, SegmentHeader, Views,
};

use super::disk::{Disk, SegmentFile, Sink};
use super::error::RecordError;
use super::recorder::{RecorderOptions, RecordingSummary};
use super::room::make_room;

/// `recording_0000.mcap` and so on; names sort in the order of the run up to 10,000 segments, a week of minutes.
#[must_use]
pub fn segment_name(segment: u32) -> String {
    format!("recording_{segment:04}.mcap")
}

/// Writes turns into segments; lives on the recording thread.
pub(super) struct Segments {
    options: RecorderOptions,
    disk: Box<dyn Disk>,
    run: RunHeader,
    /// The first segment's file, created before the thread started so that a bad directory is noticed at once.
    first_file: Option<Box<dyn SegmentFile>>,
    open: Option<Open>,
    digest: RunDigest,
    summary: RecordingSummary,
}

struct Open {
    writer: RecordingWriter<Sink>,
    path: PathBuf,
    start_ns: u64,
    written: Rc<Cell<u64>>,
}

impl Segments {
    pub(super) fn new(
        options: RecorderOptions,
        disk: Box<dyn Disk>,
        run: RunHeader,
        first_file: Box<dyn SegmentFile>,
    ) -> Self {
        let summary = RecordingSummary::default();
        Self {
            options,
            disk,
            run,
            first_file: Some(first_file),
            open: None,
            digest: RunDigest::new(),
            summary,
        }
    }

    /// Writes a turn. An error closes the segment at its last complete chunk; the next turn begins another one.
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
            salvage(open.writer.abandon(), &open.path);
            return Err(RecordError::writing(open.path, error));
        }
        self.open = Some(open);
        self.digest.add_input(&input);
        if let Some(decision) = &tick.decision {
            self.digest.add_decision(decision);
        }
        self.summary.ticks += 1;
        Ok(())
    }

    /// Closes the current segment; how many there are.
    pub(super) fn cut(&mut self) -> Result<u32, RecordError> {
        self.close()?;
        Ok(self.summary.segments)
    }

    /// Closes the last segment. A run without turns still leaves its header.
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
        let long = time_ns.saturating_sub(open.start_ns) >= self.options.segment_ns;
        long || open.written.get() >= self.options.segment_bytes
    }

    fn start(&mut self, tick: u64, time_ns: u64) -> Result<Open, RecordError> {
        let segment = self.summary.segments;
        let path = self.options.dir.join(segment_name(segment));
        if let Some(quota) = &self.options.quota {
            let removed = make_room(self.disk.as_mut(), quota, &path);
            self.summary.removed.segments += removed.segments;
            self.summary.removed.not_pulled += removed.not_pulled;
            self.summary.removed.bytes += removed.bytes;
        }
        let file = match self.first_file.take() {
            Some(file) => file,
            None => self.create(&path)?,
        };
        let written = Rc::new(Cell::new(0));
        let sink = Sink::new(file, Rc::clone(&written), self.options.sync);
        let header = SegmentHeader::new(self.run.clone(), segment, tick, time_ns);
        match RecordingWriter::begin(sink, header) {
            Ok(writer) => {
                self.summary.segments += 1;
                Ok(Open { writer, path, start_ns: time_ns, written })
            }
            Err(error) => {
                // Without its header a segment is worth nothing.
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
                // Left by a try that could not even be undone: the next one takes the next number.
                self.summary.segments += 1;
            }
            RecordError::Create { path: path.to_owned(), source }
        })
    }

    /// What was recorded so far.
    pub(super) fn summary(&self) -> &RecordingSummary {
        &self.summary
    }

    fn close(&mut self) -> Result<(), RecordError> {
        let Some(open) = self.open.take() else { return Ok(()) };
        match open.writer.finish() {
            Ok(_) => {
                self.summary.bytes += open.written.get();
                Ok(())
            }
            Err((sink, error)) => {
                salvage(sink, &open.path);
                Err(RecordError::writing(open.path, error))
            }
        }
    }
}

fn salvage(sink: Sink, path: &Path) {
    match sink.salvage() {
        Ok(()) => tracing::warn!("{} was cut back to its last complete chunk", path.display()),
        Err(error) => {
            tracing::warn!("{} could not be closed and has no end: {error}", path.display());
        }
    }
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
