//! Uploads of a robot's segments, and pulls of the uploaded segments.

use std::fs;
use std::path::Path;

use super::fleet::{Fleet, ProgressHook, SMALL, segment};
use crate::common::pull_into;
use hal::VirtualClock;
use segment_store::pull::{Options, Progress, Report};
use segment_store::source::{Directory, Listing, Source};
use segment_store::{Digest, ErrorKind, FileSink, LocalCopy, Name, StoreError};
use tempfile::{TempDir, tempdir};

pub const NAMES: [&str; 3] =
    ["monday/recording_0000.mcap", "monday/recording_0001.mcap", "tuesday/recording_0000.mcap"];

pub fn write(robot: &Path, name: &str, bytes: &[u8]) {
    let path = robot.join(name);
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(&path, bytes).unwrap();
    // RefuseAll writes to it any more.
    fs::File::open(&path).unwrap().set_modified(std::time::UNIX_EPOCH).unwrap();
}

/// Three small segments of two runs.
pub fn robot() -> TempDir {
    let dir = tempdir().unwrap();
    for (seed, name) in NAMES.iter().enumerate() {
        write(dir.path(), name, &segment(seed as u64 + 1, SMALL, 100));
    }
    dir
}

fn upload(fleet: &Fleet, robot: &Path) -> Report {
    upload_with_progress(fleet, &mut Directory::open(robot).unwrap(), Options::default(), &mut ())
        .unwrap()
}

fn upload_with_progress(
    fleet: &Fleet,
    source: &mut dyn Source,
    options: Options,
    progress: &mut dyn Progress,
) -> Result<Report, StoreError> {
    fleet.bucket().upload(source, &options, &mut VirtualClock::default(), progress)
}

/// Pulls from the store and compares the files with the robot's.
fn assert_pulled_files_equal(fleet: &Fleet, robot: &Path) {
    let here = tempdir().unwrap();
    pull_into(&mut fleet.bucket(), here.path(), Options { no_mark: true, ..Options::default() })
        .unwrap();
    for name in NAMES {
        assert!(
            fs::read(here.path().join(name)).unwrap() == fs::read(robot.join(name)).unwrap(),
            "{name} differs"
        );
    }
}

#[test]
fn uploaded_segments_can_be_pulled_and_are_marked_on_the_robot() {
    let disk = tempdir().unwrap();
    for fleet in [Fleet::in_memory(), Fleet::in_directory(disk.path())] {
        let robot = robot();
        let report = upload(&fleet, robot.path());
        assert_eq!((report.files, report.there, report.unmarked), (3, 0, 0));
        for name in NAMES {
            let digest = Digest::of(&fs::read(robot.path().join(name)).unwrap()).to_string();
            let beside = String::from_utf8(fleet.get(&format!("{name}.blake3"))).unwrap();
            assert_eq!(
                beside,
                format!("{digest}  {}\n", name.rsplit('/').next().unwrap()),
                "as b3sum writes it"
            );
            assert!(
                fs::read_to_string(robot.path().join(format!("{name}.pulled")))
                    .unwrap()
                    .starts_with(&digest)
            );
        }
        assert_pulled_files_equal(&fleet, robot.path());
    }
}

#[test]
fn a_segment_of_many_parts_is_uploaded_completely() {
    let fleet = Fleet::in_memory();
    let robot = tempdir().unwrap();
    let large = segment(1, 30, 1_200_000);
    write(robot.path(), NAMES[0], &large);
    assert_eq!(upload(&fleet, robot.path()).bytes, large.len() as u64);
    assert!(large.len() > 32 << 20 && fleet.get(NAMES[0]) == large);
}

#[test]
fn a_second_upload_sends_nothing_and_reads_only_unmarked_segments() {
    for no_mark in [false, true] {
        let fleet = Fleet::in_memory();
        let robot = robot();
        let options = Options { no_mark, ..Options::default() };
        for expected in [(3, 0), (0, if no_mark { 0 } else { 3 })] {
            let mut source = Fetches { robot: Directory::open(robot.path()).unwrap(), fetches: 0 };
            let report = upload_with_progress(&fleet, &mut source, options, &mut ()).unwrap();
            assert_eq!((report.files, report.there), expected, "no mark: {no_mark}");
            assert_eq!(source.fetches, 3 - expected.1, "no mark: {no_mark}");
            assert_eq!(report.bytes > 0, report.files > 0);
        }
    }
}

/// Counts the files that are read.
pub struct Fetches {
    pub robot: Directory,
    pub fetches: u64,
}

