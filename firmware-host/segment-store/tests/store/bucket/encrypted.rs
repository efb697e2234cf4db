//! Segments that are encrypted before an object store gets them.

use std::collections::HashSet;
use std::fs;
use std::path::Path;

use super::fleet::{Fleet, ProgressHook, SMALL, segment};
use super::uploading::{EndsAfter, Fetches, NAMES, robot, write};
use crate::common::{pull_into, pull_with_progress};
use hal::VirtualClock;
use segment_store::bucket::{Bucket, Keys};
use segment_store::pull::{Options, Report};
use segment_store::source::{Directory, Source};
use segment_store::{Digest, ErrorKind, State, StoreError};
use tempfile::tempdir;

/// Two keys of `age-keygen`.
const KITCHEN: [&str; 2] = [
    "age1t7rxyev2z3rw82stdlrrepyc39nvn86l5078zqkf5uasdy86jp6svpy7pa",
    "AGE-SECRET-KEY-1GQ9778VQXMMJVE8SK7J6VT8UJ4HDQAJUVSFCWCM02D8GEWQ72PVQ2Y5J33",
];
const HALL: [&str; 2] = [
    "age1tnkqns2v90lzm05zte02sm68r8nf36ug7ee653axu7ev5t9sxytsu975nq",
    "AGE-SECRET-KEY-1WP7XQ93D3C4MAXEF8UHRA968EUCE3UH6LVSV9SAZGPQ3MAZG8MYS9F6XL2",
];

const CHUNK: usize = 64 << 10;
const ENCRYPTED_CHUNK: usize = CHUNK + 16;

pub fn encrypting(to: &[[&str; 2]]) -> Keys {
    let recipients: Vec<String> = to.iter().map(|[public, _]| (*public).to_owned()).collect();
    Keys::read(&recipients, &[] as &[&Path]).unwrap()
}

pub fn decrypting(with: [&str; 2]) -> Keys {
    let file = tempfile::NamedTempFile::new().unwrap();
    fs::write(file.path(), with[1]).unwrap();
    Keys::read(&[], &[file.path()]).unwrap()
}

pub fn kitchen() -> (Keys, Keys) {
    (encrypting(&[KITCHEN]), decrypting(KITCHEN))
}

fn upload_from(bucket: &mut Bucket, source: &mut dyn Source) -> Result<Report, StoreError> {
    bucket.upload(source, &Options::default(), &mut VirtualClock::default(), &mut ())
}

fn upload(fleet: &Fleet, robot: &Path) -> Report {
    let mut bucket = fleet.bucket().with_keys(&encrypting(&[KITCHEN]));
    upload_from(&mut bucket, &mut Directory::open(robot).unwrap()).unwrap()
}

fn pull(fleet: &Fleet, keys: &Keys, here: &Path) -> Report {
    pull_into(&mut fleet.bucket().with_keys(keys), here, Options::default()).unwrap()
}

/// Uploads one segment, and returns its encrypted object.
fn uploaded(fleet: &Fleet, bytes: &[u8]) -> Vec<u8> {
    let robot = tempdir().unwrap();
    write(robot.path(), NAMES[0], bytes);
    assert_eq!(upload(fleet, robot.path()).files, 1);
    fleet.get(&encrypted(NAMES[0]))
}

fn encrypted(name: &str) -> String {
    format!("{name}.age")
}

fn assert_same(robot: &Path, here: &Path, names: &[&str]) {
    for name in names {
        let file = fs::read(here.join(name)).unwrap();
        assert!(file == fs::read(robot.join(name)).unwrap(), "{name} differs");
    }
}

/// The names of the finished segments of a directory of runs.
fn finished(here: &Path) -> Vec<String> {
    let runs = fs::read_dir(here).unwrap().map(|entry| entry.unwrap().path());
    let files = runs.filter(|path| path.is_dir()).flat_map(|run| fs::read_dir(run).unwrap());
    let names = files.map(|file| file.unwrap().file_name().into_string().unwrap());
    names.filter(|name| segment_store::is_segment_name(name)).collect()
}

