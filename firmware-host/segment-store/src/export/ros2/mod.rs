//! Export as a ROS 2 bag: a directory with `metadata.yaml` and one MCAP file, readable by `ros2 bag play`, rviz and the `rosbags`
//! package.
//!
//! Recordings are MCAP files as well, but with Foxglove's message types, which ROS does not define.

mod cdr;
mod messages;
mod topics;

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs::File;
use std::io::{BufWriter, ErrorKind};
use std::path::{Path, PathBuf};

use hal::{Pose2, Pose3};
use mcap::records::MessageHeader;
use mcap::{Compression, McapError, WriteOptions, Writer};
use runtime::recording::{RecordedTick, SegmentHeader};

use self::messages::{Stamp, Transform};
use self::topics::Topic;
use super::dates::Dates;
use super::folder::new_folder;
use super::maps::{Map, maps};
use super::ticks::{check_order, each_tick, no_tick};
use crate::error::StoreError;
use crate::recover::failure;

/// The counts of an export.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RosbagSummary {
    /// The number of messages of all topics.
    pub messages: u64,
    /// The number of images among them.
    pub images: u64,
    /// The number of laser scans among them.
    pub scans: u64,
    /// The number of maps among them.
    pub maps: u64,
    /// The number of ticks without a pose, for which the bag has neither odometry nor a transform.
    pub without_pose: u64,
    /// The number of segments that end early; their complete ticks are exported.
    pub cut: u64,
    /// Whether the dates are from the recording. Otherwise the run begins when its first file was written.
    pub dated: bool,
}

/// Exports the run that consists of `segments`, in this order, as a bag into the new directory `to`: images, calibration, scans,
/// odometry, transforms, maps and decisions. Times are dates: a time of zero, at which a simulation begins, means "the latest" to TF.
///
/// # Errors
/// When `to` exists already or cannot be written, a segment is not a recording, or the segments are out of order or have no tick.
pub fn ros2(segments: &[PathBuf], to: &Path) -> Result<RosbagSummary, StoreError> {
    check_order(segments)?;
    let name = format!("{}_0.mcap", to.file_name().unwrap_or_default().to_string_lossy());
    new_folder(to, |dir| {
        let path = dir.join(&name);
        let dates = Dates::of(segments)?;
        let mut bag = Bag::begin(&path, dates).map_err(|error| failure(error, &path, to))?;
        for segment in segments {
            bag.maps = maps(segment)?;
            let one = std::slice::from_ref(segment);
            bag.bagged.cut += each_tick(one, |header, tick| {
                bag.tick(header, tick).map_err(|error| tick_error(error, segment, to))
            })?;
        }
        if bag.bagged.messages == 0 {
            return Err(no_tick(segments));
        }
        let (bagged, metadata) = bag.finish(&name).map_err(|error| failure(error, &path, to))?;
        let path = dir.join("metadata.yaml");
        std::fs::write(&path, metadata).map_err(StoreError::output(path))?;
        Ok(bagged)
    })
}

struct Bag {
    dates: Dates,
    /// The maps of the present segment that are not written yet, by the time of their tick.
    maps: BTreeMap<u64, Map>,
    mcap: Writer<BufWriter<File>>,
    /// The channel id and the message count of each topic that has messages.
    channels: [Option<(u16, u64)>; Topic::ALL.len()],
    /// The times of the first and the last message.
    times_ns: Option<(u64, u64)>,
    /// The time of the wheel feedback that was written last.
    wheel_ns: Option<u64>,
    bagged: RosbagSummary,
}

impl Bag {
    fn begin(path: &Path, dates: Dates) -> Result<Self, McapError> {
        let options = WriteOptions::new()
            .profile("ros2")
            .library(concat!("embodied-depth ", env!("CARGO_PKG_VERSION")))
            .compression(Some(Compression::Zstd))
            .compression_level(1);
        let mcap = options.create(BufWriter::new(File::create_new(path)?))?;
        let channels = [None; Topic::ALL.len()];
        Ok(Self {
            dates,
            maps: BTreeMap::new(),
            mcap,
            channels,
            times_ns: None,
            wheel_ns: None,
            bagged: RosbagSummary { dated: dates.recorded, ..RosbagSummary::default() },
        })
    }

    fn tick(&mut self, header: &SegmentHeader, tick: &RecordedTick) -> Result<(), McapError> {
        let at_ns = self.dates.unix_ns(tick.time_ns);
        let stamp = ros_time(at_ns)?;
        if self.times_ns.is_none() {
            let mounts = [
                mount(stamp, "camera_optical", header.run.t_base_camera),
                mount(stamp, "laser", header.run.t_base_laser),
            ];
            self.put(Topic::TfStatic, at_ns, &messages::transforms(&mounts))?;
        }
        if let Some(frame) = &tick.frame {
            self.put(Topic::Image, at_ns, &messages::image(stamp, frame))?;
            self.put(Topic::CameraInfo, at_ns, &messages::camera_info(stamp, &header.run.camera))?;
            self.bagged.images += 1;
        }
        if let Some(scan) = &tick.scan {
            let taken = ros_time(self.dates.unix_ns(scan.time_ns))?;
            self.put(Topic::Scan, at_ns, &messages::laser_scan(taken, scan))?;
            self.bagged.scans += 1;
        }
        if let Some(map) = self.maps.remove(&tick.time_ns) {
            self.put(Topic::Map, at_ns, &messages::occupancy_grid(stamp, &map))?;
            self.bagged.maps += 1;
        }
        if let Some(decision) = &tick.decision {
            self.put(Topic::Diagnostics, at_ns, &messages::diagnostics(stamp, decision))?;
        }
        self.wheel(tick)
    }

