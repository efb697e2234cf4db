//! Pulling and uploading over HTTP in the S3 protocol, with a server that can inject faults.

use std::collections::BTreeMap;
use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use super::encrypted;
use super::fleet::{SMALL, segment};
use crate::common::pull_into;
use hal::VirtualClock;
use object_store::RetryConfig;
use object_store::aws::AmazonS3Builder;
use segment_store::bucket::Bucket;
use segment_store::pull::Options;
use segment_store::source::{Directory, Source};
use segment_store::{Digest, ErrorKind, FileSink, LocalCopy, StoreError};
use tempfile::tempdir;

/// The fault that the server injects.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Fault {
    None,
    /// Every fifth response body ends in the middle.
    Cut,
    /// Listing and reading are forbidden.
    Forbidden,
    /// Writing is forbidden.
    ReadOnly,
    NoBucket,
    /// Every response has another ETag.
    OtherVersions,
}

struct State {
    objects: BTreeMap<String, Vec<u8>>,
    /// The parts of the only upload in progress.
    parts: BTreeMap<u32, Vec<u8>>,
    fault: Fault,
    answers: u64,
}

/// A server with the bucket `fleet` on loopback.
struct Server {
    state: Arc<Mutex<State>>,
    port: u16,
}

impl Server {
    fn start(fault: Fault, objects: &[(&str, Vec<u8>)]) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let objects =
            objects.iter().map(|(key, bytes)| ((*key).to_owned(), bytes.clone())).collect();
        let state =
            Arc::new(Mutex::new(State { objects, parts: BTreeMap::new(), fault, answers: 0 }));
        let shared = Arc::clone(&state);
        std::thread::spawn(move || {
            for stream in listener.incoming() {
                let state = Arc::clone(&shared);
                // The error when the client closes the connection is expected.
                std::thread::spawn(move || drop(answer(&stream.unwrap(), &state)));
            }
        });
        Self { state, port }
    }

    fn bucket(&self) -> Bucket {
        let _ = rustls::crypto::ring::default_provider().install_default();
        let retry = RetryConfig {
            max_retries: 0,
            retry_timeout: Duration::from_secs(5),
            ..RetryConfig::default()
        };
        let store = AmazonS3Builder::new()
            .with_endpoint(format!("http://127.0.0.1:{}", self.port))
            .with_allow_http(true)
            .with_bucket_name("fleet")
            .with_access_key_id("key")
            .with_secret_access_key("secret")
            .with_retry(retry)
            .build();
        Bucket::from_store(Arc::new(store.unwrap()), "kitchen".into(), "s3://fleet/kitchen")
            .unwrap()
    }
}

fn answer(mut stream: &TcpStream, state: &Mutex<State>) -> std::io::Result<()> {
    let mut reader = BufReader::new(stream);
    let mut request = String::new();
    let mut length = 0;
    let mut range = None;
    reader.read_line(&mut request)?;
    loop {
        let mut line = String::new();
        reader.read_line(&mut line)?;
        let lower = line.to_ascii_lowercase();
        if let Some(bytes) = lower.strip_prefix("range: bytes=") {
            let (from, to) = bytes.trim().split_once('-').unwrap();
            range = Some((from.parse::<usize>().unwrap(), to.parse::<usize>().unwrap() + 1));
        }
        if let Some(bytes) = lower.strip_prefix("content-length: ") {
            length = bytes.trim().parse().unwrap();
        }
        if line.trim().is_empty() {
            break;
        }
    }
    let mut body = vec![0; length];
    std::io::Read::read_exact(&mut reader, &mut body)?;
    let mut words = request.split(' ');
    let method = words.next().unwrap();
    let target = words.next().unwrap();
    let (path, query) = target.split_once('?').unwrap_or((target, ""));
    let key = path.trim_start_matches("/fleet").trim_start_matches('/').to_owned();
    let mut state = state.lock().unwrap();
    state.answers += 1;
    let (status, extra, body) = respond(&mut state, (method, query), &key, range, body);
    let cut = state.fault == Fault::Cut && state.answers.is_multiple_of(5) && body.len() > 1000;
    drop(state);
    write!(
        stream,
        "HTTP/1.1 {status}\r\nConnection: close\r\nLast-Modified: Sun, 01 Nov 2026 10:00:00 GMT\r\n\
         Content-Length: {}\r\n{extra}\r\n",
        body.len()
    )?;
    let sent = if cut { body.len() / 2 } else { body.len() };
    if method != "HEAD" {
        stream.write_all(&body[..sent])?;
    }
    stream.flush()
}

