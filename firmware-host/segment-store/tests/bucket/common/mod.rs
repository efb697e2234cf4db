//! Segments as the recorder frames them, and stores to put them into.
#![allow(dead_code, reason = "every test file uses a part")]

use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::Path;
use std::sync::Arc;

use futures_util::TryStreamExt;
use hal::VirtualClock;
use object_store::local::LocalFileSystem;
use object_store::memory::InMemory;
use object_store::{ObjectStore, ObjectStoreExt};
use segment_store::StoreError;
use segment_store::bucket::Bucket;
use segment_store::pull::{Destination, FileSystem, Options, Progress, Report, pull};
use segment_store::source::Source;

/// Turns of a small segment.
pub const SMALL: u64 = 5;

/// Numbers that do not compress (SplitMix64).
pub struct Noise(pub u64);

impl Noise {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }
}

/// A whole segment of `turns` turns with `bytes` bytes each, and two events.
pub fn segment(seed: u64, ticks: u64, bytes: usize) -> Vec<u8> {
    segment_with_channels(seed, turns, bytes, 0)
}

/// As [`segment`], with so many channels more.
pub fn segment_with_channels(seed: u64, ticks: u64, bytes: usize, channels: usize) -> Vec<u8> {
    let (mut out, mut noise) = (Cursor::new(Vec::new()), Noise(seed));
    let mut writer = mcap::WriteOptions::new()
        .compression(None)
        .chunk_size(Some(1 << 18))
        .create(&mut out)
        .unwrap();
    let nothing = BTreeMap::new();
    let tick = writer.add_channel(0, "/robot/tick", "json", &nothing).unwrap();
    let events = writer.add_channel(0, "/events", "json", &nothing).unwrap();
    for number in 0..channels {
        writer
            .add_channel(0, &format!("/a/topic/nobody/listens/to/{number}"), "json", &nothing)
            .unwrap();
    }
    for turn in 0..ticks {
        let data: Vec<u8> =
            (0..bytes.div_ceil(8)).flat_map(|_| noise.next().to_le_bytes()).collect();
        let time = turn * 100_000_000;
        let header = |channel_id| mcap::records::MessageHeader {
            channel_id,
            sequence: turn as u32,
            log_time: time,
            publish_time: time,
        };
        writer.write_to_known_channel(&header(tick), &data).unwrap();
        if turn < 2 {
            writer.write_to_known_channel(&header(events), b"{}").unwrap();
        }
    }
    writer.finish().unwrap();
    drop(writer);
    out.into_inner()
}

/// A store with a robot's folder in it.
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

    /// Of everything.
    pub fn names(&self) -> Vec<String> {
        let prefix = "fleet/kitchen".into();
        let listed =
            self.runtime.block_on(self.store.list(Some(&prefix)).try_collect::<Vec<_>>()).unwrap();
        let relative = |path: &str| path.trim_start_matches("fleet/kitchen/").to_owned();
        listed.iter().map(|object| relative(object.location.as_ref())).collect()
    }

    /// Three small segments of two runs, and what else lies beside them.
    pub fn put_robot(&self) {
        self.put("monday/recording_0000.mcap", &segment(1, SMALL, 100));
        self.put("monday/recording_0001.mcap", &segment(2, SMALL, 100));
        self.put("tuesday/recording_0000.mcap", &segment(3, SMALL, 100));
        self.put("monday/summary.json", b"{}");
    }
}

/// Does something at every arrival, and keeps the warnings.
pub struct ProgressHook<'a> {
    arrival: Box<dyn FnMut() + 'a>,
    warnings: Vec<String>,
}

impl<'a> ProgressHook<'a> {
    pub fn arrival(arrival: impl FnMut() + 'a) -> Self {
        Self { arrival: Box::new(arrival), warnings: Vec::new() }
    }

    pub fn warnings(self) -> Vec<String> {
        self.warnings
    }
}

impl Progress for ProgressHook<'_> {
    fn received(&mut self, _bytes: u64) {
        (self.arrival)();
    }
    fn warning(&mut self, text: &str) {
        self.warnings.push(text.to_owned());
    }
}

pub fn pull_into(
    source: &mut dyn Source,
    here: &Path,
    options: Options,
) -> Result<Report, StoreError> {
    pull_watched(source, here, options, &mut ())
}

pub fn pull_watched(
    source: &mut dyn Source,
    here: &Path,
    options: Options,
    progress: &mut dyn Progress,
) -> Result<Report, StoreError> {
    let mut destination = Destination::open(here, &FileSystem)?;
    pull(source, &mut destination, &options, &mut VirtualClock::default(), progress)
}
