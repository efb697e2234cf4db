//! A ROS 2 bag: a folder with `metadata.yaml` and one MCAP file, as `ros2 bag play`, rviz and the `rosbags` package take it.
//!
//! The recording itself is MCAP too, but with Foxglove's messages, which ROS does not know.

mod cdr;
mod messages;
mod topics;

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs::File;
use std::io::{BufWriter, ErrorKind};
use std::path::{Path, PathBuf};

use hal::Pose3;
use mcap::records::MessageHeader;
use mcap::{Compression, McapError, WriteOptions, Writer};
use runtime::recording::{RecordedTick, SegmentHeader};

use self::messages::{Stamp, Transform};
use self::topics::Topic;
use super::folder::new_folder;
use super::turns::each_turn;
use crate::error::BufferError;
use crate::recover::failure;

/// What was written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Bagged {
    /// Messages of all topics.
    pub messages: u64,
    /// Pictures among them.
    pub pictures: u64,
    /// Scans among them.
    pub scans: u64,
    /// Turns that came without a pose: no odometry and no transform of theirs is in the bag.
    pub without_pose: u64,
    /// Segments that end early; what they hold is in.
    pub cut: u64,
}

/// Writes the run that consists of `segments`, in this order, as a bag into the new folder `to`: pictures, calibration, scans,
/// odometry and transforms. Times are the run's own, which begin when the robot's computer did.
///
/// # Errors
/// When `to` is there already or cannot be written, or a segment is no recording of ours.
pub fn ros2(segments: &[PathBuf], to: &Path) -> Result<Bagged, BufferError> {
    let name = format!("{}_0.mcap", to.file_name().unwrap_or_default().to_string_lossy());
    new_folder(to, |dir| {
        let path = dir.join(&name);
        let mut bag = Bag::begin(&path).map_err(|error| failure(error, &path, to))?;
        for segment in segments {
            let one = std::slice::from_ref(segment);
            bag.bagged.cut += each_turn(one, |header, turn| {
                bag.turn(header, turn).map_err(|error| refused(error, segment, to))
            })?;
        }
        let (bagged, metadata) = bag.finish(&name).map_err(|error| failure(error, &path, to))?;
        let path = dir.join("metadata.yaml");
        std::fs::write(&path, metadata).map_err(BufferError::write(path))?;
        Ok(bagged)
    })
}

struct Bag {
    mcap: Writer<BufWriter<File>>,
    /// Number and messages of each topic that has any.
    channels: [Option<(u16, u64)>; Topic::ALL.len()],
    /// First and last.
    times_ns: Option<(u64, u64)>,
    /// When the wheels last said something.
    wheel_ns: Option<u64>,
    bagged: Bagged,
}

impl Bag {
    fn begin(path: &Path) -> Result<Self, McapError> {
        let options = WriteOptions::new()
            .profile("ros2")
            .library(concat!("embodied-depth ", env!("CARGO_PKG_VERSION")))
            .compression(Some(Compression::Zstd))
            .compression_level(1);
        let mcap = options.create(BufWriter::new(File::create_new(path)?))?;
        let channels = [None; Topic::ALL.len()];
        Ok(Self { mcap, channels, times_ns: None, wheel_ns: None, bagged: Bagged::default() })
    }

    fn turn(&mut self, header: &SegmentHeader, turn: &RecordedTick) -> Result<(), McapError> {
        let (at_ns, stamp) = (turn.time_ns, stamp(turn.time_ns)?);
        if self.times_ns.is_none() {
            let (camera, laser) = (header.run.t_base_camera, header.run.t_base_laser);
            let on_robot =
                |child, pose: Pose3| Transform { stamp, parent: "base_link", child, pose };
            let mounts = [on_robot("camera_optical", camera), on_robot("laser", laser)];
            self.put(Topic::TfStatic, at_ns, &messages::transforms(&mounts))?;
        }
        if let Some(picture) = &turn.frame {
            self.put(Topic::Image, at_ns, &messages::image(stamp, picture))?;
            self.put(Topic::CameraInfo, at_ns, &messages::camera_info(stamp, &header.run.camera))?;
            self.bagged.pictures += 1;
        }
        if let Some(scan) = &turn.scan {
            self.put(Topic::Scan, at_ns, &messages::laser_scan(self::stamp(scan.time_ns)?, scan))?;
            self.bagged.scans += 1;
        }
        self.wheel(turn)
    }

    /// Silent wheels are no new odometry.
    fn wheel(&mut self, turn: &RecordedTick) -> Result<(), McapError> {
        let (at_ns, wheel) = (turn.time_ns, &turn.wheel);
        if self.wheel_ns.replace(wheel.time_ns) == Some(wheel.time_ns) {
            return Ok(());
        }
        if !wheel.odom.is_finite() {
            self.bagged.without_pose += 1;
            return Ok(());
        }
        let stamp = stamp(wheel.time_ns)?;
        let pose =
            Transform { stamp, parent: "odom", child: "base_link", pose: wheel.odom.to_pose3() };
        self.put(Topic::Odom, at_ns, &messages::odometry(stamp, wheel))?;
        self.put(Topic::Tf, at_ns, &messages::transforms(&[pose]))
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
        let quality =
            BTreeMap::from([("offered_qos_profiles".to_owned(), topic.quality().to_owned())]);
        Ok((self.mcap.add_channel(schema, topic.name(), "cdr", &quality)?, 0))
    }

    /// Ends the file; the text of `metadata.yaml`.
    fn finish(mut self, name: &str) -> Result<(Bagged, String), McapError> {
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

fn stamp(time_ns: u64) -> Result<Stamp, McapError> {
    let beyond = || {
        format!(
            "a time of {time_ns} ns is beyond the 68 years that ROS's has; the robot's clock was wrong"
        )
    };
    Ok(Stamp::new(time_ns).ok_or_else(|| std::io::Error::new(ErrorKind::InvalidData, beyond()))?)
}

fn refused(error: McapError, segment: &Path, to: &Path) -> BufferError {
    match error {
        McapError::Io(error) if error.kind() == ErrorKind::InvalidData => {
            BufferError::Segment { path: segment.to_owned(), detail: error.to_string() }
        }
        error => failure(error, segment, to),
    }
}

/// `metadata.yaml` in version 5, that of ROS 2 Humble, which every later one reads.
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
            topic.quality()
        );
    }
    text + &format!(
        "  compression_format: \"\"\n  compression_mode: \"\"\n  relative_file_paths:\n    - '{name}'\n  files:\n    \
         - path: '{name}'\n      starting_time:\n        nanoseconds_since_epoch: {first_ns}\n      duration:\n        \
         nanoseconds: {length_ns}\n      message_count: {messages}\n"
    )
}
