//! Reads the ticks of a recorded run one by one. Unlike a replay, it continues after damaged parts,
//! for commands that do not depend on the ticks before.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use runtime::recording::{RecordedTick, RunHeader};

use crate::replay::{ReplayError, open_segment, segments};

/// A recorded run whose segments are read in order.
#[derive(Debug)]
pub struct Recorded {
    segments: Vec<PathBuf>,
    run: RunHeader,
}

impl Recorded {
    /// Opens the --out folder of a run, or one segment.
    ///
    /// # Errors
    /// If none of the segments can be read.
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

    /// The header of the run: configuration, camera, mounts and seeds.
    #[must_use]
    pub fn run(&self) -> &RunHeader {
        &self.run
    }

    /// All ticks in order. A damaged segment is logged as a warning and read up to the damage. A
    /// segment of another run and a frame whose size is not the camera's are errors.
    pub fn ticks(&self) -> impl Iterator<Item = Result<RecordedTick>> + '_ {
        self.segments.iter().flat_map(|path| self.segment(path))
    }

    fn segment<'a>(
        &'a self,
        path: &'a Path,
    ) -> Box<dyn Iterator<Item = Result<RecordedTick>> + 'a> {
        let reader = match open_segment(path) {
            Ok(reader) => reader,
            Err(error) => {
                warn_damaged(path, &error);
                return Box::new(std::iter::empty());
            }
        };
        if reader.header().run != self.run {
            let other = ReplayError::OtherRun { path: path.to_owned() };
            return Box::new(std::iter::once(Err(other.into())));
        }
        let good =
            reader.map_while(move |tick| tick.inspect_err(|error| warn_damaged(path, error)).ok());
        Box::new(good.map(|tick| self.check(&tick).map(|()| tick)))
    }

    fn check(&self, tick: &RecordedTick) -> Result<()> {
        let camera = &self.run.camera;
        match &tick.frame {
            Some(frame) if (frame.width, frame.height) != (camera.width, camera.height) => {
                bail!(
                    "tick {}: the frame is {}x{}, but the recording's camera is {}x{}",
                    tick.tick,
                    frame.width,
                    frame.height,
                    camera.width,
                    camera.height
                )
            }
            _ => Ok(()),
        }
    }
}

fn warn_damaged(path: &Path, error: &dyn std::fmt::Display) {
    tracing::warn!("{} is damaged; reading it up to the damage: {error}", path.display());
}
