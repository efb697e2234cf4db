//! The header of a recording: the configuration that a run was made with.

use hal::{CameraModel, Pose3};
use serde::{Deserialize, Serialize};

use super::json;

/// Version of the recording's format. It is increased when an old reader would misread a new recording.
///
/// 2: every tick holds the safety loop's report with all sent commands, and the pose at the scan's time; decisions hold `desired`
/// and `sent`. Recordings of format 1 are refused: they do not hold what the wheels received, and their decisions cannot be
/// recomputed by a loop whose safety plane stands outside.
pub const FORMAT_VERSION: u32 = 2;

/// Everything besides the recorded inputs that determines a run's decisions. It is the same in every segment of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunHeader {
    /// Name and version of the program that wrote the recording.
    pub written_by: String,
    /// Seed of the run.
    pub seed: u64,
    /// The simulated world; `None` on a real robot.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub scene: Option<String>,
    /// Name of the policy.
    pub policy: String,
    /// Where the depth of the map comes from: `coarse`, `dense`, `network` or `truth`.
    pub depth_source: String,
    /// BLAKE3 digest of the model file, if there is a model.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub model_digest: Option<String>,
    /// The ticks at which other models were handed over, if the run had a schedule.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub hand_over: Option<HandOverSchedule>,
    /// Whether the run took models from a model store. The events of its ticks say which ones and when.
    #[serde(skip_serializing_if = "std::ops::Not::not", default)]
    pub model_store: bool,
    /// BLAKE3 digest of the map state that the run began with, in hex. The snapshot of its first tick holds the map.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub loaded_map: Option<String>,
    /// The injected faults. The recorded inputs are those that the faulty devices delivered.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub faults: Vec<String>,
    /// Seed of the injected faults.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub fault_seed: Option<u64>,
    /// Which robot recorded which run; `None` in simulation, where the same run gives the same bytes.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub identity: Option<RunIdentity>,
    /// Whether images were recorded. A run without them cannot be recomputed.
    #[serde(skip_serializing_if = "Clone::clone", default = "yes")]
    pub images: bool,
    /// Intrinsics of the images that enter the loop.
    #[serde(with = "json::camera_model")]
    pub camera: CameraModel,
    /// Pose of `camera_optical` in `base_link`.
    #[serde(with = "json::pose3")]
    pub t_base_camera: Pose3,
    /// Pose of `laser` in `base_link`.
    #[serde(with = "json::pose3")]
    pub t_base_laser: Pose3,
    /// The whole effective configuration.
    pub config: serde_json::Value,
}

fn yes() -> bool {
    true
}

impl RunHeader {
    /// The header of a run with coarse depth and without world, model and injected faults. Camera and laser are at the
    /// origin of `base_link`.
    #[must_use]
    pub fn new(written_by: &str, camera: CameraModel) -> Self {
        Self {
            written_by: written_by.to_owned(),
            seed: 0,
            scene: None,
            policy: "random".to_owned(),
            depth_source: "coarse".to_owned(),
            model_digest: None,
            hand_over: None,
            model_store: false,
            loaded_map: None,
            faults: Vec::new(),
            fault_seed: None,
            identity: None,
            images: true,
            camera,
            t_base_camera: Pose3::identity(),
            t_base_laser: Pose3::identity(),
            config: serde_json::Value::Object(serde_json::Map::new()),
        }
    }
}

/// What tells the runs of all robots apart, whatever their folders are called and whatever their clocks say.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RunIdentity {
    /// The run: 32 random hexadecimal digits.
    pub run: String,
    /// The robot's public key, 64 hexadecimal digits, with which its segments are signed; `None` if it has no key.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub robot: Option<String>,
    /// Name of the robot; empty if it has none.
    #[serde(skip_serializing_if = "String::is_empty", default)]
    pub name: String,
    /// The home or site in which the robot works; empty if it is not said.
    #[serde(skip_serializing_if = "String::is_empty", default)]
    pub site: String,
    /// The computer's start in which the run was recorded (Linux's `boot_id`): times of the monotonic clock can be compared
    /// between runs of one start. Empty if it is not known.
    #[serde(skip_serializing_if = "String::is_empty", default)]
    pub boot: String,
}

/// The ticks before which the robot gets a newly trained model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct HandOverSchedule {
    /// The first of them.
    pub first: u64,
    /// Number of ticks from one to the next.
    pub every: u64,
}

