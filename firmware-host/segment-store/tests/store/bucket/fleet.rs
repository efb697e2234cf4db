//! Segments with the structure of the recorder's, and object stores.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::Path;
use std::sync::Arc;

use futures_util::TryStreamExt;
use object_store::local::LocalFileSystem;
use object_store::memory::InMemory;
use object_store::{ObjectStore, ObjectStoreExt};
use segment_store::bucket::Bucket;
use segment_store::pull::Progress;

use crate::common::Noise;

/// The number of ticks of a small segment.
pub const SMALL: u64 = 5;

/// A complete segment of `ticks` ticks with `bytes` bytes each, and two events.
pub fn segment(seed: u64, ticks: u64, bytes: usize) -> Vec<u8> {
    segment_with_channels(seed, ticks, bytes, 0)
}

/// Like [`segment`], with additional channels.
pub fn segment_with_channels(seed: u64, ticks: u64, bytes: usize, channels: usize) -> Vec<u8> {
    let mut out = Cursor::new(Vec::new());
    let mut noise = Noise(seed);
    let mut writer = mcap::WriteOptions::new()
        .compression(None)
        .chunk_size(Some(1 << 18))
        .create(&mut out)
        .unwrap();
    let nothing = BTreeMap::new();
    let tick_channel = writer.add_channel(0, "/robot/tick", "json", &nothing).unwrap();
    let events = writer.add_channel(0, "/events", "json", &nothing).unwrap();
    for number in 0..channels {
        writer.add_channel(0, &format!("/an/unused/topic/{number}"), "json", &nothing).unwrap();
    }
    for tick in 0..ticks {
        let data: Vec<u8> =
            (0..bytes.div_ceil(8)).flat_map(|_| noise.next().to_le_bytes()).collect();
        writer.write_to_known_channel(&header(tick_channel, tick), &data).unwrap();
        if tick < 2 {
            writer.write_to_known_channel(&header(events, tick), b"{}").unwrap();
        }
    }
    writer.finish().unwrap();
    drop(writer);
    out.into_inner()
}

fn header(channel_id: u16, tick: u64) -> mcap::records::MessageHeader {
    let time = tick * 100_000_000;
    mcap::records::MessageHeader {
        channel_id,
        sequence: tick as u32,
        log_time: time,
        publish_time: time,
    }
}

/// An object store that contains a robot's directory.
pub struct Fleet {
    pub store: Arc<dyn ObjectStore>,
    runtime: tokio::runtime::Runtime,
}

impl Fleet {
    pub fn from_store(store: Arc<dyn ObjectStore>) -> Self {
        Self {
            store,
            runtime: tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap(),
        }
    }

    pub fn in_memory() -> Self {
        Self::from_store(Arc::new(InMemory::new()))
    }

    pub fn in_directory(dir: &Path) -> Self {
        Self::from_store(Arc::new(LocalFileSystem::new_with_prefix(dir).unwrap()))
    }

    pub fn bucket(&self) -> Bucket {
        Bucket::from_store(Arc::clone(&self.store), "fleet/kitchen".into(), "s3://fleet/kitchen")
            .unwrap()
    }

    pub fn put(&self, name: &str, bytes: &[u8]) {
        let path = match name.strip_prefix("../") {
            Some(other) => format!("fleet/{other}"),
            None => format!("fleet/kitchen/{name}"),
        };
        self.runtime.block_on(self.store.put(&path.into(), bytes.to_vec().into())).unwrap();
    }

    pub fn try_get(&self, name: &str) -> Option<Vec<u8>> {
        let path = format!("fleet/kitchen/{name}").into();
        let got = self.runtime.block_on(async { self.store.get(&path).await?.bytes().await });
        got.ok().map(|bytes| bytes.to_vec())
    }

    pub fn get(&self, name: &str) -> Vec<u8> {
        self.try_get(name).unwrap()
    }

    /// The names of all objects.
    pub fn names(&self) -> Vec<String> {
        let prefix = "fleet/kitchen".into();
        let listed =
            self.runtime.block_on(self.store.list(Some(&prefix)).try_collect::<Vec<_>>()).unwrap();
        listed
            .iter()
            .map(|object| object.location.as_ref().trim_start_matches("fleet/kitchen/").to_owned())
            .collect()
    }

    /// Uploads three small segments of two runs, and a file that is not a segment.
    pub fn put_robot(&self) {
        self.put("monday/recording_0000.mcap", &segment(1, SMALL, 100));
        self.put("monday/recording_0001.mcap", &segment(2, SMALL, 100));
        self.put("tuesday/recording_0000.mcap", &segment(3, SMALL, 100));
        self.put("monday/summary.json", b"{}");
    }
}

/// Calls a function whenever data are received, and collects the warnings.
pub struct ProgressHook<'a> {
    on_received: Box<dyn FnMut() + 'a>,
    warnings: Vec<String>,
}

impl<'a> ProgressHook<'a> {
    pub fn on_received(on_received: impl FnMut() + 'a) -> Self {
        Self { on_received: Box::new(on_received), warnings: Vec::new() }
    }

    pub fn warnings(self) -> Vec<String> {
        self.warnings
    }
}

impl Progress for ProgressHook<'_> {
    fn received(&mut self, _bytes: u64) {
        (self.on_received)();
    }
    fn warning(&mut self, text: &str) {
        self.warnings.push(text.to_owned());
    }
}
