//! Repeated pulls from object stores.

use std::fs;
use std::sync::Arc;

use super::fleet::{Fleet, ProgressHook, SMALL, segment, segment_with_channels};
use crate::common::{Noise, pull_into, pull_with_progress};
use object_store::memory::InMemory;
use segment_store::pull::{Options, Order};
use segment_store::source::{Listing, Source};
use segment_store::{Digest, ErrorKind, FileSink, LocalCopy, Name, Pulled, State, StoreError};
use tempfile::tempdir;

#[test]
fn all_segments_under_a_prefix_are_pulled_and_marked() {
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
        for entry in fleet.bucket().list().unwrap().entries {
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
fn a_second_pull_transfers_nothing_even_from_a_reopened_bucket() {
    let fleet = Fleet::in_memory();
    let here = tempdir().unwrap();
    fleet.put_robot();
    pull_into(&mut fleet.bucket(), here.path(), Options::default()).unwrap();
    for _ in 0..2 {
        let report = pull_into(&mut fleet.bucket(), here.path(), Options::default()).unwrap();
        assert_eq!((report.files, report.bytes, report.there), (0, 0, 3));
    }
}

#[test]
fn without_its_index_a_destination_is_compared_and_no_file_is_duplicated() {
    for has_mark in [true, false] {
        let fleet = Fleet::in_memory();
        let here = tempdir().unwrap();
        fleet.put_robot();
        let options = Options { no_mark: !has_mark, ..Options::default() };
        pull_into(&mut fleet.bucket(), here.path(), options).unwrap();
        fs::remove_file(here.path().join("pulled.json")).unwrap();
        let report = pull_into(&mut fleet.bucket(), here.path(), Options::default()).unwrap();
        // Without a marker there is no digest to compare with, so the segment is transferred again.
        assert_eq!((report.files, report.bytes == 0), (3, has_mark));
        assert_eq!(
            fs::read_dir(here.path().join("monday")).unwrap().count(),
            2,
            "mark: {has_mark}"
        );
    }
}

#[test]
fn a_second_pull_from_the_same_bucket_fetches_only_new_segments() {
    let fleet = Fleet::in_memory();
    let here = tempdir().unwrap();
    let mut bucket = fleet.bucket();
    fleet.put_robot();
    pull_into(&mut bucket, here.path(), Options { order: Order::Newest, ..Options::default() })
        .unwrap();
    fleet.put("tuesday/recording_0001.mcap", &segment(9, SMALL, 100));
    let report = pull_into(&mut bucket, here.path(), Options::default()).unwrap();
    assert_eq!((report.files, report.there), (1, 3));
}

#[test]
fn an_interrupted_pull_resumes_at_the_byte_with_and_without_a_digest() {
    let whole = segment(3, 30, 200_000);
    let half = whole.len() / 2;
    for has_digest in [false, true] {
        let fleet = Fleet::in_memory();
        let here = tempdir().unwrap();
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
fn a_pull_interrupted_anywhere_ends_with_the_same_bytes() {
    let fleet = Fleet::in_memory();
    let here = tempdir().unwrap();
    let whole = segment(4, 40, 250_000);
    fleet.put("run/recording_0000.mcap", &whole);
    let mut noise = Noise(5);
    let mut cuts = 0;
    loop {
        let mut left = noise.next() % (whole.len() as u64 / 2);
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

/// A source whose link breaks after `left` bytes.
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
        if now == bytes.len() as u64 {
            return Ok(());
        }
        let source = std::io::ErrorKind::BrokenPipe.into();
        Err(StoreError::Link { to: "bucket".to_owned(), source })
    }
    fn comparing(&mut self) -> Result<(), StoreError> {
        self.to.comparing()
    }
}

impl Source for CutShort<'_> {
    fn list(&mut self) -> Result<Listing, StoreError> {
        self.bucket.list()
    }
    fn fetch(
        &mut self,
        name: &Name,
        local: LocalCopy,
        to: &mut dyn FileSink<StoreError>,
    ) -> Result<Option<Digest>, StoreError> {
        self.bucket.fetch(name, local, &mut Short { to, left: self.left })
    }
    fn mark_pulled(&mut self, name: &Name, digest: &Digest) -> Result<(), StoreError> {
        self.bucket.mark_pulled(name, digest)
    }
}

#[test]
fn a_part_with_other_contents_is_detected_and_the_segment_is_pulled_again() {
    let whole = segment(3, 30, 200_000);
    let other = segment(8, 30, 200_000);
    for (has_digest, part) in [
        (false, other[..whole.len() / 2].to_vec()),
        (true, other[..whole.len() / 2].to_vec()),
        (true, other[..whole.len()].to_vec()),
        (false, other[..whole.len()].to_vec()),
        (false, vec![0; whole.len() + 9]),
        (true, vec![0; whole.len() + 9]),
    ] {
        let fleet = Fleet::in_memory();
        let here = tempdir().unwrap();
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
fn an_object_that_is_replaced_while_it_is_read_is_not_completed() {
    // Large enough that more requests follow after the first piece was received.
    let first = segment(3, 30, 2_000_000);
    let second = segment(8, 30, 2_000_000);
    let fleet = Fleet::in_memory();
    let here = tempdir().unwrap();
    fleet.put("recording_0000.mcap", &first);
    let mut replaced = false;
    let mut progress = ProgressHook::on_received(|| {
        if !replaced {
            replaced = true;
            fleet.put("recording_0000.mcap", &second);
        }
    });
    let report =
        pull_with_progress(&mut fleet.bucket(), here.path(), Options::default(), &mut progress)
            .unwrap();
    let warnings = progress.warnings();
    assert_eq!(report.files, 0);
    assert!(
        warnings.iter().any(|text| text.contains("replaced or removed while it was read")),
        "{warnings:?}"
    );
    assert!(!here.path().join("recording_0000.mcap").exists());
    // The next pull replaces the part of the old object.
    pull_into(&mut fleet.bucket(), here.path(), Options::default()).unwrap();
    assert!(fs::read(here.path().join("recording_0000.mcap")).unwrap() == second);
}

#[test]
fn an_object_with_a_wrong_digest_is_not_completed() {
    let fleet = Fleet::in_memory();
    let here = tempdir().unwrap();
    fleet.put("recording_0000.mcap", &segment(1, SMALL, 100));
    fleet.put("recording_0000.mcap.blake3", Digest::of(b"something else").to_string().as_bytes());
    let error = pull_into(&mut fleet.bucket(), here.path(), Options::default()).unwrap_err();
    assert!(matches!(error, StoreError::Digest { .. }), "{error}");
    assert!(!here.path().join("recording_0000.mcap").exists());
    // Malformed text does not count as a digest.
    fleet.put("recording_0000.mcap.blake3", b"<html>");
    assert_eq!(pull_into(&mut fleet.bucket(), here.path(), Options::default()).unwrap().files, 1);
}

#[test]
fn a_segment_damaged_in_the_bucket_is_pulled_twice_and_kept_with_a_warning() {
    let fleet = Fleet::in_memory();
    let here = tempdir().unwrap();
    let mut damaged = segment(1, 30, 1000);
    let middle = damaged.len() / 2;
    damaged[middle] ^= 0x10;
    fleet.put("recording_0000.mcap", &damaged);
    let mut progress = ProgressHook::on_received(|| {});
    let report =
        pull_with_progress(&mut fleet.bucket(), here.path(), Options::default(), &mut progress)
            .unwrap();
    assert_eq!((report.files, report.bytes), (1, 2 * damaged.len() as u64));
    let warnings = progress.warnings();
    assert!(warnings.iter().any(|text| text.contains("damaged at its source")), "{warnings:?}");
}

#[test]
fn a_cut_segment_is_pulled_and_later_replaced_by_its_complete_version() {
    let fleet = Fleet::in_memory();
    let here = tempdir().unwrap();
    let whole = segment(1, 30, 200_000);
    fleet.put("run/recording_0000.mcap", &whole[..whole.len() / 2]);
    // A later segment, so that the cut one does not count as still being written.
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
fn an_unusually_long_index_is_read() {
    let fleet = Fleet::in_memory();
    fleet.put("recording_0000.mcap", &segment_with_channels(1, SMALL, 100, 4000));
    let entries = fleet.bucket().list().unwrap().entries;
    assert_eq!((entries[0].state, entries[0].ticks), (State::Closed, Some(SMALL)));
}

#[test]
fn names_that_could_lead_out_of_the_store_are_not_listed() {
    let fleet = Fleet::in_memory();
    let here = tempdir().unwrap();
    fleet.put_robot();
    for odd in [".ssh/recording_0000.mcap", "a/b/recording_0000.mcap", "run/id_rsa"] {
        fleet.put(odd, &segment(1, SMALL, 100));
    }
    // The prefix is a directory and not the beginning of a name.
    fleet.put("../kitchen2/run/recording_0000.mcap", &segment(1, SMALL, 100));
    let report = pull_into(&mut fleet.bucket(), here.path(), Options::default()).unwrap();
    assert_eq!(report.files, 3, "only the files that put_robot() created");
    let runs = fs::read_dir(here.path())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let mut runs: Vec<_> = runs.filter(|name| !name.starts_with('.')).collect();
    runs.sort();
    assert_eq!(runs, ["monday", "pulled.json", "tuesday"]);
}

#[test]
fn a_marker_is_written_only_for_the_version_that_was_read() {
    let fleet = Fleet::in_memory();
    fleet.put_robot();
    let mut bucket = fleet.bucket();
    let name = Name::parse("monday/recording_0000.mcap").unwrap();
    bucket.list().unwrap();
    fleet.put(name.as_str(), &segment(77, SMALL, 100));
    let error = bucket.mark_pulled(&name, &Digest::of(b"")).unwrap_err();
    assert!(error.to_string().contains("is not marked as pulled"), "{error}");
    assert!(fleet.try_get("monday/recording_0000.mcap.pulled").is_none());
}

#[test]
fn a_segment_behind_half_a_million_objects_is_listed() {
    let fleet = Fleet::in_memory();
    for run in 0..500_000 {
        fleet.put(&format!("a{run}/recording_0000.mcap.keep"), b"");
    }
    fleet.put("notes/readme.txt", b"not a segment");
    fleet.put("zoo/recording_0000.mcap", &segment(5, SMALL, 100));
    let listed: Vec<String> =
        fleet.bucket().list().unwrap().entries.iter().map(|entry| entry.name.to_string()).collect();
    assert_eq!(listed, ["zoo/recording_0000.mcap"]);
}

#[test]
fn an_empty_prefix_is_an_empty_store() {
    let bucket = segment_store::bucket::Bucket::from_store(
        Arc::new(InMemory::new()),
        "nothing".into(),
        "memory:///nothing",
    );
    assert!(bucket.unwrap().list().unwrap().entries.is_empty());
}