#[test]
fn encrypted_segments_are_pulled_as_the_robot_recorded_them() {
    let disk = tempdir().unwrap();
    for fleet in [Fleet::in_memory(), Fleet::in_directory(disk.path())] {
        let robot = robot();
        let here = tempdir().unwrap();
        let report = upload(&fleet, robot.path());
        assert_eq!((report.files, report.there, report.unmarked), (3, 0, 0));
        let pulled = pull(&fleet, &decrypting(KITCHEN), here.path());
        assert_eq!((pulled.files, pulled.cut, pulled.unmarked, pulled.unread), (3, 0, 0, vec![]));
        assert_eq!(pulled.bytes, report.bytes);
        assert_same(robot.path(), here.path(), &NAMES);
    }
}

#[test]
fn the_robots_marker_has_the_digest_of_its_segment_and_the_store_that_of_the_object_as_well() {
    let fleet = Fleet::in_memory();
    let robot = robot();
    upload(&fleet, robot.path());
    for name in NAMES {
        let plain = Digest::of(&fs::read(robot.path().join(name)).unwrap());
        let stored = Digest::of(&fleet.get(&encrypted(name)));
        let beside = String::from_utf8(fleet.get(&format!("{name}.age.blake3"))).unwrap();
        let file = name.rsplit('/').next().unwrap();
        assert_eq!(
            beside,
            format!("{stored}  {file}.age\n{plain}  {file}\n"),
            "as b3sum writes it"
        );
        let marker = fs::read_to_string(robot.path().join(format!("{name}.pulled"))).unwrap();
        assert!(marker.starts_with(&plain.to_string()), "{marker}");
    }
}

#[test]
fn no_object_contains_any_part_of_the_plain_segments() {
    // Short enough that no part of a segment is without one, and long enough that none is in other bytes by chance.
    const PART: usize = 12;
    for is_encrypted in [true, false] {
        let fleet = Fleet::in_memory();
        let robot = robot();
        let parts: HashSet<Vec<u8>> = NAMES
            .iter()
            .map(|name| fs::read(robot.path().join(name)).unwrap())
            .flat_map(|bytes| bytes.windows(PART).map(<[u8]>::to_vec).collect::<Vec<_>>())
            // Of zeros, of which any file may have some.
            .filter(|part| part.iter().any(|byte| *byte != 0))
            .collect();
        let keys = if is_encrypted { encrypting(&[KITCHEN]) } else { Keys::default() };
        let mut bucket = fleet.bucket().with_keys(&keys);
        upload_from(&mut bucket, &mut Directory::open(robot.path()).unwrap()).unwrap();
        let names = fleet.names();
        assert_eq!(names.len(), 6, "{names:?}");
        let leaks = names
            .iter()
            .filter(|name| fleet.get(name).windows(PART).any(|window| parts.contains(window)));
        // What is not encrypted shows that this test finds it.
        assert_eq!(leaks.count(), if is_encrypted { 0 } else { 3 });
    }
}

#[test]
fn equal_segments_are_different_objects() {
    let whole = segment(1, SMALL, 100);
    assert!(uploaded(&Fleet::in_memory(), &whole) != uploaded(&Fleet::in_memory(), &whole));
}

#[test]
fn the_state_and_the_counts_of_an_encrypted_segment_are_known_with_its_key() {
    let fleet = Fleet::in_memory();
    let whole = segment(1, 30, 20_000);
    uploaded(&fleet, &whole);
    let listing = fleet.bucket().with_keys(&decrypting(KITCHEN)).list().unwrap();
    let entry = &listing.entries[0];
    assert_eq!((entry.name.as_str(), entry.bytes), (NAMES[0], whole.len() as u64));
    assert_eq!((entry.state, entry.ticks, entry.events), (State::Closed, Some(30), Some(2)));
    assert_eq!(entry.times.unwrap().last_ns, 2_900_000_000);
}

