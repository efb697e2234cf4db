//! `dataset.toml`: the properties of a dataset that the lists of the TUM layout do not contain.

use std::path::Path;

use hal::{CameraModel, Distortion};
use serde::Deserialize;

use super::DatasetError;

/// Content of `dataset.toml`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// Name of the sequence.
    pub name: String,
    /// Layout of the files; must be `tum`.
    #[serde(default = "tum")]
    pub layout: String,
    /// Frames per second. Half of its inverse is the tolerance when the lists are associated.
    pub nominal_fps: f64,
    /// A value of a depth image divided by `depth_scale` is the z-depth in metres. The value 0
    /// means no depth.
    pub depth_scale: f64,
    /// Licence of the data.
    #[serde(default)]
    pub license: String,
    /// Origin of the data.
    #[serde(default)]
    pub source: String,
    /// Up direction in the frame of `groundtruth.txt`, of any length. Without it, it is estimated
    /// from the poses.
    #[serde(default)]
    pub up: Option<[f64; 3]>,
    /// Notes of the person who made the dataset.
    #[serde(default)]
    pub note: String,
    /// The colour camera. Depth images must be registered to it.
    pub camera: CameraSection,
}

/// `[camera]`: a pinhole model in which pixel centres have integer coordinates.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraSection {
    pub width: usize,
    pub height: usize,
    /// Focal lengths and principal point, pixels.
    pub fx: f64,
    pub fy: f64,
    pub cx: f64,
    pub cy: f64,
    /// Plumb-bob coefficients k1 k2 p1 p2 \[k3\]; empty without distortion.
    #[serde(default)]
    pub distortion: Vec<f64>,
}

fn tum() -> String {
    "tum".to_owned()
}

impl Manifest {
    /// Reads and checks `path`.
    ///
    /// # Errors
    /// If the file cannot be read or parsed, or has an unknown key or a value out of range.
    pub fn read(path: &Path) -> Result<Self, DatasetError> {
        let text = std::fs::read_to_string(path)
            .map_err(|source| DatasetError::Read { path: path.to_owned(), source })?;
        let manifest: Self = toml::from_str(&text).map_err(|error| DatasetError::Manifest {
            path: path.to_owned(),
            detail: error.to_string(),
        })?;
        manifest.check(path)?;
        Ok(manifest)
    }

    fn check(&self, path: &Path) -> Result<(), DatasetError> {
        let camera = &self.camera;
        let positive = "a finite number above 0";
        let pixels = "1 to 16384";
        require(path, "layout", &self.layout, self.layout == "tum", "\"tum\"")?;
        require(path, "nominal_fps", &self.nominal_fps, is_positive(self.nominal_fps), positive)?;
        require(path, "depth_scale", &self.depth_scale, is_positive(self.depth_scale), positive)?;
        if let Some(up) = &self.up {
            let direction =
                up.iter().all(|part| part.is_finite()) && up.iter().any(|part| part.abs() > 1e-6);
            require(path, "up", &format!("{up:?}"), direction, "a direction, as [0.0, 0.0, 1.0]")?;
        }
        require(path, "camera.width", &camera.width, (1..=16384).contains(&camera.width), pixels)?;
        require(
            path,
            "camera.height",
            &camera.height,
            (1..=16384).contains(&camera.height),
            pixels,
        )?;
        require(path, "camera.fx", &camera.fx, is_positive(camera.fx), positive)?;
        require(path, "camera.fy", &camera.fy, is_positive(camera.fy), positive)?;
        require(path, "camera.cx", &camera.cx, camera.cx.is_finite(), "a finite number")?;
        require(path, "camera.cy", &camera.cy, camera.cy.is_finite(), "a finite number")?;
        let k = &camera.distortion;
        let sound = matches!(k.len(), 0 | 4 | 5) && k.iter().all(|value| value.is_finite());
        require(
            path,
            "camera.distortion",
            &format!("{k:?}"),
            sound,
            "[] or finite k1 k2 p1 p2 [k3]",
        )
    }

    /// The camera of the original images, with distortion.
    #[must_use]
    pub fn camera_model(&self) -> CameraModel {
        let CameraSection { width, height, fx, fy, cx, cy, ref distortion } = self.camera;
        let distortion = if distortion.iter().all(|k| *k == 0.0) {
            Distortion::None
        } else {
            let mut plumb_bob = [0.0; 5];
            plumb_bob.iter_mut().zip(distortion).for_each(|(to, from)| *to = *from);
            Distortion::PlumbBob(plumb_bob)
        };
        CameraModel { width, height, fx, fy, cx, cy, distortion }
    }
}

fn is_positive(value: f64) -> bool {
    value.is_finite() && value > 0.0
}

fn require(
    path: &Path,
    key: &'static str,
    value: &impl std::fmt::Display,
    sound: bool,
    allowed: &'static str,
) -> Result<(), DatasetError> {
    if sound {
        return Ok(());
    }
    Err(DatasetError::Value { path: path.to_owned(), key, value: value.to_string(), allowed })
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = "name = \"x\"\nlayout = \"tum\"\nnominal_fps = 30\ndepth_scale = 1000\n[camera]\nwidth = 640\n\
                        height = 480\nfx = 500.0\nfy = 500.0\ncx = 320.0\ncy = 240.0\ndistortion = []\n";

    fn read(text: &str) -> Result<Manifest, DatasetError> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("dataset.toml");
        std::fs::write(&path, text).unwrap();
        Manifest::read(&path)
    }

    #[test]
    fn a_valid_file_is_read() {
        let model = read(GOOD).unwrap().camera_model();
        assert_eq!((model.width, model.fx, model.distortion), (640, 500.0, Distortion::None));
    }

    #[test]
    fn four_distortion_coefficients_leave_k3_at_zero() {
        let model =
            read(&GOOD.replace("[]\n", "[0.1, -0.2, 0.01, 0.02]\n")).unwrap().camera_model();
        assert_eq!(model.distortion, Distortion::PlumbBob([0.1, -0.2, 0.01, 0.02, 0.0]));
    }

    #[test]
    fn an_unknown_key_is_refused_by_name() {
        let error = read(&GOOD.replace("depth_scale", "depth_scael")).unwrap_err().to_string();
        assert!(error.contains("dataset.toml") && error.contains("depth_scael"), "{error}");
    }

    #[test]
    fn values_out_of_range_are_refused_with_key_value_and_range() {
        for (good, bad, key) in [
            ("fx = 500.0", "fx = -1.0", "camera.fx"),
            ("fy = 500.0", "fy = nan", "camera.fy"),
            ("depth_scale = 1000", "depth_scale = 0", "depth_scale"),
            ("width = 640", "width = 0", "camera.width"),
            ("\"tum\"", "\"kitti\"", "layout"),
            ("[]", "[0.1]", "camera.distortion"),
            ("nominal_fps", "up = [0.0, 0.0, 0.0]\nnominal_fps", "up"),
        ] {
            let error = read(&GOOD.replace(good, bad)).unwrap_err().to_string();
            assert!(error.contains(key) && error.contains("allowed"), "{error}");
        }
    }
}
