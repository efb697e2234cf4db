//! Where `perceive` gets pictures with poses from.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use hal::CameraModel;
use runtime::recording::{RecordedTick, RunHeader};

use crate::cli::PerceiveArgs;
use crate::config::Config;
use crate::dataset::{Dataset, Sample};
use crate::replay::{ReplayError, open_segment, segments};

/// A sequence of pictures with poses.
pub(super) struct Source {
    path: PathBuf,
    config: Config,
    pictures: Pictures,
}

enum Pictures {
    Dataset(Box<Dataset>),
    Recording { segments: Vec<PathBuf>, run: Box<RunHeader> },
}

impl Source {
    /// Opens the dataset or the recording that the arguments name.
    pub fn open(args: &PerceiveArgs) -> Result<Self> {
        let asked = args.config.as_deref().map(Config::load).transpose()?;
        if let Some(path) = &args.recording {
            return Self::recording(path, asked);
        }
        // clap asks for one of the two.
        let path = args.dataset.clone().context("give --dataset DIR or --recording RUN")?;
        let config = asked.unwrap_or_default();
        let dataset = Dataset::open(&path, config.camera.width, config.camera.height)?;
        Ok(Self { path, config, pictures: Pictures::Dataset(Box::new(dataset)) })
    }

    fn recording(path: &Path, asked: Option<Config>) -> Result<Self> {
        let segments = segments(path)?;
        let mut first_error = None;
        let header = segments.iter().find_map(|segment| match open_segment(segment) {
            Ok(reader) => Some(reader.header().run.clone()),
            Err(error) => {
                first_error.get_or_insert(error);
                None
            }
        });
        let Some(run) = header else {
            return Err(first_error.unwrap_or_else(|| ReplayError::NoSegments { dir: path.to_owned() }).into());
        };
        let recorded = || serde_json::from_value(run.config.clone());
        let config = asked
            .map_or_else(recorded, Ok)
            .context("the recording's configuration cannot be read; give one with --config FILE")?;
        let pictures = Pictures::Recording { segments, run: Box::new(run) };
        Ok(Self { path: path.to_owned(), config, pictures })
    }

    /// What shapes coarse depth and networks.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// The pictures' camera.
    pub fn camera(&self) -> &CameraModel {
        match &self.pictures {
            Pictures::Dataset(dataset) => dataset.camera(),
            Pictures::Recording { run, .. } => &run.camera,
        }
    }

    /// Folder or file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The dataset, if it is one.
    pub fn dataset(&self) -> Option<&Dataset> {
        match &self.pictures {
            Pictures::Dataset(dataset) => Some(dataset),
            Pictures::Recording { .. } => None,
        }
    }

    pub fn is_recording(&self) -> bool {
        matches!(self.pictures, Pictures::Recording { .. })
    }

    /// Number of pictures; a recording must be read to know.
    pub fn len(&self) -> Option<u64> {
        match &self.pictures {
            Pictures::Dataset(dataset) => Some(dataset.len() as u64),
            Pictures::Recording { .. } => None,
        }
    }

    /// Pictures of a dataset that no pose is near in time.
    pub fn without_pose(&self) -> usize {
        match &self.pictures {
            Pictures::Dataset(dataset) => dataset.without_pose(),
            Pictures::Recording { .. } => 0,
        }
    }

    /// All pictures in time order.
    pub fn samples(&self) -> Box<dyn Iterator<Item = Result<Sample>> + '_> {
        match &self.pictures {
            Pictures::Dataset(dataset) => Box::new(dataset.samples().map(|sample| Ok(sample?))),
            Pictures::Recording { segments, run } => {
                Box::new(segments.iter().flat_map(move |path| recorded_samples(path, run)))
            }
        }
    }
}

/// The pictures of one segment. One that breaks off is named and read as far as it goes: each picture stands for itself
/// here, unlike in a replay.
fn recorded_samples<'a>(path: &'a Path, run: &'a RunHeader) -> Box<dyn Iterator<Item = Result<Sample>> + 'a> {
    let damaged = move |error: &dyn std::fmt::Display| {
        tracing::warn!("{} is damaged and read only as far as it goes: {error}", path.display());
    };
    let reader = match open_segment(path) {
        Ok(reader) => reader,
        Err(error) => {
            damaged(&error);
            return Box::new(std::iter::empty());
        }
    };
    if reader.header().run != *run {
        let other = ReplayError::OtherRun { path: path.to_owned() };
        return Box::new(std::iter::once(Err(other.into())));
    }
    let good = reader.map_while(move |tick| tick.inspect_err(|error| damaged(error)).ok());
    Box::new(good.filter_map(move |tick| sample(tick, run).transpose()))
}

/// What `perceive` needs of a turn; `None` for one without a picture.
fn sample(tick: RecordedTick, run: &RunHeader) -> Result<Option<Sample>> {
    let Some(frame) = tick.frame else { return Ok(None) };
    if (frame.width, frame.height) != (run.camera.width, run.camera.height) {
        let (width, height) = (run.camera.width, run.camera.height);
        bail!("turn {}: a {}x{} picture from a {width}x{height} camera", tick.tick, frame.width, frame.height);
    }
    Ok(Some(Sample {
        time_ns: tick.time_ns,
        rgb: frame.rgb,
        camera: run.camera,
        t_world_camera: tick.wheel.odom.to_pose3() * run.t_base_camera,
        truth: tick.truth,
    }))
}
