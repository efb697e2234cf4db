//! `summary.json`: the settings and results of a run. A key without a value is absent, never 0.

use std::{collections::BTreeMap, fmt, path::Path};

use runtime::lidar_agreement::{AgreementStats, LidarAgreement};
use runtime::robot::Robot;
use runtime::{
    accuracy::{AccuracyRows, Metrics},
    event::ExploreEnd,
    latency::Percentiles,
    robot::DepthSource,
};
use serde::{Deserialize, Serialize};

use super::{
    atomic::{ReportError, write_atomically},
    events::EventCounts,
    latency::Stage,
    pose_error::PoseError,
};
use crate::config::Odometry;

/// Name of the file in the output directory.
pub const SUMMARY_FILE: &str = "summary.json";

/// The settings and results of a run, as they are written into `summary.json`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct Summary {
    /// Number of camera frames.
    pub frames: u64,
    /// Seed of all random choices.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// Name of the exploration policy.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub policy: Option<String>,
    /// Scene that was explored.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scene: Option<String>,
    /// Dataset or recording that was evaluated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dataset: Option<String>,
    /// Source of the depth in the map.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub depth_source: Option<DepthSource>,
    /// How wrong the simulated robot's odometry was.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub odometry: Option<Odometry>,
    /// BLAKE3 digest of the network, hexadecimal.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub model: Option<String>,
    /// Injected faults, in the notation of `--fault`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub faults: Vec<String>,
    /// Seed of the random choices in faults.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fault_seed: Option<u64>,
    /// Why the exploration ended.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub end_reason: Option<ExploreEnd>,
    /// Length of the ground-truth path, metres.
    #[serde(skip_serializing_if = "absent")]
    pub path_m: Option<f64>,
    /// Share of the reachable floor that was mapped, 0 to 1.
    #[serde(skip_serializing_if = "absent")]
    pub coverage: Option<f64>,
    /// Share of the reachable floor that was mapped and that the map shows at its true place, to
    /// 0.15 m, if the start pose is aligned.
    #[serde(skip_serializing_if = "absent")]
    pub coverage_true: Option<f64>,
    /// Share of the occupied cells that are more than 10 cm from any true obstacle, after the best
    /// rigid fit of the map.
    #[serde(skip_serializing_if = "absent")]
    pub map_off10: Option<f64>,
    /// Distances between occupied cells and true obstacles, both ways, after the best rigid fit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub map_error_m: Option<MapError>,
    /// Intersection over union of the map's free floor and the true one, after the best rigid fit.
    #[serde(skip_serializing_if = "absent")]
    pub map_iou: Option<f64>,
    /// Errors of the poses that the robot believed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pose_error: Option<PoseError>,
    /// Area of the reachable floor, square metres.
    #[serde(skip_serializing_if = "absent")]
    pub reachable_m2: Option<f64>,
    /// Number of collisions: the footprint met an obstacle (ground truth).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub collisions: Option<u64>,
    /// Number of times that the footprint came within 0.1 m of an edge over which it can fall, such
    /// as that of stairs down (ground truth); absent if it never did.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub edge_approaches: Option<u64>,
    /// Whether the robot fell over such an edge, which ends the run; absent if it did not.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub fell: Option<bool>,
    /// Number of frames in which the safety plane held the robot ([`HeldMeter`](super::held::HeldMeter)).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub held_frames: Option<u64>,
    /// Number of frames in which the robot made no progress
    /// ([`StuckMeter`](super::stuck::StuckMeter)).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stuck_frames: Option<u64>,
    /// Largest number of such frames in a row.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stuck_longest_frames: Option<u64>,
    /// Ticks of a real robot's exploration plane that were skipped because the one before took
    /// longer than its period.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub skipped_ticks: Option<u64>,
    #[serde(flatten)]
    pub events: EventCounts,
    /// Wall-clock time, seconds.
    #[serde(skip_serializing_if = "absent")]
    pub wall_s: Option<f64>,
    /// Frames per second of wall-clock time.
    #[serde(skip_serializing_if = "absent")]
    pub frames_per_s: Option<f64>,
    /// Time taken by each stage, milliseconds.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub latency_ms: BTreeMap<Stage, Percentiles>,
    /// Accuracy of depth compared with ground truth.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub accuracy: Option<DepthAccuracy>,
    /// Recent agreement of the map's depth with the LiDAR; of coarse depth, if the map uses dense
    /// depth, which is made with the scan. Unlike `accuracy`, a real robot can measure it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lidar_line: Option<LidarLine>,
    /// How late the camera stamps its frames, as image motion shows it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera_latency: Option<CameraLatency>,
    /// Peak resident memory, MiB.
    #[serde(skip_serializing_if = "absent")]
    pub resident_mib: Option<f64>,
    /// Size of the recording, MiB.
    #[serde(skip_serializing_if = "absent")]
    pub recording_mib: Option<f64>,
    /// BLAKE3 digest of the recording's files, hexadecimal.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recording_digest: Option<String>,
    /// BLAKE3 digest of all decisions, hexadecimal. Two runs with the same digest decided the same.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub digest: Option<String>,
    /// Version of the binary.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub version: String,
}

