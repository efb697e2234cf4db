//! Writes ticks to MCAP.

use std::collections::BTreeMap;
use std::io::Write;

use foxglove::{Encode, messages as fox};
use mcap::records::MessageHeader;
use mcap::write::NoSeek;
use serde::{Deserialize, Serialize};

use super::event_log::EventLog;
use super::header::SegmentHeader;
use super::json::{ImuJson, OutsideJson, PoseJson, ScanJson, WheelJson};
use super::tick::RecordedTick;
use super::topics::Topic;
use super::views::{self, Views};
use super::{RecordingError, image};
use crate::operator::OperatorOrder;
use crate::task::{AreaChange, Task};
use crate::tick::{Decision, SafetyReport};

/// A chunk is closed when it holds this many bytes before compression, about one second of images at 10 Hz.
pub const CHUNK_BYTES: u64 = 4 << 20;

/// A chunk is closed when this much time has passed between its first and its last tick.
pub const CHUNK_NS: u64 = 1_000_000_000;

/// At negative levels zstd stores incompressible bytes, such as those of a PNG, without entropy coding. A minute of 640x480
/// images, scans and maps takes 0.4 of the time of level 1 and 3 % more space; images without noise take less of both. `mcap`
/// takes the level as an unsigned number and passes its bits to zstd unchanged.
const ZSTD_LEVEL: i32 = -1;

/// These bytes behind the last complete chunk make the stream a valid MCAP file without an index: an empty data-end record,
/// a footer without summary, and the magic (MCAP specification, "Data End", "Footer").
pub const END_WITHOUT_SUMMARY: [u8; 50] = {
    let mut bytes = [0; 50];
    bytes[0] = mcap::records::op::DATA_END;
    bytes[1] = 4;
    bytes[13] = mcap::records::op::FOOTER;
    bytes[14] = 20;
    let mut i = 0;
    while i < 8 {
        bytes[42 + i] = mcap::MAGIC[i];
        i += 1;
    }
    bytes
};

/// The first message of every tick: wheel feedback, the safety loop's report, and which other messages belong to the tick.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct TickJson {
    pub tick: u64,
    pub time_ns: u64,
    pub wheel: WheelJson,
    pub scan: Option<ScanJson>,
    pub scan_odom: PoseJson,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub imu: Option<ImuJson>,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub outside: Option<OutsideJson>,
    pub frame: bool,
    pub truth: bool,
    pub decision: bool,
    #[serde(skip_serializing_if = "std::ops::Not::not", default)]
    pub snapshot: bool,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub task: Option<Task>,
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub areas: Vec<AreaChange>,
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub orders: Vec<OperatorOrder>,
    pub safety: SafetyReport,
}

/// Writes one segment of a run. The sink receives whole chunks in order, and its `flush` is called after each chunk.
pub struct RecordingWriter<W: Write> {
    mcap: mcap::Writer<NoSeek<W>>,
    header: SegmentHeader,
    channels: [Option<u16>; Topic::COUNT],
    chunk_start_ns: Option<u64>,
    chunk_bytes: u64,
    last_goal_m: Option<[f64; 2]>,
    events: EventLog,
    buffer: Vec<u8>,
}

impl<W: Write> RecordingWriter<W> {
    /// Starts a segment and writes its header, in a chunk of its own.
    ///
    /// # Errors
    /// When the header holds numbers that are not finite or the sink fails.
    pub fn begin(sink: W, header: SegmentHeader) -> Result<Self, RecordingError> {
        let options = mcap::WriteOptions::new()
            .library(concat!("embodied-depth ", env!("CARGO_PKG_VERSION")))
            .compression(Some(mcap::Compression::Zstd))
            .compression_level(ZSTD_LEVEL.cast_unsigned())
            // With more than zero, zstd's blocks and hence the bytes depend on the number of threads.
            .compression_threads(0)
            // `write` closes chunks between ticks.
            .chunk_size(None)
            // A chunk is assembled in memory and written once.
            .disable_seeking(true);
        let mcap = options.create(NoSeek::new(sink)).map_err(RecordingError::writing)?;
        let mut writer = Self {
            mcap,
            channels: [None; Topic::COUNT],
            chunk_start_ns: None,
            chunk_bytes: 0,
            last_goal_m: None,
            events: EventLog::default(),
            buffer: Vec::new(),
            header,
        };
        let tick = writer.header.first_tick;
        let time_ns = writer.header.first_time_ns;
        let json = serde_json::to_vec(&writer.header)
            .map_err(|error| encode_error(tick, Topic::Header, &error))?;
        // A header that cannot be read back is refused now, not at replay.
        serde_json::from_slice::<SegmentHeader>(&json)
            .map_err(|error| encode_error(tick, Topic::Header, &error))?;
        writer.put(Topic::Header, tick, time_ns, &json)?;
        writer.flush()?;
        Ok(writer)
    }

