//! The lists of the TUM RGB-D layout: a timestamp in seconds, then a file name or a pose; `#`
//! starts a comment.

use std::path::{Path, PathBuf};

use hal::Pose3;
use nalgebra::{Quaternion, Translation3, UnitQuaternion};

use super::DatasetError;

/// Allowed deviation of a quaternion's length from 1. Lists are written with four or more decimals.
const UNIT_TOLERANCE: f64 = 1e-2;

/// One line of `rgb.txt` or `depth.txt`.
#[derive(Debug, Clone, PartialEq)]
pub struct ImageEntry {
    pub time_ns: u64,
    /// Path of the file, including the dataset's folder.
    pub path: PathBuf,
}

/// One line of `groundtruth.txt`.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseEntry {
    pub time_ns: u64,
    /// Pose of `camera_optical` in the world.
    pub t_world_camera: Pose3,
}

/// Reads a list of images and checks that every file exists.
///
/// # Errors
/// Names the list, the line and the value.
pub fn read_images(root: &Path, list: &str) -> Result<Vec<ImageEntry>, DatasetError> {
    let path = root.join(list);
    let mut entries = Vec::new();
    for_each_line(&path, |line, time_ns, fields| {
        let [name] = fields else {
            return Err(bad_line(
                &path,
                line,
                format!("expected `timestamp filename`, found {} fields", fields.len() + 1),
            ));
        };
        let image = root.join(name);
        if !image.is_file() {
            return Err(DatasetError::MissingImage { list: path.clone(), line, path: image });
        }
        entries.push(ImageEntry { time_ns, path: image });
        Ok(())
    })?;
    not_empty(entries, path, "timestamp filename")
}

/// Reads a list of poses.
///
/// # Errors
/// Names the list, the line and the value.
pub fn read_poses(root: &Path, list: &str) -> Result<Vec<PoseEntry>, DatasetError> {
    let path = root.join(list);
    let mut entries = Vec::new();
    for_each_line(&path, |line, time_ns, fields| {
        let t_world_camera = parse_pose(fields).map_err(|what| bad_line(&path, line, what))?;
        entries.push(PoseEntry { time_ns, t_world_camera });
        Ok(())
    })?;
    not_empty(entries, path, "timestamp tx ty tz qx qy qz qw")
}

/// Calls `each` with line number, time and remaining fields of every line that is not empty.
fn for_each_line(
    path: &Path,
    mut each: impl FnMut(usize, u64, &[&str]) -> Result<(), DatasetError>,
) -> Result<(), DatasetError> {
    let text = std::fs::read_to_string(path)
        .map_err(|source| DatasetError::Read { path: path.to_owned(), source })?;
    let mut previous: Option<(u64, &str)> = None;
    for (index, text) in text.lines().enumerate() {
        let line = index + 1;
        let fields: Vec<&str> =
            text.split('#').next().unwrap_or_default().split_ascii_whitespace().collect();
        let Some((&stamp, rest)) = fields.split_first() else { continue };
        let time_ns = parse_seconds(stamp).ok_or_else(|| {
            bad_line(
                path,
                line,
                format!("`{stamp}` is not a timestamp; expected seconds such as 1305031102.175304"),
            )
        })?;
        if let Some((before, before_text)) = previous
            && time_ns <= before
        {
            let what = format!(
                "timestamp {stamp} is not later than {before_text} on the line before; sort the list by time"
            );
            return Err(bad_line(path, line, what));
        }
        previous = Some((time_ns, stamp));
        each(line, time_ns, rest)?;
    }
    Ok(())
}

/// Converts decimal seconds to nanoseconds exactly. An f64 of today's Unix time has a resolution of
/// only 240 ns.
fn parse_seconds(text: &str) -> Option<u64> {
    let (whole, fraction) = text.split_once('.').unwrap_or((text, ""));
    if whole.is_empty() || !whole.bytes().chain(fraction.bytes()).all(|b| b.is_ascii_digit()) {
        return None;
    }
    let seconds: u64 = whole.parse().ok()?;
    let nanos: u64 = format!("{fraction:0<9}").get(..9)?.parse().ok()?;
    seconds.checked_mul(1_000_000_000)?.checked_add(nanos)
}

