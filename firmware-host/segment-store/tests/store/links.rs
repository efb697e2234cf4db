//! Links that break, stall, or damage and reorder data: a file is never completed with wrong contents.

use std::fs;
use std::io::{self, Read};
use std::os::unix::net::UnixStream;
use std::time::Duration;

use crate::common::{FILES, Noise, assert_same, connect, pull_into, robot, serve_on};
use segment_store::pull::Options;
use segment_store::source::Remote;
use segment_store::{ErrorKind, StoreError};
use tempfile::{TempDir, tempdir};

/// What a link does to the bytes from the robot at a given offset.
enum Fault {
    /// The connection ends there.
    Cut,
    /// Flips a bit of the byte there.
    Flip,
    /// Swaps two pieces of data there.
    Swap,
    /// Drops 13 bytes there.
    Lose,
}

struct BadLink {
    stream: UnixStream,
    fault: Fault,
    at: u64,
    read: u64,
}

impl BadLink {
    fn fill(&mut self, buffer: &mut [u8]) -> io::Result<()> {
        self.stream.read_exact(buffer)
    }
}

impl Read for BadLink {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let left = self.at.saturating_sub(self.read);
        if left > 0 {
            let count = buffer.len().min(left as usize);
            let count = self.stream.read(&mut buffer[..count])?;
            self.read += count as u64;
            return Ok(count);
        }
        if self.read > self.at {
            return self.stream.read(buffer);
        }
        self.read += 1;
        match self.fault {
            Fault::Cut => {
                self.read -= 1;
                Ok(0)
            }
            Fault::Flip => {
                self.fill(&mut buffer[..1])?;
                buffer[0] ^= 0x10;
                Ok(1)
            }
            Fault::Swap if buffer.len() >= 2 => {
                let half = (buffer.len() / 2).min(16);
                self.fill(&mut buffer[half..2 * half])?;
                self.fill(&mut buffer[..half])?;
                Ok(2 * half)
            }
            Fault::Swap => self.stream.read(buffer),
            Fault::Lose => {
                let mut lost = [0; 13];
                self.fill(&mut lost)?;
                self.stream.read(buffer)
            }
        }
    }
}

/// Pulls over a link with a fault. Files with their final name must equal the robot's, even when the pull fails.
fn pull_with_fault(
    there: &TempDir,
    here: &TempDir,
    fault: Fault,
    at: u64,
) -> Result<(), StoreError> {
    let (ours, theirs) = UnixStream::pair().unwrap();
    serve_on(there.path(), theirs);
    ours.set_read_timeout(Some(Duration::from_millis(300))).unwrap();
    let link = BadLink { stream: ours.try_clone().unwrap(), fault, at, read: 0 };
    let mut source = Remote::greet("robot", link, ours, 1)?;
    let result = pull_into(&mut source, here.path(), Options::default()).map(drop);
    for file in FILES {
        if let Ok(bytes) = fs::read(here.path().join(file)) {
            assert!(bytes == fs::read(there.path().join(file)).unwrap(), "{file}, fault at {at}");
        }
    }
    result
}

/// Roughly the number of bytes that a whole pull transfers: all files and their frames.
fn carried(there: &TempDir) -> u64 {
    FILES.iter().map(|file| fs::metadata(there.path().join(file)).unwrap().len() + 100).sum()
}

#[test]
fn a_link_cut_anywhere_loses_nothing_and_the_next_pull_resumes() {
    let there = tempdir().unwrap();
    robot(there.path());
    let total = carried(&there);
    let mut noise = Noise(3);
    for _ in 0..40 {
        let here = tempdir().unwrap();
        let mut tries = 0;
        while pull_with_fault(&there, &here, Fault::Cut, 100 + noise.below(total)).is_err() {
            tries += 1;
            assert!(tries < 200);
        }
        assert_same(there.path(), here.path(), &FILES);
    }
}

#[test]
fn damage_on_the_link_completes_no_wrong_file_and_the_next_pull_succeeds() {
    let there = tempdir().unwrap();
    robot(there.path());
    let total = carried(&there);
    let mut noise = Noise(4);
    let mut failed_pulls = 0;
    for round in 0..90 {
        let here = tempdir().unwrap();
        let fault = match round % 3 {
            0 => Fault::Flip,
            1 => Fault::Swap,
            _ => Fault::Lose,
        };
        if let Err(error) = pull_with_fault(&there, &here, fault, noise.below(total)) {
            assert!(error.to_string().len() > 20, "{error}");
            failed_pulls += 1;
        }
        pull_into(&mut connect(there.path()), here.path(), Options::default()).unwrap();
        assert_same(there.path(), here.path(), &FILES);
    }
    // Faults in the data of a file do not end the pull: the file is pulled a second time.
    println!("{failed_pulls} of 90 faults ended the pull");
    assert!(failed_pulls > 20, "{failed_pulls} of 90 faults ended the pull");
}

#[test]
fn a_stalled_link_is_an_error_with_a_way_out() {
    let there = tempdir().unwrap();
    let here = tempdir().unwrap();
    robot(there.path());
    // A robot that accepts the session and then sends nothing.
    let (ours, mut theirs) = UnixStream::pair().unwrap();
    ours.set_read_timeout(Some(Duration::from_millis(50))).unwrap();
    segment_store::wire::write_frame(&mut theirs, &mut Vec::new(), |body| {
        segment_store::wire::Reply::Welcome { version: 1 }.encode(body)
    })
    .unwrap();
    let mut source = Remote::greet("robot", ours.try_clone().unwrap(), ours, 60).unwrap();
    let error = pull_into(&mut source, here.path(), Options::default()).unwrap_err();
    assert!(
        matches!(error, StoreError::Stalled { .. }) && error.kind() == ErrorKind::Link,
        "{error}"
    );
    assert!(error.to_string().contains("check the network"), "{error}");
}
