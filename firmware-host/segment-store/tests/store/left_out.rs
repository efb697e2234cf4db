//! What cannot be read is named and never left out in silence, and an output replaces nothing.

use std::fs::{self, File, Permissions};
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::{Path, PathBuf};

use crate::common::{CHUNK_TICKS, robot, segment};
use rustix::thread::{CapabilitySet, capabilities, set_capabilities};
use segment_store::export::{mcap, tum, viewer};
use segment_store::{Catalogue, ErrorKind, StoreError, recover_file};

/// The three segments of the run `monday`: 30, 30 and 20 ticks.
fn monday(dir: &Path) -> Vec<PathBuf> {
    robot(dir);
    (0..3).map(|number| dir.join(format!("monday/recording_{number:04}.mcap"))).collect()
}

fn names(dir: &Path) -> Vec<String> {
    let mut names: Vec<_> = fs::read_dir(dir)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}

fn listed(dir: &Path) -> (usize, Vec<String>) {
    let (_, catalogue) = Catalogue::open(dir).unwrap();
    (catalogue.entries.len(), catalogue.unread.iter().map(ToString::to_string).collect())
}

#[test]
fn a_segment_that_is_a_link_is_named_instead_of_left_out_in_silence() {
    let dir = tempfile::tempdir().unwrap();
    let segments = monday(dir.path());
    let moved = dir.path().join("moved.mcap");
    fs::rename(&segments[1], &moved).unwrap();
    symlink(&moved, &segments[1]).unwrap();
    let (readable, unread) = listed(dir.path());
    assert_eq!((readable, unread.len()), (3, 1));
    let start = format!("cannot read {}: it is a symbolic link", segments[1].display());
    assert!(unread[0].starts_with(&start), "{unread:?}");
    let (_, catalogue) = Catalogue::open(dir.path()).unwrap();
    assert_eq!(catalogue.gaps(), [], "it is there, although it cannot be read");
}

/// Root reads everything. This thread gives that up, so that the test means the same in a container, where everybody is root.
fn obey_modes() {
    let mut sets = capabilities(None).unwrap();
    sets.effective -= CapabilitySet::DAC_OVERRIDE | CapabilitySet::DAC_READ_SEARCH;
    set_capabilities(None, sets).unwrap();
}

#[test]
fn what_belongs_to_another_account_is_named_with_the_account_that_can_read_it() {
    let dir = tempfile::tempdir().unwrap();
    let segments = monday(dir.path());
    obey_modes();
    fs::set_permissions(&segments[1], Permissions::from_mode(0o0)).unwrap();
    assert!(File::open(&segments[1]).is_err());
    let tuesday = dir.path().join("tuesday");
    fs::create_dir(dir.path().join("lost+found")).unwrap();
    for (folder, mode) in [("tuesday", 0), ("lost+found", 0)] {
        fs::set_permissions(dir.path().join(folder), Permissions::from_mode(mode)).unwrap();
    }
    let (readable, mut unread) = listed(dir.path());
    unread.sort();
    assert_eq!((readable, unread.len()), (2, 2), "{unread:?}");
    for (path, said) in [&segments[1], &tuesday].into_iter().zip(&unread) {
        assert!(said.starts_with(&format!("cannot read {}: ", path.display())), "{said}");
        assert!(said.contains("sudo -u embodied-depth"), "{said}");
    }
    // It may be listed, but not entered.
    fs::set_permissions(&tuesday, Permissions::from_mode(0o400)).unwrap();
    let (readable, mut again) = listed(dir.path());
    // The order is that of the file system.
    again.sort();
    assert_eq!((readable, &again), (2, &unread));
    let alone = Catalogue::open(&tuesday).unwrap_err().to_string();
    assert_eq!(alone, unread[1]);
    for folder in ["tuesday", "lost+found"] {
        fs::set_permissions(dir.path().join(folder), Permissions::from_mode(0o700)).unwrap();
    }
}