/// Percentiles of the distances between a map and the truth, metres.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct MapError {
    pub p50: f64,
    pub p90: f64,
}

impl MapError {
    /// Percentiles of distances, by the nearest rank; `None` without any distance.
    #[must_use]
    pub fn of(mut distances: Vec<f64>) -> Option<Self> {
        distances.sort_by(f64::total_cmp);
        Some(Self { p50: nearest_rank(&distances, 0.5)?, p90: nearest_rank(&distances, 0.9)? })
    }
}

fn nearest_rank(sorted: &[f64], share: f64) -> Option<f64> {
    let rank = (share * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.max(1) - 1).copied()
}

/// Time from the exposure of a frame to its stamp, in addition to `devices.camera.latency_ms`, found while driving.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct CameraLatency {
    /// The time that was found, milliseconds.
    pub found_ms: f64,
    /// Standard deviation of `found_ms`.
    pub error_ms: f64,
}

impl CameraLatency {
    /// What a robot has found; `None` when it does not estimate the latency.
    #[must_use]
    pub fn of(robot: &Robot) -> Option<Self> {
        let (found_s, error_s) = robot.camera_latency_s();
        let estimated = robot.config().localization.estimate_camera_latency;
        estimated.then_some(Self { found_ms: 1e3 * found_s, error_ms: 1e3 * error_s })
    }
}

/// For the terminal.
impl fmt::Display for CameraLatency {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { found_ms, error_ms } = self;
        write!(
            f,
            "frames exposed {found_ms:.1} ms before their time stamp (error {error_ms:.1} ms)"
        )
    }
}

/// Agreement of depth with the LiDAR's returns in the image.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LidarLine {
    pub all: AgreementStats,
    /// The agreement in ranges of distance.
    pub by_distance: Vec<AgreementStats>,
}

impl LidarLine {
    /// The state of a monitor; `None` if it has not compared anything yet.
    #[must_use]
    pub fn of(monitor: &LidarAgreement) -> Option<Self> {
        monitor.overall().map(|all| Self { all, by_distance: monitor.by_distance() })
    }
}

/// Formats the agreement as a sentence for the terminal.
impl fmt::Display for LidarLine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let AgreementStats { delta1, scale, share, .. } = self.all;
        write!(
            f,
            "{:.0} % of the depths are within 25 % of the LiDAR (scale {scale:.2}); {:.0} % of the \
             LiDAR's returns in the image have a depth",
            100.0 * delta1,
            100.0 * share
        )
    }
}

/// Accuracy of each source of depth. A source without any depth is absent.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct DepthAccuracy {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub coarse: Option<AccuracyRows>,
    /// Coarse depth, completed by what was seen before and by the cells around.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dense: Option<AccuracyRows>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub network: Option<AccuracyRows>,
    /// Accuracy of the network on the pixels that have coarse depth.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refined: Option<Metrics>,
    /// Accuracy of a constant depth, the median of the ground truth: the baseline that every source
    /// must exceed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub constant: Option<AccuracyRows>,
}

/// Whether to leave out a value. JSON has no NaN and no infinity, so those are left out as well.
fn absent(value: &Option<f64>) -> bool {
    !value.is_some_and(f64::is_finite)
}

impl Summary {
    /// The summary as indented JSON with a final newline.
    #[must_use]
    pub fn to_json(&self) -> String {
        // Serializing numbers, strings and maps with string keys cannot fail.
        let mut text = serde_json::to_string_pretty(self).unwrap_or_default();
        text.push('\n');
        text
    }

    /// Writes `summary.json` into `dir` atomically.
    ///
    /// # Errors
    /// [`ReportError::Unwritable`].
    pub fn write(&self, dir: &Path) -> Result<(), ReportError> {
        write_atomically(&dir.join(SUMMARY_FILE), self.to_json().as_bytes())
    }
}

/// Peak resident memory of this process, MiB; `None` if the system does not report it.
#[must_use]
pub fn peak_resident_mib() -> Option<f64> {
    peak_resident_in(&std::fs::read_to_string("/proc/self/status").ok()?)
}

