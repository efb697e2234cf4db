//! The server with a robot that only sends what the test says, and with clients that are not ours.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test that cannot set up its scene has failed"
)]

use std::net::SocketAddr;
use std::time::Duration;

use futures_util::{SinkExt, StreamExt};
use live_link::{Answer, Channel, Frame, Line, LineReader, Order, frame};
use live_view::access::{Access, Tokens, Transport};
use live_view::robot::Robot;
use live_view::server;
use runtime::operator::Role;
use serde_json::{Value, json};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::{TcpListener, TcpStream, UnixListener, UnixStream};
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::{Error, Message};
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async};

const TOKENS: &str = "anna steer aaaaaaaaaaaaaaaa1\nscreen watch bbbbbbbbbbbbbbbb2\n";
const PATIENCE: Duration = Duration::from_secs(30);

/// The robot's end of the socket.
struct FakeRobot {
    listener: UnixListener,
    stream: Option<UnixStream>,
    lines: LineReader,
    pending: Vec<Line>,
}

impl FakeRobot {
    async fn accept(&mut self) {
        let (mut stream, _) = within(self.listener.accept()).await.unwrap();
        let channels = Frame::Channels(vec![channel(0, "/robot/now"), channel(1, "/map")]);
        stream.write_all(&channels.to_bytes().unwrap()).await.unwrap();
        self.stream = Some(stream);
    }

    async fn send(&mut self, channel: u16, payload: &[u8]) {
        let bytes = frame::message(channel, 77, payload).unwrap();
        self.stream.as_mut().unwrap().write_all(&bytes).await.unwrap();
    }

    async fn line(&mut self) -> Line {
        loop {
            if !self.pending.is_empty() {
                return self.pending.remove(0);
            }
            let mut piece = [0; 4096];
            let count = within(self.stream.as_mut().unwrap().read(&mut piece)).await.unwrap();
            assert!(count > 0, "the view has closed the connection");
            let lines = self.lines.push(&piece[..count]);
            self.pending.extend(lines.into_iter().map(Result::unwrap));
        }
    }

    /// Waits until these channels are subscribed.
    async fn subscribed(&mut self, channels: &[u16]) {
        while self.line().await != Line::Subscribe(channels.to_vec()) {}
    }

    /// Waits for an order, accepts it, and returns its client and role.
    async fn order(&mut self, expected: Order) -> (String, Role) {
        loop {
            if let Line::Order(order) = self.line().await {
                assert_eq!(order.order, expected);
                let answer = Answer { id: order.id, accepted: true, text: "done".to_owned() };
                let bytes = Frame::Answer(answer).to_bytes().unwrap();
                self.stream.as_mut().unwrap().write_all(&bytes).await.unwrap();
                return (order.who, order.role);
            }
        }
    }
}

fn channel(id: u16, topic: &str) -> Channel {
    Channel {
        id,
        topic: topic.to_owned(),
        encoding: "json".to_owned(),
        schema_name: "x".to_owned(),
        schema_encoding: "jsonschema".to_owned(),
        schema: "{}".to_owned(),
    }
}

async fn within<T>(what: impl Future<Output = T>) -> T {
    tokio::time::timeout(PATIENCE, what).await.expect("it did not happen in time")
}

async fn serve(tokens: Option<&str>) -> (FakeRobot, SocketAddr, tempfile::TempDir) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("live.sock");
    let listener = UnixListener::bind(&path).unwrap();
    let mut robot =
        FakeRobot { listener, stream: None, lines: LineReader::default(), pending: Vec::new() };
    let web = TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = web.local_addr().unwrap();
    let tokens = tokens.map(|text| Tokens::parse(text).unwrap());
    let access = Access::new(address.ip(), Transport::Plain, tokens, Vec::new()).unwrap();
    tokio::spawn(server::serve(web, Robot::connect(&path), access));
    robot.accept().await;
    (robot, address, dir)
}

type Socket = WebSocketStream<MaybeTlsStream<TcpStream>>;

struct Client {
    socket: Socket,
}

impl Client {
    async fn connect(address: SocketAddr, query: &str) -> Self {
        Self { socket: connect(address, query, None).await.unwrap() }
    }

    async fn say(&mut self, message: Value) {
        self.socket.send(Message::Text(message.to_string().into())).await.unwrap();
    }

    async fn subscribe(&mut self, id: u32, channel: u32) {
        let subscriptions = json!([{"id": id, "channelId": channel}]);
        self.say(json!({"op": "subscribe", "subscriptions": subscriptions})).await;
    }

    async fn next(&mut self) -> Message {
        within(self.socket.next()).await.unwrap().unwrap()
    }

