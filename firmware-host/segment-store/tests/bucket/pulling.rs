//! Buffers in object stores are pulled, again and again.

use std::fs;
use std::sync::Arc;

use crate::common::{Fleet, Noise, ProgressHook, SMALL, pull_into, pull_watched, segment};
use object_store::memory::InMemory;
use segment_store::pull::{Options, Order};
use segment_store::source::Source;
use segment_store::{Digest, ErrorKind, FileSink, LocalCopy, Name, Pulled, State, StoreError};
use tempfile::tempdir;

#[test]
fn everything_under_a_prefix_arrives_whole_and_is_marked() {
    let disk = tempdir().unwrap();
    for fleet in [Fleet::in_memory(), Fleet::in_directory(disk.path())] {
        let here = tempdir().unwrap();
        fleet.put_robot();
        let report = pull_into(&mut fleet.bucket(), here.path(), Options::default()).unwrap();
        assert_eq!((report.files, report.there, report.open, report.unmarked), (3, 0, 0, 0));
        for name in [
            "monday/recording_0000.mcap",
            "monday/recording_0001.mcap",
            "tuesday/recording_0000.mcap",
        ] {
            assert!(fs::read(here.path().join(name)).unwrap() == fleet.get(name), "{name} differs");
        }
        for entry in fleet.bucket().list().unwrap() {
            assert_eq!(
                entry.pulled,
                Pulled::Yes(Digest::of(&fleet.get(entry.name.as_str()))),
                "{}",
                entry.name
            );
            assert_eq!(
                (entry.state, entry.ticks, entry.events),
                (State::Closed, Some(SMALL), Some(2))
            );
        }
    }
}

#[test]
fn a_second_pull_moves_nothing_also_from_a_bucket_that_is_opened_again() {
    let (fleet, here) = (Fleet::in_memory(), tempdir().unwrap());
    fleet.put_robot();
    pull_into(&mut fleet.bucket(), here.path(), Options::default()).unwrap();
    for _ in 0..2 {
        let report = pull_into(&mut fleet.bucket(), here.path(), Options::default()).unwrap();
        assert_eq!((report.files, report.bytes, report.there), (0, 0, 3));
    }
}

#[test]
fn without_its_index_a_destination_is_compared_and_nothing_is_kept_twice() {
    for has_mark in [true, false] {
        let (fleet, here) = (Fleet::in_memory(), tempdir().unwrap());
        fleet.put_robot();
        let options = Options { no_mark: !has_mark, ..Options::default() };
        pull_into(&mut fleet.bucket(), here.path(), options).unwrap();
        fs::remove_file(here.path().join("pulled.json")).unwrap();
        let report = pull_into(&mut fleet.bucket(), here.path(), Options::default()).unwrap();
        // Without a mark there is nothing that it could be compared with but the bytes.
        assert_eq!((report.files, report.bytes == 0), (3, has_mark));
        assert_eq!(
            fs::read_dir(here.path().join("monday")).unwrap().count(),
            2,
            "mark: {has_mark}"
        );
    }
}

#[test]
fn a_bucket_that_is_followed_brings_what_is_new() {
    let (fleet, here) = (Fleet::in_memory(), tempdir().unwrap());
    let mut bucket = fleet.bucket();
    fleet.put_robot();
    pull_into(&mut bucket, here.path(), Options { order: Order::Newest, ..Options::default() })
        .unwrap();
    fleet.put("tuesday/recording_0001.mcap", &segment(9, SMALL, 100));
    let report = pull_into(&mut bucket, here.path(), Options::default()).unwrap();
    assert_eq!((report.files, report.there), (1, 3));
}

#[test]
fn an_interrupted_pull_goes_on_at_the_byte_with_and_without_a_digest() {
    let whole = segment(3, 30, 200_000);
    let half = whole.len() / 2;
    for has_digest in [false, true] {
        let (fleet, here) = (Fleet::in_memory(), tempdir().unwrap());
        fleet.put("recording_0000.mcap", &whole);
        if has_digest {
            let line = format!("{}  recording_0000.mcap\n", Digest::of(&whole));
            fleet.put("recording_0000.mcap.blake3", line.as_bytes());
        }
        fs::write(here.path().join("recording_0000.mcap.part"), &whole[..half]).unwrap();
        let report = pull_into(&mut fleet.bucket(), here.path(), Options::default()).unwrap();
        assert_eq!(
            (report.files, report.bytes),
            (1, (whole.len() - half) as u64),
            "digest: {has_digest}"
        );
        assert!(fs::read(here.path().join("recording_0000.mcap")).unwrap() == whole);
    }
}

