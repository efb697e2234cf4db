//! Robots are pulled from, again and again.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "helpers of tests")]

mod common;

use std::fs;
use std::os::unix::fs::symlink;
use std::time::SystemTime;

use common::{FILES, assert_same, connect, pull_into, robot, segment};
use segment_store::pull::Options;
use segment_store::source::{Directory, Source};
use segment_store::{Catalogue, Digest, FileSink, LocalCopy, Name, Pulled, Root, StoreError};
use tempfile::tempdir;

#[test]
fn everything_arrives_whole_and_the_robot_knows() {
    let (there, here) = (tempdir().unwrap(), tempdir().unwrap());
    robot(there.path());
    let report = pull_into(&mut connect(there.path()), here.path(), Options::default()).unwrap();
    assert_eq!(
        (report.files, report.there, report.open, report.unmarked),
        (FILES.len() as u64, 0, 0, 0)
    );
    assert_same(there.path(), here.path(), &FILES);
    for other in ["monday/summary.json", "monday/more"] {
        assert!(!here.path().join(other).exists(), "{other} stays where it is");
    }
    for entry in Catalogue::read(&Root::open(there.path()).unwrap()).unwrap().entries {
        let digest = Digest::of(&fs::read(there.path().join(entry.name.as_str())).unwrap());
        assert_eq!(entry.pulled, Pulled::Yes(digest), "{}", entry.name);
    }
}

#[test]
fn a_second_pull_moves_nothing_and_reads_nothing() {
    for local in [false, true] {
        let (there, here) = (tempdir().unwrap(), tempdir().unwrap());
        robot(there.path());
        let mut source: Box<dyn Source> = if local {
            Box::new(Directory::open(there.path()).unwrap())
        } else {
            Box::new(connect(there.path()))
        };
        pull_into(source.as_mut(), here.path(), Options::default()).unwrap();
        // Whoever reads these now gets something else; only sizes and times are still the same.
        let path = there.path().join("monday/recording_0000.mcap");
        let (length, modified) =
            (fs::read(&path).unwrap().len(), fs::metadata(&path).unwrap().modified().unwrap());
        fs::write(&path, vec![0; length]).unwrap();
        let file = fs::File::options().write(true).open(&path).unwrap();
        file.set_modified(modified).unwrap();
        let report = pull_into(source.as_mut(), here.path(), Options::default()).unwrap();
        assert_eq!((report.files, report.bytes, report.there), (0, 0, FILES.len() as u64));
    }
}

#[test]
fn without_its_index_a_destination_is_compared_and_nothing_is_sent_again() {
    let (there, here) = (tempdir().unwrap(), tempdir().unwrap());
    robot(there.path());
    pull_into(&mut connect(there.path()), here.path(), Options::default()).unwrap();
    for damage in [None, Some("{ not json"), Some("{\"format\": 99, \"files\": {}}")] {
        let index = here.path().join("pulled.json");
        match damage {
            None => fs::remove_file(&index).unwrap(),
            Some(text) => fs::write(&index, text).unwrap(),
        }
        let report =
            pull_into(&mut connect(there.path()), here.path(), Options::default()).unwrap();
        assert_eq!((report.files, report.bytes), (FILES.len() as u64, 0));
        assert_same(there.path(), here.path(), &FILES);
    }
}

#[test]
fn a_part_is_gone_on_with_at_its_byte_when_it_is_the_beginning_and_replaced_when_it_is_not() {
    let whole = segment(0, 0, 30);
    let half = whole.len() / 2;
    for (part, expected) in [
        (whole[..half].to_vec(), whole.len() - half),
        (whole.clone(), 0),
        (vec![7; half], whole.len()),
        (vec![7; whole.len() + 5], whole.len()),
        (Vec::new(), whole.len()),
    ] {
        let (there, here) = (tempdir().unwrap(), tempdir().unwrap());
        fs::write(there.path().join("recording_0000.mcap"), &whole).unwrap();
        fs::write(here.path().join("recording_0000.mcap.part"), &part).unwrap();
        let report =
            pull_into(&mut connect(there.path()), here.path(), Options::default()).unwrap();
        assert_eq!((report.files, report.bytes), (1, expected as u64));
        assert_same(there.path(), here.path(), &["recording_0000.mcap"]);
    }
}

#[test]
fn a_segment_that_is_being_written_comes_when_it_is_closed() {
    let (there, here) = (tempdir().unwrap(), tempdir().unwrap());
    let (path, whole) = (there.path().join("recording_0000.mcap"), segment(0, 0, 30));
    fs::write(&path, &whole[..whole.len() / 2]).unwrap();
    let mut source = connect(there.path());
    let report = pull_into(&mut source, here.path(), Options::default()).unwrap();
    assert_eq!((report.files, report.open), (0, 1));
    fs::write(&path, &whole).unwrap();
    let report = pull_into(&mut source, here.path(), Options::default()).unwrap();
    assert_eq!((report.files, report.open), (1, 0));
    assert_same(there.path(), here.path(), &["recording_0000.mcap"]);
}

#[test]
fn a_cut_segment_that_the_robot_has_made_whole_replaces_the_cut_one() {
    let (there, here) = (tempdir().unwrap(), tempdir().unwrap());
    let (path, whole) = (there.path().join("recording_0000.mcap"), segment(0, 0, 30));
    fs::write(&path, &whole[..whole.len() / 2]).unwrap();
    fs::File::open(&path).unwrap().set_modified(SystemTime::UNIX_EPOCH).unwrap();
    let mut source = connect(there.path());
    assert_eq!(pull_into(&mut source, here.path(), Options::default()).unwrap().cut, 1);
    fs::write(&path, &whole).unwrap();
    let report = pull_into(&mut source, here.path(), Options::default()).unwrap();
    assert_eq!(report.bytes as usize, whole.len() - whole.len() / 2, "only the rest is sent");
    assert_same(there.path(), here.path(), &["recording_0000.mcap"]);
    assert_eq!(
        fs::read_dir(here.path()).unwrap().count(),
        3,
        "the segment, the index and the lock"
    );
}

