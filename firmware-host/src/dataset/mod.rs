//! Recorded pictures with poses, and depth where a sensor measured it: the layout of the TUM RGB-D benchmark (Sturm et
//! al. 2012: `rgb.txt`, `depth.txt`, `groundtruth.txt`) plus a `dataset.toml` with the camera.

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

/// One picture with its pose, in the size that perception works on.
#[derive(Debug, Clone)]
pub struct Sample {
    /// When, in the dataset's clock.
    pub time_ns: u64,
    /// The picture, three bytes a pixel.
    pub rgb: Vec<u8>,
    /// Its camera: a pinhole.
    pub camera: CameraModel,
    /// Where `camera_optical` was in the world.
    pub t_world_camera: Pose3,
    /// What the depth sensor measured.
    pub truth: Option<DepthMap>,
}

/// A dataset whose lists were read and put together; the pictures are read one by one.
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
    /// Reads the lists of the dataset in `folder` for perception at `width` x `height`. `depth.txt` may be absent; there
    /// is no ground truth then.
    ///
    /// # Errors
    /// Names the file, the line and the value that cannot be used.
    pub fn open(folder: &Path, width: usize, height: usize) -> Result<Self, DatasetError> {
        let manifest = Manifest::read(&folder.join("dataset.toml"))?;
        let pictures = list::read_images(folder, "rgb.txt")?;
        let depths = if folder.join("depth.txt").exists() {
            list::read_images(folder, "depth.txt")?
        } else {
            Vec::new()
        };
        let poses = list::read_poses(folder, "groundtruth.txt")?;
        let tolerance_ns = (0.5e9 / manifest.nominal_fps) as u64;
        let total = pictures.len();
        let frames: Vec<FrameEntry> = pictures
            .into_iter()
            .filter_map(|picture| {
                let t_world_camera = associate::pose_at(&poses, picture.time_ns, tolerance_ns)?;
                let depth = associate::nearest(&depths, picture.time_ns, tolerance_ns)
                    .map(|entry| entry.path.clone());
                Some(FrameEntry {
                    time_ns: picture.time_ns,
                    rgb: picture.path,
                    depth,
                    t_world_camera,
                })
            })
            .collect();
        if frames.is_empty() {
            return Err(DatasetError::NoPose {
                path: folder.join("groundtruth.txt"),
                pictures: total,
                tolerance_ms: tolerance_ns as f64 / 1e6,
            });
        }
        let resampler = Resampler::new(&manifest.camera_model(), width, height);
        Ok(Self { manifest, resampler, without_pose: total - frames.len(), frames })
    }

    /// What `dataset.toml` says.
    #[must_use]
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// The camera of the samples: a pinhole of the size that was asked for.
    #[must_use]
    pub fn camera(&self) -> &CameraModel {
        self.resampler.camera()
    }

    /// Number of samples.
    #[must_use]
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// Never: a dataset without samples is refused.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    /// Where the camera was at each sample.
    #[must_use]
    pub fn poses(&self) -> Vec<Pose3> {
        self.frames.iter().map(|frame| frame.t_world_camera).collect()
    }

    /// Pictures that were left out because no pose is near them in time.
    #[must_use]
    pub fn without_pose(&self) -> usize {
        self.without_pose
    }

    /// All samples in time order, each read when it is asked for.
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
                want_width: camera.width,
                want_height: camera.height,
            });
        }
        Ok(image)
    }
}

#[cfg(test)]
mod tests;
