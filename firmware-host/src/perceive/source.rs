//! The two sources of images with poses for `perceive`: a dataset or a recorded run.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use hal::{CameraModel, LaserScan, Pose2};
use runtime::perception::Moment;
use runtime::recording::{RecordedTick, RunHeader};

use crate::cli::PerceiveArgs;
use crate::config::Config;
use crate::dataset::{Dataset, Sample};
use crate::frame_depth::{moment_of, scan_of};
use crate::recorded::Recorded;

/// An image with its pose and what dense depth needs besides.
pub(super) struct View {
    pub sample: Sample,
    /// A new scan with `t_odom_laser`.
    pub scan: Option<(LaserScan, Pose2)>,
    pub moment: Moment,
}

/// A sequence of images with poses.
pub(super) struct Source {
    path: PathBuf,
    config: Config,
    images: Images,
}

enum Images {
    Dataset(Box<Dataset>),
    Recording(Box<Recorded>),
}

impl Source {
    /// Opens the dataset or the recording that the arguments name.
    pub fn open(args: &PerceiveArgs) -> Result<Self> {
        let given = args.config.as_deref().map(Config::load).transpose()?;
        if let Some(path) = &args.recording {
            return Self::recording(path, given);
        }
        // clap already requires one of the two.
        let path = args.dataset.clone().context("give --dataset DIR or --recording RUN")?;
        let config = given.unwrap_or_default();
        let dataset = Dataset::open(&path, config.camera.width, config.camera.height)?;
        Ok(Self { path, config, images: Images::Dataset(Box::new(dataset)) })
    }

    fn recording(path: &Path, given: Option<Config>) -> Result<Self> {
        let recording = Recorded::open(path)?;
        let config = given
            .map_or_else(|| serde_json::from_value(recording.run().config.clone()), Ok)
            .context("the recording's configuration cannot be read; give one with --config FILE")?;
        Ok(Self { path: path.to_owned(), config, images: Images::Recording(Box::new(recording)) })
    }

    /// The configuration of coarse depth and networks.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// The camera of the images.
    pub fn camera(&self) -> &CameraModel {
        match &self.images {
            Images::Dataset(dataset) => dataset.camera(),
            Images::Recording(recording) => &recording.run().camera,
        }
    }

    /// Path of the dataset or recording, for messages.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The dataset; `None` for a recording.
    pub fn dataset(&self) -> Option<&Dataset> {
        match &self.images {
            Images::Dataset(dataset) => Some(dataset),
            Images::Recording(_) => None,
        }
    }

    pub fn is_recording(&self) -> bool {
        matches!(self.images, Images::Recording(_))
    }

    /// Number of images; `None` for a recording, which would have to be read completely.
    pub fn len(&self) -> Option<u64> {
        match &self.images {
            Images::Dataset(dataset) => Some(dataset.len() as u64),
            Images::Recording(_) => None,
        }
    }

    /// Number of images of a dataset without a pose near them in time.
    pub fn without_pose(&self) -> usize {
        match &self.images {
            Images::Dataset(dataset) => dataset.without_pose(),
            Images::Recording(_) => 0,
        }
    }

    /// All images in time order.
    pub fn views(&self) -> Box<dyn Iterator<Item = Result<View>> + '_> {
        match &self.images {
            Images::Dataset(dataset) => {
                Box::new(dataset.samples().map(|sample| {
                    Ok(View { sample: sample?, scan: None, moment: Moment::HANDHELD })
                }))
            }
            Images::Recording(recording) => Box::new(
                recording
                    .ticks()
                    .filter_map(|tick| tick.map(|tick| view(tick, recording.run())).transpose()),
            ),
        }
    }
}

/// Converts a recorded tick; `None` for a tick without a frame.
fn view(tick: RecordedTick, run: &RunHeader) -> Option<View> {
    let moment = moment_of(&tick);
    let scan = scan_of(&tick, &run.t_base_laser).map(|(scan, pose)| (scan.clone(), pose));
    let sample = Sample {
        time_ns: tick.time_ns,
        rgb: tick.frame?.rgb,
        camera: run.camera,
        t_world_camera: moment.t_odom_base.to_pose3() * run.t_base_camera,
        truth: tick.truth,
    };
    Some(View { sample, scan, moment })
}
