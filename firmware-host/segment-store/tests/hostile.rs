//! The other side means harm, or is of another time.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "helpers of tests")]

mod common;

use std::fs;
use std::io::{Cursor, Read, Write};

use common::{pull_into, robot};
use proptest::prelude::*;
use segment_store::pull::Options;
use segment_store::source::{Remote, Source};
use segment_store::wire::{
    MAX_REPLY, Refusal, RefusalKind, Reply, Request, WireError, read_frame, write_frame,
};
use segment_store::{
    CpuFeatures, Digest, Entry, ErrorKind, LocalCopy, Name, Pulled, Root, State, StoreError,
};
use tempfile::tempdir;

fn frames(replies: &[Reply<'_>]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for reply in replies {
        write_frame(&mut bytes, &mut Vec::new(), |body| reply.encode(body)).unwrap();
    }
    bytes
}

fn requests(requests: &[Request]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for request in requests {
        write_frame(&mut bytes, &mut Vec::new(), |body| request.encode(body)).unwrap();
    }
    bytes
}

/// What a served buffer answers to these bytes.
fn served(root: &Root, bytes: &[u8]) -> Vec<u8> {
    let mut answer = Vec::new();
    let _ =
        segment_store::serve(root, CpuFeatures { aes: true }, &mut Cursor::new(bytes), &mut answer);
    answer
}

fn refusal(mut answer: &[u8]) -> Option<Refusal> {
    let (mut body, mut last) = (Vec::new(), None);
    while let Ok(Ok(Some(kind))) = read_frame(&mut answer, &mut body, MAX_REPLY) {
        if let Ok(Reply::Refused(refusal)) = Reply::decode(kind, &body) {
            last = Some(refusal);
        }
    }
    last
}

const HELLO: Request = Request::Hello { versions: (1, 1) };

#[test]
fn a_robot_says_what_computer_it_is_and_an_older_one_is_not_asked() {
    let (dir, asked) = (
        tempdir().unwrap(),
        requests(&[Request::Hello { versions: (1, 2) }, Request::CpuFeatures]),
    );
    let answer = served(&Root::open(dir.path()).unwrap(), &asked);
    let mut output = Vec::new();
    let mut remote = Remote::greet("robot", Cursor::new(answer), &mut output, 1).unwrap();
    assert_eq!(remote.cpu_features().unwrap(), Some(CpuFeatures { aes: true }));
    assert_eq!(output, asked);
    let (older, mut output) = (frames(&[Reply::Welcome { version: 1 }]), Vec::new());
    assert_eq!(
        Remote::greet("robot", Cursor::new(older), &mut output, 1).unwrap().cpu_features().unwrap(),
        None
    );
    assert_eq!(output, requests(&[Request::Hello { versions: (1, 2) }]));
}

#[test]
fn a_list_of_more_bytes_than_can_be_counted_is_pulled_like_any_other() {
    let here = tempdir().unwrap();
    let entries = ["recording_0000.mcap", "recording_0001.mcap"]
        .map(|name| Reply::Entry(entry(name, u64::MAX)));
    let mut replies = vec![Reply::Welcome { version: 1 }];
    replies.extend(entries);
    replies.push(Reply::ListEnd);
    let mut remote = Remote::greet("robot", Cursor::new(frames(&replies)), Vec::new(), 1).unwrap();
    let error = pull_into(&mut remote, here.path(), Options::default()).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Link, "{error}");
}

#[test]
fn a_workstation_of_another_time_is_refused_with_words() {
    let dir = tempdir().unwrap();
    let root = Root::open(dir.path()).unwrap();
    for versions in [(3, 4), (0, 0), (900, 901), (3, 2)] {
        let refusal =
            refusal(&served(&root, &requests(&[Request::Hello { versions }, Request::List])))
                .unwrap();
        assert_eq!(refusal.kind, RefusalKind::Version);
        assert!(refusal.text.contains("install the same release"), "{refusal}");
    }
    assert!(refusal(&served(&root, &requests(&[Request::Hello { versions: (1, 9) }]))).is_none());
}

#[test]
fn a_robot_of_another_time_is_refused_with_its_words() {
    let text = "this robot speaks version 7".to_owned();
    let answer = frames(&[Reply::Refused(Refusal { kind: RefusalKind::Version, text })]);
    let error = Remote::greet("robot", Cursor::new(answer), Vec::new(), 1).err().unwrap();
    assert!(
        error.kind() == ErrorKind::Refused && error.to_string().contains("speaks version 7"),
        "{error}"
    );
}

