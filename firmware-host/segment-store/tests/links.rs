//! Links that break, hang, damage and mix up what they carry: nothing wrong ever gets a segment's name.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "helpers of tests")]

mod common;

use std::fs;
use std::io::{self, Read};
use std::os::unix::net::UnixStream;
use std::time::Duration;

use common::{FILES, Noise, assert_same, connect, pull_into, robot, serve_on};
use segment_store::pull::Options;
use segment_store::source::Remote;
use segment_store::{ErrorKind, StoreError};
use tempfile::{TempDir, tempdir};

/// What a link does to the bytes from the robot.
enum Fault {
    /// Ends behind so many bytes.
    Cut,
    /// Flips a bit of that byte.
    Flip,
    /// Swaps two pieces there.
    Swap,
    /// Loses a piece there.
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

/// Pulls over a bad link. Whatever comes of it, what has a segment's name is what the robot has.
fn pull_badly(there: &TempDir, here: &TempDir, fault: Fault, at: u64) -> Result<(), StoreError> {
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

/// Bytes that a whole pull carries, roughly: all files and their frames.
fn carried(there: &TempDir) -> u64 {
    FILES.iter().map(|file| fs::metadata(there.path().join(file)).unwrap().len() + 100).sum()
}

#[test]
fn a_link_that_is_cut_anywhere_loses_nothing_and_the_next_pull_goes_on() {
    let there = tempdir().unwrap();
    robot(there.path());
    let (total, mut noise) = (carried(&there), Noise(3));
    for _ in 0..40 {
        let here = tempdir().unwrap();
        // Cut again and again until it is through, then compared.
        let mut tries = 0;
        while pull_badly(&there, &here, Fault::Cut, 100 + noise.below(total)).is_err() {
            tries += 1;
            assert!(tries < 200);
        }
        assert_same(there.path(), here.path(), &FILES);
    }
}

#[test]
fn what_is_changed_swapped_or_lost_anywhere_is_noticed_and_the_next_pull_mends_it() {
    let there = tempdir().unwrap();
    robot(there.path());
    let (total, mut noise) = (carried(&there), Noise(4));
    for round in 0..90 {
        let here = tempdir().unwrap();
        let fault = match round % 3 {
            0 => Fault::Flip,
            1 => Fault::Swap,
            _ => Fault::Lose,
        };
        if let Err(error) = pull_badly(&there, &here, fault, noise.below(total)) {
            assert!(error.to_string().len() > 20, "{error}");
        }
        pull_into(&mut connect(there.path()), here.path(), Options::default()).unwrap();
        assert_same(there.path(), here.path(), &FILES);
    }
}

#[test]
fn a_link_that_hangs_is_given_up_with_words() {
    let (there, here) = (tempdir().unwrap(), tempdir().unwrap());
    robot(there.path());
    // A robot that greets and then says nothing.
    let (ours, mut theirs) = UnixStream::pair().unwrap();
    ours.set_read_timeout(Some(Duration::from_millis(50))).unwrap();
    let hello = {
        let mut frame = Vec::new();
        segment_store::wire::write_frame(&mut frame, &mut Vec::new(), |body| {
            segment_store::wire::Reply::Welcome { version: 1 }.encode(body)
        })
        .unwrap();
        frame
    };
    io::Write::write_all(&mut theirs, &hello).unwrap();
    let mut source = Remote::greet("robot", ours.try_clone().unwrap(), ours, 60).unwrap();
    let error = pull_into(&mut source, here.path(), Options::default()).unwrap_err();
    assert!(
        matches!(error, StoreError::Stalled { .. }) && error.kind() == ErrorKind::Link,
        "{error}"
    );
    assert!(error.to_string().contains("check the network"), "{error}");
}