impl Source for Fetches {
    fn list(&mut self) -> Result<Listing, StoreError> {
        self.robot.list()
    }
    fn fetch(
        &mut self,
        name: &Name,
        local: LocalCopy,
        to: &mut dyn FileSink<StoreError>,
    ) -> Result<Option<Digest>, StoreError> {
        self.fetches += 1;
        self.robot.fetch(name, local, to)
    }
    fn mark_pulled(&mut self, name: &Name, digest: &Digest) -> Result<(), StoreError> {
        self.robot.mark_pulled(name, digest)
    }
}

#[test]
fn repeated_uploads_send_only_new_segments() {
    let fleet = Fleet::in_memory();
    let robot = robot();
    let mut bucket = fleet.bucket();
    let mut clock = VirtualClock::default();
    let mut source = Directory::open(robot.path()).unwrap();
    let options = Options { no_mark: true, ..Options::default() };
    let first = bucket.upload(&mut source, &options, &mut clock, &mut ()).unwrap();
    assert_eq!(first.files, 3);
    let second = bucket.upload(&mut source, &options, &mut clock, &mut ()).unwrap();
    assert_eq!((second.files, second.there), (0, 3));
    write(robot.path(), "tuesday/recording_0001.mcap", &segment(9, SMALL, 100));
    let third = bucket.upload(&mut source, &options, &mut clock, &mut ()).unwrap();
    assert_eq!((third.files, third.there), (1, 3));
}

#[test]
fn an_object_without_its_digest_is_compared_and_not_sent_again() {
    let fleet = Fleet::in_memory();
    let robot = robot();
    // The state after a kill between object and digest, or after an upload by another program.
    fleet.put(NAMES[0], &fs::read(robot.path().join(NAMES[0])).unwrap());
    let sent: u64 =
        NAMES[1..].iter().map(|name| fs::metadata(robot.path().join(name)).unwrap().len()).sum();
    let report = upload(&fleet, robot.path());
    assert_eq!((report.files, report.bytes), (3, sent));
    assert_pulled_files_equal(&fleet, robot.path());
}

#[test]
fn another_recording_under_an_old_name_does_not_replace_the_old_one() {
    for (new, has_digest) in
        [(segment(7, SMALL, 100), true), (segment(7, SMALL, 100), false), (segment(7, 9, 50), true)]
    {
        let fleet = Fleet::in_memory();
        let robot = robot();
        let old = fs::read(robot.path().join(NAMES[0])).unwrap();
        match has_digest {
            true => drop(upload(&fleet, robot.path())),
            false => fleet.put(NAMES[0], &old),
        }
        write(robot.path(), NAMES[0], &new);
        let later = std::time::UNIX_EPOCH + std::time::Duration::from_secs(1);
        fs::File::open(robot.path().join(NAMES[0])).unwrap().set_modified(later).unwrap();
        upload(&fleet, robot.path());
        assert!(fleet.get(NAMES[0]) == new);
        let kept = fleet
            .names()
            .into_iter()
            .find(|name| name.starts_with(&format!("{}.", NAMES[0])) && fleet.get(name) == old);
        assert!(kept.is_some(), "{:?}", fleet.names());
        assert_pulled_files_equal(&fleet, robot.path());
    }
}

#[test]
fn an_upload_interrupted_anywhere_leaves_no_partial_object_and_the_next_one_completes_it() {
    let fleet = Fleet::in_memory();
    let robot = robot();
    let total: u64 =
        NAMES.iter().map(|name| fs::metadata(robot.path().join(name)).unwrap().len()).sum();
    let mut ends = 0;
    for (at, after) in (0..total).step_by(total as usize / 40).enumerate() {
        let fleet = if at % 2 == 0 { &fleet } else { &Fleet::in_memory() };
        let mut source = EndsAfter { robot: Directory::open(robot.path()).unwrap(), bytes: after };
        let error = match upload_with_progress(
            fleet,
            &mut source,
            Options { no_mark: true, ..Options::default() },
            &mut (),
        ) {
            Ok(_) => continue,
            Err(error) => error,
        };
        assert_eq!(error.kind(), ErrorKind::Link, "{error}");
        ends += 1;
        for name in NAMES {
            let there = fleet.try_get(name);
            assert!(
                there.is_none_or(|there| there == fs::read(robot.path().join(name)).unwrap()),
                "{name}, {after}"
            );
        }
    }
    assert!(ends > 10, "{ends}");
    upload(&fleet, robot.path());
    assert_pulled_files_equal(&fleet, robot.path());
}

