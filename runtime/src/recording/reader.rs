//! Reads the ticks of a recording.

use std::io::Read;

use foxglove::{Decode, messages as fox};
use hal::{DepthMap, LaserScan, Pose2, WheelFeedback};
use mcap::McapError;

use super::container::Messages;
use super::header::{FORMAT_VERSION, SegmentHeader};
use super::tick::{RecordedTick, RgbImage};
use super::topics::Topic;
use super::writer::TickJson;
use super::{RecordingError, image, scan};
use crate::imu::ImuInput;
use crate::outside_pose::OutsideInput;
use crate::tick::Decision;

/// Reads one segment tick by tick. On a stream without its end, the iterator returns the complete ticks, then one
/// [`Truncated`](RecordingError::Truncated), then `None`.
pub struct RecordingReader<R: Read> {
    messages: Messages<R>,
    header: SegmentHeader,
    last_tick: Option<u64>,
    done: bool,
}

impl<R: Read> RecordingReader<R> {
    /// Opens a segment and reads its header.
    ///
    /// # Errors
    /// When the stream is not MCAP, not a recording of this program's format, or truncated before its first complete
    /// chunk.
    pub fn open(source: R) -> Result<Self, RecordingError> {
        let mut messages = Messages::new(source);
        let header = match messages.next() {
            Ok(Some(message)) if message.topic == Topic::Header.name() => {
                parse_header(&message.data)?
            }
            Ok(_) => return Err(RecordingError::MissingHeader { topic: Topic::Header.name() }),
            Err(McapError::BadMagic) => return Err(RecordingError::NotMcap),
            Err(error) => return Err(RecordingError::reading(error, None)),
        };
        Ok(Self { messages, header, last_tick: None, done: false })
    }

    /// The segment's header.
    #[must_use]
    pub fn header(&self) -> &SegmentHeader {
        &self.header
    }

    /// The next tick with all of its parts, or `None` at the end of the stream.
    fn next_tick(&mut self) -> Result<Option<RecordedTick>, RecordingError> {
        let mut open: Option<Parts> = None;
        loop {
            let message = self
                .messages
                .next()
                .map_err(|error| RecordingError::reading(error, self.last_tick))?;
            let Some(message) = message else {
                return open.map_or(Ok(None), |parts| Err(parts.missing()));
            };
            match (Topic::of_replay(&message.topic), &mut open) {
                (Some(Topic::Tick), Some(parts)) => return Err(parts.missing()),
                (Some(Topic::Tick), None) => {
                    open = Some(Parts::new(self.parse_tick(&message.data)?));
                }
                (Some(topic), Some(parts)) => parts.add(topic, &message.data)?,
                // Channels for viewers, and channels that other tools have added.
                _ => {}
            }
            if let Some(parts) = open.take_if(|parts| parts.first_missing().is_none()) {
                self.last_tick = Some(parts.json.tick);
                return Ok(Some(parts.into_tick()));
            }
        }
    }

    fn parse_tick(&self, data: &[u8]) -> Result<TickJson, RecordingError> {
        let next = self.last_tick.map_or(self.header.first_tick, |tick| tick.saturating_add(1));
        let json: TickJson =
            serde_json::from_slice(data).map_err(|error| bad_message(next, Topic::Tick, &error))?;
        match self.last_tick {
            Some(previous) if json.tick <= previous => {
                Err(RecordingError::TickOrder { previous, found: json.tick })
            }
            _ => Ok(json),
        }
    }
}

impl<R: Read> Iterator for RecordingReader<R> {
    type Item = Result<RecordedTick, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.done {
            return None;
        }
        let item = self.next_tick().transpose();
        self.done = !matches!(item, Some(Ok(_)));
        item
    }
}

/// The messages of a tick that have been read so far.
struct Parts {
    json: TickJson,
    scan: Option<LaserScan>,
    frame: Option<RgbImage>,
    truth: Option<DepthMap>,
    decision: Option<Decision>,
    snapshot: Option<Vec<u8>>,
}

impl Parts {
    fn new(json: TickJson) -> Self {
        Self { json, scan: None, frame: None, truth: None, decision: None, snapshot: None }
    }

