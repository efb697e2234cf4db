//! Writes coarse and dense depth as NumPy files, so that a network can be trained on the same input
//! that the robot will give it.
//!
//! `NNNNNN.npy` (coarse depth) and `NNNNNN_dense.npy` are uint16 `[2, rows, columns]`: depth in
//! millimetres (0: none), then confidence times 65535. For a dataset, the resampled images are written too: `NNNNNN_rgb.npy` is uint8
//! `[rows, columns, 3]`, and `NNNNNN_truth.npy` is uint16 in millimetres. A recording already
//! contains its images. `dump.json` lists the files. It is written last, so a folder without it is
//! incomplete.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use hal::{CameraModel, DepthMap, Pose3};
use runtime::perception::DepthEstimate;
use serde::Serialize;

use crate::report::atomic::{prepare_dir, write_atomically};

const INDEX: &str = "dump.json";

/// A writer for such a folder.
pub(crate) struct Dump {
    dir: PathBuf,
    index: Index,
}

/// The depth of a frame without a network.
#[derive(Clone, Copy, Default)]
pub(crate) struct Depths<'a> {
    pub coarse: Option<&'a DepthEstimate>,
    pub dense: Option<&'a DepthEstimate>,
}

/// One frame, without its depth.
pub(crate) struct Shot<'a> {
    pub time_ns: u64,
    /// Pose of `camera_optical` in the frame of the run's poses.
    pub t_world_camera: Pose3,
    /// RGB8, row-major; `None` if a recording contains it.
    pub rgb: Option<&'a [u8]>,
    /// Ground truth; `None` if a recording contains it, or there is none.
    pub truth: Option<&'a DepthMap>,
    /// The test view to which the frame belongs.
    pub view: Option<View>,
}

/// A test view of `firmware-host views`. The network is evaluated on its last frame, which has
/// ground truth; the earlier frames were taken on the way to it.
#[derive(Clone, Copy, Serialize)]
pub(crate) struct View {
    /// Number of the view, from 0.
    pub view: u64,
    /// The camera's motion before the frame: `drive`, or `turn` for a rotation on the spot.
    pub approach: &'static str,
}

#[derive(Serialize)]
struct Index {
    format_version: u32,
    width: usize,
    height: usize,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    frames: Vec<Entry>,
}

#[derive(Serialize)]
struct Entry {
    name: String,
    time_ns: u64,
    /// Pose as a homogeneous 4x4 matrix, row-major.
    t_world_camera: Vec<f64>,
    coarse: bool,
    dense: bool,
    rgb: bool,
    truth: bool,
    #[serde(flatten)]
    view: Option<View>,
}

impl Dump {
    pub fn create(dir: &Path, camera: &CameraModel) -> Result<Self> {
        // Its index would be lost, and its files would be mixed with the new ones.
        if dir.join(INDEX).exists() {
            bail!("{} contains {INDEX} of another run; choose another folder", dir.display());
        }
        prepare_dir(dir)?;
        let CameraModel { width, height, fx, fy, cx, cy, .. } = *camera;
        let index = Index { format_version: 1, width, height, fx, fy, cx, cy, frames: Vec::new() };
        Ok(Self { dir: dir.to_owned(), index })
    }

    pub fn add(&mut self, shot: &Shot<'_>, depths: &Depths<'_>) -> Result<()> {
        let name = format!("{:06}", self.index.frames.len());
        let rows = self.index.height;
        let columns = self.index.width;
        for (estimate, suffix) in [(depths.coarse, ""), (depths.dense, "_dense")] {
            if let Some(estimate) = estimate {
                let planes = npy_u16(&[2, rows, columns], planes(estimate));
                self.write(format!("{name}{suffix}.npy"), &planes)?;
            }
        }
        if let Some(truth) = shot.truth {
            let planes = npy_u16(&[rows, columns], millimetres(truth));
            self.write(format!("{name}_truth.npy"), &planes)?;
        }
        if let Some(rgb) = shot.rgb {
            self.write(format!("{name}_rgb.npy"), &npy("|u1", &[rows, columns, 3], rgb))?;
        }
        self.index.frames.push(Entry {
            time_ns: shot.time_ns,
            t_world_camera: row_major(&shot.t_world_camera),
            coarse: depths.coarse.is_some(),
            dense: depths.dense.is_some(),
            rgb: shot.rgb.is_some(),
            truth: shot.truth.is_some(),
            view: shot.view,
            name,
        });
        Ok(())
    }

    fn write(&self, name: String, bytes: &[u8]) -> Result<()> {
        Ok(write_atomically(&self.dir.join(name), bytes)?)
    }

    /// Writes the index of all frames so far. More frames may follow.
    pub fn write_index(&self) -> Result<()> {
        Ok(write_atomically(&self.dir.join(INDEX), &serde_json::to_vec_pretty(&self.index)?)?)
    }
}