#[test]
fn a_pull_that_is_cut_anywhere_ends_with_the_same_bytes() {
    let (fleet, here) = (Fleet::in_memory(), tempdir().unwrap());
    let whole = segment(4, 40, 250_000);
    fleet.put("run/recording_0000.mcap", &whole);
    let mut noise = Noise(5);
    let mut cuts = 0;
    loop {
        let mut left = noise.next() % (whole.len() as u64 / 2);
        // What a limit on the disk, a kill or a broken link look like from here.
        let mut source = CutShort { bucket: fleet.bucket(), left: &mut left };
        match pull_into(&mut source, here.path(), Options::default()) {
            Ok(_) => break,
            Err(error) => assert!(error.kind() == ErrorKind::Link, "{error}"),
        }
        cuts += 1;
        assert!(cuts < 100 && !here.path().join("run/recording_0000.mcap").exists());
    }
    assert!(cuts > 1 && fs::read(here.path().join("run/recording_0000.mcap")).unwrap() == whole);
}

/// Ends behind so many bytes.
struct CutShort<'a> {
    bucket: segment_store::bucket::Bucket,
    left: &'a mut u64,
}

struct Short<'a, 'b> {
    to: &'a mut dyn FileSink<StoreError>,
    left: &'b mut u64,
}

impl FileSink<StoreError> for Short<'_, '_> {
    fn start(&mut self, from: u64, length: u64) -> Result<(), StoreError> {
        self.to.start(from, length)
    }
    fn data(&mut self, at: u64, bytes: &[u8]) -> Result<(), StoreError> {
        let now = (*self.left).min(bytes.len() as u64);
        *self.left -= now;
        self.to.data(at, &bytes[..now as usize])?;
        let broken = || StoreError::Link {
            to: "bucket".to_owned(),
            source: std::io::ErrorKind::BrokenPipe.into(),
        };
        if now < bytes.len() as u64 { Err(broken()) } else { Ok(()) }
    }
    fn comparing(&mut self) -> Result<(), StoreError> {
        self.to.comparing()
    }
}

impl Source for CutShort<'_> {
    fn list(&mut self) -> Result<Vec<segment_store::Entry>, StoreError> {
        self.bucket.list()
    }
    fn fetch(
        &mut self,
        name: &Name,
        local: LocalCopy,
        to: &mut dyn FileSink<StoreError>,
    ) -> Result<Option<Digest>, StoreError> {
        self.bucket.fetch(name, have, &mut Short { to, left: self.left })
    }
    fn mark_pulled(&mut self, name: &Name, digest: &Digest) -> Result<(), StoreError> {
        self.bucket.mark_pulled(name, digest)
    }
}

#[test]
fn a_part_of_something_else_is_noticed_and_everything_is_pulled_once_more() {
    let (whole, other) = (segment(3, 30, 200_000), segment(8, 30, 200_000));
    for (has_digest, part) in [
        (false, other[..whole.len() / 2].to_vec()),
        (true, other[..whole.len() / 2].to_vec()),
        (true, other[..whole.len()].to_vec()),
        (false, other[..whole.len()].to_vec()),
        (false, vec![0; whole.len() + 9]),
        (true, vec![0; whole.len() + 9]),
    ] {
        let (fleet, here) = (Fleet::in_memory(), tempdir().unwrap());
        fleet.put("recording_0000.mcap", &whole);
        if has_digest {
            fleet.put("recording_0000.mcap.blake3", Digest::of(&whole).to_string().as_bytes());
        }
        fs::write(here.path().join("recording_0000.mcap.part"), &part).unwrap();
        let report = pull_into(&mut fleet.bucket(), here.path(), Options::default()).unwrap();
        assert_eq!(report.files, 1);
        assert!(report.bytes >= whole.len() as u64, "{}", report.bytes);
        assert!(fs::read(here.path().join("recording_0000.mcap")).unwrap() == whole);
    }
}

#[test]
fn an_object_that_is_replaced_while_it_is_read_never_gets_a_segments_name() {
    // So long that more pieces are asked for after the first has come.
    let (first, second) = (segment(3, 30, 2_000_000), segment(8, 30, 2_000_000));
    let (fleet, here) = (Fleet::in_memory(), tempdir().unwrap());
    fleet.put("recording_0000.mcap", &first);
    let mut replaced = false;
    let mut progress = ProgressHook::arrival(|| {
        if !replaced {
            replaced = true;
            fleet.put("recording_0000.mcap", &second);
        }
    });
    let report =
        pull_watched(&mut fleet.bucket(), here.path(), Options::default(), &mut progress).unwrap();
    let warnings = progress.warnings();
    assert_eq!(report.files, 0);
    assert!(
        warnings.iter().any(|text| text.contains("replaced or removed while it was read")),
        "{warnings:?}"
    );
    assert!(!here.path().join("recording_0000.mcap").exists());
    // The next pull finds a part of the old one, and comes to the new one whole.
    pull_into(&mut fleet.bucket(), here.path(), Options::default()).unwrap();
    assert!(fs::read(here.path().join("recording_0000.mcap")).unwrap() == second);
}