fn peak_resident_in(status: &str) -> Option<f64> {
    let kib =
        status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?.trim().strip_suffix("kB")?;
    Some(kib.trim().parse::<f64>().ok()? / 1024.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_key_without_a_value_is_absent() {
        let empty: serde_json::Value = serde_json::from_str(&Summary::default().to_json()).unwrap();
        assert_eq!(empty, json!({"frames": 0}));
        let drive: serde_json::Value = serde_json::from_str(
            &Summary { events: EventCounts::driving(), ..Summary::default() }.to_json(),
        )
        .unwrap();
        assert_eq!(
            drive,
            json!({"frames": 0, "bumper_trips": 0, "bumper_escapes": 0, "goals": {"reached": 0}})
        );
    }

    #[test]
    fn injected_faults_and_safety_faults_have_separate_keys() {
        let mut summary = Summary { faults: vec!["lidar:stall@4..6".into()], ..Summary::default() };
        summary.events.safety_faults.insert("lidar_silent".into(), 1);
        let value: serde_json::Value = serde_json::from_str(&summary.to_json()).unwrap();
        assert_eq!(value["faults"], json!(["lidar:stall@4..6"]));
        assert_eq!(value["safety_faults"], json!({"lidar_silent": 1}));
    }

    #[test]
    fn a_number_that_json_cannot_hold_is_absent_not_null() {
        let summary =
            Summary { path_m: Some(f64::NAN), wall_s: Some(f64::INFINITY), ..Summary::default() };
        let text = summary.to_json();
        assert!(
            !text.contains("null") && !text.contains("path_m") && !text.contains("wall_s"),
            "{text}"
        );
    }

    #[test]
    fn keys_and_nesting_are_those_that_tools_rely_on() {
        let coarse =
            Metrics { share: 0.71, delta1: 0.86, delta1_unscaled: 0.84, ..Metrics::default() };
        let constant = Metrics { delta1: 0.65, ..Metrics::default() };
        let summary = Summary {
            frames: 3000,
            seed: Some(7),
            policy: Some("active".into()),
            scene: Some("builtin:house?seed=3".into()),
            odometry: Some(Odometry::Realistic),
            coverage_true: Some(0.81),
            map_error_m: Some(MapError { p50: 0.01, p90: 0.05 }),
            depth_source: Some(DepthSource::Coarse),
            end_reason: Some(ExploreEnd::FrameBudget),
            path_m: Some(81.2),
            coverage: Some(0.83),
            collisions: Some(0),
            stuck_frames: Some(12),
            wall_s: Some(95.1),
            digest: Some("ab12".into()),
            latency_ms: BTreeMap::from([(
                Stage::Total,
                Percentiles { p50: 6.1, p99: 9.7, max: 14.0 },
            )]),
            accuracy: Some(DepthAccuracy {
                coarse: Some(AccuracyRows { all: Some(coarse), confident: None }),
                dense: None,
                network: None,
                refined: None,
                constant: Some(AccuracyRows { all: Some(constant), confident: None }),
            }),
            events: EventCounts::driving(),
            ..Summary::default()
        };
        let mut value: serde_json::Value = serde_json::from_str(&summary.to_json()).unwrap();
        let accuracy = value["accuracy"].take();
        let expected = json!({
            "frames": 3000, "seed": 7, "policy": "active", "scene": "builtin:house?seed=3", "odometry": "realistic",
            "coverage_true": 0.81, "map_error_m": {"p50": 0.01, "p90": 0.05}, "depth_source": "coarse",
            "end_reason": "frame_budget", "path_m": 81.2, "coverage": 0.83, "collisions": 0, "stuck_frames": 12,
            "wall_s": 95.1, "digest": "ab12", "latency_ms": {"total": {"p50": 6.1, "p99": 9.7, "max": 14.0}},
            "accuracy": null, "bumper_trips": 0, "bumper_escapes": 0, "goals": {"reached": 0},
        });
        assert_eq!(value, expected);
        assert_eq!(accuracy["coarse"]["all"]["delta1_unscaled"], 0.84);
        assert_eq!(accuracy["constant"]["all"]["delta1"], 0.65);
        assert_eq!((accuracy.get("dense"), accuracy.get("network")), (None, None));
        assert_eq!(accuracy["coarse"].get("confident"), None);
        assert_eq!(serde_json::from_str::<Summary>(&summary.to_json()).unwrap(), summary);
    }

    #[test]
    fn percentiles_of_a_map_are_distances_of_the_map() {
        let error = MapError::of((1..=10).rev().map(f64::from).collect()).unwrap();
        assert_eq!((error.p50, error.p90), (5.0, 9.0));
        assert_eq!(MapError::of(vec![0.3]), Some(MapError { p50: 0.3, p90: 0.3 }));
        assert_eq!(MapError::of(Vec::new()), None);
    }

    #[test]
    fn it_is_written_into_the_output_directory() {
        let dir = tempfile::tempdir().unwrap();
        let summary = Summary { frames: 5, ..Summary::default() };
        summary.write(dir.path()).unwrap();
        let text = std::fs::read_to_string(dir.path().join("summary.json")).unwrap();
        assert_eq!(serde_json::from_str::<Summary>(&text).unwrap(), summary);
        assert!(
            summary
                .write(&dir.path().join("absent"))
                .unwrap_err()
                .to_string()
                .contains("absent/summary.json")
        );
    }

    #[test]
    fn peak_memory_is_read_in_mebibytes() {
        assert_eq!(
            peak_resident_in("VmPeak:\t 9 kB\nVmHWM:\t    2048 kB\nVmRSS:\t 1 kB\n"),
            Some(2.0)
        );
        assert_eq!(peak_resident_in("Name: x\n"), None);
    }
}