    /// The next text message with this `op`.
    async fn text(&mut self, op: &str) -> Value {
        loop {
            if let Message::Text(text) = self.next().await {
                let value: Value = serde_json::from_str(&text).unwrap();
                if value["op"] == op {
                    return value;
                }
            }
        }
    }

    async fn binary(&mut self) -> Vec<u8> {
        loop {
            if let Message::Binary(bytes) = self.next().await {
                return bytes.to_vec();
            }
        }
    }

    async fn call(&mut self, service: u32, payload: &str) {
        let mut bytes = vec![2];
        for number in [service, 9, 4] {
            bytes.extend_from_slice(&number.to_le_bytes());
        }
        bytes.extend_from_slice(b"json");
        bytes.extend_from_slice(payload.as_bytes());
        self.socket.send(Message::Binary(bytes.into())).await.unwrap();
    }
}

async fn connect(address: SocketAddr, query: &str, origin: Option<&str>) -> Result<Socket, u16> {
    let mut request = format!("ws://{address}/{query}").into_client_request().unwrap();
    let headers = request.headers_mut();
    headers.insert("sec-websocket-protocol", "foxglove.sdk.v1".parse().unwrap());
    if let Some(origin) = origin {
        headers.insert("origin", origin.parse().unwrap());
    }
    match within(connect_async(request)).await {
        Ok((socket, _)) => Ok(socket),
        Err(Error::Http(response)) => Err(response.status().as_u16()),
        Err(error) => panic!("{error}"),
    }
}

#[tokio::test]
async fn a_client_gets_the_messages_that_it_subscribed_and_its_calls_are_answered() {
    let (mut robot, address, _dir) = serve(None).await;
    let mut client = Client::connect(address, "").await;
    assert_eq!(client.text("serverInfo").await["metadata"]["role"], "steer");
    assert_eq!(client.text("advertise").await["channels"][1]["topic"], "/map");
    client.subscribe(40, 1).await;
    robot.subscribed(&[1]).await;
    robot.send(0, b"not wanted").await;
    robot.send(1, b"a map").await;
    let bytes = client.binary().await;
    assert_eq!(bytes[..5], [1, 40, 0, 0, 0]);
    assert_eq!((&bytes[5..13], &bytes[13..]), (&77u64.to_le_bytes()[..], &b"a map"[..]));

    client.call(1, "{}").await;
    let (who, role) = robot.order(Order::Stop).await;
    assert!(who.starts_with("127.0.0.1:") && role == Role::Steer);
    let response = client.binary().await;
    assert_eq!(response[..9], [3, 1, 0, 0, 0, 9, 0, 0, 0]);
    assert!(String::from_utf8_lossy(&response).contains("\"accepted\":true"));

    // What Foxglove's tool "publish" sends.
    client.say(json!({"op": "advertise", "channels": [{"id": 1, "topic": "/goal_pose", "encoding": "json",
        "schemaName": "geometry_msgs/PoseStamped"}]})).await;
    let pose = br#"{"pose":{"position":{"x":1.5,"y":-2.0,"z":0.0}}}"#;
    let published = [&[1, 1, 0, 0, 0], &pose[..]].concat();
    client.socket.send(Message::Binary(published.into())).await.unwrap();
    robot.order(Order::GoTo { x_m: 1.5, y_m: -2.0 }).await;
}

#[tokio::test]
async fn tokens_give_roles_and_strangers_get_nothing() {
    let (mut robot, address, _dir) = serve(Some(TOKENS)).await;
    for query in ["", "?token=", "?token=aaaaaaaaaaaaaaaa"] {
        assert_eq!(connect(address, query, None).await.err(), Some(401), "{query}");
    }
    let mut screen = Client::connect(address, "?token=bbbbbbbbbbbbbbbb2").await;
    assert_eq!(screen.text("serverInfo").await["metadata"]["role"], "watch");
    let services = screen.text("advertiseServices").await;
    assert_eq!(services["services"].as_array().unwrap().len(), 1);
    // A watcher that calls what it was not offered: the robot refuses and records it.
    screen.call(3, "{}").await;
    let (who, role) = robot.order(Order::Arm).await;
    assert!(who.starts_with("screen at 127.0.0.1:") && role == Role::Watch);
}

#[tokio::test]
async fn pages_of_other_origins_are_turned_away() {
    let (_robot, address, _dir) = serve(None).await;
    assert_eq!(connect(address, "", Some("https://evil.example")).await.err(), Some(403));
    let own = format!("http://{address}");
    assert!(connect(address, "", Some(&own)).await.is_ok());
}