#[test]
fn a_segment_that_was_cut_is_pulled_as_it_is_and_counted() {
    let fleet = Fleet::in_memory();
    let robot = tempdir().unwrap();
    let here = tempdir().unwrap();
    let whole = segment(1, 30, 20_000);
    write(robot.path(), NAMES[0], &whole[..whole.len() / 2]);
    write(robot.path(), NAMES[1], &segment(2, SMALL, 100));
    assert_eq!(upload(&fleet, robot.path()).cut, 1);
    let report = pull(&fleet, &decrypting(KITCHEN), here.path());
    assert_eq!((report.files, report.cut), (2, 1));
    assert_same(robot.path(), here.path(), &NAMES[..2]);
}

#[test]
fn every_recipient_decrypts_with_its_own_key() {
    let fleet = Fleet::in_memory();
    let robot = robot();
    let mut bucket = fleet.bucket().with_keys(&encrypting(&[KITCHEN, HALL]));
    upload_from(&mut bucket, &mut Directory::open(robot.path()).unwrap()).unwrap();
    for identity in [KITCHEN, HALL] {
        let here = tempdir().unwrap();
        assert_eq!(pull(&fleet, &decrypting(identity), here.path()).files, 3);
        assert_same(robot.path(), here.path(), &NAMES);
    }
}

#[test]
fn without_the_right_key_encrypted_segments_are_named_and_the_others_are_pulled() {
    for (keys, way) in [
        (Keys::default(), "--identity key.txt"),
        (decrypting(HALL), "encrypted to other keys than the given ones"),
    ] {
        let fleet = Fleet::in_memory();
        let here = tempdir().unwrap();
        let plain = segment(7, SMALL, 100);
        fleet.put("tuesday/recording_0001.mcap", &plain);
        upload(&fleet, robot().path());
        let mut bucket = fleet.bucket().with_keys(&keys);
        // Twice, because the second time nothing is read of the encrypted objects.
        for new in [1, 0] {
            let report = pull_into(&mut bucket, here.path(), Options::default()).unwrap();
            assert_eq!((report.files, report.there), (new, 1 - new));
            let named = |name: &str| {
                let begin = format!("{name}.age is encrypted");
                report.unread.iter().any(|why| why.starts_with(&begin) && why.contains(way))
            };
            assert!(report.unread.len() == 3 && NAMES.iter().all(|name| named(name)), "{report:?}");
        }
        assert_eq!(finished(here.path()), ["recording_0001.mcap"]);
        assert!(fs::read(here.path().join("tuesday/recording_0001.mcap")).unwrap() == plain);
    }
}

#[test]
fn a_repeated_upload_sends_nothing() {
    for no_mark in [false, true] {
        let fleet = Fleet::in_memory();
        let robot = robot();
        let options = Options { no_mark, ..Options::default() };
        let mut objects = Vec::new();
        for expected in [(3, 0), (0, if no_mark { 0 } else { 3 })] {
            let mut source = Fetches { robot: Directory::open(robot.path()).unwrap(), fetches: 0 };
            let mut bucket = fleet.bucket().with_keys(&encrypting(&[KITCHEN]));
            let report = bucket
                .upload(&mut source, &options, &mut VirtualClock::default(), &mut ())
                .unwrap();
            assert_eq!((report.files, report.there), expected, "no mark: {no_mark}");
            assert_eq!(source.fetches, 3 - expected.1, "no mark: {no_mark}");
            objects.push(NAMES.map(|name| fleet.get(&encrypted(name))));
        }
        assert!(objects[0] == objects[1], "an object was replaced");
    }
}

#[test]
fn a_segment_that_is_there_in_one_form_is_not_sent_in_the_other() {
    for plain_first in [true, false] {
        let fleet = Fleet::in_memory();
        let robot = robot();
        let mut sent = Vec::new();
        for is_plain in [plain_first, !plain_first] {
            let keys = if is_plain { Keys::default() } else { encrypting(&[KITCHEN]) };
            let mut bucket = fleet.bucket().with_keys(&keys);
            let options = Options { no_mark: true, ..Options::default() };
            let mut source = Directory::open(robot.path()).unwrap();
            let report =
                bucket.upload(&mut source, &options, &mut VirtualClock::default(), &mut ());
            sent.push(report.unwrap().bytes);
        }
        assert!(sent[0] > 0 && sent[1] == 0, "{sent:?}");
    }
}

