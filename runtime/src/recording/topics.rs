//! The recording's channels.

use std::borrow::Cow;

use foxglove::{Encode, Schema, messages as fox};

/// Channels of a recording, in the order of first use.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Topic {
    Header,
    Tick,
    Scan,
    Image,
    Calibration,
    TruthDepth,
    Odom,
    Tf,
    Map,
    Path,
    Depth,
    Goal,
    Events,
    Decision,
    Snapshot,
}

impl Topic {
    pub(super) const COUNT: usize = Self::Snapshot as usize + 1;

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Header => "/robot/header",
            Self::Tick => "/robot/tick",
            Self::Scan => "/scan",
            Self::Image => "/camera/image",
            Self::Calibration => "/camera/calibration",
            Self::TruthDepth => "/camera/truth_depth",
            Self::Odom => "/odom",
            Self::Tf => "/tf",
            Self::Map => "/map",
            Self::Path => "/path",
            Self::Depth => "/depth",
            Self::Goal => "/goal",
            Self::Events => "/events",
            Self::Decision => "/robot/decision",
            Self::Snapshot => "/robot/snapshot",
        }
    }

    /// The channels that replay reads; the others are for viewers.
    pub(super) fn of_replay(name: &str) -> Option<Self> {
        use Topic::{Decision, Header, Image, Scan, Snapshot, Tick, TruthDepth};
        [Header, Tick, Snapshot, Scan, Image, TruthDepth, Decision]
            .into_iter()
            .find(|topic| topic.name() == name)
    }

    /// Encoding of the channel's messages.
    pub(super) fn encoding(self) -> &'static str {
        match self {
            Self::Header | Self::Tick | Self::Decision => "json",
            Self::Snapshot => "postcard",
            _ => "protobuf",
        }
    }

    /// `None` for a layout that other programs need not read.
    pub(super) fn schema(self) -> Option<Schema> {
        match self {
            Self::Snapshot => None,
            Self::Header => Some(json_schema("robot.Header", HEADER)),
            Self::Tick => Some(json_schema("robot.Tick", TICK)),
            Self::Decision => Some(json_schema("robot.Decision", DECISION)),
            Self::Scan => fox::LaserScan::get_schema(),
            Self::Image => fox::CompressedImage::get_schema(),
            Self::Calibration => fox::CameraCalibration::get_schema(),
            Self::TruthDepth | Self::Depth => fox::RawImage::get_schema(),
            Self::Odom | Self::Goal => fox::PoseInFrame::get_schema(),
            Self::Tf => fox::FrameTransforms::get_schema(),
            Self::Map => fox::Grid::get_schema(),
            Self::Path => fox::PosesInFrame::get_schema(),
            Self::Events => fox::Log::get_schema(),
        }
    }
}

fn json_schema(name: &str, text: &'static str) -> Schema {
    Schema::new(name, "jsonschema", Cow::Borrowed(text.as_bytes()))
}

const HEADER: &str = r#"{"title":"robot.Header","type":"object","properties":{
"format_version":{"type":"integer"},"segment":{"type":"integer"},"first_tick":{"type":"integer"},
"first_time_ns":{"type":"integer"},"zero_unix_ns":{"type":"integer"},
"run":{"type":"object","properties":{
"written_by":{"type":"string"},"seed":{"type":"integer"},"scene":{"type":"string"},
"policy":{"type":"string"},"depth_source":{"type":"string"},"model_digest":{"type":"string"},"hand_over":{"type":"object"},
"camera":{"type":"object","properties":{}},"t_base_camera":{"type":"object","properties":{}},
"t_base_laser":{"type":"object","properties":{}},"config":{"type":"object","properties":{}}}}}}"#;

const TICK: &str = r#"{"title":"robot.Tick","type":"object","properties":{
"tick":{"type":"integer"},"time_ns":{"type":"integer"},
"wheel":{"type":"object","properties":{
"time_ns":{"type":"integer"},"x_m":{"type":"number"},"y_m":{"type":"number"},
"yaw_rad":{"type":"number"},"linear_mps":{"type":"number"},"angular_radps":{"type":"number"},
"contact":{"type":"boolean"},"cliff":{"type":"boolean"}}},
"scan":{"type":"object","properties":{"time_ns":{"type":"integer"},"angle_min_rad":{"type":"number"},
"angle_increment_rad":{"type":"number"},"beams":{"type":"integer"},"range_min_m":{"type":"number"},
"range_max_m":{"type":"number"},"period_ns":{"type":"integer"},"clockwise":{"type":"boolean"}}},
"frame":{"type":"boolean"},"truth":{"type":"boolean"},"decision":{"type":"boolean"},"snapshot":{"type":"boolean"},
"safety":{"type":"object","properties":{"in_charge":{"type":"boolean"},
"blocked_m":{"type":"array","items":{"type":"number"}},"unseen_m":{"type":"array","items":{"type":"number"}},"events":{"type":"array","items":{}},
"sent":{"type":"array","items":{"type":"object","properties":{"time_ns":{"type":"integer"},"counter":{"type":"integer"},
"linear_mps":{"type":"number"},"angular_radps":{"type":"number"}}}},"sent_dropped":{"type":"integer"}}},
"scan_odom":{"type":"object","properties":{"x_m":{"type":"number"},"y_m":{"type":"number"},"yaw_rad":{"type":"number"}}},
"imu":{"type":"object","properties":{"gaps":{"type":"integer"},"yaw_rad":{"type":"number"},
"yaw_at_scan_rad":{"type":"number"},"tilt_rad":{"type":"number"}}}}}"#;

const DECISION: &str = r#"{"title":"robot.Decision","type":"object","properties":{"tick":{"type":"integer"},
"time_ns":{"type":"integer"},
"desired":{"type":"object","properties":{"linear_mps":{"type":"number"},"angular_radps":{"type":"number"}}},
"sent":{"type":"object","properties":{"linear_mps":{"type":"number"},"angular_radps":{"type":"number"}}},
"goal_m":{"type":"array","items":{"type":"number"}},
"t_odom_base":{"type":"object","properties":{"x_m":{"type":"number"},"y_m":{"type":"number"},"yaw_rad":{"type":"number"}}},
"t_map_odom":{"type":"object","properties":{"x_m":{"type":"number"},"y_m":{"type":"number"},"yaw_rad":{"type":"number"}}},
"lost":{"type":"string"},
"events":{"type":"array","items":{"type":"object","properties":{"event":{"type":"string"}}}},
"input_digest":{"type":"integer"},"depth_digest":{"type":"integer"},"map_digest":{"type":"integer"}}}"#;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn our_json_schemas_are_json_objects() {
        for text in [HEADER, TICK, DECISION] {
            let value: serde_json::Value = serde_json::from_str(text).unwrap();
            assert_eq!(value["type"], "object");
            assert!(value["title"].as_str().unwrap().starts_with("robot."));
        }
    }

    #[test]
    fn replay_reads_what_it_needs_and_nothing_else() {
        assert_eq!(Topic::of_replay("/robot/tick"), Some(Topic::Tick));
        assert_eq!(Topic::of_replay("/map"), None);
        assert_eq!(Topic::of_replay("/cmd_vel"), None);
    }
}
