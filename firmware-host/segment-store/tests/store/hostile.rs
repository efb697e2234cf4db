//! A hostile peer, or one with another protocol version.

use std::fs;
use std::io::{Cursor, Read, Write};
use std::os::unix::fs::symlink;

use crate::common::{pull_into, robot};
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

/// The answer of a server to these bytes.
fn served(root: &Root, bytes: &[u8]) -> Vec<u8> {
    let mut answer = Vec::new();
    let _ = segment_store::serve(
        root,
        CpuFeatures { aes: true },
        &mut |_| (),
        &mut Cursor::new(bytes),
        &mut answer,
    );
    answer
}

#[test]
fn each_segment_that_is_sent_is_named_first_and_no_other() {
    let dir = tempdir().unwrap();
    robot(dir.path());
    let fetch =
        |name: &str| Request::Fetch { name: Name::parse(name).unwrap(), local: LocalCopy::none() };
    let asked = requests(&[
        HELLO,
        Request::List,
        fetch("monday/recording_0001.mcap"),
        fetch("monday/recording_0009.mcap"),
        fetch("tuesday/recording_0000.mcap"),
    ]);
    let mut named = Vec::new();
    segment_store::serve(
        &Root::open(dir.path()).unwrap(),
        CpuFeatures { aes: true },
        &mut |name: &Name| named.push(name.to_string()),
        &mut Cursor::new(asked),
        &mut Vec::new(),
    )
    .unwrap();
    assert_eq!(named, ["monday/recording_0001.mcap", "tuesday/recording_0000.mcap"]);
}

fn refusal(mut answer: &[u8]) -> Option<Refusal> {
    let mut body = Vec::new();
    let mut last = None;
    while let Ok(Ok(Some(kind))) = read_frame(&mut answer, &mut body, MAX_REPLY) {
        if let Ok(Reply::Refused(refusal)) = Reply::decode(kind, &body) {
            last = Some(refusal);
        }
    }
    last
}

const HELLO: Request = Request::Hello { versions: (1, 1) };

#[test]
fn a_robot_reports_its_processor_and_an_older_one_is_not_asked() {
    let dir = tempdir().unwrap();
    let asked = requests(&[Request::Hello { versions: (1, 3) }, Request::CpuFeatures]);
    let answer = served(&Root::open(dir.path()).unwrap(), &asked);
    let mut output = Vec::new();
    let mut remote = Remote::greet("robot", Cursor::new(answer), &mut output, 1).unwrap();
    assert_eq!(remote.cpu_features().unwrap(), Some(CpuFeatures { aes: true }));
    assert_eq!(output, asked);
    let older = frames(&[Reply::Welcome { version: 1 }]);
    let mut output = Vec::new();
    assert_eq!(
        Remote::greet("robot", Cursor::new(older), &mut output, 1).unwrap().cpu_features().unwrap(),
        None
    );
    assert_eq!(output, requests(&[Request::Hello { versions: (1, 3) }]));
}

#[test]
fn an_older_workstation_is_not_told_what_cannot_be_read_because_it_does_not_know_the_reply() {
    let dir = tempdir().unwrap();
    robot(dir.path());
    symlink("recording_0000.mcap", dir.path().join("monday/recording_0009.mcap")).unwrap();
    let root = Root::open(dir.path()).unwrap();
    assert_eq!(unread(&root, 2), [""; 0]);
    let [said] = unread(&root, 3).try_into().unwrap();
    assert!(said.contains("monday/recording_0009.mcap: it is a symbolic link"), "{said}");
}

fn unread(root: &Root, newest: u16) -> Vec<String> {
    let answer =
        served(root, &requests(&[Request::Hello { versions: (1, newest) }, Request::List]));
    Remote::greet("robot", Cursor::new(answer), Vec::new(), 1).unwrap().list().unwrap().unread
}

#[test]
fn what_a_hostile_robot_cannot_read_controls_no_terminal() {
    let replies = [
        Reply::Welcome { version: 3 },
        Reply::Unread("\x1b]0;title\x07cannot read".to_owned()),
        Reply::ListEnd,
    ];
    let mut remote = Remote::greet("robot", Cursor::new(frames(&replies)), Vec::new(), 1).unwrap();
    assert_eq!(remote.list().unwrap().unread, ["]0;titlecannot read"]);
}