#[test]
fn plain_objects_without_a_digest_get_it_from_an_upload_that_encrypts() {
    let fleet = Fleet::in_memory();
    let robot = robot();
    let bytes = fs::read(robot.path().join(NAMES[0])).unwrap();
    fleet.put(NAMES[0], &bytes);
    upload(&fleet, robot.path());
    let beside = String::from_utf8(fleet.get(&format!("{}.blake3", NAMES[0]))).unwrap();
    assert_eq!(beside, format!("{}  recording_0000.mcap\n", Digest::of(&bytes)));
    assert!(fleet.try_get(&encrypted(NAMES[0])).is_none());
}

#[test]
fn an_interrupted_upload_leaves_no_object_and_the_next_one_completes_it() {
    let robot = robot();
    let total: u64 =
        NAMES.iter().map(|name| fs::metadata(robot.path().join(name)).unwrap().len()).sum();
    for bytes in (0..total).step_by(total as usize / 10) {
        let fleet = Fleet::in_memory();
        let mut bucket = fleet.bucket().with_keys(&encrypting(&[KITCHEN]));
        let mut source = EndsAfter { robot: Directory::open(robot.path()).unwrap(), bytes };
        let options = Options { no_mark: true, ..Options::default() };
        let error = bucket
            .upload(&mut source, &options, &mut VirtualClock::default(), &mut ())
            .unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Link, "{error}");
        // Those before it are complete, with their digests.
        assert!(
            fleet.names().len() < 6 && fleet.names().len().is_multiple_of(2),
            "{:?}",
            fleet.names()
        );
        upload(&fleet, robot.path());
        let here = tempdir().unwrap();
        assert_eq!(pull(&fleet, &decrypting(KITCHEN), here.path()).files, 3);
        assert_same(robot.path(), here.path(), &NAMES);
        for name in NAMES {
            let _ = fs::remove_file(robot.path().join(format!("{name}.pulled")));
        }
    }
}

#[test]
fn an_encrypted_object_without_its_digest_is_sent_again_and_kept() {
    let fleet = Fleet::in_memory();
    let robot = robot();
    let object = uploaded(&Fleet::in_memory(), &fs::read(robot.path().join(NAMES[0])).unwrap());
    // The state after a kill between object and digest.
    fleet.put(&encrypted(NAMES[0]), &object);
    let report = upload(&fleet, robot.path());
    assert_eq!(report.files, 3);
    assert!(fleet.try_get(&format!("{}.age.blake3", NAMES[0])).is_some());
    let kept = fleet.names().into_iter().filter(|name| fleet.get(name) == object);
    assert_eq!(kept.count(), 1);
    let here = tempdir().unwrap();
    assert_eq!(pull(&fleet, &decrypting(KITCHEN), here.path()).files, 3);
    assert_same(robot.path(), here.path(), &NAMES);
}

#[test]
fn another_recording_under_an_old_name_counts_and_the_old_one_is_kept() {
    let forms = [(true, true), (false, true), (true, false)];
    for (old_is_encrypted, new_is_encrypted) in forms {
        let fleet = Fleet::in_memory();
        let robot = tempdir().unwrap();
        let keys = |is_encrypted| match is_encrypted {
            true => encrypting(&[KITCHEN]),
            false => Keys::default(),
        };
        let form = |is_encrypted| match is_encrypted {
            true => encrypted(NAMES[0]),
            false => NAMES[0].to_owned(),
        };
        let mut source = Directory::open(robot.path()).unwrap();
        write(robot.path(), NAMES[0], &segment(1, SMALL, 100));
        upload_from(&mut fleet.bucket().with_keys(&keys(old_is_encrypted)), &mut source).unwrap();
        let old = fleet.get(&form(old_is_encrypted));
        write(robot.path(), NAMES[0], &segment(7, 9, 50));
        upload_from(&mut fleet.bucket().with_keys(&keys(new_is_encrypted)), &mut source).unwrap();
        assert!(fleet.get(&form(new_is_encrypted)) != old);
        assert!(fleet.names().iter().any(|name| fleet.get(name) == old), "{:?}", fleet.names());
        let here = tempdir().unwrap();
        assert_eq!(pull(&fleet, &decrypting(KITCHEN), here.path()).files, 1);
        assert_same(robot.path(), here.path(), &NAMES[..1]);
    }
}