#[test]
fn another_run_under_the_same_name_never_replaces_what_was_pulled() {
    let (there, here) = (tempdir().unwrap(), tempdir().unwrap());
    let path = there.path().join("recording_0000.mcap");
    fs::write(&path, segment(0, 0, 30)).unwrap();
    pull_into(&mut connect(there.path()), here.path(), Options::default()).unwrap();
    let first = fs::read(&path).unwrap();
    fs::write(&path, segment(0, 500, 12)).unwrap();
    let root = Root::open(there.path()).unwrap();
    assert_eq!(Catalogue::read(&root).unwrap().entries[0].pulled, Pulled::Stale);
    pull_into(&mut connect(there.path()), here.path(), Options::default()).unwrap();
    assert_same(there.path(), here.path(), &["recording_0000.mcap"]);
    let aside = here.path().join(format!("recording_0000.mcap.{}", Digest::of(&first).short()));
    assert!(fs::read(aside).unwrap() == first);
}

#[test]
fn a_mark_is_set_only_for_what_the_robot_has() {
    let there = tempdir().unwrap();
    robot(there.path());
    let name = Name::parse("monday/recording_0000.mcap").unwrap();
    let mut source = connect(there.path());
    let error = source.mark_pulled(&name, &Digest::of(b"something else")).unwrap_err();
    assert!(
        matches!(error, StoreError::Refused { .. }) && error.to_string().contains("is not marked"),
        "{error}"
    );
    assert!(!there.path().join("monday/recording_0000.mcap.pulled").exists());
    let digest = Digest::of(&fs::read(there.path().join(name.as_str())).unwrap());
    source.mark_pulled(&name, &digest).unwrap();
    assert!(there.path().join("monday/recording_0000.mcap.pulled").exists());
}

#[test]
fn no_mark_leaves_the_robot_as_it_was() {
    let (there, here) = (tempdir().unwrap(), tempdir().unwrap());
    robot(there.path());
    let count = |dir: &std::path::Path| fs::read_dir(dir.join("monday")).unwrap().count();
    let before = count(there.path());
    pull_into(
        &mut connect(there.path()),
        here.path(),
        Options { no_mark: true, ..Options::default() },
    )
    .unwrap();
    assert_eq!(count(there.path()), before);
    // The next pull that may, tells it.
    pull_into(&mut connect(there.path()), here.path(), Options::default()).unwrap();
    assert_eq!(count(there.path()), before + 3);
}

/// Takes nothing.
struct Nobody;

impl FileSink<StoreError> for Nobody {
    fn start(&mut self, _from: u64, _length: u64) -> Result<(), StoreError> {
        panic!("a file that is not there begins")
    }
    fn data(&mut self, _at: u64, _bytes: &[u8]) -> Result<(), StoreError> {
        panic!("a file that is not there has data")
    }
    fn comparing(&mut self) -> Result<(), StoreError> {
        Ok(())
    }
}

#[test]
fn links_and_odd_files_in_a_buffer_are_not_there() {
    let (there, here, secret) = (tempdir().unwrap(), tempdir().unwrap(), tempdir().unwrap());
    robot(there.path());
    robot(secret.path());
    let target = secret.path().join("monday/recording_0000.mcap");
    symlink(&target, there.path().join("recording_0000.mcap")).unwrap();
    symlink(secret.path().join("monday"), there.path().join("linked")).unwrap();
    symlink("/etc", there.path().join("etc")).unwrap();
    fs::create_dir(there.path().join("tuesday/recording_0007.mcap")).unwrap();
    let pipe = there.path().join("tuesday/recording_0008.mcap");
    let made = std::process::Command::new("mkfifo").arg(&pipe).status().unwrap();
    assert!(made.success());
    let mut source = connect(there.path());
    let report = pull_into(&mut source, here.path(), Options::default()).unwrap();
    assert_eq!(report.files, 4, "what robot() made and nothing else");
    for name in [
        "recording_0000.mcap",
        "linked/recording_0000.mcap",
        "tuesday/recording_0008.mcap",
        "etc/recording_0000.mcap",
    ] {
        let error = source
            .fetch(&Name::parse(name).unwrap(), LocalCopy::none(), &mut Nobody)
            .unwrap_err()
            .to_string();
        assert!(error.contains("refuses"), "{name}: {error}");
    }
}

#[test]
fn two_pulls_at_once_into_one_place_are_one_too_many() {
    let (there, here) = (tempdir().unwrap(), tempdir().unwrap());
    robot(there.path());
    let first =
        segment_store::pull::Destination::open(here.path(), &segment_store::pull::FileSystem)
            .unwrap();
    let error = pull_into(&mut connect(there.path()), here.path(), Options::default()).unwrap_err();
    assert!(
        matches!(error, StoreError::Busy { .. }) && error.to_string().contains("another pull"),
        "{error}"
    );
    drop(first);
    pull_into(&mut connect(there.path()), here.path(), Options::default()).unwrap();
}

#[test]
fn a_source_that_is_not_there_is_named_with_the_way_out() {
    let error = Directory::open(std::path::Path::new("/no/such/buffer")).unwrap_err().to_string();
    assert!(error.contains("/no/such/buffer") && error.contains("give the directory"), "{error}");
}
