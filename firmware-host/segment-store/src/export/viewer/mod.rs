//! Export of a run for Foxglove and Rerun: one MCAP file with dates instead of the robot's monotonic times, and with messages that
//! both viewers draw.
//!
//! The robot does not record these messages, because they follow from the others: its recordings stay small, and older ones can be
//! exported as well.

mod draw;
mod poses;

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

use foxglove::{Decode, Encode, messages as fox};
use mcap::McapError;
use mcap::records::MessageHeader;
use nalgebra::Point3;
use runtime::recording::messages::timestamp;
use serde::Deserialize;

use self::poses::Poses;
use super::dates::Dates;
use super::ticks::{check_order, no_tick};
use crate::error::StoreError;
use crate::recover::{Output, Recorded, Recovered, Rewriter, failure, write_new};

/// Heights above the map at which paths are drawn, so that none hides another, metres.
const PATH_HEIGHT_M: f64 = 0.02;
const TRACK_HEIGHT_M: f64 = 0.04;
const GOAL_HEIGHT_M: f64 = 0.06;
const ROBOT_HEIGHT_M: f64 = 0.08;

/// The counts of an export.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct ViewerSummary {
    /// The number of messages of all topics.
    pub messages: u64,
    /// The number of ticks of the control loop.
    pub ticks: u64,
    /// The number of messages that were left out because they do not have the content of their topic, or nothing defines their
    /// channel.
    pub unreadable: u64,
    /// The number of chunks that were left out because they are damaged.
    pub bad_chunks: u64,
    /// The number of segments that end early.
    pub cut: u64,
    /// Whether the dates are from the recording. Otherwise the run begins when its first file was written.
    pub dated: bool,
}

/// Exports the run that consists of `segments`, in this order, into the new file `to`.
///
/// # Errors
/// When a segment is not an MCAP file, the segments are out of order or have no tick, or `to` exists already or cannot be
/// written.
pub fn viewer(segments: &[PathBuf], to: &Path) -> Result<ViewerSummary, StoreError> {
    check_order(segments)?;
    let dates = Dates::of(segments)?;
    write_new(to, |sink| {
        let mut rewriter = Rewriter::begin(sink).map_err(|error| failure(error, to, to))?;
        let mut shown = Shown::new(dates);
        for segment in segments {
            let file = File::open(segment).map_err(StoreError::read(segment))?;
            rewriter
                .add_edited(&file, &mut |out, message| shown.add(out, &message))
                .map_err(|error| failure(error, segment, to))?;
        }
        let (_, read) = rewriter.finish().map_err(|error| failure(error, to, to))?;
        if read.ticks == 0 { Err(no_tick(segments)) } else { Ok(shown.summary(&read)) }
    })
}

/// Exports one segment in memory, with the times of the run's clock as dates.
///
/// # Errors
/// When `segment` is not an MCAP file, or `sink` cannot be written.
pub fn viewer_of_bytes<W: Write>(segment: &[u8], sink: W) -> Result<ViewerSummary, McapError> {
    let mut rewriter = Rewriter::begin(sink)?;
    let mut shown = Shown::new(Dates::default());
    rewriter.add_edited(segment, &mut |out, message| shown.add(out, &message))?;
    let (_, read) = rewriter.finish()?;
    Ok(shown.summary(&read))
}

/// The run as viewers show it.
struct Shown {
    dates: Dates,
    /// The channels of the added messages.
    channels: BTreeMap<&'static str, u16>,
    poses: Poses,
    /// A scan that waits for the pose of its tick.
    scan: Option<fox::LaserScan>,
    /// When the scanner was halfway through it.
    taken_ns: Option<u64>,
    done: ViewerSummary,
}

impl Shown {
    fn new(dates: Dates) -> Self {
        Self {
            dates,
            channels: BTreeMap::new(),
            poses: Poses::default(),
            scan: None,
            taken_ns: None,
            done: ViewerSummary { dated: dates.recorded, ..ViewerSummary::default() },
        }
    }