#[test]
fn a_digest_that_is_not_the_objects_keeps_it_from_getting_its_name() {
    let (fleet, here) = (Fleet::in_memory(), tempdir().unwrap());
    fleet.put("recording_0000.mcap", &segment(1, SMALL, 100));
    fleet.put("recording_0000.mcap.blake3", Digest::of(b"something else").to_string().as_bytes());
    let error = pull_into(&mut fleet.bucket(), here.path(), Options::default()).unwrap_err();
    assert!(matches!(error, StoreError::Digest { .. }), "{error}");
    assert!(!here.path().join("recording_0000.mcap").exists());
    // What makes no sense is no digest.
    fleet.put("recording_0000.mcap.blake3", b"<html>");
    assert_eq!(pull_into(&mut fleet.bucket(), here.path(), Options::default()).unwrap().files, 1);
}

#[test]
fn a_segment_that_is_damaged_in_the_bucket_is_pulled_twice_and_kept_with_a_warning() {
    let (fleet, here) = (Fleet::in_memory(), tempdir().unwrap());
    let mut damaged = segment(1, 30, 1000);
    let middle = damaged.len() / 2;
    damaged[middle] ^= 0x10;
    fleet.put("recording_0000.mcap", &damaged);
    let mut progress = ProgressHook::arrival(|| {});
    let report =
        pull_watched(&mut fleet.bucket(), here.path(), Options::default(), &mut progress).unwrap();
    assert_eq!((report.files, report.bytes), (1, 2 * damaged.len() as u64));
    let warnings = progress.warnings();
    assert!(
        warnings.iter().any(|text| text.contains("damaged where it comes from")),
        "{warnings:?}"
    );
}

#[test]
fn a_cut_segment_arrives_as_it_is_and_its_whole_successor_replaces_it() {
    let (fleet, here) = (Fleet::in_memory(), tempdir().unwrap());
    let whole = segment(1, 30, 200_000);
    fleet.put("run/recording_0000.mcap", &whole[..whole.len() / 2]);
    // Not the last of its run, so nobody is writing it.
    fleet.put("run/recording_0001.mcap", &segment(2, SMALL, 100));
    let mut bucket = fleet.bucket();
    let report = pull_into(&mut bucket, here.path(), Options::default()).unwrap();
    assert_eq!((report.files, report.cut), (2, 1));
    fleet.put("run/recording_0000.mcap", &whole);
    let report = pull_into(&mut bucket, here.path(), Options::default()).unwrap();
    assert_eq!(
        (report.files, report.bytes),
        (1, (whole.len() - whole.len() / 2) as u64),
        "only the rest is read"
    );
    assert!(fs::read(here.path().join("run/recording_0000.mcap")).unwrap() == whole);
}

#[test]
fn an_index_that_is_longer_than_usual_is_read_as_well() {
    let fleet = Fleet::in_memory();
    fleet.put("recording_0000.mcap", &common::segment_with_channels(1, SMALL, 100, 4000));
    let entries = fleet.bucket().list().unwrap();
    assert_eq!((entries[0].state, entries[0].ticks), (State::Closed, Some(SMALL)));
}

#[test]
fn names_that_could_lead_elsewhere_are_not_there() {
    let (fleet, here) = (Fleet::in_memory(), tempdir().unwrap());
    fleet.put_robot();
    for odd in [".ssh/recording_0000.mcap", "a/b/recording_0000.mcap", "run/id_rsa"] {
        fleet.put(odd, &segment(1, SMALL, 100));
    }
    // The prefix is a folder and not the beginning of a name.
    fleet.put("../kitchen2/run/recording_0000.mcap", &segment(1, SMALL, 100));
    let report = pull_into(&mut fleet.bucket(), here.path(), Options::default()).unwrap();
    assert_eq!(report.files, 3, "what put_robot() made and nothing else");
    let runs = fs::read_dir(here.path())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let mut runs: Vec<_> = runs.filter(|name| !name.starts_with('.')).collect();
    runs.sort();
    assert_eq!(runs, ["monday", "pulled.json", "tuesday"]);
}

#[test]
fn a_mark_is_set_only_for_what_was_read() {
    let fleet = Fleet::in_memory();
    fleet.put_robot();
    let (mut bucket, name) = (fleet.bucket(), Name::parse("monday/recording_0000.mcap").unwrap());
    bucket.list().unwrap();
    fleet.put(name.as_str(), &segment(77, SMALL, 100));
    let error = bucket.mark_pulled(&name, &Digest::of(b"")).unwrap_err();
    assert!(error.to_string().contains("is not marked as pulled"), "{error}");
    assert!(fleet.try_get("monday/recording_0000.mcap.pulled").is_none());
}

#[test]
fn an_empty_prefix_is_an_empty_buffer() {
    let bucket = segment_store::bucket::Bucket::from_store(
        Arc::new(InMemory::new()),
        "nothing".into(),
        "memory:///nothing",
    );
    assert!(bucket.unwrap().list().unwrap().is_empty());
}