    /// Writes a tick; closes the chunk when it is full.
    ///
    /// # Errors
    /// When a part cannot be recorded exactly (see [`RecordingError`]) or the sink fails. The writer must then be
    /// [abandoned](Self::abandon).
    pub fn write(&mut self, tick: &RecordedTick, views: &Views) -> Result<(), RecordingError> {
        self.put_inputs(tick)?;
        self.put_poses(tick)?;
        self.put_views(tick, views)?;
        if let Some(decision) = &tick.decision {
            self.put_decision(tick, decision)?;
        }
        let start_ns = *self.chunk_start_ns.get_or_insert(tick.time_ns);
        if self.chunk_bytes >= CHUNK_BYTES || tick.time_ns.saturating_sub(start_ns) >= CHUNK_NS {
            self.flush()?;
        }
        Ok(())
    }

    /// Closes the chunk and flushes the sink, so that every tick so far can be read even if the process is killed.
    ///
    /// # Errors
    /// When the sink fails.
    pub fn flush(&mut self) -> Result<(), RecordingError> {
        self.chunk_start_ns = None;
        self.chunk_bytes = 0;
        self.mcap.flush().map_err(RecordingError::writing)
    }

    /// Closes the chunk and writes a metadata record behind it: texts by their names, such as a signature of everything before it.
    ///
    /// # Errors
    /// When the sink fails.
    pub fn write_metadata(
        &mut self,
        name: &str,
        metadata: BTreeMap<String, String>,
    ) -> Result<(), RecordingError> {
        let metadata = mcap::records::Metadata { name: name.to_owned(), metadata };
        self.mcap.write_metadata(&metadata).map_err(RecordingError::writing)
    }

    /// Writes the index and the footer, and returns the sink.
    ///
    /// # Errors
    /// When the sink fails.
    pub fn finish(mut self) -> Result<W, (W, RecordingError)> {
        // Ticks are flushed before the index is written, so that they are kept when the index fails.
        let finished = self.mcap.flush().and_then(|()| self.mcap.finish());
        let sink = self.mcap.into_inner().into_inner();
        match finished {
            Ok(_) => Ok(sink),
            Err(error) => Err((sink, RecordingError::writing(error))),
        }
    }

    /// Returns the sink after it has failed, without writing to it again.
    pub fn abandon(self) -> W {
        self.mcap.into_inner().into_inner()
    }

    fn put_inputs(&mut self, tick: &RecordedTick) -> Result<(), RecordingError> {
        let json = TickJson {
            tick: tick.tick,
            time_ns: tick.time_ns,
            wheel: WheelJson::from(&tick.wheel),
            scan: tick.scan.as_ref().map(|scan| ScanJson::new(scan.time_ns, &scan.geometry)),
            scan_odom: PoseJson::from(&tick.scan_odom),
            imu: tick.imu.as_ref().map(ImuJson::from),
            outside: tick.outside.as_ref().map(OutsideJson::from),
            frame: tick.frame.is_some(),
            truth: tick.truth.is_some(),
            decision: tick.decision.is_some(),
            snapshot: tick.snapshot.is_some(),
            task: tick.task,
            areas: tick.areas.clone(),
            orders: tick.orders.clone(),
            safety: tick.safety.clone(),
        };
        let json = serde_json::to_vec(&json)
            .map_err(|error| encode_error(tick.tick, Topic::Tick, &error))?;
        self.put(Topic::Tick, tick.tick, tick.time_ns, &json)?;
        if let Some(snapshot) = &tick.snapshot {
            self.put(Topic::Snapshot, tick.tick, tick.time_ns, snapshot)?;
        }
        if let Some(scan) = &tick.scan {
            self.put_message(Topic::Scan, tick, &views::scan(scan, scan.time_ns))?;
        }
        if let Some(frame) = &tick.frame {
            let png = image::encode_png(frame)
                .map_err(|error| encode_error(tick.tick, Topic::Image, &error))?;
            let message = fox::CompressedImage {
                timestamp: views::timestamp(tick.time_ns),
                frame_id: "camera_optical".to_owned(),
                data: png.into(),
                format: "png".to_owned(),
            };
            self.put_message(Topic::Image, tick, &message)?;
            let calibration = views::calibration(&self.header.run.camera, tick.time_ns);
            self.put_message(Topic::Calibration, tick, &calibration)?;
        }
        if let Some(truth) = &tick.truth {
            if let Some((pixel, depth_m)) = image::first_not_mm(truth) {
                return Err(RecordingError::TruthNotMillimetres {
                    tick: tick.tick,
                    pixel,
                    depth_m,
                });
            }
            self.put_depth(Topic::TruthDepth, tick, truth)?;
        }
        Ok(())
    }