fn parse_pose(fields: &[&str]) -> Result<Pose3, String> {
    if fields.len() != 7 {
        return Err(format!(
            "expected `timestamp tx ty tz qx qy qz qw`, found {} fields",
            fields.len() + 1
        ));
    }
    let mut values = [0.0; 7];
    for ((value, text), name) in
        values.iter_mut().zip(fields).zip(["tx", "ty", "tz", "qx", "qy", "qz", "qw"])
    {
        *value = text.parse().ok().filter(|v: &f64| v.is_finite()).ok_or_else(|| {
            format!("{name} = {text} is not a finite number; leave an unknown pose out of the list")
        })?;
    }
    let [tx, ty, tz, qx, qy, qz, qw] = values;
    let rotation = Quaternion::new(qw, qx, qy, qz);
    if (rotation.norm() - 1.0).abs() > UNIT_TOLERANCE {
        return Err(format!(
            "quaternion ({qx}, {qy}, {qz}, {qw}) has length {:.4}; allowed: 1 +- {UNIT_TOLERANCE}",
            rotation.norm()
        ));
    }
    Ok(Pose3::from_parts(Translation3::new(tx, ty, tz), UnitQuaternion::from_quaternion(rotation)))
}

fn bad_line(path: &Path, line: usize, what: String) -> DatasetError {
    DatasetError::Line { path: path.to_owned(), line, what }
}

fn not_empty<T>(
    entries: Vec<T>,
    path: PathBuf,
    form: &'static str,
) -> Result<Vec<T>, DatasetError> {
    if entries.is_empty() { Err(DatasetError::EmptyList { path, form }) } else { Ok(entries) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn poses(text: &str) -> Result<Vec<PoseEntry>, DatasetError> {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("groundtruth.txt"), text).unwrap();
        read_poses(dir.path(), "groundtruth.txt")
    }

    fn message(text: &str) -> String {
        poses(text).unwrap_err().to_string()
    }

    #[test]
    fn comments_and_blank_lines_are_skipped() {
        let entries =
            poses("# time ...\n\n0.5 1 2 3 0 0 0 1 # fine\n0.75 1 2 3 0 0 0 -1\n").unwrap();
        assert_eq!(
            entries.iter().map(|e| e.time_ns).collect::<Vec<_>>(),
            [500_000_000, 750_000_000]
        );
    }

    #[test]
    fn unix_timestamps_keep_every_digit() {
        assert_eq!(parse_seconds("1305031102.175304"), Some(1_305_031_102_175_304_000));
        assert_eq!(parse_seconds("0.0333333333333"), Some(33_333_333));
        for bad in ["", ".5", "-1", "1e3", "nan", "rgb/1.png", "99999999999999"] {
            assert_eq!(parse_seconds(bad), None, "{bad}");
        }
    }

    #[test]
    fn unsorted_timestamps_are_refused_with_file_line_and_both_values() {
        let error = message("2.0 0 0 0 0 0 0 1\n1.5 0 0 0 0 0 0 1\n");
        assert!(
            error.contains("groundtruth.txt:2") && error.contains("1.5") && error.contains("2.0"),
            "{error}"
        );
    }

    #[test]
    fn nan_and_quaternions_that_are_not_normalized_are_refused() {
        assert!(message("1 0 nan 0 0 0 0 1\n").contains("ty = nan"));
        assert!(message("1 0 0 0 0 0 0 inf\n").contains("qw = inf"));
        assert!(message("1 0 0 0 0 0 0 0.9\n").contains("length 0.9"));
        assert!(message("1 0 0 0 0 0 0\n").contains("7 fields"));
    }

    #[test]
    fn an_empty_list_and_a_missing_list_are_errors() {
        assert!(message("# nothing\n").contains("empty"));
        assert!(
            read_poses(Path::new("/nowhere"), "groundtruth.txt")
                .unwrap_err()
                .to_string()
                .contains("/nowhere")
        );
    }

    #[test]
    fn a_line_without_a_timestamp_and_a_missing_image_are_named() {
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("a.png"), "").unwrap();
        std::fs::write(dir.path().join("rgb.txt"), "0.1 a.png\na.png\n").unwrap();
        let error = read_images(dir.path(), "rgb.txt").unwrap_err().to_string();
        assert!(error.contains("rgb.txt:2") && error.contains("a.png"), "{error}");
        std::fs::write(dir.path().join("rgb.txt"), "0.1 b.png\n").unwrap();
        let error = read_images(dir.path(), "rgb.txt").unwrap_err().to_string();
        assert!(error.contains("rgb.txt:1") && error.contains("b.png"), "{error}");
    }

    proptest! {
        #[test]
        fn no_content_of_a_list_causes_a_panic(text in "[0-9a-z.# \n-]{0,80}") {
            let _ = poses(&text);
        }
    }
}