#[test]
fn sizes_that_overflow_their_sum_do_not_stop_a_pull() {
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
fn a_workstation_with_another_protocol_version_is_refused_with_a_way_out() {
    let dir = tempdir().unwrap();
    let root = Root::open(dir.path()).unwrap();
    for versions in [(4, 5), (0, 0), (900, 901), (3, 2)] {
        let refusal =
            refusal(&served(&root, &requests(&[Request::Hello { versions }, Request::List])))
                .unwrap();
        assert_eq!(refusal.kind, RefusalKind::Version);
        assert!(refusal.text.contains("install the same release"), "{refusal}");
    }
    assert!(refusal(&served(&root, &requests(&[Request::Hello { versions: (1, 9) }]))).is_none());
}

#[test]
fn a_robot_with_another_protocol_version_is_refused_with_its_message() {
    let text = "this robot speaks version 7".to_owned();
    let answer = frames(&[Reply::Refused(Refusal { kind: RefusalKind::Version, text })]);
    let error = Remote::greet("robot", Cursor::new(answer), Vec::new(), 1).err().unwrap();
    assert!(
        error.kind() == ErrorKind::Refused && error.to_string().contains("speaks version 7"),
        "{error}"
    );
}

#[test]
fn output_of_a_shell_is_reported_as_the_cause() {
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
        matches!(error, StoreError::Silent { .. }) && error.to_string().contains("--program"),
        "{error}"
    );
}

#[test]
fn requests_before_the_greeting_and_names_outside_the_store_are_refused() {
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
fn a_refusal_is_shown_without_control_characters() {
    let refusal = Refusal { kind: RefusalKind::Disk, text: "full\x1b]0;owned\x07\r\n".to_owned() };
    assert_eq!(refusal.to_string(), "full]0;owned");
}

fn entry(name: &str, bytes: u64) -> Entry {
    let entry = Entry::new(Name::parse(name).unwrap(), bytes, 5);
    Entry { state: State::Closed, ticks: Some(3), keep: true, ..entry }
}

/// Pulls from a robot that sends these replies after the greeting and a list of one file.
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
fn a_robot_that_violates_the_protocol_completes_no_file() {
    let digest = Digest::of(b"0123456789");
    let start = Reply::Start { from: 0, length: 10 };
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

fn data(at: u64, bytes: &[u8]) -> Reply<'_> {
    Reply::Data { at, bytes }
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
    assert!(error.contains("a list, which is not an answer"), "{error}");
}

fn any_name() -> impl Strategy<Value = Name> {
    "([a-z]{1,9}/)?recording_[0-9]{4,6}\\.mcap"
        .prop_filter_map("a name", |text| Name::parse(&text).ok())
}

proptest! {
    #[test]
    fn requests_survive_encoding_and_decoding(name in any_name(), bytes: u64, digest: [u8; 32], versions: (u16, u16)) {
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
    fn replies_survive_encoding_and_decoding(name in any_name(), numbers: [u64; 5], digest: [u8; 32], flags: [bool; 4], data: Vec<u8>) {
        let digest = Digest::from_bytes(digest);
        let [bytes, modified_ns, first_ns, last_ns, ticks] = numbers;
        let entry = Entry {
            name, bytes, modified_ns, state: State::Cut, times: flags[0].then_some(segment_store::Times { first_ns, last_ns }),
            ticks: flags[1].then_some(ticks), events: flags[2].then_some(bytes), keep: flags[3],
            pulled: if flags[0] { Pulled::Yes(digest) } else { Pulled::Stale },
        };
        let cpu = Reply::CpuFeatures(CpuFeatures { aes: flags[1] });
        let unread = Reply::Unread(format!("cannot read {}", entry.name));
        let data = Reply::Data { at: bytes, bytes: &data };
        for reply in [Reply::Entry(entry), unread, data, Reply::End { digest }, Reply::Marked, cpu] {
            let mut body = Vec::new();
            let kind = reply.encode(&mut body);
            prop_assert_eq!(Reply::decode(kind, &body), Ok(reply));
        }
    }

    #[test]
    fn decoding_arbitrary_bytes_never_panics(kind: u8, body: Vec<u8>) {
        let _ = Request::decode(kind, &body);
        let _ = Reply::decode(kind, &body);
    }

    #[test]
    fn a_server_survives_arbitrary_bytes_and_ends(bytes: Vec<u8>, greet: bool) {
        let dir = tempdir().unwrap();
        let root = Root::open(dir.path()).unwrap();
        let mut all = if greet { requests(&[HELLO]) } else { Vec::new() };
        all.extend(bytes);
        served(&root, &all);
        prop_assert_eq!(fs::read_dir(dir.path()).unwrap().count(), 0);
    }

    #[test]
    fn a_workstation_survives_arbitrary_bytes_and_completes_no_segment(bytes: Vec<u8>) {
        let here = tempdir().unwrap();
        let mut answer = frames(&[Reply::Welcome { version: 1 }, Reply::Entry(entry("recording_0000.mcap", 10)), Reply::ListEnd]);
        answer.write_all(&bytes).unwrap();
        let mut source = Remote::greet("robot", Cursor::new(answer), Vec::new(), 1).unwrap();
        prop_assert!(pull_into(&mut source, here.path(), Options::default()).is_err());
        prop_assert!(!here.path().join("recording_0000.mcap").exists());
    }
}