#[tokio::test]
async fn ten_clients_see_the_robot_while_one_is_slow_and_one_sends_rubbish() {
    let (mut robot, address, _dir) = serve(None).await;
    let mut clients = Vec::new();
    for _ in 0..10 {
        let mut client = Client::connect(address, "").await;
        client.subscribe(1, 0).await;
        clients.push(client);
    }
    let mut slow = Client::connect(address, "").await;
    slow.subscribe(1, 1).await;
    robot.subscribed(&[0, 1]).await;
    let mut rude = Client::connect(address, "").await;
    for rubbish in ["", "{", "[1,2]", "{\"op\":7}", "{\"op\":\"subscribe\"}"] {
        rude.socket.send(Message::Text(rubbish.into())).await.unwrap();
        assert_eq!(rude.text("status").await["level"], 1);
    }
    // Too many of them, and too large a one.
    for _ in 0..500 {
        if rude.socket.send(Message::Binary(vec![2].into())).await.is_err() {
            break;
        }
    }
    let large = Message::Binary(vec![1; 1 << 20].into());
    let mut huge = Client::connect(address, "").await;
    let _ = huge.socket.send(large).await;

    for round in 0..40u8 {
        // The slow client never reads its megabytes.
        robot.send(1, &vec![round; 1 << 20]).await;
        robot.send(0, &[round]).await;
    }
    for client in &mut clients {
        let mut last = None;
        while last != Some(39) {
            last = client.binary().await.last().copied();
        }
    }
    for mut cut in [rude, huge] {
        while let Some(Ok(message)) = within(cut.socket.next()).await {
            if message.is_close() {
                break;
            }
        }
    }
}

#[tokio::test]
async fn a_client_that_answers_no_ping_is_gone_and_one_that_answers_stays() {
    let (mut robot, address, _dir) = serve(None).await;
    let mut silent = Client::connect(address, "").await;
    silent.subscribe(1, 1).await;
    robot.subscribed(&[1]).await;
    let mut good = Client::connect(address, "").await;
    good.subscribe(1, 0).await;
    robot.subscribed(&[0, 1]).await;
    // Its library answers pings while it waits for messages. The other one keeps its connection open and does nothing.
    let stays = tokio::spawn(async move { good.binary().await });
    robot.subscribed(&[0]).await;
    robot.send(0, b"still here").await;
    assert!(within(stays).await.unwrap().ends_with(b"still here"));
    drop(silent);
}

#[tokio::test]
async fn a_robot_that_goes_and_comes_back_is_announced() {
    let (mut robot, address, _dir) = serve(None).await;
    let mut client = Client::connect(address, "").await;
    client.text("removeStatus").await;
    client.subscribe(1, 0).await;
    robot.subscribed(&[0]).await;
    robot.stream = None;
    let status = client.text("status").await;
    assert_eq!((&status["level"], &status["id"]), (&json!(2), &json!("robot")));
    client.call(1, "{}").await;
    let failed = client.text("serviceCallFailure").await;
    assert!(failed["message"].as_str().unwrap().contains("did not reach the robot"), "{failed}");

    robot.accept().await;
    client.text("removeStatus").await;
    robot.subscribed(&[0]).await;
    robot.send(0, b"again").await;
    assert!(client.binary().await.ends_with(b"again"));
}

#[tokio::test]
async fn the_page_comes_with_headers_that_let_nothing_else_in() {
    let (_robot, address, _dir) = serve(None).await;
    for (path, host, expected) in [
        ("/", "127.0.0.1", "200 OK"),
        ("/app.js", "localhost", "200 OK"),
        ("/../Cargo.toml", "localhost", "404 Not Found"),
        ("/", "evil.example", "403 Forbidden"),
    ] {
        let mut stream = TcpStream::connect(address).await.unwrap();
        let request = format!("GET {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n");
        stream.write_all(request.as_bytes()).await.unwrap();
        let mut response = String::new();
        within(stream.read_to_string(&mut response)).await.unwrap();
        assert!(response.starts_with(&format!("HTTP/1.1 {expected}")), "{path}: {response}");
        if expected == "200 OK" {
            assert!(response.contains("content-security-policy: default-src 'none'"), "{response}");
        }
    }
}

#[test]
fn output_that_is_not_read_ends_the_program_with_no_panic() {
    let folder = tempfile::tempdir().unwrap();
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    // It prints where the layout is, and then finds its address taken.
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_live-view"))
        .args(["--listen", &taken.local_addr().unwrap().to_string(), "--robot"])
        .arg(folder.path().join("no-robot.sock"))
        .arg("--layout")
        .arg(folder.path().join("layout.json"))
        .stdout(writer)
        .stderr(std::process::Stdio::piped())
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("cannot listen at"), "{said}");
}