    /// The counts, with those of the reader.
    fn summary(&self, read: &Recovered) -> ViewerSummary {
        ViewerSummary {
            ticks: read.ticks,
            unreadable: self.done.unreadable + read.unknown_messages,
            bad_chunks: read.bad_chunks,
            cut: read.cut,
            ..self.done
        }
    }

    fn add<W: Write>(
        &mut self,
        out: &mut Output<W>,
        message: &Recorded<'_>,
    ) -> Result<(), McapError> {
        let time_ns = message.header.log_time;
        match message.topic {
            // The robot's memory is of no use to a viewer, and ten times larger than anything else.
            "/robot/snapshot" => Ok(()),
            "/camera/image" => self.copy::<fox::CompressedImage, _>(out, message).map(drop),
            "/camera/calibration" => self.copy::<fox::CameraCalibration, _>(out, message).map(drop),
            "/camera/truth_depth" => self.copy::<fox::RawImage, _>(out, message).map(drop),
            "/odom" => self.copy::<fox::PoseInFrame, _>(out, message).map(drop),
            "/events" => self.copy::<fox::Log, _>(out, message).map(drop),
            "/robot/tick" => {
                let tick: Option<TickTimes> = serde_json::from_slice(message.data).ok();
                self.taken_ns = tick.and_then(|tick| tick.scan).map(ScanTimes::middle_ns);
                self.write(out, message.header.channel_id, time_ns, message.data)
            }
            "/scan" => {
                self.scan = self.copy::<fox::LaserScan, _>(out, message)?;
                Ok(())
            }
            "/tf" => self.add_transforms(out, message),
            "/map" => {
                let Some(grid) = self.copy::<fox::Grid, _>(out, message)? else { return Ok(()) };
                draw::voxels(&grid)
                    .map_or(Ok(()), |voxels| self.put(out, "/map/voxels", time_ns, &voxels))
            }
            "/depth" => {
                let Some(depth) = self.copy::<fox::RawImage, _>(out, message)? else {
                    return Ok(());
                };
                draw::colored(&depth)
                    .map_or(Ok(()), |image| self.put(out, "/depth/color", time_ns, &image))
            }
            "/path" => {
                let Some(path) = self.copy::<fox::PosesInFrame, _>(out, message)? else {
                    return Ok(());
                };
                let along = draw::along(&path, PATH_HEIGHT_M);
                let points = draw::points(path.timestamp, &along, draw::BLUE);
                self.put(out, "/path/points", time_ns, &points)
            }
            "/goal" => {
                let Some(goal) = self.copy::<fox::PoseInFrame, _>(out, message)? else {
                    return Ok(());
                };
                let at = goal.pose.and_then(|pose| pose.position);
                let at = at.map(|at| Point3::new(at.x, at.y, GOAL_HEIGHT_M));
                let points = draw::points(goal.timestamp, at.as_slice(), draw::PURPLE);
                self.put(out, "/goal/points", time_ns, &points)
            }
            // Numbers in JSON, and channels of other programs.
            _ => self.write(out, message.header.channel_id, time_ns, message.data),
        }
    }

    /// Writes the transforms of a tick, the robot's place, and the scan that waits for them.
    fn add_transforms<W: Write>(
        &mut self,
        out: &mut Output<W>,
        message: &Recorded<'_>,
    ) -> Result<(), McapError> {
        let time_ns = message.header.log_time;
        let Ok(mut transforms) = fox::FrameTransforms::decode(message.data) else {
            self.done.unreadable += 1;
            return Ok(());
        };
        self.poses.take(&transforms, time_ns);
        for transform in &mut transforms.transforms {
            transform.timestamp = self.date(transform.timestamp);
        }
        self.write(out, message.header.channel_id, time_ns, &encoded(&transforms)?)?;
        if let Some(t_map_base) = self.poses.t_map_base() {
            let at = t_map_base.translation.vector;
            let at = [Point3::new(at.x, at.y, TRACK_HEIGHT_M)];
            let stamp = timestamp(self.dates.unix_ns(time_ns));
            self.put(out, "/track/points", time_ns, &draw::points(stamp, &at, draw::SKY))?;
            let mark = draw::robot(&t_map_base, ROBOT_HEIGHT_M);
            self.put(out, "/robot/points", time_ns, &draw::points(stamp, &mark, draw::ORANGE))?;
        }
        let Some(scan) = self.scan.take() else { return Ok(()) };
        let taken_ns = self.taken_ns.take().unwrap_or(time_ns);
        let Some(t_map_laser) = self.poses.t_map_laser(taken_ns) else { return Ok(()) };
        let hits: Vec<_> = draw::hits(&scan).iter().map(|hit| t_map_laser * hit).collect();
        let points = draw::points(scan.timestamp, &hits, draw::VERMILION);
        self.put(out, "/scan/points", time_ns, &points)
    }