fn error_response(status: &str, code: &str) -> (String, String, Vec<u8>) {
    let body = format!("<Error><Code>{code}</Code></Error>");
    (status.to_owned(), String::new(), body.into_bytes())
}

fn etag(bytes: &[u8], version: u64) -> String {
    format!("\"{}-{version}\"", Digest::of(bytes).short())
}

fn respond(
    state: &mut State,
    (method, query): (&str, &str),
    key: &str,
    range: Option<(usize, usize)>,
    sent: Vec<u8>,
) -> (String, String, Vec<u8>) {
    match state.fault {
        Fault::Forbidden => return error_response("403 Forbidden", "AccessDenied"),
        Fault::ReadOnly if ["PUT", "POST"].contains(&method) => {
            return error_response("403 Forbidden", "AccessDenied");
        }
        Fault::NoBucket => return error_response("404 Not Found", "NoSuchBucket"),
        _ => {}
    }
    let version = if state.fault == Fault::OtherVersions { state.answers } else { 0 };
    let part = query.split('&').find_map(|word| word.strip_prefix("partNumber="));
    if let Some(part) = part {
        let header = format!("ETag: {}\r\n", etag(&sent, version));
        state.parts.insert(part.parse().unwrap(), sent);
        return ("200 OK".to_owned(), header, Vec::new());
    }
    if method == "POST" && query.starts_with("uploads") {
        let begun = b"<InitiateMultipartUploadResult><UploadId>1</UploadId></InitiateMultipartUploadResult>";
        return ("200 OK".to_owned(), String::new(), begun.to_vec());
    }
    if method == "POST" {
        let whole = std::mem::take(&mut state.parts).into_values().flatten().collect::<Vec<_>>();
        let done = "CompleteMultipartUploadResult";
        let body = format!(
            "<{done}><ETag>{}</ETag></{done}>",
            etag(&whole, version).replace('"', "&quot;")
        );
        state.objects.insert(key.to_owned(), whole);
        return ("200 OK".to_owned(), String::new(), body.into_bytes());
    }
    if method == "DELETE" {
        state.parts.clear();
        return ("204 No Content".to_owned(), String::new(), Vec::new());
    }
    if method == "PUT" {
        let header = format!("ETag: {}\r\n", etag(&sent, version));
        state.objects.insert(key.to_owned(), sent);
        return ("200 OK".to_owned(), header, Vec::new());
    }
    if key.is_empty() {
        let contents = state.objects.iter().map(|(key, bytes)| {
            format!(
                "<Contents><Key>{key}</Key><LastModified>2026-11-01T10:00:00.000Z</LastModified>\
                 <ETag>&quot;{}&quot;</ETag><Size>{}</Size></Contents>",
                etag(bytes, version).trim_matches('"'),
                bytes.len()
            )
        });
        let listing =
            format!("<ListBucketResult>{}</ListBucketResult>", contents.collect::<String>());
        return ("200 OK".to_owned(), String::new(), listing.into_bytes());
    }
    let Some(bytes) = state.objects.get(key) else {
        return error_response("404 Not Found", "NoSuchKey");
    };
    let header = format!("ETag: {}\r\n", etag(bytes, version));
    match range {
        Some((from, to)) => {
            let header =
                format!("{header}Content-Range: bytes {from}-{}/{}\r\n", to - 1, bytes.len());
            ("206 Partial Content".to_owned(), header, bytes[from..to].to_vec())
        }
        None => ("200 OK".to_owned(), header, bytes.clone()),
    }
}

#[test]
fn a_bucket_is_pulled_over_http_and_marked() {
    let whole = segment(1, 30, 400_000);
    let server = Server::start(Fault::None, &[("kitchen/run/recording_0000.mcap", whole.clone())]);
    let here = tempdir().unwrap();
    let report = pull_into(&mut server.bucket(), here.path(), Options::default()).unwrap();
    assert_eq!((report.files, report.bytes, report.unmarked), (1, whole.len() as u64, 0));
    assert!(fs::read(here.path().join("run/recording_0000.mcap")).unwrap() == whole);
    let mark =
        server.state.lock().unwrap().objects["kitchen/run/recording_0000.mcap.pulled"].clone();
    assert!(String::from_utf8(mark).unwrap().starts_with(&Digest::of(&whole).to_string()));
}

