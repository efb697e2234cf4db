//! Reads recorded images with poses and, optionally, measured depth, in the layout of the TUM RGB-D
//! benchmark (Sturm et al. 2012: `rgb.txt`, `depth.txt`, `groundtruth.txt`) plus a `dataset.toml`
//! with the camera.

mod associate;
mod error;
mod list;
mod manifest;
mod resample;

use std::path::{Path, PathBuf};

use hal::{CameraModel, DepthMap, Pose3};

pub use error::DatasetError;
pub use manifest::{CameraSection, Manifest};
pub use resample::Resampler;

/// One image with its pose, resampled to the size that perception works on.
#[derive(Debug, Clone)]
pub struct Sample {
    /// Time stamp in the dataset's clock.
    pub time_ns: u64,
    /// Pixels in RGB8, row-major.
    pub rgb: Vec<u8>,
    /// Pinhole camera of the resampled image.
    pub camera: CameraModel,
    /// Pose of `camera_optical` in the world.
    pub t_world_camera: Pose3,
    /// Depth that a sensor measured, if the dataset has any.
    pub truth: Option<DepthMap>,
}

/// A dataset. The lists are read when it is opened, the images one by one later.
#[derive(Debug)]
pub struct Dataset {
    manifest: Manifest,
    resampler: Resampler,
    frames: Vec<FrameEntry>,
    without_pose: usize,
}

#[derive(Debug)]
struct FrameEntry {
    time_ns: u64,
    rgb: PathBuf,
    depth: Option<PathBuf>,
    t_world_camera: Pose3,
}

impl Dataset {
    /// Reads the lists of the dataset in `folder` and associates them by time. Images will be
    /// resampled to `width` x `height`. Without `depth.txt` there is no ground truth.
    ///
    /// # Errors
    /// Names the file, the line and the value that cannot be used.
    pub fn open(folder: &Path, width: usize, height: usize) -> Result<Self, DatasetError> {
        let manifest = Manifest::read(&folder.join("dataset.toml"))?;
        let images = list::read_images(folder, "rgb.txt")?;
        let depths = if folder.join("depth.txt").exists() {
            list::read_images(folder, "depth.txt")?
        } else {
            Vec::new()
        };
        let poses = list::read_poses(folder, "groundtruth.txt")?;
        let tolerance_ns = (0.5e9 / manifest.nominal_fps) as u64;
        let total = images.len();
        let frames: Vec<FrameEntry> = images
            .into_iter()
            .filter_map(|image| {
                let t_world_camera = associate::pose_at(&poses, image.time_ns, tolerance_ns)?;
                let depth = associate::nearest(&depths, image.time_ns, tolerance_ns)
                    .map(|entry| entry.path.clone());
                Some(FrameEntry { time_ns: image.time_ns, rgb: image.path, depth, t_world_camera })
            })
            .collect();
        if frames.is_empty() {
            return Err(DatasetError::NoPose {
                path: folder.join("groundtruth.txt"),
                images: total,
                tolerance_ms: tolerance_ns as f64 / 1e6,
            });
        }
        let resampler = Resampler::new(&manifest.camera_model(), width, height);
        Ok(Self { manifest, resampler, without_pose: total - frames.len(), frames })
    }

    /// Content of `dataset.toml`.
    #[must_use]
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// Pinhole camera of the samples, with the size given to [`open`](Self::open).
    #[must_use]
    pub fn camera(&self) -> &CameraModel {
        self.resampler.camera()
    }

    /// Number of samples.
    #[must_use]
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// Always false, because a dataset without samples cannot be opened.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    /// Pose of the camera for each sample, `t_world_camera`.
    #[must_use]
    pub fn poses(&self) -> Vec<Pose3> {
        self.frames.iter().map(|frame| frame.t_world_camera).collect()
    }

    /// Number of images that were left out because no pose is near them in time.
    #[must_use]
    pub fn without_pose(&self) -> usize {
        self.without_pose
    }

    /// All samples in time order. Each one is read from disk when the iterator reaches it.
    pub fn samples(&self) -> impl ExactSizeIterator<Item = Result<Sample, DatasetError>> + '_ {
        self.frames.iter().map(|frame| self.read(frame))
    }

    fn read(&self, frame: &FrameEntry) -> Result<Sample, DatasetError> {
        let rgb = self.decode(&frame.rgb)?.into_rgb8();
        let truth = frame.depth.as_deref().map(|path| self.read_depth(path)).transpose()?;
        Ok(Sample {
            time_ns: frame.time_ns,
            rgb: self.resampler.rgb(rgb.as_raw()),
            camera: *self.camera(),
            t_world_camera: frame.t_world_camera,
            truth,
        })
    }

    fn read_depth(&self, path: &Path) -> Result<DepthMap, DatasetError> {
        let image = self.decode(path)?;
        let Some(values) = image.as_luma16() else {
            return Err(DatasetError::DepthFormat {
                path: path.to_owned(),
                color: format!("{:?}", image.color()),
            });
        };
        let scale = 1.0 / self.manifest.depth_scale;
        let depth_m: Vec<f32> =
            values.as_raw().iter().map(|value| (f64::from(*value) * scale) as f32).collect();
        Ok(self.resampler.depth(&depth_m))
    }

    fn decode(&self, path: &Path) -> Result<image::DynamicImage, DatasetError> {
        let bytes = std::fs::read(path)
            .map_err(|source| DatasetError::Read { path: path.to_owned(), source })?;
        let image = image::load_from_memory(&bytes)
            .map_err(|source| DatasetError::Image { path: path.to_owned(), source })?;
        let camera = &self.manifest.camera;
        if (image.width() as usize, image.height() as usize) != (camera.width, camera.height) {
            return Err(DatasetError::ImageSize {
                path: path.to_owned(),
                width: image.width(),
                height: image.height(),
                camera_width: camera.width,
                camera_height: camera.height,
            });
        }
        Ok(image)
    }
}

#[cfg(test)]
mod tests;
