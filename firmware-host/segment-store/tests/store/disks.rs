//! The workstation's disk fails at any operation.

use std::fs;
use std::io::{self, Read, Write};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};

use crate::common::{FILES, assert_same, connect, pull_into, robot};
use hal::VirtualClock;
use rustix::io::Errno;
use segment_store::StoreError;
use segment_store::pull::{Destination, Disk, FileSystem, Options, PartFile, pull};
use tempfile::tempdir;

/// A disk that fails with `errno` after `left` successful operations.
#[derive(Clone)]
struct Failing {
    left: Arc<AtomicI64>,
    errno: Errno,
}

impl Failing {
    fn check(&self) -> io::Result<()> {
        if self.left.fetch_sub(1, Ordering::Relaxed) <= 0 { Err(self.errno.into()) } else { Ok(()) }
    }
}

struct FailingFile(Box<dyn PartFile>, Failing);

impl Disk for Failing {
    fn open_part(&self, path: &Path) -> io::Result<Box<dyn PartFile>> {
        self.check()?;
        Ok(Box::new(FailingFile(FileSystem.open_part(path)?, self.clone())))
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.check()?;
        FileSystem.rename(from, to)
    }
}

impl Read for FailingFile {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.0.read(buffer)
    }
}

impl Write for FailingFile {
    fn write(&mut self, data: &[u8]) -> io::Result<usize> {
        if let Err(error) = self.1.check() {
            // A full disk writes the data that still fit.
            let _ = self.0.write(&data[..data.len() / 2]);
            return Err(error);
        }
        self.0.write(data)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

impl PartFile for FailingFile {
    fn truncate(&mut self, len: u64) -> io::Result<()> {
        self.1.check()?;
        self.0.truncate(len)
    }

    fn sync(&mut self) -> io::Result<()> {
        self.1.check()?;
        self.0.sync()
    }
}

#[test]
fn a_disk_error_at_any_operation_leaves_only_complete_files_and_the_next_pull_succeeds() {
    let there = tempdir().unwrap();
    robot(there.path());
    for errno in [Errno::NOSPC, Errno::IO, Errno::ROFS] {
        for operations in 0.. {
            let here = tempdir().unwrap();
            let disk = Failing { left: Arc::new(AtomicI64::new(operations)), errno };
            let result = Destination::open(here.path(), &disk).and_then(|mut to| {
                let mut source = connect(there.path());
                pull(
                    &mut source,
                    &mut to,
                    &Options::default(),
                    &mut VirtualClock::default(),
                    &mut (),
                )
            });
            for file in FILES {
                if let Ok(bytes) = fs::read(here.path().join(file)) {
                    assert!(
                        bytes == fs::read(there.path().join(file)).unwrap(),
                        "{file} after {operations}"
                    );
                }
            }
            let Err(error) = result else {
                assert!(
                    operations > 20,
                    "each of five files is opened, truncated, written, synced and renamed"
                );
                break;
            };
            assert!(matches!(error, StoreError::Write { .. }), "{error}");
            assert!(error.to_string().contains("free disk space"), "{error}");
            pull_into(&mut connect(there.path()), here.path(), Options::default()).unwrap();
            assert_same(there.path(), here.path(), &FILES);
        }
    }
}

#[test]
fn a_robot_that_cannot_write_markers_is_pulled_nevertheless() {
    let there = tempdir().unwrap();
    let here = tempdir().unwrap();
    robot(there.path());
    // A directory in the place of the marker, which even root cannot overwrite.
    for number in 0..3 {
        fs::create_dir_all(
            there.path().join(format!("monday/recording_{number:04}.mcap.pulled/full")),
        )
        .unwrap();
    }
    let report = pull_into(&mut connect(there.path()), here.path(), Options::default()).unwrap();
    assert_eq!((report.files, report.unmarked), (FILES.len() as u64, 3));
    assert_same(there.path(), here.path(), &FILES);
}