#[test]
fn broken_connections_lose_no_data_and_no_received_byte_is_requested_again() {
    // Long enough that the end that is verified without a digest is still missing when the link breaks.
    let whole = segment(1, 50, 620_000);
    let server = Server::start(Fault::Cut, &[("kitchen/run/recording_0000.mcap", whole.clone())]);
    let here = tempdir().unwrap();
    let mut breaks = 0;
    let mut received = 0;
    loop {
        let part = here.path().join("run/recording_0000.mcap.part");
        let before = fs::metadata(&part).map_or(0, |metadata| metadata.len());
        match pull_into(&mut server.bucket(), here.path(), Options::default()) {
            Ok(report) => {
                received += report.bytes;
                break;
            }
            Err(error) => {
                assert!(error.kind() == ErrorKind::Link, "{error}");
                received += fs::metadata(&part).map_or(0, |metadata| metadata.len()) - before;
            }
        }
        breaks += 1;
        assert!(breaks < 100);
    }
    assert!(breaks > 0 && received == whole.len() as u64, "{breaks} breaks, {received} bytes");
    assert!(fs::read(here.path().join("run/recording_0000.mcap")).unwrap() == whole);
}

#[test]
fn missing_permissions_and_buckets_are_reported_with_a_way_out() {
    for (fault, what) in
        [(Fault::Forbidden, "AWS_ACCESS_KEY_ID"), (Fault::NoBucket, "there is no such bucket")]
    {
        let server = Server::start(fault, &[]);
        let error = server.bucket().list().unwrap_err();
        let text = error.to_string();
        assert!(text.starts_with("s3://fleet/kitchen: ") && text.contains(what), "{text}");
        assert_eq!(error.kind(), ErrorKind::Refused, "trying again changes nothing: {text}");
    }
}

#[test]
fn a_store_that_does_not_answer_is_a_link_error() {
    let server = Server::start(Fault::None, &[]);
    let mut bucket = Server { port: 1, ..server }.bucket();
    let error = bucket.list().unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Link, "{error}");
}

#[test]
fn a_key_that_leads_out_of_the_prefix_is_refused_and_nothing_is_written() {
    for key in ["kitchen/../../recording_0000.mcap", "kitchen/run/../recording_0000.mcap"] {
        let server = Server::start(Fault::None, &[(key, segment(1, SMALL, 100))]);
        let here = tempdir().unwrap();
        let error = pull_into(&mut server.bucket(), here.path(), Options::default()).unwrap_err();
        assert!(error.to_string().contains("not a valid file name"), "{error}");
        assert_eq!(error.kind(), ErrorKind::Refused);
        let left = fs::read_dir(here.path())
            .unwrap()
            .map(|entry| entry.unwrap().file_name())
            .collect::<Vec<_>>();
        assert_eq!(left, [".pull.lock"]);
    }
}

#[test]
fn a_store_that_ignores_if_match_cannot_mix_versions() {
    let server =
        Server::start(Fault::None, &[("kitchen/run/recording_0000.mcap", segment(1, SMALL, 100))]);
    let mut bucket = server.bucket();
    let name = bucket.list().unwrap().entries[0].name.clone();
    server.state.lock().unwrap().fault = Fault::OtherVersions;
    let error = bucket.fetch(&name, LocalCopy::none(), &mut RefuseData).unwrap_err();
    assert!(error.to_string().contains("was replaced or removed while it was read"), "{error}");
    assert!(
        bucket.list().unwrap().entries.is_empty(),
        "an object that changes while it is inspected is not listed"
    );
}

/// Accepts the start of a file and fails the test when data follow.
struct RefuseData;

impl FileSink<StoreError> for RefuseData {
    fn start(&mut self, _from: u64, _length: u64) -> Result<(), StoreError> {
        Ok(())
    }
    fn data(&mut self, _at: u64, _bytes: &[u8]) -> Result<(), StoreError> {
        panic!("data of another version")
    }
    fn comparing(&mut self) -> Result<(), StoreError> {
        Ok(())
    }
}