#[test]
fn a_shell_that_talks_is_named_as_what_is_wrong() {
    let noise = b"Welcome to Robot OS 22!\nLast login: never\n".repeat(5);
    let error = Remote::greet("robot", Cursor::new(noise), Vec::new(), 1).err().unwrap();
    assert!(
        matches!(&error, StoreError::Protocol { source: WireError::Foreign(_), .. }),
        "{error}"
    );
    assert!(
        error.to_string().contains("Welcome to Robot OS") && error.to_string().contains("shell"),
        "{error}"
    );
    let error = Remote::greet("robot", Cursor::new(Vec::new()), Vec::new(), 1).err().unwrap();
    assert!(
        matches!(error, StoreError::Silent { .. })
            && error.to_string().contains("--remote-command"),
        "{error}"
    );
}

#[test]
fn a_request_before_the_greeting_or_with_a_name_that_leads_out_is_refused() {
    let dir = tempdir().unwrap();
    robot(dir.path());
    fs::write(dir.path().join("secret"), "secret").unwrap();
    let root = Root::open(&dir.path().join("monday")).unwrap();
    assert_eq!(
        refusal(&served(&root, &requests(&[Request::List]))).unwrap().kind,
        RefusalKind::Malformed
    );
    for name in [
        "../secret",
        "/etc/passwd",
        "../tuesday/recording_0000.mcap",
        "..",
        "recording_0000.mcap\0",
        "",
    ] {
        let mut bytes = requests(&[HELLO]);
        write_frame(&mut bytes, &mut Vec::new(), |body| {
            body.extend_from_slice(&[0; 40]);
            body.extend_from_slice(name.as_bytes());
            3
        })
        .unwrap();
        let answer = served(&root, &bytes);
        assert_eq!(refusal(&answer).unwrap().kind, RefusalKind::Malformed, "{name}");
        assert!(answer.len() < 400);
    }
}

#[test]
fn a_refusal_cannot_speak_to_the_terminal() {
    let refusal = Refusal { kind: RefusalKind::Disk, text: "full\x1b]0;owned\x07\r\n".to_owned() };
    assert_eq!(refusal.to_string(), "full]0;owned");
}

fn entry(name: &str, bytes: u64) -> Entry {
    Entry {
        name: Name::parse(name).unwrap(),
        bytes,
        modified_ns: 5,
        state: State::Closed,
        times: None,
        turns: Some(3),
        events: None,
        keep: true,
        pulled: Pulled::No,
    }
}