impl HandOverSchedule {
    /// The training round that ends before `tick`, counted from 0; `None` when none ends there.
    #[must_use]
    pub fn round(&self, tick: u64) -> Option<u64> {
        let since = tick.checked_sub(self.first)?;
        (since.checked_rem(self.every)? == 0).then(|| since / self.every)
    }
}

/// First message of every segment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SegmentHeader {
    /// Version of the recording format, [`FORMAT_VERSION`] of the program that wrote it.
    pub format_version: u32,
    /// Number of the segment in its run, from 0.
    pub segment: u32,
    /// Number of the first tick in this segment.
    pub first_tick: u64,
    /// Time of the first tick, monotonic.
    pub first_time_ns: u64,
    /// Unix time at which the run's clock was zero, by the computer's date when the segment began, nanoseconds. It differs
    /// between segments when the date was corrected. `None` in simulation, where the same run gives the same bytes.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub zero_unix_ns: Option<u64>,
    /// The run's configuration.
    pub run: RunHeader,
}

impl SegmentHeader {
    /// The header of segment number `segment`, in the format of this program.
    #[must_use]
    pub fn new(run: RunHeader, segment: u32, first_tick: u64, first_time_ns: u64) -> Self {
        Self {
            format_version: FORMAT_VERSION,
            segment,
            first_tick,
            first_time_ns,
            zero_unix_ns: None,
            run,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::run_header;
    use super::*;

    #[test]
    fn a_header_comes_back_from_json_bit_for_bit() {
        let mut run = run_header();
        run.camera.distortion = hal::Distortion::PlumbBob([0.1, -0.2, 1e-3, 0.0, 1.0 / 3.0]);
        let header = SegmentHeader::new(run, 3, 1_800, 60_000_000_001);
        let text = serde_json::to_string(&header).unwrap();
        let back: SegmentHeader = serde_json::from_str(&text).unwrap();
        assert_eq!(back, header);
        assert_eq!(serde_json::to_string(&back).unwrap(), text);
    }

    #[test]
    fn a_date_comes_back_and_a_header_from_before_there_were_any_is_read() {
        let undated = SegmentHeader::new(run_header(), 0, 0, 0);
        let dated =
            SegmentHeader { zero_unix_ns: Some(1_790_000_000_123_456_789), ..undated.clone() };
        for header in [undated, dated] {
            let text = serde_json::to_string(&header).unwrap();
            assert_eq!(text.contains("unix"), header.zero_unix_ns.is_some());
            assert_eq!(serde_json::from_str::<SegmentHeader>(&text).unwrap(), header);
        }
    }

    #[test]
    fn faults_are_in_the_header_and_a_header_from_before_there_were_any_is_read() {
        let run = RunHeader {
            faults: vec!["lidar:stall@4..6".to_owned()],
            fault_seed: Some(3),
            ..run_header()
        };
        let text = serde_json::to_string(&run).unwrap();
        assert_eq!(serde_json::from_str::<RunHeader>(&text).unwrap(), run);
        let old = serde_json::to_string(&run_header()).unwrap();
        assert!(!old.contains("fault"));
        assert_eq!(serde_json::from_str::<RunHeader>(&old).unwrap(), run_header());
    }

    #[test]
    fn an_identity_is_in_the_header_and_a_header_from_before_there_were_any_is_read() {
        let identity = RunIdentity {
            run: "00".repeat(16),
            robot: Some("ab".repeat(32)),
            name: "kitchen".to_owned(),
            site: String::new(),
            boot: "b1".to_owned(),
        };
        let run = RunHeader { identity: Some(identity), ..run_header() };
        let text = serde_json::to_string(&run).unwrap();
        assert!(text.contains("kitchen") && !text.contains("site"));
        assert_eq!(serde_json::from_str::<RunHeader>(&text).unwrap(), run);
        assert!(!serde_json::to_string(&run_header()).unwrap().contains("identity"));
    }

    #[test]
    fn models_are_handed_over_at_the_first_tick_and_then_regularly() {
        let schedule = HandOverSchedule { first: 600, every: 300 };
        let rounds: Vec<_> =
            (0..1300).filter_map(|tick| Some((tick, schedule.round(tick)?))).collect();
        assert_eq!(rounds, [(600, 0), (900, 1), (1200, 2)]);
        assert_eq!(HandOverSchedule { first: 0, every: 0 }.round(5), None);
    }

    #[test]
    fn a_header_with_an_impossible_camera_is_refused() {
        let text = serde_json::to_string(&run_header()).unwrap().replace("\"fx\":", "\"fx\":-");
        assert!(serde_json::from_str::<RunHeader>(&text).is_err());
    }
}