#[test]
fn with_read_only_credentials_segments_are_pulled_and_counted_as_unmarked() {
    let server = Server::start(
        Fault::ReadOnly,
        &[("kitchen/run/recording_0000.mcap", segment(1, SMALL, 100))],
    );
    let here = tempdir().unwrap();
    let report = pull_into(&mut server.bucket(), here.path(), Options::default()).unwrap();
    assert_eq!((report.files, report.unmarked), (1, 1));
}

fn upload(
    server: &Server,
    robot: &std::path::Path,
) -> Result<segment_store::pull::Report, StoreError> {
    let mut source = Directory::open(robot).unwrap();
    server.bucket().upload(&mut source, &Options::default(), &mut VirtualClock::default(), &mut ())
}

fn robot(bytes: &[u8]) -> tempfile::TempDir {
    let robot = tempdir().unwrap();
    let path = robot.path().join("recording_0000.mcap");
    fs::write(&path, bytes).unwrap();
    fs::File::open(&path).unwrap().set_modified(std::time::UNIX_EPOCH).unwrap();
    robot
}

#[test]
fn a_segment_uploaded_in_parts_over_http_is_complete() {
    let whole = segment(1, 30, 700_000);
    let server = Server::start(Fault::None, &[]);
    let robot = robot(&whole);
    let report = upload(&server, robot.path()).unwrap();
    assert_eq!((report.files, report.bytes, report.unmarked), (1, whole.len() as u64, 0));
    let state = server.state.lock().unwrap();
    assert!(state.objects["kitchen/recording_0000.mcap"] == whole);
    let digest = &state.objects["kitchen/recording_0000.mcap.blake3"];
    assert!(digest.starts_with(Digest::of(&whole).to_string().as_bytes()));
}

#[test]
fn an_encrypted_segment_is_uploaded_in_parts_over_http_and_pulled_over_a_link_that_breaks() {
    let whole = segment(1, 30, 700_000);
    let server = Server::start(Fault::None, &[]);
    let robot = robot(&whole);
    let here = tempdir().unwrap();
    let (encrypting, decrypting) = encrypted::kitchen();
    let mut source = Directory::open(robot.path()).unwrap();
    let report = server
        .bucket()
        .with_keys(&encrypting)
        .upload(&mut source, &Options::default(), &mut VirtualClock::default(), &mut ())
        .unwrap();
    assert_eq!((report.files, report.bytes), (1, whole.len() as u64));
    server.state.lock().unwrap().fault = Fault::Cut;
    let mut breaks = 0;
    let mut bucket = server.bucket().with_keys(&decrypting);
    while let Err(error) = pull_into(&mut bucket, here.path(), Options::default()) {
        assert!(error.kind() == ErrorKind::Link, "{error}");
        breaks += 1;
        assert!(breaks < 100);
    }
    assert!(breaks > 0);
    assert!(fs::read(here.path().join("recording_0000.mcap")).unwrap() == whole);
}

#[test]
fn an_empty_object_in_the_place_of_an_encrypted_segment_is_named_and_the_others_are_pulled() {
    let objects = [
        ("kitchen/run/recording_0000.mcap.age", Vec::new()),
        ("kitchen/run/recording_0001.mcap", segment(1, SMALL, 100)),
    ];
    let server = Server::start(Fault::None, &objects);
    let here = tempdir().unwrap();
    let (_, decrypting) = encrypted::kitchen();
    let mut bucket = server.bucket().with_keys(&decrypting);
    let report = pull_into(&mut bucket, here.path(), Options::default()).unwrap();
    assert_eq!((report.files, report.unread.len()), (1, 1));
    assert!(report.unread[0].contains("run/recording_0000.mcap.age is damaged"), "{report:?}");
}

#[test]
fn an_upload_without_write_permission_fails_and_marks_nothing_on_the_robot() {
    let server = Server::start(Fault::ReadOnly, &[]);
    let robot = robot(&segment(1, SMALL, 100));
    let error = upload(&server, robot.path()).unwrap_err();
    assert!(error.to_string().contains("these credentials may not write there"), "{error}");
    assert_eq!(error.kind(), ErrorKind::Refused);
    assert!(!robot.path().join("recording_0000.mcap.pulled").exists());
}