#[test]
fn segments_that_are_missing_between_others_are_known() {
    let dir = tempfile::tempdir().unwrap();
    let segments = monday(dir.path());
    assert!(gaps(dir.path()).is_empty());
    fs::remove_file(&segments[1]).unwrap();
    assert_eq!(gaps(dir.path()), ["monday/recording_0001.mcap"]);
    fs::rename(&segments[2], dir.path().join("monday/recording_10000.mcap")).unwrap();
    assert_eq!(gaps(dir.path()), ["monday/recording_0001.mcap to recording_9999.mcap"]);
    // The robot deletes the oldest segments first: a run that lacks its first segments has no gap.
    fs::remove_file(&segments[0]).unwrap();
    assert!(gaps(dir.path()).is_empty());
}

fn gaps(dir: &Path) -> Vec<String> {
    let (_, catalogue) = Catalogue::open(dir).unwrap();
    catalogue.gaps().iter().map(ToString::to_string).collect()
}

#[test]
fn an_export_counts_cut_segments_and_damaged_chunks() {
    let dir = tempfile::tempdir().unwrap();
    let segments = monday(dir.path());
    let whole = mcap(&segments, &dir.path().join("whole.mcap")).unwrap();
    assert_eq!((whole.ticks, whole.cut, whole.bad_chunks), (80, 0, 0));
    let mut bytes = fs::read(&segments[1]).unwrap();
    bytes.truncate(bytes.len() * 3 / 4);
    fs::write(&segments[1], &bytes).unwrap();
    let done = mcap(&segments, &dir.path().join("cut.mcap")).unwrap();
    assert_eq!((done.ticks, done.cut, done.bad_chunks), (50 + 2 * CHUNK_TICKS, 1, 0));
    let done = viewer(&segments, &dir.path().join("viewer.mcap")).unwrap();
    assert_eq!((done.ticks, done.cut, done.bad_chunks), (50 + 2 * CHUNK_TICKS, 1, 0));
    assert_eq!(tum(&segments, &dir.path().join("tum")).unwrap().cut, 1);
    let mut bytes = fs::read(&segments[0]).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&segments[0], &bytes).unwrap();
    let done = mcap(&segments, &dir.path().join("damaged.mcap")).unwrap();
    assert_eq!((done.cut, done.bad_chunks), (1, 1));
}

/// All exports, into outputs that do not exist.
fn all_exports(segments: &[PathBuf], dir: &Path) -> Vec<Result<(), StoreError>> {
    vec![
        mcap(segments, &dir.join("out.mcap")).map(drop),
        viewer(segments, &dir.join("viewer.mcap")).map(drop),
        tum(segments, &dir.join("tum")).map(drop),
    ]
}

#[test]
fn an_export_without_a_tick_is_refused_and_leaves_nothing_behind() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("recording_0000.mcap");
    let whole = segment(0, 0, 30);
    // An empty file, and one that was cut in its second chunk, behind the header.
    for length in [0, 3000] {
        fs::write(&path, &whole[..length]).unwrap();
        for refused in all_exports(std::slice::from_ref(&path), dir.path()) {
            let error = refused.unwrap_err();
            let said = error.to_string();
            assert_eq!(error.kind(), ErrorKind::Usage, "{said}");
            assert!(said.starts_with(&path.display().to_string()), "{said}");
            assert!(said.contains("nothing to export"), "{said}");
        }
        assert_eq!(names(dir.path()), ["recording_0000.mcap"]);
    }
}

#[test]
fn segments_that_were_renamed_out_of_order_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let segments = monday(dir.path());
    let between = dir.path().join("between");
    for (from, to) in
        [(&segments[0], &between), (&segments[1], &segments[0]), (&between, &segments[1])]
    {
        fs::rename(from, to).unwrap();
    }
    for refused in all_exports(&segments, dir.path()) {
        let said = refused.unwrap_err().to_string();
        assert!(said.contains("recording_0001.mcap: begins at tick 0"), "{said}");
        assert!(said.contains("recording_0000.mcap before it at tick 30"), "{said}");
    }
}