    fn add(&mut self, topic: Topic, data: &[u8]) -> Result<(), RecordingError> {
        let tick = self.json.tick;
        self.read(topic, data).map_err(|detail| bad_message(tick, topic, &detail))
    }

    fn read(&mut self, topic: Topic, data: &[u8]) -> Result<(), String> {
        match topic {
            Topic::Snapshot => self.snapshot = Some(data.to_vec()),
            Topic::Scan => self.scan = Some(self.parse_scan(data)?),
            Topic::Image => {
                let message =
                    fox::CompressedImage::decode(data).map_err(|error| error.to_string())?;
                self.frame = Some(image::decode_png(&message.data)?);
            }
            Topic::TruthDepth => {
                let message = fox::RawImage::decode(data).map_err(|error| error.to_string())?;
                self.truth = Some(image::decode_depth(&message)?);
            }
            Topic::Decision => {
                self.decision =
                    Some(serde_json::from_slice(data).map_err(|error| error.to_string())?);
            }
            _ => {}
        }
        Ok(())
    }

    fn parse_scan(&self, data: &[u8]) -> Result<LaserScan, String> {
        let json = self.json.scan.as_ref().ok_or("the message on /robot/tick has no scan")?;
        let message = fox::LaserScan::decode(data).map_err(|error| error.to_string())?;
        let ranges = message.ranges.iter().map(|number| {
            scan::decode(*number)
                .ok_or_else(|| format!("{number} is not a distance that this program writes"))
        });
        Ok(LaserScan {
            time_ns: json.time_ns,
            geometry: json.geometry(),
            ranges: ranges.collect::<Result<_, _>>()?,
        })
    }

    fn first_missing(&self) -> Option<Topic> {
        let parts = [
            (Topic::Scan, self.json.scan.is_some(), self.scan.is_some()),
            (Topic::Image, self.json.frame, self.frame.is_some()),
            (Topic::TruthDepth, self.json.truth, self.truth.is_some()),
            (Topic::Decision, self.json.decision, self.decision.is_some()),
            (Topic::Snapshot, self.json.snapshot, self.snapshot.is_some()),
        ];
        parts.into_iter().find(|(_, promised, here)| *promised && !here).map(|(topic, ..)| topic)
    }

    fn missing(&self) -> RecordingError {
        let topic = self.first_missing().unwrap_or(Topic::Tick).name();
        RecordingError::MissingPart { tick: self.json.tick, topic }
    }

    fn into_tick(self) -> RecordedTick {
        RecordedTick {
            tick: self.json.tick,
            time_ns: self.json.time_ns,
            wheel: WheelFeedback::from(&self.json.wheel),
            scan: self.scan,
            scan_odom: Pose2::from(&self.json.scan_odom),
            imu: self.json.imu.as_ref().map(ImuInput::from),
            outside: self.json.outside.as_ref().map(OutsideInput::from),
            frame: self.frame,
            truth: self.truth,
            task: self.json.task,
            areas: self.json.areas,
            orders: self.json.orders,
            decision: self.decision,
            snapshot: self.snapshot,
            safety: self.json.safety,
        }
    }
}

fn parse_header(data: &[u8]) -> Result<SegmentHeader, RecordingError> {
    // The version is read first, because a header of another format may lack this format's fields.
    let value: serde_json::Value =
        serde_json::from_slice(data).map_err(|error| bad_message(0, Topic::Header, &error))?;
    let found = value["format_version"].as_u64().unwrap_or(0);
    if found != u64::from(FORMAT_VERSION) {
        let written_by = value["run"]["written_by"].as_str().unwrap_or("unknown").to_owned();
        return Err(RecordingError::FormatVersion { found, supported: FORMAT_VERSION, written_by });
    }
    serde_json::from_value(value).map_err(|error| bad_message(0, Topic::Header, &error))
}

fn bad_message(tick: u64, topic: Topic, detail: &impl std::fmt::Display) -> RecordingError {
    RecordingError::BadMessage { tick, topic: topic.name(), detail: detail.to_string() }
}
