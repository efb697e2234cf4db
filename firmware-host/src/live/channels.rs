//! The channels of the live view: those of a recording under the same names, and two of its own.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use foxglove::{Encode, messages as fox};
use live_link::Channel;

/// A channel of the live view, by what it shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Topic {
    /// State of the robot, after every tick.
    Now,
    /// What `firmware-host health` shows, twice a second.
    Health,
    Tf,
    Pose,
    Scan,
    Map,
    Path,
    Goal,
    Camera,
    Calibration,
    Depth,
    Events,
    KeepOut,
}

impl Topic {
    /// All of them, in the order of their numbers.
    pub const ALL: [Self; 13] = [
        Self::Now,
        Self::Health,
        Self::Tf,
        Self::Pose,
        Self::Scan,
        Self::Map,
        Self::Path,
        Self::Goal,
        Self::Camera,
        Self::Calibration,
        Self::Depth,
        Self::Events,
        Self::KeepOut,
    ];

    /// The channel's number.
    pub fn id(self) -> u16 {
        self as u16
    }

    /// The topic's bit in a set of topics.
    pub fn bit(self) -> u32 {
        1 << self as u32
    }

    fn name(self) -> &'static str {
        match self {
            Self::Now => "/robot/now",
            Self::Health => "/robot/health",
            Self::Tf => "/tf",
            Self::Pose => "/pose",
            Self::Scan => "/scan",
            Self::Map => "/map",
            Self::Path => "/path",
            Self::Goal => "/goal",
            Self::Camera => "/camera/image",
            Self::Calibration => "/camera/calibration",
            Self::Depth => "/depth/image",
            Self::Events => "/events",
            Self::KeepOut => "/keep_out",
        }
    }

    /// The description of the channel that clients receive.
    pub fn channel(self) -> Channel {
        let schema = match self {
            Self::Now => return self.json("robot.Now", NOW),
            Self::Health => return self.json("robot.Health", HEALTH),
            Self::Tf => fox::FrameTransforms::get_schema(),
            Self::Pose | Self::Goal => fox::PoseInFrame::get_schema(),
            Self::Scan => fox::LaserScan::get_schema(),
            Self::Map => fox::Grid::get_schema(),
            Self::Path => fox::PosesInFrame::get_schema(),
            Self::Camera | Self::Depth => fox::CompressedImage::get_schema(),
            Self::Calibration => fox::CameraCalibration::get_schema(),
            Self::Events => fox::Log::get_schema(),
            Self::KeepOut => fox::SceneUpdate::get_schema(),
        };
        let (name, data) =
            schema.map_or_else(Default::default, |schema| (schema.name, schema.data));
        Channel {
            id: self.id(),
            topic: self.name().to_owned(),
            encoding: "protobuf".to_owned(),
            schema_name: name,
            schema_encoding: "protobuf".to_owned(),
            schema: STANDARD.encode(data),
        }
    }

    fn json(self, schema_name: &str, schema: &str) -> Channel {
        Channel {
            id: self.id(),
            topic: self.name().to_owned(),
            encoding: "json".to_owned(),
            schema_name: schema_name.to_owned(),
            schema_encoding: "jsonschema".to_owned(),
            schema: schema.to_owned(),
        }
    }
}

const NOW: &str = r#"{"title":"robot.Now","type":"object","properties":{
"tick":{"type":"integer"},"run_s":{"type":"number"},"plane":{"type":"string"},
"stands":{"type":"boolean"},"needs_person":{"type":"boolean"},"why":{"type":"string"},
"x_m":{"type":"number"},"y_m":{"type":"number"},"yaw_deg":{"type":"number"},
"position_std_m":{"type":"number"},"yaw_std_deg":{"type":"number"},
"goal":{"type":"object","properties":{"x_m":{"type":"number"},"y_m":{"type":"number"},"why":{"type":"string"}}},
"linear_mps":{"type":"number"},"angular_radps":{"type":"number"},
"most_mps":{"type":"number"},"most_radps":{"type":"number"},
"tick_ms":{"type":"number"},"dropped":{"type":"integer"}}}"#;

const HEALTH: &str = r#"{"title":"robot.Health","type":"object","properties":{
"uptime_s":{"type":"number"},"disk_free_gib":{"type":"number"},
"safety":{"type":"object","properties":{"state":{"type":"string"},"for_s":{"type":"number"},"stops":{"type":"integer"},
"worst_late_us":{"type":"number"}}},
"power":{"type":"object","properties":{"voltage_v":{"type":"number"},"current_a":{"type":"number"},
"temperature_c":{"type":"number"}}},
"exploration":{"type":"object","properties":{"ticks":{"type":"integer"},"skipped":{"type":"integer"},
"tick_p50_ms":{"type":"number"},"tick_p99_ms":{"type":"number"},"mapped_m2":{"type":"number"}}},
"recording":{"type":"object","properties":{"folder":{"type":"string"},"dropped":{"type":"integer"},
"failure":{"type":"string"}}}}}"#;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_channel_has_a_schema_and_its_place_is_its_number() {
        for (at, topic) in Topic::ALL.into_iter().enumerate() {
            let channel = topic.channel();
            assert_eq!(usize::from(channel.id), at);
            assert!(channel.topic.starts_with('/') && !channel.schema.is_empty());
            if channel.encoding == "json" {
                let schema: serde_json::Value = serde_json::from_str(&channel.schema).unwrap();
                assert_eq!(schema["title"], channel.schema_name);
            }
        }
    }

    /// Topics that the layout shows: keys and values that begin with a slash. A plot's path goes on with fields after a dot.
    fn topics_in(layout: &serde_json::Value, found: &mut Vec<String>) {
        match layout {
            serde_json::Value::String(text) => note_topic(text, found),
            serde_json::Value::Array(values) => {
                values.iter().for_each(|value| topics_in(value, found));
            }
            serde_json::Value::Object(values) => {
                values.keys().for_each(|key| note_topic(key, found));
                values.values().for_each(|value| topics_in(value, found));
            }
            _ => {}
        }
    }

    fn note_topic(text: &str, found: &mut Vec<String>) {
        let topic = text.split('.').next().filter(|text| text.starts_with('/'));
        found.extend(topic.map(str::to_owned));
    }

    #[test]
    fn every_topic_that_the_foxglove_layout_shows_is_a_channel() {
        let mut layout = live_view::layout();
        let panels = layout["configById"].as_object_mut().unwrap();
        // What the layout sends: orders, places and velocities.
        panels.retain(|id, _| !id.starts_with("CallService!") && !id.starts_with("Teleop!"));
        panels["3D!map"]["publish"].take();
        let mut named = Vec::new();
        topics_in(&layout, &mut named);
        assert!(named.len() >= Topic::ALL.len(), "{named:?}");
        for topic in named {
            assert!(Topic::ALL.iter().any(|known| known.name() == topic), "{topic}");
        }
    }
}