#[test]
fn nothing_of_the_user_is_deleted_or_overwritten_by_a_temporary_output() {
    let dir = tempfile::tempdir().unwrap();
    let segments = monday(dir.path());
    fs::create_dir(dir.path().join("tum.partial")).unwrap();
    fs::write(dir.path().join("tum.partial/photo"), "precious").unwrap();
    fs::write(dir.path().join("out.mcap.partial"), "precious").unwrap();
    for done in all_exports(&segments, dir.path()) {
        done.unwrap();
    }
    for kept in ["tum.partial/photo", "out.mcap.partial"] {
        assert_eq!(fs::read_to_string(dir.path().join(kept)).unwrap(), "precious", "{kept}");
    }
    let partial = names(dir.path()).iter().filter(|name| name.contains(".partial")).count();
    assert_eq!(partial, 2, "{:?}", names(dir.path()));
}

#[test]
fn of_two_exports_into_one_output_one_succeeds_and_is_complete() {
    let dir = tempfile::tempdir().unwrap();
    let segments = monday(dir.path());
    let [alone, alone_mcap] = ["alone", "alone.mcap"].map(|name| dir.path().join(name));
    tum(&segments, &alone).unwrap();
    mcap(&segments, &alone_mcap).unwrap();
    for round in 0..10 {
        let to = dir.path().join(format!("tum{round}"));
        let to_mcap = dir.path().join(format!("run{round}.mcap"));
        let mut results = Vec::new();
        std::thread::scope(|scope| {
            let export = || (tum(&segments, &to).map(drop), mcap(&segments, &to_mcap).map(drop));
            let started = [scope.spawn(export), scope.spawn(export)];
            results.extend(started.map(|thread| thread.join().unwrap()));
        });
        let (folders, files): (Vec<_>, Vec<_>) = results.into_iter().unzip();
        for results in [folders, files] {
            assert_eq!(results.iter().filter(|result| result.is_ok()).count(), 1, "{results:?}");
            for refused in results.into_iter().filter_map(Result::err) {
                assert!(matches!(refused, StoreError::Exists { .. }), "{refused}");
            }
        }
        for folder in ["", "rgb"] {
            assert_eq!(names(&to.join(folder)), names(&alone.join(folder)));
        }
        assert!(fs::read(&to_mcap).unwrap() == fs::read(&alone_mcap).unwrap());
    }
    assert!(!names(dir.path()).iter().any(|name| name.contains(".partial")));
}

#[test]
fn a_segment_without_an_intact_tick_is_not_recovered_and_nothing_is_written() {
    let dir = tempfile::tempdir().unwrap();
    let from = dir.path().join("recording_0000.mcap");
    let out = dir.path().join("whole.mcap");
    let whole = segment(0, 0, 30);
    for length in [0, 3000] {
        fs::write(&from, &whole[..length]).unwrap();
        let refused = recover_file(&File::open(&from).unwrap(), &from, &out).unwrap_err();
        let said = refused.to_string();
        assert!(said.contains("recording_0000.mcap: no tick in it is intact"), "{said}");
        assert!(said.contains(&format!("({length} bytes)")), "{said}");
        assert_eq!(names(dir.path()), ["recording_0000.mcap"]);
    }
    fs::write(&from, &whole[..whole.len() * 3 / 4]).unwrap();
    let done = recover_file(&File::open(&from).unwrap(), &from, &out).unwrap();
    assert!(done.ticks > 0 && done.cut == 1, "{done:?}");
}

#[test]
fn an_output_in_a_folder_that_is_not_there_says_how_to_go_on_and_nothing_about_pulls() {
    let dir = tempfile::tempdir().unwrap();
    let segments = monday(dir.path());
    let to = dir.path().join("nosuchdir/x.mcap");
    let said = mcap(&segments, &to).unwrap_err().to_string();
    assert!(said.contains("nosuchdir/x.mcap") && said.contains("create the folder"), "{said}");
    assert!(!said.contains("pull"), "{said}");
}