fn row_major(pose: &Pose3) -> Vec<f64> {
    pose.to_matrix().transpose().as_slice().to_vec()
}

/// Depth, then confidence.
fn planes(estimate: &DepthEstimate) -> impl Iterator<Item = u16> + '_ {
    let confidence = estimate.confidence.iter();
    let confidence = confidence.map(|value| (value.clamp(0.0, 1.0) * 65_535.0).round() as u16);
    millimetres(&estimate.depth).chain(confidence)
}

/// Depth in millimetres. A depth that does not fit into 16 bits becomes 0, no depth.
fn millimetres(depth: &DepthMap) -> impl Iterator<Item = u16> + '_ {
    depth.values().iter().map(|metres| {
        let mm = (metres * 1000.0).round();
        if mm <= 65_535.0 { mm as u16 } else { 0 }
    })
}

fn npy_u16(shape: &[usize], values: impl Iterator<Item = u16>) -> Vec<u8> {
    npy("<u2", shape, &values.flat_map(u16::to_le_bytes).collect::<Vec<_>>())
}

/// NumPy's file format, version 1.0: magic, header padded to 64 bytes, values in C order.
fn npy(kind: &str, shape: &[usize], values: &[u8]) -> Vec<u8> {
    const BEFORE_TEXT: usize = 10;
    let shape = shape.iter().map(|side| format!("{side},")).collect::<String>();
    let mut text = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({shape}), }}");
    let padded = (BEFORE_TEXT + text.len() + 1).next_multiple_of(64) - BEFORE_TEXT;
    text.extend(std::iter::repeat_n(' ', padded - 1 - text.len()));
    text.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((padded as u16).to_le_bytes());
    bytes.extend(text.as_bytes());
    bytes.extend(values);
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numpys_format_has_a_padded_header_and_then_the_values() {
        let bytes = npy_u16(&[1, 2], [1u16, 515].into_iter());
        assert_eq!(&bytes[..8], b"\x93NUMPY\x01\x00");
        let text = usize::from(u16::from_le_bytes([bytes[8], bytes[9]]));
        assert_eq!((10 + text) % 64, 0);
        let header = std::str::from_utf8(&bytes[10..10 + text]).unwrap();
        assert!(
            header.starts_with("{'descr': '<u2', 'fortran_order': False, 'shape': (1,2,), }")
                && header.ends_with('\n')
        );
        assert_eq!(bytes[10 + text..], [1, 0, 3, 2]);
    }

    #[test]
    fn a_folder_contains_depth_images_and_an_index_that_is_written_last_and_never_replaced() {
        let dir = tempfile::tempdir().unwrap();
        let camera = CameraModel::pinhole(2, 1, std::f64::consts::FRAC_PI_2);
        let truth = DepthMap::from_vec(2, 1, vec![0.0, 1.5]).unwrap();
        let rgb = [1, 2, 3, 4, 5, 6];
        let shot = Shot {
            time_ns: 7,
            t_world_camera: Pose3::translation(1.0, 2.0, 3.0),
            rgb: Some(&rgb),
            truth: Some(&truth),
            view: None,
        };
        let depth = DepthMap::from_vec(2, 1, vec![2.5, 70.0]).unwrap();
        let coarse = DepthEstimate { depth, confidence: vec![1.0, 0.5] };
        let mut dump = Dump::create(dir.path(), &camera).unwrap();
        dump.add(&shot, &Depths::default()).unwrap();
        dump.add(&shot, &Depths { coarse: Some(&coarse), dense: Some(&coarse) }).unwrap();
        assert!(!dir.path().join(INDEX).exists());
        dump.write_index().unwrap();
        let index: serde_json::Value =
            serde_json::from_slice(&std::fs::read(dir.path().join(INDEX)).unwrap()).unwrap();
        assert_eq!(index["frames"][0]["coarse"], false);
        assert_eq!(index["frames"][1]["t_world_camera"][3], 1.0);
        let planes = std::fs::read(dir.path().join("000001.npy")).unwrap();
        let values = [2500u16, 0, 65_535, 32_768].map(u16::to_le_bytes).concat();
        assert!(planes.ends_with(&values));
        assert_eq!(std::fs::read(dir.path().join("000001_dense.npy")).unwrap(), planes);
        assert_eq!(index["frames"][0]["dense"], false);
        assert!(std::fs::read(dir.path().join("000000_rgb.npy")).unwrap().ends_with(&rgb));
        assert!(!dir.path().join("000000.npy").exists());
        let again = Dump::create(dir.path(), &camera).err().unwrap().to_string();
        assert!(again.ends_with("contains dump.json of another run; choose another folder"));
        assert!(dir.path().join(INDEX).exists());
    }
}