    /// Writes a message of the recording with the date of its content, and returns it. A message that does not have the content of
    /// its topic is left out.
    fn copy<M: Stamped, W: Write>(
        &mut self,
        out: &mut Output<W>,
        message: &Recorded<'_>,
    ) -> Result<Option<M>, McapError> {
        let Ok(mut content) = M::decode(message.data) else {
            self.done.unreadable += 1;
            return Ok(None);
        };
        let dated = self.date(*content.stamp());
        *content.stamp() = dated;
        self.write(out, message.header.channel_id, message.header.log_time, &encoded(&content)?)?;
        Ok(Some(content))
    }

    /// Writes an added message.
    fn put<M: Encode, W: Write>(
        &mut self,
        out: &mut Output<W>,
        topic: &'static str,
        time_ns: u64,
        content: &M,
    ) -> Result<(), McapError> {
        let channel = match self.channels.get(topic) {
            Some(channel) => *channel,
            None => {
                let schema = M::get_schema().map_or(Ok(0), |schema| {
                    out.add_schema(&schema.name, &schema.encoding, &schema.data)
                })?;
                let encoding = M::get_message_encoding();
                let channel = out.add_channel(schema, topic, &encoding, &BTreeMap::new())?;
                self.channels.insert(topic, channel);
                channel
            }
        };
        self.write(out, channel, time_ns, &encoded(content)?)
    }

    fn write<W: Write>(
        &mut self,
        out: &mut Output<W>,
        channel_id: u16,
        time_ns: u64,
        data: &[u8],
    ) -> Result<(), McapError> {
        let date_ns = self.dates.unix_ns(time_ns);
        // Viewers do not use the sequence.
        let header =
            MessageHeader { channel_id, sequence: 0, log_time: date_ns, publish_time: date_ns };
        self.done.messages += 1;
        out.write_to_known_channel(&header, data)
    }

    fn date(&self, recorded: Option<fox::Timestamp>) -> Option<fox::Timestamp> {
        timestamp(self.dates.unix_ns(recorded?.total_nanos()))
    }
}

fn encoded(content: &impl Encode) -> Result<Vec<u8>, McapError> {
    let mut bytes = Vec::with_capacity(content.encoded_len().unwrap_or(0));
    content
        .encode(&mut bytes)
        .map_err(|error| McapError::Io(std::io::Error::other(error.to_string())))?;
    Ok(bytes)
}

/// What `/robot/tick` says about the times of a tick's scan.
#[derive(Deserialize)]
struct TickTimes {
    #[serde(default)]
    scan: Option<ScanTimes>,
}

#[derive(Deserialize)]
struct ScanTimes {
    time_ns: u64,
    period_ns: u64,
}

impl ScanTimes {
    fn middle_ns(self) -> u64 {
        self.time_ns.saturating_add(self.period_ns / 2)
    }
}

/// A message with the time of its content.
trait Stamped: Encode + Decode {
    fn stamp(&mut self) -> &mut Option<fox::Timestamp>;
}

macro_rules! stamped {
    ($($message:ident),+) => {$(
        impl Stamped for fox::$message {
            fn stamp(&mut self) -> &mut Option<fox::Timestamp> {
                &mut self.timestamp
            }
        }
    )+};
}

stamped!(
    CameraCalibration,
    CompressedImage,
    Grid,
    LaserScan,
    Log,
    PoseInFrame,
    PosesInFrame,
    RawImage
);
