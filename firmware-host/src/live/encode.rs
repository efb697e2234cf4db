//! The thread that turns copies of ticks into messages.

use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::Receiver;

use anyhow::Result;
use foxglove::Encode;
use foxglove::messages as fox;
use hal::Pose2;
use image::codecs::jpeg::JpegEncoder;
use image::imageops::{FilterType, resize};
use image::{ExtendedColorType, RgbImage};
use live_link::frame;
use runtime::recording::{EventLog, messages};
use serde::Serialize;

use super::Mounts;
use super::channels::Topic;
use super::depth_color;
use super::hub::Hub;
use super::tick_copy::TickCopy;
use crate::config::LiveSection;
use crate::run::status::{Status, unix_s};

/// The thread runs when nothing else does: the view may be late, the robot may not.
const NICENESS: i32 = 10;

/// What the exploration loop puts into the queue.
#[derive(Debug)]
pub enum Item {
    Tick(Box<TickCopy>),
    Health(Box<Status>),
}

/// Encodes messages and passes them on to the clients.
pub struct Encoder {
    hub: Arc<Hub>,
    config: LiveSection,
    mounts: Mounts,
    /// The health's time must not be before that of the messages before it.
    time_ns: u64,
    events: EventLog,
    buffer: Vec<u8>,
}

/// The status with what only the view shows.
#[derive(Serialize)]
struct Health<'a> {
    #[serde(flatten)]
    status: &'a Status,
    /// Free space on the disk of the recording.
    #[serde(skip_serializing_if = "Option::is_none")]
    disk_free_gib: Option<f64>,
}

impl Encoder {
    /// Starts the thread. It ends when the queue's other end is dropped.
    ///
    /// # Errors
    /// When the system cannot create a thread.
    pub fn start(
        hub: Arc<Hub>,
        config: LiveSection,
        mounts: Mounts,
        items: Receiver<Item>,
    ) -> Result<()> {
        let mut encoder = Self::new(hub, config, mounts);
        std::thread::Builder::new().name("live".to_owned()).spawn(move || {
            // The niceness is that of this thread only. Without it the view is as important as the rest.
            let _ = rustix::process::nice(NICENESS);
            for item in items {
                encoder.item(&item);
            }
        })?;
        Ok(())
    }

    fn new(hub: Arc<Hub>, config: LiveSection, mounts: Mounts) -> Self {
        let events = EventLog::default();
        Self { hub, config, mounts, time_ns: 0, events, buffer: Vec::new() }
    }

    fn item(&mut self, item: &Item) {
        match item {
            Item::Tick(copy) => self.copy(copy),
            Item::Health(status) => self.health(status),
        }
    }

    fn copy(&mut self, copy: &TickCopy) {
        let time_ns = copy.time_ns;
        self.time_ns = time_ns;
        self.json(Topic::Now, &copy.now);
        let Mounts { camera, t_base_camera, t_base_laser } = self.mounts.clone();
        if self.hub.wants(Topic::Tf) {
            self.put(
                Topic::Tf,
                &messages::transforms(
                    &copy.t_map_odom,
                    &copy.t_odom_base,
                    &t_base_camera,
                    &t_base_laser,
                    time_ns,
                ),
            );
        }
        let t_map_base = copy.t_map_odom.compose(&copy.t_odom_base);
        self.put_some(Topic::Pose, messages::pose_in("map", &t_map_base, time_ns).as_ref());
        let goal = copy.goal_m.map(|[x_m, y_m]| Pose2 { x_m, y_m, yaw_rad: 0.0 });
        let goal = goal.and_then(|goal| messages::pose_in("map", &goal, time_ns));
        self.put_some(Topic::Goal, goal.as_ref());
        if let Some(scan) = &copy.scan {
            self.put(Topic::Scan, &messages::scan(scan, time_ns));
        }
        if let Some(path_m) = &copy.path_m {
            self.put(Topic::Path, &messages::path(path_m, time_ns));
        }
        if let Some(Ok(grid)) = copy.map.as_ref().map(|map| messages::grid(map, time_ns)) {
            self.put(Topic::Map, &grid);
        }
        if let Some(areas) = &copy.areas {
            self.put(Topic::KeepOut, &areas.scene(time_ns));
        }
        if self.hub.is_fresh(Topic::Events) {
            // A client that subscribes while depth is missing also receives the event that says so.
            self.events = EventLog::default();
        }
        for message in self.events.messages(&copy.events, time_ns) {
            self.put(Topic::Events, &message);
        }
        if let Some(frame) = &copy.frame {
            self.image(Topic::Camera, frame.width, frame.height, frame.rgb.clone());
            self.put(Topic::Calibration, &messages::calibration(&camera, time_ns));
        }
        if let Some(depth) = &copy.depth {
            self.image(Topic::Depth, depth.width(), depth.height(), depth_color::image(depth));
        }
    }

