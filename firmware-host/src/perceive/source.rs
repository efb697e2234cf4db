//! Where `perceive` gets pictures with poses from.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use hal::CameraModel;
use runtime::recording::{RecordedTick, RunHeader};

use crate::cli::PerceiveArgs;
use crate::config::Config;
use crate::dataset::{Dataset, Sample};
use crate::recorded::Recorded;

/// A sequence of pictures with poses.
pub(super) struct Source {
    path: PathBuf,
    config: Config,
    pictures: Pictures,
}

enum Pictures {
    Dataset(Box<Dataset>),
    Recording(Box<Recorded>),
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
        let recording = Recorded::open(path)?;
        let recorded = || serde_json::from_value(recording.run().config.clone());
        let config = asked
            .map_or_else(recorded, Ok)
            .context("the recording's configuration cannot be read; give one with --config FILE")?;
        Ok(Self {
            path: path.to_owned(),
            config,
            pictures: Pictures::Recording(Box::new(recording)),
        })
    }

    /// What shapes coarse depth and networks.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// The pictures' camera.
    pub fn camera(&self) -> &CameraModel {
        match &self.pictures {
            Pictures::Dataset(dataset) => dataset.camera(),
            Pictures::Recording(recording) => &recording.run().camera,
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
            Pictures::Recording(_) => None,
        }
    }

    pub fn is_recording(&self) -> bool {
        matches!(self.pictures, Pictures::Recording(_))
    }

    /// Number of pictures; a recording must be read to know.
    pub fn len(&self) -> Option<u64> {
        match &self.pictures {
            Pictures::Dataset(dataset) => Some(dataset.len() as u64),
            Pictures::Recording(_) => None,
        }
    }

    /// Pictures of a dataset that no pose is near in time.
    pub fn without_pose(&self) -> usize {
        match &self.pictures {
            Pictures::Dataset(dataset) => dataset.without_pose(),
            Pictures::Recording(_) => 0,
        }
    }

    /// All pictures in time order.
    pub fn samples(&self) -> Box<dyn Iterator<Item = Result<Sample>> + '_> {
        match &self.pictures {
            Pictures::Dataset(dataset) => Box::new(dataset.samples().map(|sample| Ok(sample?))),
            Pictures::Recording(recording) => Box::new(
                recording
                    .ticks()
                    .filter_map(|tick| tick.map(|tick| sample(tick, recording.run())).transpose()),
            ),
        }
    }
}

/// What `perceive` needs of a turn; `None` for one without a picture.
fn sample(tick: RecordedTick, run: &RunHeader) -> Option<Sample> {
    Some(Sample {
        time_ns: tick.time_ns,
        rgb: tick.frame?.rgb,
        camera: run.camera,
        t_world_camera: tick.wheel.odom.to_pose3() * run.t_base_camera,
        truth: tick.truth,
    })
}