    /// Writes odometry only when the wheel feedback is new: the loop repeats the last feedback when none was received.
    fn wheel(&mut self, tick: &RecordedTick) -> Result<(), McapError> {
        let at_ns = self.dates.unix_ns(tick.time_ns);
        let wheel = &tick.wheel;
        if self.wheel_ns.replace(wheel.time_ns) == Some(wheel.time_ns) {
            return Ok(());
        }
        if !wheel.odom.is_finite() {
            self.bagged.without_pose += 1;
            return Ok(());
        }
        let stamp = ros_time(self.dates.unix_ns(wheel.time_ns))?;
        let t_odom_base = tick.t_odom_base();
        let t_map_odom = tick.decision.as_ref().map_or(Pose2::IDENTITY, |made| made.t_map_odom);
        let poses = [
            Transform { stamp, parent: "odom", child: "base_link", pose: t_odom_base.to_pose3() },
            Transform { stamp, parent: "map", child: "odom", pose: t_map_odom.to_pose3() },
        ];
        self.put(Topic::Odom, at_ns, &messages::odometry(stamp, &t_odom_base, &wheel.twist))?;
        self.put(Topic::Tf, at_ns, &messages::transforms(&poses))
    }

    fn put(&mut self, topic: Topic, at_ns: u64, data: &[u8]) -> Result<(), McapError> {
        let (channel_id, count) = self.channel(topic)?;
        let header = MessageHeader {
            channel_id,
            sequence: count as u32,
            log_time: at_ns,
            publish_time: at_ns,
        };
        self.channels[topic as usize] = Some((channel_id, count + 1));
        self.bagged.messages += 1;
        let (first, last) = self.times_ns.unwrap_or((at_ns, at_ns));
        self.times_ns = Some((first.min(at_ns), last.max(at_ns)));
        self.mcap.write_to_known_channel(&header, data)
    }

    fn channel(&mut self, topic: Topic) -> Result<(u16, u64), McapError> {
        if let Some(channel) = self.channels[topic as usize] {
            return Ok(channel);
        }
        let schema =
            self.mcap.add_schema(topic.message_type(), "ros2msg", topic.schema().as_bytes())?;
        let qos = BTreeMap::from([("offered_qos_profiles".to_owned(), topic.qos().to_owned())]);
        Ok((self.mcap.add_channel(schema, topic.name(), "cdr", &qos)?, 0))
    }

    /// Closes the file and returns the text of `metadata.yaml`.
    fn finish(mut self, name: &str) -> Result<(RosbagSummary, String), McapError> {
        self.mcap.finish()?;
        let file =
            self.mcap.into_inner().into_inner().map_err(std::io::IntoInnerError::into_error)?;
        file.sync_all()?;
        let counts = Topic::ALL
            .into_iter()
            .filter_map(|topic| Some((topic, self.channels[topic as usize]?.1)));
        Ok((
            self.bagged,
            metadata(name, self.times_ns.unwrap_or_default(), self.bagged.messages, counts),
        ))
    }
}

fn mount(stamp: Stamp, child: &'static str, pose: Pose3) -> Transform {
    Transform { stamp, parent: "base_link", child, pose }
}

fn ros_time(time_ns: u64) -> Result<Stamp, McapError> {
    Ok(Stamp::new(time_ns).ok_or_else(|| {
        let text = format!(
            "a time of {time_ns} ns exceeds the 68 years of a ROS time; the robot's clock was wrong"
        );
        std::io::Error::new(ErrorKind::InvalidData, text)
    })?)
}

fn tick_error(error: McapError, segment: &Path, to: &Path) -> StoreError {
    match error {
        McapError::Io(error) if error.kind() == ErrorKind::InvalidData => {
            StoreError::Segment { path: segment.to_owned(), detail: error.to_string() }
        }
        error => failure(error, segment, to),
    }
}

/// `metadata.yaml` in version 5, which ROS 2 Humble and all later distributions read.
fn metadata(
    name: &str,
    (first_ns, last_ns): (u64, u64),
    messages: u64,
    topics: impl Iterator<Item = (Topic, u64)>,
) -> String {
    let name = name.replace('\'', "''");
    let length_ns = last_ns - first_ns;
    let mut text = format!(
        "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n  duration:\n    nanoseconds: {length_ns}\n  \
         starting_time:\n    nanoseconds_since_epoch: {first_ns}\n  message_count: {messages}\n  topics_with_message_count:\n"
    );
    for (topic, count) in topics {
        // Writing into a String cannot fail.
        let _ = write!(
            text,
            "    - topic_metadata:\n        name: {}\n        type: {}\n        serialization_format: cdr\n        \
             offered_qos_profiles: {:?}\n      message_count: {count}\n",
            topic.name(),
            topic.message_type(),
            topic.qos()
        );
    }
    text + &format!(
        "  compression_format: \"\"\n  compression_mode: \"\"\n  relative_file_paths:\n    - '{name}'\n  files:\n    \
         - path: '{name}'\n      starting_time:\n        nanoseconds_since_epoch: {first_ns}\n      duration:\n        \
         nanoseconds: {length_ns}\n      message_count: {messages}\n"
    )
}