    fn health(&mut self, status: &Status) {
        let disk_free_gib = status.recording.folder.as_deref().and_then(free_gib);
        if self.time_ns == 0 {
            self.time_ns = (unix_s() * 1e9) as u64;
        }
        self.json(Topic::Health, &Health { status, disk_free_gib });
    }

    fn image(&mut self, topic: Topic, width: usize, height: usize, rgb: Vec<u8>) {
        let Some(jpeg) = self.jpeg(width, height, rgb) else { return };
        let message = fox::CompressedImage {
            timestamp: messages::timestamp(self.time_ns),
            frame_id: "camera_optical".to_owned(),
            data: jpeg.into(),
            format: "jpeg".to_owned(),
        };
        self.put(topic, &message);
    }

    fn jpeg(&self, width: usize, height: usize, rgb: Vec<u8>) -> Option<Vec<u8>> {
        let (width, height) = (u32::try_from(width).ok()?, u32::try_from(height).ok()?);
        let mut image = RgbImage::from_raw(width, height, rgb)?;
        let columns = self.config.image_columns;
        if width > columns {
            let rows = (u64::from(height) * u64::from(columns) / u64::from(width)).max(1) as u32;
            image = resize(&image, columns, rows, FilterType::Triangle);
        }
        let mut jpeg = Vec::new();
        JpegEncoder::new_with_quality(&mut jpeg, self.config.jpeg_quality)
            .encode(&image, image.width(), image.height(), ExtendedColorType::Rgb8)
            .ok()?;
        Some(jpeg)
    }

    fn put_some(&mut self, topic: Topic, message: Option<&impl Encode>) {
        if let Some(message) = message {
            self.put(topic, message);
        }
    }

    fn put(&mut self, topic: Topic, message: &impl Encode) {
        if !self.hub.wants(topic) {
            return;
        }
        self.buffer.clear();
        if let Err(error) = message.encode(&mut self.buffer) {
            tracing::debug!("a message of the live view cannot be encoded: {error}");
            return;
        }
        self.send(topic);
    }

    fn json(&mut self, topic: Topic, message: &impl Serialize) {
        if !self.hub.wants(topic) {
            return;
        }
        self.buffer.clear();
        if serde_json::to_writer(&mut self.buffer, message).is_ok() {
            self.send(topic);
        }
    }

    fn send(&self, topic: Topic) {
        if let Ok(frame) = frame::message(topic.id(), self.time_ns, &self.buffer) {
            self.hub.send(topic, &frame.into());
        }
    }
}

fn free_gib(folder: &str) -> Option<f64> {
    let disk = rustix::fs::statvfs(Path::new(folder)).ok()?;
    Some((disk.f_bavail * disk.f_frsize) as f64 / f64::from(1 << 30))
}

#[cfg(test)]
mod tests {
    use super::*;
    use hal::{CameraModel, DepthMap, Pose3};
    use live_link::{Frame, FrameReader};
    use runtime::event::Event;
    use runtime::perception::NoDepth;
    use runtime::recording::MapView;