    fn put_poses(&mut self, tick: &RecordedTick) -> Result<(), RecordingError> {
        let run = &self.header.run;
        // A tick without decision has no localized pose.
        let decided = tick.decision.as_ref();
        let t_odom_base = decided.map_or(tick.wheel.odom, |decision| decision.t_odom_base);
        let t_map_odom = decided.map_or(hal::Pose2::IDENTITY, |decision| decision.t_map_odom);
        let transforms = views::transforms(
            &t_map_odom,
            &t_odom_base,
            &run.t_base_camera,
            &run.t_base_laser,
            tick.time_ns,
        );
        self.put_message(Topic::Tf, tick, &transforms)?;
        match views::pose_in("odom", &t_odom_base, tick.time_ns) {
            Some(pose) => self.put_message(Topic::Odom, tick, &pose),
            None => Ok(()),
        }
    }

    fn put_views(&mut self, tick: &RecordedTick, views: &Views) -> Result<(), RecordingError> {
        if let Some(map) = &views.map {
            let grid = views::grid(map, tick.time_ns)
                .map_err(|error| encode_error(tick.tick, Topic::Map, &error))?;
            self.put_message(Topic::Map, tick, &grid)?;
        }
        if let Some(points_m) = &views.path_m {
            self.put_message(Topic::Path, tick, &views::path(points_m, tick.time_ns))?;
        }
        if let Some(depth) = &views.depth {
            self.put_depth(Topic::Depth, tick, depth)?;
        }
        let Some(decision) = &tick.decision else { return Ok(()) };
        if let Some([x_m, y_m]) = decision.goal_m.filter(|goal_m| self.last_goal_m != Some(*goal_m))
        {
            let goal = hal::Pose2 { x_m, y_m, yaw_rad: 0.0 };
            if let Some(pose) = views::pose_in("map", &goal, tick.time_ns) {
                self.put_message(Topic::Goal, tick, &pose)?;
            }
        }
        self.last_goal_m = decision.goal_m;
        for message in self.events.messages(&decision.events, tick.time_ns) {
            self.put_message(Topic::Events, tick, &message)?;
        }
        Ok(())
    }

    fn put_depth(
        &mut self,
        topic: Topic,
        tick: &RecordedTick,
        depth: &hal::DepthMap,
    ) -> Result<(), RecordingError> {
        let mut message =
            image::depth_image(depth).map_err(|error| encode_error(tick.tick, topic, &error))?;
        message.timestamp = views::timestamp(tick.time_ns);
        "camera_optical".clone_into(&mut message.frame_id);
        self.put_message(topic, tick, &message)
    }

    fn put_decision(
        &mut self,
        tick: &RecordedTick,
        decision: &Decision,
    ) -> Result<(), RecordingError> {
        let json = serde_json::to_vec(decision)
            .map_err(|error| encode_error(tick.tick, Topic::Decision, &error))?;
        // JSON writes NaN as null, which is not read back as NaN.
        if serde_json::from_slice::<Decision>(&json).ok().as_ref() != Some(decision) {
            return Err(RecordingError::DecisionNotFinite { tick: tick.tick });
        }
        self.put(Topic::Decision, tick.tick, tick.time_ns, &json)
    }

    fn put_message(
        &mut self,
        topic: Topic,
        tick: &RecordedTick,
        message: &impl Encode,
    ) -> Result<(), RecordingError> {
        let mut buffer = std::mem::take(&mut self.buffer);
        buffer.clear();
        message.encode(&mut buffer).map_err(|error| encode_error(tick.tick, topic, &error))?;
        let written = self.put(topic, tick.tick, tick.time_ns, &buffer);
        self.buffer = buffer;
        written
    }

    fn put(
        &mut self,
        topic: Topic,
        tick: u64,
        time_ns: u64,
        data: &[u8],
    ) -> Result<(), RecordingError> {
        let channel_id = self.channel(topic)?;
        self.chunk_bytes += data.len() as u64;
        // The sequence is for viewers; the exact number of the tick is in `/robot/tick`.
        let header = MessageHeader {
            channel_id,
            sequence: tick as u32,
            log_time: time_ns,
            publish_time: time_ns,
        };
        self.mcap.write_to_known_channel(&header, data).map_err(RecordingError::writing)
    }

    fn channel(&mut self, topic: Topic) -> Result<u16, RecordingError> {
        if let Some(id) = self.channels[topic as usize] {
            return Ok(id);
        }
        // 0 means "no schema" (MCAP specification, "Channel").
        let schema_id = topic.schema().map_or(Ok(0), |schema| {
            self.mcap
                .add_schema(&schema.name, &schema.encoding, &schema.data)
                .map_err(RecordingError::writing)
        })?;
        let id = self
            .mcap
            .add_channel(schema_id, topic.name(), topic.encoding(), &BTreeMap::new())
            .map_err(RecordingError::writing)?;
        self.channels[topic as usize] = Some(id);
        Ok(id)
    }
}

fn encode_error(tick: u64, topic: Topic, detail: &impl std::fmt::Display) -> RecordingError {
    RecordingError::Encode { tick, topic: topic.name(), detail: detail.to_string() }
}