/// Pulls from a robot that answers this after the greeting and the list of one file.
fn pull_from(replies: &[Reply<'_>]) -> (Result<u64, StoreError>, tempfile::TempDir) {
    let here = tempdir().unwrap();
    let mut answer = frames(&[
        Reply::Welcome { version: 1 },
        Reply::Entry(entry("recording_0000.mcap", 10)),
        Reply::ListEnd,
    ]);
    answer.extend(frames(replies));
    let mut source = Remote::greet("robot", Cursor::new(answer), Vec::new(), 1).unwrap();
    let result = pull_into(&mut source, here.path(), Options::default()).map(|report| report.files);
    (result, here)
}

#[test]
fn a_robot_that_breaks_the_rules_gets_no_file_a_name() {
    let digest = Digest::of(b"0123456789");
    let start = Reply::Start { from: 0, length: 10 };
    let data = |at, bytes| Reply::Data { at, bytes };
    let good =
        [start.clone(), data(0, b"01234"), data(5, b"56789"), Reply::End { digest }, Reply::Marked];
    let (result, here) = pull_from(&good);
    assert_eq!(result.unwrap(), 1);
    assert_eq!(fs::read(here.path().join("recording_0000.mcap")).unwrap(), b"0123456789");
    let bad: [&[Reply<'_>]; 11] = [
        &[Reply::End { digest }],
        &[data(0, b"01234")],
        &[start.clone(), data(5, b"56789"), data(0, b"01234"), Reply::End { digest }],
        &[start.clone(), data(0, b"01234"), data(0, b"01234"), Reply::End { digest }],
        &[start.clone(), data(0, b"0123456789ab"), Reply::End { digest }],
        &[start.clone(), data(0, b"0123456789"), Reply::End { digest: Digest::of(b"other") }],
        &[start.clone(), data(0, b"01234"), Reply::End { digest }],
        &[start.clone(), data(0, b""), data(0, b"")],
        &[Reply::Start { from: 3, length: 10 }],
        &[Reply::Start { from: 10, length: 0 }],
        &[Reply::Comparing, Reply::Comparing, Reply::Comparing, Reply::Comparing],
    ];
    for replies in bad {
        let (result, here) = pull_from(replies);
        assert!(result.is_err(), "{replies:?}");
        assert!(!here.path().join("recording_0000.mcap").exists(), "{replies:?}");
    }
}

#[test]
fn an_endless_list_ends() {
    struct Endless(Cursor<Vec<u8>>, Vec<u8>);
    impl Read for Endless {
        fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
            let read = self.0.read(buffer)?;
            if read == 0 && !buffer.is_empty() {
                self.0 = Cursor::new(self.1.clone());
                return self.0.read(buffer);
            }
            Ok(read)
        }
    }
    let first = frames(&[Reply::Welcome { version: 1 }]);
    let more = frames(&[Reply::Entry(entry("recording_0000.mcap", 1))]);
    let mut source =
        Remote::greet("robot", Endless(Cursor::new(first), more), Vec::new(), 1).unwrap();
    let error = source.list().unwrap_err().to_string();
    assert!(error.contains("a list, out of turn"), "{error}");
}

fn any_name() -> impl Strategy<Value = Name> {
    "([a-z]{1,9}/)?recording_[0-9]{4,6}\\.mcap"
        .prop_filter_map("a name", |text| Name::parse(&text).ok())
}

proptest! {
    #[test]
    fn requests_come_back_from_their_bytes(name in any_name(), bytes: u64, digest: [u8; 32], versions: (u16, u16)) {
        let digest = Digest::from_bytes(digest);
        let all = [
            Request::Hello { versions }, Request::List, Request::Fetch { name: name.clone(), local: LocalCopy { bytes, digest } },
            Request::Mark { name, digest }, Request::CpuFeatures,
        ];
        for request in all {
            let mut body = Vec::new();
            let kind = request.encode(&mut body);
            prop_assert_eq!(Request::decode(kind, &body), Ok(request));
        }
    }

    #[test]
    fn replies_come_back_from_their_bytes(name in any_name(), numbers: [u64; 5], digest: [u8; 32], flags: [bool; 4], data: Vec<u8>) {
        let digest = Digest::from_bytes(digest);
        let [bytes, modified_ns, first_ns, last_ns, turns] = numbers;
        let entry = Entry {
            name, bytes, modified_ns, state: State::Cut, times: flags[0].then_some(segment_store::Times { first_ns, last_ns }),
            ticks: flags[1].then_some(turns), events: flags[2].then_some(bytes), keep: flags[3],
            pulled: if flags[0] { Pulled::Yes(digest) } else { Pulled::Stale },
        };
        let computer = Reply::CpuFeatures(CpuFeatures { aes: flags[1] });
        let data = Reply::Data { at: bytes, bytes: &data };
        for reply in [Reply::Entry(entry), data, Reply::End { digest }, Reply::Marked, computer] {
            let mut body = Vec::new();
            let kind = reply.encode(&mut body);
            prop_assert_eq!(Reply::decode(kind, &body), Ok(reply));
        }
    }

    #[test]
    fn any_bytes_are_a_message_or_an_error(kind: u8, body: Vec<u8>) {
        let _ = Request::decode(kind, &body);
        let _ = Reply::decode(kind, &body);
    }

    #[test]
    fn a_served_buffer_survives_any_bytes_and_ends(bytes: Vec<u8>, greet: bool) {
        let dir = tempdir().unwrap();
        let root = Root::open(dir.path()).unwrap();
        let mut all = if greet { requests(&[HELLO]) } else { Vec::new() };
        all.extend(bytes);
        served(&root, &all);
        prop_assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
    }

    #[test]
    fn a_workstation_survives_any_bytes_and_writes_no_segment(bytes: Vec<u8>) {
        let here = tempdir().unwrap();
        let mut answer = frames(&[Reply::Welcome { version: 1 }, Reply::Entry(entry("recording_0000.mcap", 10)), Reply::ListEnd]);
        answer.write_all(&bytes).unwrap();
        let mut source = Remote::greet("robot", Cursor::new(answer), Vec::new(), 1).unwrap();
        prop_assert!(pull_into(&mut source, here.path(), Options::default()).is_err());
        prop_assert!(!here.path().join("recording_0000.mcap").exists());
    }
}