#[test]
fn a_repeated_pull_transfers_nothing() {
    let fleet = Fleet::in_memory();
    let here = tempdir().unwrap();
    upload(&fleet, robot().path());
    pull(&fleet, &decrypting(KITCHEN), here.path());
    let report = pull(&fleet, &decrypting(KITCHEN), here.path());
    assert_eq!((report.files, report.bytes, report.there), (0, 0, 3));
    // Without its index, the files are compared by their digests.
    fs::remove_file(here.path().join("pulled.json")).unwrap();
    let report = pull(&fleet, &decrypting(KITCHEN), here.path());
    assert_eq!((report.files, report.bytes), (3, 0));
    for entry in fleet.bucket().with_keys(&decrypting(KITCHEN)).list().unwrap().entries {
        let file = fs::read(here.path().join(entry.name.as_str())).unwrap();
        assert_eq!(entry.pulled_digest(), Some(Digest::of(&file)), "{}", entry.name);
    }
}

#[test]
fn an_interrupted_pull_resumes_at_the_byte() {
    let whole = segment(3, 30, 20_000);
    let fleet = Fleet::in_memory();
    uploaded(&fleet, &whole);
    for have in [1, CHUNK - 1, CHUNK, CHUNK + 1, 3 * CHUNK, whole.len() - 1] {
        let here = tempdir().unwrap();
        fs::create_dir(here.path().join("monday")).unwrap();
        let part = here.path().join(format!("{}.part", NAMES[0]));
        fs::write(part, &whole[..have]).unwrap();
        let report = pull(&fleet, &decrypting(KITCHEN), here.path());
        assert_eq!((report.files, report.bytes), (1, (whole.len() - have) as u64), "{have}");
        assert!(fs::read(here.path().join(NAMES[0])).unwrap() == whole, "{have}");
    }
}

#[test]
fn no_flipped_bit_and_no_truncation_becomes_a_finished_file() {
    let fleet = Fleet::in_memory();
    let object = uploaded(&fleet, &segment(1, 1, 8));
    let here = tempdir().unwrap();
    let flipped = (0..object.len()).map(|at| {
        let mut changed = object.clone();
        changed[at] ^= 1 << (at % 8);
        changed
    });
    let truncated = (0..object.len()).map(|length| object[..length].to_vec());
    let longer = [[&object[..], &[0]].concat()];
    for (number, changed) in flipped.chain(truncated).chain(longer).enumerate() {
        fleet.put(&encrypted(NAMES[0]), &changed);
        let report = pull(&fleet, &decrypting(KITCHEN), here.path());
        assert_eq!((report.files, report.unread.len()), (0, 1), "{number}: {report:?}");
        let why = &report.unread[0];
        assert!(why.starts_with(&encrypted(NAMES[0])), "{why}");
    }
    assert_eq!(finished(here.path()), [""; 0]);
    fleet.put(&encrypted(NAMES[0]), &object);
    assert_eq!(pull(&fleet, &decrypting(KITCHEN), here.path()).files, 1);
}

