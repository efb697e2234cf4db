//! Repeated pulls from robots.

use std::fs;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::Path;
use std::time::SystemTime;

use crate::common::{FILES, assert_same, connect, pull_into, robot, segment};
use segment_store::pull::Options;
use segment_store::source::{Directory, Source};
use segment_store::{Catalogue, Digest, FileSink, LocalCopy, Name, Pulled, Root, StoreError};
use tempfile::tempdir;

#[test]
fn all_segments_are_pulled_and_marked_on_the_robot() {
    let there = tempdir().unwrap();
    let here = tempdir().unwrap();
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
fn what_cannot_be_read_at_the_source_is_reported_and_the_others_are_pulled() {
    for is_local in [false, true] {
        let there = tempdir().unwrap();
        let here = tempdir().unwrap();
        robot(there.path());
        symlink("recording_0000.mcap", there.path().join("monday/recording_0009.mcap")).unwrap();
        let mut source: Box<dyn Source> = match is_local {
            true => Box::new(Directory::open(there.path()).unwrap()),
            false => Box::new(connect(there.path())),
        };
        let report = pull_into(source.as_mut(), here.path(), Options::default()).unwrap();
        assert_eq!(report.files, FILES.len() as u64);
        let [said] = report.unread.try_into().unwrap();
        assert!(said.contains("monday/recording_0009.mcap: it is a symbolic link"), "{said}");
    }
}

#[test]
fn pulled_recordings_are_for_the_account_that_pulls_only() {
    let there = tempdir().unwrap();
    let here = tempdir().unwrap();
    robot(there.path());
    let data = here.path().join("data/kitchen");
    pull_into(&mut connect(there.path()), &data, Options::default()).unwrap();
    for folder in ["", "monday", "tuesday"] {
        assert_eq!(mode(&data.join(folder)), 0o700, "the folder {folder:?}");
    }
    for file in FILES {
        assert_eq!(mode(&data.join(file)), 0o600, "{file}");
    }
}

fn mode(path: &Path) -> u32 {
    fs::metadata(path).unwrap().permissions().mode() & 0o777
}

#[test]
fn a_second_pull_transfers_and_reads_nothing() {
    for local in [false, true] {
        let there = tempdir().unwrap();
        let here = tempdir().unwrap();
        robot(there.path());
        let mut source: Box<dyn Source> = if local {
            Box::new(Directory::open(there.path()).unwrap())
        } else {
            Box::new(connect(there.path()))
        };
        pull_into(source.as_mut(), here.path(), Options::default()).unwrap();
        // Changes the contents, but neither the size nor the modification time.
        let path = there.path().join("monday/recording_0000.mcap");
        let metadata = fs::metadata(&path).unwrap();
        fs::write(&path, vec![0; metadata.len() as usize]).unwrap();
        let file = fs::File::options().write(true).open(&path).unwrap();
        file.set_modified(metadata.modified().unwrap()).unwrap();
        let report = pull_into(source.as_mut(), here.path(), Options::default()).unwrap();
        assert_eq!((report.files, report.bytes, report.there), (0, 0, FILES.len() as u64));
    }
}

#[test]
fn without_its_index_a_destination_is_compared_and_nothing_is_sent_again() {
    let there = tempdir().unwrap();
    let here = tempdir().unwrap();
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
fn a_part_is_resumed_if_it_is_the_beginning_and_replaced_if_not() {
    let whole = segment(0, 0, 30);
    let half = whole.len() / 2;
    for (part, expected) in [
        (whole[..half].to_vec(), whole.len() - half),
        (whole.clone(), 0),
        (vec![7; half], whole.len()),
        (vec![7; whole.len() + 5], whole.len()),
        (Vec::new(), whole.len()),
    ] {
        let there = tempdir().unwrap();
        let here = tempdir().unwrap();
        fs::write(there.path().join("recording_0000.mcap"), &whole).unwrap();
        fs::write(here.path().join("recording_0000.mcap.part"), &part).unwrap();
        let report =
            pull_into(&mut connect(there.path()), here.path(), Options::default()).unwrap();
        assert_eq!((report.files, report.bytes), (1, expected as u64));
        assert_same(there.path(), here.path(), &["recording_0000.mcap"]);
    }
}

#[test]
fn an_open_segment_is_pulled_when_it_is_closed() {
    let there = tempdir().unwrap();
    let here = tempdir().unwrap();
    let path = there.path().join("recording_0000.mcap");
    let whole = segment(0, 0, 30);
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
fn a_segment_that_the_robot_has_completed_replaces_its_cut_version() {
    let there = tempdir().unwrap();
    let here = tempdir().unwrap();
    let path = there.path().join("recording_0000.mcap");
    let whole = segment(0, 0, 30);
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
    let there = tempdir().unwrap();
    let here = tempdir().unwrap();
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
fn a_marker_is_written_only_for_the_robots_own_contents() {
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
fn no_mark_writes_nothing_on_the_robot() {
    let there = tempdir().unwrap();
    let here = tempdir().unwrap();
    robot(there.path());
    let run = there.path().join("monday");
    let before = fs::read_dir(&run).unwrap().count();
    pull_into(
        &mut connect(there.path()),
        here.path(),
        Options { no_mark: true, ..Options::default() },
    )
    .unwrap();
    assert_eq!(fs::read_dir(&run).unwrap().count(), before);
    // The next pull without this option writes the markers.
    pull_into(&mut connect(there.path()), here.path(), Options::default()).unwrap();
    assert_eq!(fs::read_dir(&run).unwrap().count(), before + 3);
}

/// Fails the test when a file is sent.
struct RefuseAll;

impl FileSink<StoreError> for RefuseAll {
    fn start(&mut self, _from: u64, _length: u64) -> Result<(), StoreError> {
        panic!("the start of a file that does not exist")
    }
    fn data(&mut self, _at: u64, _bytes: &[u8]) -> Result<(), StoreError> {
        panic!("data of a file that does not exist")
    }
    fn comparing(&mut self) -> Result<(), StoreError> {
        Ok(())
    }
}

#[test]
fn symbolic_links_and_special_files_are_not_listed() {
    let there = tempdir().unwrap();
    let here = tempdir().unwrap();
    let secret = tempdir().unwrap();
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
    assert_eq!(report.files, 4, "only the files that robot() created");
    for name in [
        "recording_0000.mcap",
        "linked/recording_0000.mcap",
        "tuesday/recording_0008.mcap",
        "etc/recording_0000.mcap",
    ] {
        let error = source
            .fetch(&Name::parse(name).unwrap(), LocalCopy::none(), &mut RefuseAll)
            .unwrap_err()
            .to_string();
        assert!(error.contains("refuses"), "{name}: {error}");
    }
}

#[test]
fn a_second_pull_into_the_same_directory_is_refused() {
    let there = tempdir().unwrap();
    let here = tempdir().unwrap();
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
fn a_missing_source_is_an_error_with_a_way_out() {
    let error = Directory::open(std::path::Path::new("/no/such/buffer")).unwrap_err().to_string();
    assert!(error.contains("/no/such/buffer") && error.contains("give the directory"), "{error}");
}
