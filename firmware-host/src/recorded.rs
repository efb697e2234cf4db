//! A recorded run as far as it can be read, for what takes each turn by itself: unlike a replay, it goes on after damage.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use runtime::recording::{RecordedTick, RunHeader};

use crate::replay::{ReplayError, open_segment, segments};

/// A recorded run.
#[derive(Debug)]
pub struct Recorded {
    segments: Vec<PathBuf>,
    run: RunHeader,
}

impl Recorded {
    /// Opens the --out folder of a run, or one segment.
    ///
    /// # Errors
    /// When none of its segments can be read.
    pub fn open(path: &Path) -> Result<Self> {
        let segments = segments(path)?;
        let mut first_error = None;
        let run = segments.iter().find_map(|segment| match open_segment(segment) {
            Ok(reader) => Some(reader.header().run.clone()),
            Err(error) => {
                first_error.get_or_insert(error);
                None
            }
        });
        match run {
            Some(run) => Ok(Self { segments, run }),
            None => Err(first_error
                .unwrap_or_else(|| ReplayError::NoSegments { dir: path.to_owned() })
                .into()),
        }
    }

    /// What it was made with.
    #[must_use]
    pub fn run(&self) -> &RunHeader {
        &self.run
    }

    /// All turns in order. A segment that breaks off is named and read as far as it goes; one of another run, and a picture of
    /// another size than the camera's, are errors.
    pub fn ticks(&self) -> impl Iterator<Item = Result<RecordedTick>> + '_ {
        self.segments.iter().flat_map(|path| self.segment(path))
    }

    fn segment<'a>(
        &'a self,
        path: &'a Path,
    ) -> Box<dyn Iterator<Item = Result<RecordedTick>> + 'a> {
        let damaged = move |error: &dyn std::fmt::Display| {
            tracing::warn!(
                "{} is damaged and read only as far as it goes: {error}",
                path.display()
            );
        };
        let reader = match open_segment(path) {
            Ok(reader) => reader,
            Err(error) => {
                damaged(&error);
                return Box::new(std::iter::empty());
            }
        };
        if reader.header().run != self.run {
            let other = ReplayError::OtherRun { path: path.to_owned() };
            return Box::new(std::iter::once(Err(other.into())));
        }
        let good = reader.map_while(move |tick| tick.inspect_err(|error| damaged(error)).ok());
        Box::new(good.map(|tick| self.check(&tick).map(|()| tick)))
    }

    fn check(&self, tick: &RecordedTick) -> Result<()> {
        let (width, height) = (self.run.camera.width, self.run.camera.height);
        match &tick.frame {
            Some(frame) if (frame.width, frame.height) != (width, height) => {
                bail!(
                    "turn {}: a {}x{} picture from a {width}x{height} camera",
                    tick.tick,
                    frame.width,
                    frame.height
                )
            }
            _ => Ok(()),
        }
    }
}