    fn encoder(image_columns: u32) -> (Encoder, super::super::hub::Outgoing) {
        let hub = Arc::new(Hub::default());
        let (client, outgoing) = hub.join().unwrap();
        hub.subscribe(&client, &Topic::ALL.map(Topic::id));
        let mounts = Mounts {
            camera: CameraModel::pinhole(64, 32, 1.5),
            t_base_camera: Pose3::identity(),
            t_base_laser: Pose3::identity(),
        };
        let config = LiveSection { image_columns, ..LiveSection::default() };
        (Encoder::new(hub, config, mounts), outgoing)
    }

    /// All messages of a client. The queue ends when the encoder, which holds the hub, is dropped.
    fn messages_of(outgoing: &super::super::hub::Outgoing) -> Vec<(u16, Vec<u8>)> {
        let mut reader = FrameReader::default();
        let mut read = Vec::new();
        while let Some(bytes) = outgoing.next() {
            reader.push(&bytes);
            while let Some(Frame::Message { channel, payload, time_ns }) =
                reader.next_frame().unwrap()
            {
                assert_eq!(time_ns, 5_000_000_000);
                read.push((channel, payload));
            }
        }
        read
    }

    #[test]
    fn a_tick_becomes_the_messages_that_foxglove_reads() {
        let (mut encoder, outgoing) = encoder(640);
        let map = MapView {
            origin_m: [-1.0, 2.0],
            cell_m: 0.05,
            columns: 3,
            occupancy: vec![0, -1, 100],
        };
        let copy = TickCopy {
            time_ns: 5_000_000_000,
            path_m: Some(vec![[0.0, 0.0], [1.0, 0.0]]),
            map: Some(map),
            depth: DepthMap::from_vec(4, 2, vec![1.0; 8]),
            ..TickCopy::default()
        };
        encoder.item(&Item::Tick(Box::new(copy)));
        drop(encoder);
        let read = messages_of(&outgoing);
        let topics: Vec<u16> = read.iter().map(|(channel, _)| *channel).collect();
        let expected = [Topic::Now, Topic::Tf, Topic::Pose, Topic::Path, Topic::Map, Topic::Depth]
            .map(Topic::id);
        assert_eq!(topics, expected);
        let now: serde_json::Value = serde_json::from_slice(&read[0].1).unwrap();
        assert_eq!(now["tick"], 0);
        let grid = <fox::Grid as foxglove::Decode>::decode(&read[4].1[..]).unwrap();
        assert_eq!((grid.column_count, grid.data.len()), (3, 15));
    }

    #[test]
    fn a_client_that_subscribes_while_depth_is_missing_is_told_once() {
        let (mut encoder, first) = encoder(640);
        let no_depth = Event::NoDepth { why: NoDepth::TooLittleParallax };
        let copy =
            TickCopy { time_ns: 5_000_000_000, events: vec![no_depth], ..TickCopy::default() };
        encoder.copy(&copy);
        encoder.copy(&copy);
        let (client, second) = encoder.hub.join().unwrap();
        encoder.hub.subscribe(&client, &[Topic::Events.id()]);
        drop(client);
        encoder.copy(&copy);
        encoder.copy(&copy);
        // The first client receives the event again when the second one comes.
        drop(encoder);
        assert_eq!([&first, &second].map(number_of_events), [2, 1]);
    }

    fn number_of_events(outgoing: &super::super::hub::Outgoing) -> usize {
        let messages = messages_of(outgoing);
        messages.iter().filter(|(channel, _)| *channel == Topic::Events.id()).count()
    }

    #[test]
    fn a_large_image_is_made_smaller() {
        let (encoder, _) = encoder(64);
        let jpeg = encoder.jpeg(128, 48, vec![90; 128 * 48 * 3]).unwrap();
        let small = image::load_from_memory(&jpeg).unwrap();
        assert_eq!((small.width(), small.height()), (64, 24));
        assert!(encoder.jpeg(9, 9, vec![0; 3]).is_none());
    }
}