/// A source whose link breaks after `bytes` bytes.
pub struct EndsAfter {
    pub robot: Directory,
    pub bytes: u64,
}

struct Ends<'a> {
    to: &'a mut dyn FileSink<StoreError>,
    left: &'a mut u64,
}

impl FileSink<StoreError> for Ends<'_> {
    fn start(&mut self, from: u64, length: u64) -> Result<(), StoreError> {
        self.to.start(from, length)
    }
    fn data(&mut self, at: u64, bytes: &[u8]) -> Result<(), StoreError> {
        let (now, rest) = bytes.split_at((*self.left).min(bytes.len() as u64) as usize);
        *self.left -= now.len() as u64;
        self.to.data(at, now)?;
        match rest {
            [] => Ok(()),
            _ => Err(StoreError::Link {
                to: "robot".to_owned(),
                source: std::io::ErrorKind::BrokenPipe.into(),
            }),
        }
    }
    fn comparing(&mut self) -> Result<(), StoreError> {
        self.to.comparing()
    }
}

impl Source for EndsAfter {
    fn list(&mut self) -> Result<Listing, StoreError> {
        self.robot.list()
    }
    fn fetch(
        &mut self,
        name: &Name,
        local: LocalCopy,
        to: &mut dyn FileSink<StoreError>,
    ) -> Result<Option<Digest>, StoreError> {
        self.robot.fetch(name, local, &mut Ends { to, left: &mut self.bytes })
    }
    fn mark_pulled(&mut self, name: &Name, digest: &Digest) -> Result<(), StoreError> {
        self.robot.mark_pulled(name, digest)
    }
}

#[test]
fn a_segment_that_changes_while_it_is_sent_is_left_for_the_next_upload() {
    let fleet = Fleet::in_memory();
    let robot = tempdir().unwrap();
    write(robot.path(), NAMES[0], &segment(1, 30, 100_000));
    let path = robot.path().join(NAMES[0]);
    let longer = segment(2, 31, 100_000);
    let mut progress = ProgressHook::on_received(|| fs::write(&path, &longer).unwrap());
    let mut source = Directory::open(robot.path()).unwrap();
    let report =
        upload_with_progress(&fleet, &mut source, Options::default(), &mut progress).unwrap();
    let warnings = progress.warnings();
    assert!(
        warnings.iter().any(|text| text.contains("was written while it was read")),
        "{warnings:?}"
    );
    assert!(report.files == 0 && fleet.try_get(NAMES[0]).is_none());
    write(robot.path(), NAMES[0], &longer);
    assert_eq!(upload(&fleet, robot.path()).files, 1);
    assert!(fleet.get(NAMES[0]) == longer);
}

#[test]
fn a_segment_damaged_in_transit_is_not_completed_and_is_read_again() {
    let fleet = Fleet::in_memory();
    let robot = robot();
    let mut source = Liar { robot: Directory::open(robot.path()).unwrap(), lies: 1 };
    let mut progress = ProgressHook::on_received(|| {});
    let report =
        upload_with_progress(&fleet, &mut source, Options::default(), &mut progress).unwrap();
    assert_eq!(report.files, 3);
    assert!(progress.warnings()[0].contains("arrived damaged"));
    assert_pulled_files_equal(&fleet, robot.path());
    let fleet = Fleet::in_memory();
    let mut source = Liar { robot: Directory::open(robot.path()).unwrap(), lies: u64::MAX };
    let error = upload_with_progress(&fleet, &mut source, Options::default(), &mut ()).unwrap_err();
    assert!(matches!(error, StoreError::Digest { .. }), "{error}");
    assert!(fleet.names().is_empty(), "{:?}", fleet.names());
}

/// A source that returns a wrong digest `lies` times.
struct Liar {
    robot: Directory,
    lies: u64,
}

impl Source for Liar {
    fn list(&mut self) -> Result<Listing, StoreError> {
        self.robot.list()
    }
    fn fetch(
        &mut self,
        name: &Name,
        local: LocalCopy,
        to: &mut dyn FileSink<StoreError>,
    ) -> Result<Option<Digest>, StoreError> {
        let digest = self.robot.fetch(name, local, to)?;
        let lies = self.lies > 0;
        self.lies = self.lies.saturating_sub(1);
        Ok(if lies { Some(Digest::of(b"something else")) } else { digest })
    }
    fn mark_pulled(&mut self, name: &Name, digest: &Digest) -> Result<(), StoreError> {
        self.robot.mark_pulled(name, digest)
    }
}