#[test]
fn a_segment_that_is_damaged_in_the_middle_is_left_out_and_read_again_when_it_changes() {
    let whole = segment(1, 30, 20_000);
    let fleet = Fleet::in_memory();
    let here = tempdir().unwrap();
    let object = uploaded(&fleet, &whole);
    fleet.put(NAMES[1], &segment(2, SMALL, 100));
    let mut damaged = object.clone();
    damaged[object.len() / 2] ^= 0x10;
    fleet.put(&encrypted(NAMES[0]), &damaged);
    let mut bucket = fleet.bucket().with_keys(&decrypting(KITCHEN));
    let mut progress = ProgressHook::on_received(|| {});
    let report =
        pull_with_progress(&mut bucket, here.path(), Options::default(), &mut progress).unwrap();
    let warnings = progress.warnings();
    assert!(warnings.iter().any(|text| text.contains("is pulled once more")), "{warnings:?}");
    assert_eq!((report.files, report.unread.len()), (1, 1));
    let way = "damaged or incomplete in the store (decryption error); remove this object";
    assert!(report.unread[0].contains(way), "{report:?}");
    assert_eq!(finished(here.path()), ["recording_0001.mcap"]);
    // It is known to be damaged, and nothing is read of it.
    let report = pull_into(&mut bucket, here.path(), Options::default()).unwrap();
    assert_eq!((report.files, report.bytes, report.unread.len()), (0, 0, 1));
    fleet.put(&encrypted(NAMES[0]), &object);
    let report = pull_into(&mut bucket, here.path(), Options::default()).unwrap();
    assert_eq!((report.files, report.unread.len()), (1, 0));
    assert!(fs::read(here.path().join(NAMES[0])).unwrap() == whole);
}

#[test]
fn an_object_that_ends_with_a_whole_chunk_too_early_is_left_out() {
    let fleet = Fleet::in_memory();
    let here = tempdir().unwrap();
    let object = uploaded(&fleet, &segment(1, 30, 20_000));
    let chunks = object.len() / ENCRYPTED_CHUNK;
    let start = object.windows(5).position(|window| window == b"\n--- ").unwrap() + 5 + 43 + 1 + 16;
    for kept in 1..=chunks {
        fleet.put(&encrypted(NAMES[0]), &object[..start + kept * ENCRYPTED_CHUNK]);
        let report = pull(&fleet, &decrypting(KITCHEN), here.path());
        assert_eq!((report.files, report.unread.len()), (0, 1), "{kept}: {report:?}");
    }
    assert!(chunks > 5 && finished(here.path()).is_empty());
}

#[test]
fn a_wrong_digest_of_the_segment_is_noticed() {
    let fleet = Fleet::in_memory();
    let here = tempdir().unwrap();
    uploaded(&fleet, &segment(1, SMALL, 100));
    let line = format!("{}  recording_0000.mcap\n", Digest::of(b"something else"));
    fleet.put(&format!("{}.age.blake3", NAMES[0]), line.as_bytes());
    let mut bucket = fleet.bucket().with_keys(&decrypting(KITCHEN));
    let error = pull_into(&mut bucket, here.path(), Options::default()).unwrap_err();
    assert!(matches!(error, StoreError::Digest { .. }), "{error}");
    assert_eq!(finished(here.path()), [""; 0]);
}

#[test]
fn a_segment_that_the_tool_age_encrypted_is_pulled() {
    let fleet = Fleet::in_memory();
    let here = tempdir().unwrap();
    // `age -r KITCHEN -o made_by_age.mcap.age FILE` of age 1.1.1, which is written in Go.
    fleet.put(&encrypted(NAMES[0]), include_bytes!("made_by_age.mcap.age"));
    let report = pull(&fleet, &decrypting(KITCHEN), here.path());
    assert_eq!((report.files, report.unread), (1, vec![]));
    let file = fs::read(here.path().join(NAMES[0])).unwrap();
    assert_eq!(Digest::of(&file).to_string(), MADE_BY_AGE);
}

/// The digest of the segment that `age` encrypted.
const MADE_BY_AGE: &str = "b42b1328c63bc2fd083a2cf3f3294f4986a58d361b608faef9b16ec06e73b8f0";
