//! What a run was made with.

use hal::{CameraModel, Pose3};
use serde::{Deserialize, Serialize};

use super::json;

/// Version of the recording's format. Goes up when an old reader would misread a new recording.
///
/// 2: every tick holds the safety loop's report with all sent commands, and the pose at the scan's time; decisions hold `desired`
/// and `sent`. Recordings of format 1 are refused: they do not hold what the wheels received, and their decisions cannot be
/// recomputed by a loop whose safety plane stands outside.
pub const FORMAT_VERSION: u32 = 2;

/// Everything besides the recorded inputs that decides what a run decides. The same in every segment of a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunHeader {
    /// Name and version of the program that wrote this.
    pub written_by: String,
    /// Seed of the run.
    pub seed: u64,
    /// The world, for a simulated run.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub scene: Option<String>,
    /// Name of the policy.
    pub policy: String,
    /// Where depth comes from: `coarse`, `network` or `truth`.
    pub depth_source: String,
    /// BLAKE3 digest of the model file, if there is a model.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub model_digest: Option<String>,
    /// When other models were handed over, if they were.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub hand_over: Option<HandOverSchedule>,
    /// Whether models came out of a store on its way; which ones and when stands in the turns' events.
    #[serde(skip_serializing_if = "std::ops::Not::not", default)]
    pub model_store: bool,
    /// What was broken on purpose; the recorded inputs are as the broken devices gave them.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub faults: Vec<String>,
    /// Seed of everything random in that.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub fault_seed: Option<u64>,
    /// Whether its pictures were recorded: without them nothing can be recomputed.
    #[serde(skip_serializing_if = "Clone::clone", default = "yes")]
    pub pictures: bool,
    /// Intrinsics of the pictures that the loop gets.
    #[serde(with = "json::camera_model")]
    pub camera: CameraModel,
    /// `camera_optical` on the robot.
    #[serde(with = "json::pose3")]
    pub t_base_camera: Pose3,
    /// `laser` on the robot.
    #[serde(with = "json::pose3")]
    pub t_base_laser: Pose3,
    /// The whole effective configuration.
    pub config: serde_json::Value,
}

fn yes() -> bool {
    true
}

impl RunHeader {
    /// A run by wheels and coarse depth: no world, no model, nothing broken, camera and laser in the robot's middle.
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
            faults: Vec::new(),
            fault_seed: None,
            pictures: true,
            camera,
            t_base_camera: Pose3::identity(),
            t_base_laser: Pose3::identity(),
            config: serde_json::Value::Object(serde_json::Map::new()),
        }
    }
}

/// Turns before which the robot gets a newly trained model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct HandOverSchedule {
    /// The first such turn.
    pub first: u64,
    /// Turns from one to the next.
    pub every: u64,
}

impl HandOverSchedule {
    /// The round that ends before turn `tick`, counted from 0.
    #[must_use]
    pub fn round(&self, tick: u64) -> Option<u64> {
        let since = tick.checked_sub(self.first)?;
        (since.checked_rem(self.every)? == 0).then(|| since / self.every)
    }
}

/// First message of every segment.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SegmentHeader {
    /// [`FORMAT_VERSION`].
    pub format_version: u32,
    /// Counts up from 0 over the run's files.
    pub segment: u32,
    /// First turn in this segment.
    pub first_tick: u64,
    /// Its time.
    pub first_time_ns: u64,
    /// The run.
    pub run: RunHeader,
}

impl SegmentHeader {
    /// The header of the run's segment number `segment`, whose first turn is `first_tick`.
    #[must_use]
    pub fn new(run: RunHeader, segment: u32, first_tick: u64, first_time_ns: u64) -> Self {
        Self { format_version: FORMAT_VERSION, segment, first_tick, first_time_ns, run }
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
    fn models_are_handed_over_at_the_first_turn_and_then_regularly() {
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
